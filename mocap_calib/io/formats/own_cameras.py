"""cameras.yaml, our own file of cameras, which carries all that is known of a rig.

Every float is written with as many digits as bring it back exactly.
"""

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import yaml

from mocap_calib.geometry.rotation import rig_size
from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras
from mocap_calib.io.document import Document, typed
from mocap_calib.io.file import unsigned_zeros
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields, read_judgement, round_sigma
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.types import ARBITRARY, Camera, CameraClock, CameraRig, ClockKind, EstimatedCamera

VERSION = 1
SUBFRAME = "clock_subframe_offset"  # of a camera: the part of a frame that comes to its offset
CONVENTION = "x_camera = R x_world + t; x right, y down, z forward; pixel centres are integers"
_NOT_ESCAPED = "[\x85\u2028\u2029]"  # line breaks that PyYAML reads back as spaces
_FORMAT = r"^format: *[\"']?mocap-calib cameras"
_EXPECTED = "name, size, K and a model of opencv, fisheye or pinhole"
_Table = Annotated[tuple[tuple[int, int], ...], msgspec.Meta(min_length=1)]
_Rate = Annotated[float, msgspec.Meta(gt=0, le=1e300)]
_Sigma = Annotated[float, msgspec.Meta(ge=0, le=1e300)]


class _Estimated(msgspec.Struct, forbid_unknown_fields=True):
    focal_sigma: _Sigma
    k1_sigma: _Sigma


class _Camera(msgspec.Struct):
    name: Any
    K: Any
    size: Any = None
    model: Literal["opencv", "fisheye", "pinhole"] = "opencv"
    distortion: Any = None
    principal_point_sigma: _Sigma | None = None
    focal_sigma: _Sigma | None = None
    estimated: _Estimated | msgspec.UnsetType = msgspec.UNSET
    R: Any = None
    t: Any = None
    clock_offset_frames: Any = None
    clock_rate: Any = 1.0

    def raw(self) -> RawCamera:
        """Return the camera unchecked; the model `pinhole` has no distortion."""
        return RawCamera(
            name=str(self.name),
            size=self.size,
            matrix=self.K,
            distortion=() if self.model == "pinhole" else self.distortion,
            fisheye=self.model == "fisheye",
            rotation=self.R,
            translation=self.t,
        )

    def mark(self, camera: Camera) -> Camera:
        """Return the camera with the uncertainties that are stated, or were estimated."""
        centre_sigma, focal_sigma = self.principal_point_sigma, self.focal_sigma
        camera = replace(camera, centre_sigma=centre_sigma, focal_sigma=focal_sigma)
        if self.estimated is msgspec.UNSET:
            return camera
        return EstimatedCamera.of(camera, **msgspec.structs.asdict(self.estimated))


class _Offset(msgspec.Struct):
    name: Any
    clock_subframe_offset: Annotated[float, msgspec.Meta(ge=-1e300, le=1e300)]


class _File(msgspec.Struct):
    cameras: list[_Camera]
    unit: Any = ""
    provenance: Any = None
    world: Any = None


def sniff(document: Document) -> bool:
    """Return whether the first field states that it is ours."""
    return document.syntax == "yaml" and re.search(_FORMAT, document.text, re.M) is not None


def read(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping()
    if data.get("version") != VERSION:
        found = f"version {data.get('version')}"
        expected = f"version {VERSION} of our cameras"
        raise document.refuse(expected, found, "use the program that wrote it")
    file = typed(data, _File, document.source, f"cameras with {_EXPECTED}")
    rig = collect_cameras(
        (each.raw() for each in file.cameras),
        document.source,
        unit=file.unit,
        provenance=file.provenance,
    )
    pairs = list(zip(file.cameras, rig.cameras, strict=True))
    clocks = (_read_clock(fields, camera.name) for fields, camera in pairs)
    return replace(
        rig,
        cameras=tuple(fields.mark(camera) for fields, camera in pairs),
        clocks=tuple(clock for clock in clocks if clock is not None),
        world=read_world(file.world),
    )


def camera_from_fields(fields: Any, source: str) -> Camera:
    """Return the camera that `camera_fields` wrote. Raises FormatError."""
    read = typed(fields, _Camera, source, f"a camera with {_EXPECTED}")
    camera, _ = read.raw().check(source)
    return read.mark(camera)


def camera_fields(camera: Camera) -> dict[str, Any]:
    """Return the fields of a camera in our own files."""
    sigmas: dict[str, Any] = {
        "principal_point_sigma": camera.centre_sigma,
        "focal_sigma": camera.focal_sigma,
    }
    if isinstance(camera, EstimatedCamera):
        sigmas |= {"focal_sigma": None, "estimated": estimated_fields(camera)}
    return {
        "name": camera.name,
        "size": list(camera.size),
        "model": "fisheye" if camera.fisheye else "opencv",
        "K": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        **{name: value for name, value in sigmas.items() if value is not None},
    }


def estimated_fields(camera: EstimatedCamera) -> dict[str, float]:
    """Return how sure the intrinsics of a camera are that were estimated from a recording."""
    return {"focal_sigma": camera.focal_sigma, "k1_sigma": camera.k1_sigma}


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the file, which carries all."""
    return Written({"cameras.yaml": format_cameras_yaml(rig, provenance).encode()})


def format_cameras_yaml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Return our own file: plain YAML, lengths in the rig's unit.

    provenance: whatever states how the rig came about. Its field clock_subframe_offset, by the
        names of cameras, is written beside each, and its field centre_sigma_percent as a length.
    """
    offsets = provenance.get(SUBFRAME, {})
    lengths = _centre_sigmas(rig, provenance)
    provenance = {key: provenance[key] for key in provenance if key != SUBFRAME}
    header = {
        "format": "mocap-calib cameras",
        "version": VERSION,
        "unit": rig.unit,
        **stated_world(rig.world, rig.unit),
        "convention": CONVENTION,
        "provenance": plain_fields(provenance),
    }
    cameras = []
    for view, camera in enumerate(rig.cameras):
        extrinsics: dict[str, Any] = {
            "R": rig.rotation[view].tolist(),
            "t": rig.translation[view].tolist(),
            "centre": rig.centres[view].tolist(),
        }
        if camera.name in lengths:
            extrinsics["centre_sigma"] = lengths[camera.name]
        part = {SUBFRAME: offsets[camera.name]} if camera.name in offsets else {}
        cameras.append(camera_fields(camera) | extrinsics | _clock_fields(rig, camera.name) | part)
    # flow style (None) puts the rows of a matrix on a line each
    return _dump_yaml(header, flow=False) + _dump_yaml({"cameras": cameras}, flow=None)


def _centre_sigmas(rig: CameraRig, provenance: Mapping[str, Any]) -> dict[str, float]:
    """Return how sure centres are as lengths, by the names of cameras; nothing where unknown.

    Percents are those of the size of a whole rig: they say nothing of a part of it, nor of cameras
    that stood elsewhere for some time.
    """
    judged = read_judgement(provenance)
    percent = judged.get("centre_sigma_percent", {})
    if rig.unit == ARBITRARY or set(percent) != set(rig.names) or "frames" in judged:
        return {}
    size = rig_size(rig)
    return {name: round_sigma(value / 100 * size) for name, value in percent.items()}


def _clock_fields(rig: CameraRig, camera: str) -> dict[str, Any]:
    """Return what is written of the clock of a camera, nothing where it is that of the others."""
    clock = next((each for each in rig.clocks if each.camera == camera), None)
    if clock is None or not clock.differs:
        return {}
    if clock.kind == "clock":
        return {"clock_offset_frames": clock.offset}
    table = [list(row) for row in clock.table]
    return {"clock_offset_frames": table, "clock_rate": float(clock.rate)}


def _read_clock(fields: _Camera, camera: str) -> CameraClock | None:
    """Return the clock that `_clock_fields` wrote, None where there is none that makes sense."""
    offset = fields.clock_offset_frames
    if type(offset) is int:
        return CameraClock(camera, "clock", offset)
    with suppress(msgspec.ValidationError):
        table = msgspec.convert(offset, _Table)
        rate = msgspec.convert(fields.clock_rate, _Rate)
        kind: ClockKind = "dropped" if rate == 1.0 else "rate"
        return CameraClock(camera, kind, table[0][1], rate, table)
    return None


def _dump_yaml(fields: Mapping[str, Any], *, flow: bool | None) -> str:
    """Return YAML, with all characters as they are unless PyYAML would change some."""
    unicode_as_is = not re.search(_NOT_ESCAPED, json.dumps(fields, ensure_ascii=False))
    return yaml.safe_dump(
        unsigned_zeros(fields),
        default_flow_style=flow,
        sort_keys=False,
        allow_unicode=unicode_as_is,
        width=160,
    )


def stored_provenance(path: Path) -> dict[str, Any]:
    """Return the provenance in a file of ours, and the offsets of the clocks beside it.

    It is what `write` takes. What was edited into something else is left out. Raises FormatError.
    """
    tree = Document(path).tree
    stored = tree if isinstance(tree, dict) else {}
    cameras, known = stored.get("cameras"), stored.get("provenance")
    offsets: dict[str, float] = {}
    for camera in cameras if isinstance(cameras, list) else ():
        with suppress(msgspec.ValidationError):
            offset = msgspec.convert(camera, _Offset)
            offsets[str(offset.name)] = offset.clock_subframe_offset
    return (known if isinstance(known, dict) else {}) | ({SUBFRAME: offsets} if offsets else {})


FORMAT = Format(
    name="mocap-calib",
    title="mocap-calib cameras.yaml",
    sniff=sniff,
    read=read,
    passed_over=("provenance", "world", "centre", "centre_sigma", SUBFRAME),
    write=write,
    endings=(".yaml", ".yml"),
)
