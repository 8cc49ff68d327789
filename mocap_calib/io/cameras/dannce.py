"""Label3D's and DANNCE's .mat, all cameras in one or a file for each: K and rotation for row vectors, as MATLAB has them."""

import io
import re
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from scipy.io import savemat

from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, numbers, skew_in_pixels
from mocap_calib.io.cameras.source import CameraFile, Source, terms, unique, without_sizes
from mocap_calib.io.file import malformed, one_line
from mocap_calib.io.mat5 import DAMAGE, read_mat
from mocap_calib.io.registry import Written
from mocap_calib.types import Camera, CameraRig, Floats

_FIELDS = ("K", "RDistort", "TDistort", "r", "t")
_SKEW = 1e-2  # of the focal length: MATLAB estimates it where it is noise
_REMEDY = "save params and camnames with `save -v7`"
_PER_CAMERA = r"(?:hires_)?(?P<camera>.+?)(?:_params)?"  # hires_cam1_params.mat


def sniff(source: Source) -> bool:
    """Any file that MATLAB wrote."""
    return source.syntax == "binary" and source.content.startswith(b"MATLAB")


def parse(source: Source) -> CameraFile:
    """The cells `params`, and `camnames` where there are any; or the fields of one camera, which the file's name names. Raises FormatError."""
    params, names = _load(source)
    cameras, extrinsics, notes = [], {}, []
    for number, fields in enumerate(params):
        name = names[number] if names else f"Camera{number + 1}"
        where = f"{source.path}: camera {name}"
        missing = [key for key in _FIELDS if key not in fields]
        if missing:
            raise malformed(
                where, f"the fields {', '.join(_FIELDS)}", f"none of {', '.join(missing)}", _REMEDY
            )
        matrix, note = _without_skew(numbers(fields["K"], "a 3 x 3 matrix K", where).T, name)
        radial, tangential = (
            numbers(fields[key], f"numbers {key}", where).reshape(-1)
            for key in ("RDistort", "TDistort")
        )
        if len(radial) not in (2, 3) or len(tangential) != 2:
            raise malformed(
                where,
                "2 or 3 RDistort and 2 TDistort",
                f"{len(radial)} and {len(tangential)}",
                "mend the distortion",
            )
        lens = np.concatenate([radial[:2], tangential, radial[2:]])
        cameras.append(make_camera(name, None, matrix, lens, False, where))
        extrinsics[name] = make_extrinsics(
            numbers(fields["r"], "a 3 x 3 rotation r", where).T, fields["t"], where
        )
        notes += note
    return CameraFile(unique(cameras, source.path), extrinsics, notes=tuple(notes))


def _load(source: Source) -> tuple[list[dict[str, Any]], list[str]]:
    """The fields of every camera, and the names. Raises FormatError."""
    if source.content.startswith(b"MATLAB 7.3"):
        raise malformed(source.path, "a .mat file of version 7 or below", "version 7.3", _REMEDY)
    try:
        found = read_mat(source.content, ("params", "camnames", *_FIELDS))
    except DAMAGE as error:
        raise malformed(
            source.path,
            "a .mat file of Label3D or DANNCE",
            f"an error ({one_line(error) or type(error).__name__})",
            _REMEDY,
        ) from None
    if "params" not in found and found.keys() >= set(_FIELDS):
        name = re.fullmatch(_PER_CAMERA, source.stem)
        return [found], [name["camera"] if name else source.stem]
    cells, called = found.get("params"), found.get("camnames", [])
    structs = (
        [cell[0] if isinstance(cell, list) and len(cell) == 1 else cell for cell in cells]
        if isinstance(cells, list)
        else []
    )
    params = [fields for fields in structs if isinstance(fields, dict)]
    names = [str(name).strip() for name in called] if isinstance(called, list) else []
    if not params or len(params) < len(structs) or len(names) not in (0, len(params)):
        expected = f"cells params, a camera each, and as many camnames; or {', '.join(_FIELDS)} of one camera"
        raise malformed(
            source.path,
            expected,
            f"{len(params)} and {len(names)}",
            "give the file that has the cameras",
        )
    return params, names


def _without_skew(matrix: Floats, name: str) -> tuple[Floats, list[str]]:
    """The matrix without a skew of noise, and a note of what that does at the edge of the image."""
    if matrix.shape != (3, 3) or not 0 < abs(matrix[0, 1]) < _SKEW * abs(matrix[0, 0]):
        return matrix, []
    plain = matrix.copy()
    plain[0, 1] = 0.0
    off = f"{skew_in_pixels(matrix):.1f} pixels at the edge of the image"
    return plain, [f"camera {name}: the skew {matrix[0, 1]:.2f} is left out, which is up to {off}"]


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """`params` and `camnames`. Raises MismatchError."""
    params, names = (
        np.empty((len(rig.cameras), 1), dtype=object),
        np.empty((1, len(rig.cameras)), dtype=object),
    )
    for v, camera in enumerate(rig.cameras):
        params[v, 0] = _params(camera, rig.rotation[v], rig.translation[v])
        names[0, v] = camera.name
    file = io.BytesIO()
    savemat(cast(Any, file), {"params": params, "camnames": names})
    content = re.sub(
        rb"\AMATLAB 5.0 MAT-file.{96}",
        b"MATLAB 5.0 MAT-file".ljust(115),
        file.getvalue(),
        flags=re.S,
    )  # it has the time
    return Written({"label3d_dannce.mat": content}, without_sizes(rig))


def _params(camera: Camera, rotation: Floats, translation: Floats) -> dict[str, Floats]:
    k1, k2, p1, p2, k3 = terms(camera, 5, "dannce").tolist()
    lens = {"RDistort": np.array([[k1, k2, k3]]), "TDistort": np.array([[p1, p2]])}
    return {
        "K": camera.matrix.T.copy(),
        **lens,
        "r": rotation.T.copy(),
        "t": translation[None].copy(),
    }
