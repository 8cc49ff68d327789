"""A numpy archive of the arrays of `Poses3D`, for scripts; it carries all.

`numpy.load` reads it: positions, error, views, confidence, frames, and keypoints, individuals, fps,
unit and title; covariance where that is known, source, raw where it is not the positions, and
world, as JSON, where that is known.
Pickled objects, which could run anything, are not read.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import damage_refused, most_unpacked
from mocap_calib.io.poses import PoseFile
from mocap_calib.io.units import known_unit
from mocap_calib.io.world_fields import read_world, world_fields
from mocap_calib.results import Poses3D
from mocap_calib.types import check_shape

_ARRAYS = ("positions", "error", "views", "confidence", "frames")
_COVARIANCE = "covariance"  # where it is known
_RAW = "raw"  # where the positions are more than the triangulated points
_SOURCE = "source"
_WORLD = "world"
_ZIP = b"PK\x03\x04"


def sniff(document: Document) -> bool:
    """Return whether this is a zip archive."""
    return document.start.startswith(_ZIP)


def read(document: Document) -> PoseFile:
    """Read the arrays. Raises FormatError."""
    with damage_refused(document.source, f"an .npz of poses ({', '.join(_ARRAYS)}, ...)"):
        check_sizes(document.content, document.source)
        with np.load(io.BytesIO(document.content), allow_pickle=False) as file:
            poses = Poses3D(
                keypoints=tuple(map(str, file["keypoints"])),
                frames=file["frames"].astype(np.int64, casting="safe"),
                positions=file["positions"].astype(np.float64),
                error=file["error"].astype(np.float64),
                views=file["views"].astype(np.int64, casting="safe"),
                confidence=file["confidence"].astype(np.float64),
                unit=known_unit(str(file["unit"]), document.source),
                covariance=_read_if_there(file, _COVARIANCE).astype(np.float32),
                raw=_read_if_there(file, _RAW).astype(np.float64),
                source=_read_if_there(file, _SOURCE).astype(np.int8),
                world=read_world(json.loads(str(file[_WORLD])) if _WORLD in file else None),
            )
            individuals = tuple(map(str, file["individuals"]))
            rate = float(file["fps"])
        _check_shapes(poses, individuals)
        return PoseFile(poses, rate, individuals)


def check_sizes(content: bytes, source: str) -> None:
    """Raise FormatError for an archive whose arrays unpack to far more than they take in it."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for part in archive.infolist():
            most = most_unpacked(part.compress_size)
            if part.file_size > most:
                raise FormatError(
                    source,
                    f"at most {most / 1e6:.0f} MB of `{part.filename}` in the "
                    f"{part.compress_size / 1e6:.1f} MB stored",
                    f"{part.file_size / 1e6:.0f} MB",
                    "the file is damaged, or nearly all of it is missing points",
                )


def _read_if_there(file: Mapping[str, Any], name: str) -> NDArray[Any]:
    """Return an array, an empty one where a file does not have it."""
    return np.asarray(file[name]) if name in file else np.zeros(0)


def _check_shapes(poses: Poses3D, individuals: tuple[str, ...]) -> None:
    """Raise ValueError where the arrays are not of one shape, or not of their names."""
    shape = (len(poses.frames), len(individuals), len(poses.keypoints))
    check_shape("positions", poses.positions, *shape, 3)
    check_shape("error", poses.error, *shape)
    check_shape("views", poses.views, *shape)
    check_shape("confidence", poses.confidence, *shape)


def write(file: PoseFile, title: str) -> bytes:
    """Write the archive."""
    arrays: dict[str, Any] = {name: getattr(file.poses, name) for name in _ARRAYS}
    if np.isfinite(file.poses.covariance).any():
        arrays[_COVARIANCE] = file.poses.covariance
    if file.poses.raw is not file.poses.positions:
        arrays[_RAW] = file.poses.raw
    arrays[_SOURCE] = file.poses.source
    if file.poses.world.kind != "not known":
        arrays[_WORLD] = np.array(json.dumps(world_fields(file.poses.world, file.poses.unit)))
    content = io.BytesIO()
    np.savez_compressed(
        content,
        **arrays,
        keypoints=np.array(file.poses.keypoints, dtype=str),
        individuals=np.array(file.individuals, dtype=str),
        fps=np.array(file.rate),
        unit=np.array(file.poses.unit),
        title=np.array(title),
    )
    return content.getvalue()


POSES = Format(
    name="npz",
    title="numpy archive",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".npz",),
)
