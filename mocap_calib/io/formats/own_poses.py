"""poses3d.h5, our own file of 3D poses, which carries all.

Datasets: position `[frame, individual, keypoint, 3]`, error, views, confidence, source `[frame,
individual, keypoint]`, frames `[frame]`, keypoint_names `[keypoint]`; covariance `[frame,
individual, keypoint, 6]`, position_raw where that is not the position, individual_names
`[individual]`, keypoint_joints `[keypoint]` and edges `[edge, 2]` where they are known. Each says
its axes, its unit and its meaning in attributes; the file its rate (`fps`) where that is known.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.errors import FormatError
from mocap_calib.io import hdf5
from mocap_calib.io.atomic import replace_file
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5_packed import write_packed
from mocap_calib.io.poses import PoseFile, attribute, is_hdf5_that, opened_hdf5
from mocap_calib.io.world_fields import read_world, world_fields
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import check_shape

VERSION = 1
_FORMAT = "mocap-calib poses"
_POINTS = "frame, individual, keypoint"
_SQUARE = "^2"
_REMEDY = "write the file again"


@dataclass(frozen=True)
class _Dataset:
    """What the attributes of a dataset say.

    unit: empty where it is that of the poses, `_SQUARE` where it is that squared.
    """

    axes: str
    unit: str
    meaning: str


_DATASETS = {
    "position": _Dataset(
        f"{_POINTS}, coordinate (x, y, z)",
        "",
        "3D position in the world that the cameras stand in, the best estimate; NaN = missing",
    ),
    "position_raw": _Dataset(
        f"{_POINTS}, coordinate (x, y, z)",
        "",
        "the triangulated point, which the best estimate was made from; NaN = missing",
    ),
    "source": _Dataset(
        _POINTS,
        "code",
        "what the position is made of: "
        + ", ".join(f"{code} = {source}" for code, source in enumerate(POINT_SOURCES)),
    ),
    "error": _Dataset(
        _POINTS,
        "pixel",
        "RMS reprojection error of the triangulated point over the views used; NaN = missing or "
        "not known",
    ),
    "views": _Dataset(_POINTS, "views", "number of views that the point was triangulated from"),
    "confidence": _Dataset(
        _POINTS, "0 to 1", "mean confidence of the detections used; NaN = missing or not known"
    ),
    "covariance": _Dataset(
        f"{_POINTS}, entry (xx, xy, xz, yy, yz, zz)",
        _SQUARE,
        "covariance of the position, as far as it is due to the detectors' noise; NaN = missing",
    ),
    "frames": _Dataset(
        "frame", "frame number", "number of each frame, as the keypoint files have it"
    ),
    "keypoint_names": _Dataset("keypoint", "name", "name of each keypoint"),
    "keypoint_joints": _Dataset(
        "keypoint", "name", "joint that each keypoint was said to be; empty = none"
    ),
    "individual_names": _Dataset("individual", "name", "name of each individual"),
    "edges": _Dataset(
        "edge, end",
        "index of a keypoint",
        "pairs of keypoints that the skeleton joins, counted from 0: lines to draw",
    ),
}


def sniff(document: Document) -> bool:
    """Return whether the attribute `format` says that it is ours."""
    return is_hdf5_that(document, lambda file: attribute(file.attrs, "format") == _FORMAT)


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses, the names of the individuals, the rate, the edges and the joints.

    Raises FormatError.
    """
    source = document.source
    with opened_hdf5(document, f"{_FORMAT}, version {VERSION}") as file:
        poses = _read_poses(file, source)
        individuals, joints = (
            hdf5.names(file, name, source) if name in file else ()
            for name in ("individual_names", "keypoint_joints")
        )
        if joints and len(joints) != len(poses.keypoints):
            expected = f"a joint for each of the {len(poses.keypoints)} keypoints"
            raise FormatError(source, expected, len(joints), _REMEDY)
        rate = float(file.attrs.get("fps", np.nan))
        edges = _read_edges(file, len(poses.keypoints), source)
        return PoseFile(poses, rate, individuals, edges=edges, joints=joints)


def _read_poses(file: h5py.File, source: str) -> Poses3D:
    """Read the datasets. Raises FormatError, and what h5py raises on damage."""
    format, version = file.attrs["format"], file.attrs["version"]
    if format != _FORMAT or version != VERSION:
        raise ValueError(f"format {format}, version {version}")
    poses = Poses3D(
        keypoints=hdf5.names(file, "keypoint_names", source),
        frames=hdf5.integers(file, "frames", source),
        positions=hdf5.array(file, "position", source).astype(np.float64),
        error=hdf5.array(file, "error", source).astype(np.float64),
        views=hdf5.integers(file, "views", source),
        confidence=hdf5.array(file, "confidence", source).astype(np.float64),
        unit=str(file.attrs["unit"]),
        covariance=_read_if_there(file, "covariance", source).astype(np.float32),
        raw=_read_if_there(file, "position_raw", source).astype(np.float64),
        source=_read_if_there(file, "source", source).astype(np.int8),
        world=read_world(json.loads(file.attrs["world"]) if "world" in file.attrs else None),
    )
    check_shape("position", poses.positions, len(poses.frames), None, len(poses.keypoints), 3)
    for name in ("error", "views", "confidence"):
        check_shape(name, getattr(poses, name), *poses.positions.shape[:3])
    return poses


def _read_if_there(file: h5py.File, name: str, source: str) -> NDArray[Any]:
    """Return a dataset, an empty array where a file does not have it."""
    return hdf5.array(file, name, source) if name in file else np.zeros(0)


def _read_edges(file: h5py.File, keypoints: int, source: str) -> tuple[tuple[int, int], ...]:
    """Return pairs of keypoints (indices), none where the file has none. Raises FormatError."""
    if "edges" not in file:
        return ()
    edges = hdf5.integers(file, "edges", source)
    check_shape("edges", edges, None, 2)
    if edges.size and not 0 <= edges.min() <= edges.max() < keypoints:
        expected = f"edges between the {keypoints} keypoints, counted from 0"
        raise FormatError(source, expected, f"{edges.min()} to {edges.max()}", _REMEDY)
    return tuple((int(a), int(b)) for a, b in edges)


def stored_provenance(path: Path) -> dict[str, Any]:
    """Return the provenance in a file of ours, nothing where it was edited."""
    with h5py.File(path, "r") as file:
        text = file.attrs.get("provenance", "{}")
    try:
        found = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


# --- writing


def write_poses_h5(path: Path, poses: PoseFile, provenance: Mapping[str, Any]) -> None:
    """Write poses of numbered individuals, whole or not at all, without a copy in memory."""
    with replace_file(path) as work, h5py.File(work, "w") as file:
        _fill(file, poses, provenance)


def write(poses: PoseFile, title: str) -> bytes:
    """Return a file with the names of the individuals; a title becomes its provenance."""
    with h5py.File("poses", "w", driver="core", backing_store=False) as file:
        _fill(file, poses, {"title": title} if title else {}, individuals=poses.individuals)
        file.flush()
        content: bytes = file.id.get_file_image()
    return content


def _fill(
    file: h5py.File,
    given: PoseFile,
    provenance: Mapping[str, Any],
    individuals: Sequence[str] = (),
) -> None:
    """Fill an HDF5 file. No times are written: they would change its bytes."""
    poses = given.poses
    arrays = {
        "position": poses.positions,
        "error": poses.error,
        "views": poses.views,
        "confidence": poses.confidence,
        "source": poses.source,
        "frames": poses.frames,
    }
    if poses.raw is not poses.positions:
        arrays["position_raw"] = poses.raw
    if _any_known(poses.covariance):
        arrays["covariance"] = poses.covariance
    if given.edges:
        arrays["edges"] = np.array(given.edges, dtype=np.int64)
    for name, array in arrays.items():
        write_packed(file, name, array)
    texts = {
        "keypoint_names": poses.keypoints,
        "keypoint_joints": given.joints,
        "individual_names": individuals,
    }
    for name, words in texts.items():
        if words or name == "keypoint_names":
            hdf5.write_names(file, name, words)
    for name, dataset in file.items():
        dataset.attrs["axes"] = _DATASETS[name].axes
        unit = _DATASETS[name].unit
        dataset.attrs["unit"] = unit if unit not in ("", _SQUARE) else poses.unit + unit
        dataset.attrs["meaning"] = _DATASETS[name].meaning
    file.attrs["format"] = _FORMAT
    file.attrs["version"] = VERSION
    file.attrs["unit"] = poses.unit
    if poses.world.kind != "not known":
        file.attrs["world"] = json.dumps(world_fields(poses.world, poses.unit))
    file.attrs["dimensions"] = "frame, individual, keypoint, coordinate"
    if np.isfinite(given.rate):
        file.attrs["fps"] = file["frames"].attrs["fps"] = given.rate
    file.attrs["provenance"] = json.dumps(provenance, default=str)


def _any_known(array: NDArray[Any]) -> bool:
    """Return whether any number of an array `[frame, ...]` is finite."""
    return any(np.isfinite(array[block]).any() for block in mapped.frame_slices(len(array)))


POSES = Format(
    kind="poses",
    name="poses-h5",
    title="mocap-calib poses3d.h5",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".h5",),
)
