"""Kalibr's camchain: each camera from the one before; cam0 is the world. Read only."""

import numpy as np

from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras.source import CameraFile, Source, entries, need, unique
from mocap_calib.io.file import malformed
from mocap_calib.types import Camera, Floats

_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution")


def sniff(source: Source) -> bool:
    """Cameras with a list of intrinsics."""
    if (
        source.syntax != "yaml"
        or "intrinsics" not in source.text
        or not isinstance(source.tree, dict)
    ):
        return False
    return bool(source.tree) and all(
        isinstance(fields, dict) and "intrinsics" in fields for fields in source.tree.values()
    )


def parse(source: Source) -> CameraFile:
    """T_cn_cnm1 of camN is `camN from camN-1`; a camera after a gap in the chain has no extrinsics. Raises FormatError."""
    cameras, extrinsics = [], {}
    chain: Floats | None = np.eye(4)
    found = entries(source.tree, "cameras cam0, cam1, ...", source.path)
    for name, fields in sorted(found, key=lambda each: (len(each[0]), each[0])):
        where = f"{source.path}: camera {name}"
        cameras.append(_camera(name, fields, where))
        if len(cameras) > 1:
            step = fields.get("T_cn_cnm1")
            chain = None if step is None or chain is None else _transform(step, where) @ chain
        if chain is not None:
            extrinsics[name] = make_extrinsics(chain[:3, :3], chain[:3, 3], where)
    return CameraFile(unique(cameras, source.path), extrinsics)


def _camera(name: str, fields: dict[str, object], where: str) -> Camera:
    need(fields, _KEYS, where)
    model, lens = str(fields["camera_model"]), str(fields["distortion_model"])
    if model != "pinhole" or lens not in ("radtan", "equidistant", "none"):
        raise malformed(
            where,
            "the models pinhole and radtan, equidistant or none",
            f"{model} and {lens}",
            "calibrate with one of them",
        )
    values = numbers(fields["intrinsics"], "intrinsics [fu, fv, pu, pv]", where).reshape(-1)
    if len(values) != 4:
        raise malformed(where, "intrinsics [fu, fv, pu, pv]", f"{len(values)} numbers", "mend them")
    fu, fv, pu, pv = values.tolist()
    return make_camera(
        name,
        fields["resolution"],
        [[fu, 0, pu], [0, fv, pv], [0, 0, 1]],
        fields["distortion_coeffs"],
        lens == "equidistant",
        where,
    )


def _transform(value: object, where: str) -> Floats:
    step = numbers(value, "a 4 x 4 transform T_cn_cnm1", where)
    if step.shape != (4, 4) or not np.isfinite(step).all():
        raise malformed(
            where, "a finite 4 x 4 transform T_cn_cnm1", f"shape {step.shape}", "mend it"
        )
    make_extrinsics(step[:3, :3], step[:3, 3], where)
    return step
