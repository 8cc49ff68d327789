"""poses3d.h5: the 3D poses of all individuals.

Datasets: position `[frame, individual, keypoint, 3]`, error, views, confidence, source `[frame,
individual, keypoint]`, frames `[frame]`, keypoint_names `[keypoint]`; covariance `[frame,
individual, keypoint, 6]`, position_raw where that is not the position, individual_names
`[individual]`, keypoint_joints `[keypoint]` and edges `[edge, 2]` where they are known. Each says
its axes, its unit and its meaning in attributes.
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
from mocap_calib.io import hdf5
from mocap_calib.io.atomic import replace_file
from mocap_calib.io.document import Document
from mocap_calib.io.hdf5_packed import write_packed
from mocap_calib.io.world_fields import read_world, world_fields
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import World, check_shape

VERSION = 1
Edges = Sequence[tuple[int, int]]
_FORMAT = "mocap-calib poses"
_POINTS = "frame, individual, keypoint"
_SQUARE = "^2"


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


def write_poses_h5(
    path: Path,
    poses: Poses3D,
    provenance: Mapping[str, Any],
    *,
    edges: Edges = (),
    fps: float = np.nan,
    joints: Sequence[str] = (),
) -> None:
    """Write what `poses_to_h5` gives, whole or not at all, and without a copy of it in memory."""
    with replace_file(path) as work, h5py.File(work, "w") as file:
        _fill(file, poses, provenance, edges=edges, fps=fps, joints=joints)


def poses_to_h5(
    poses: Poses3D,
    provenance: Mapping[str, Any],
    *,
    edges: Edges = (),
    fps: float = np.nan,
    individuals: Sequence[str] = (),
    joints: Sequence[str] = (),
) -> bytes:
    """Return the poses as HDF5; the same arguments give the same bytes.

    edges: pairs of keypoints (indices) that a skeleton joins.
    fps: frames per second, NaN where it is not known.
    individuals: `[individual]` names. joints: `[keypoint]` of each keypoint, where its name does
        not say so.
    """
    with h5py.File("poses", "w", driver="core", backing_store=False) as file:
        _fill(
            file,
            poses,
            provenance,
            edges=edges,
            fps=fps,
            individuals=individuals,
            joints=joints,
        )
        file.flush()
        content: bytes = file.id.get_file_image()
    return content


def read_poses_h5(document: Document) -> Poses3D:
    """Return the poses in a file that `poses_to_h5` or `write_poses_h5` wrote.

    Raises FormatError. Call it through `io.poses.read`, which guards against crashes.
    """
    try:
        poses = _read(document.hdf5, document.source)
        check_shape("position", poses.positions, len(poses.frames), None, len(poses.keypoints), 3)
        shape = poses.positions.shape[:3]
        check_shape("error", poses.error, *shape)
        check_shape("views", poses.views, *shape)
        check_shape("confidence", poses.confidence, *shape)
    except hdf5.HDF5_DAMAGE as damage:
        raise document.refuse(
            f"{_FORMAT}, version {VERSION}", f"an error ({damage})", "write the file again"
        ) from None
    return poses


def _fill(
    file: h5py.File,
    poses: Poses3D,
    provenance: Mapping[str, Any],
    *,
    edges: Edges,
    fps: float,
    individuals: Sequence[str] = (),
    joints: Sequence[str] = (),
) -> None:
    """Fill an HDF5 file. No times are written: they would change its bytes."""
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
    if edges:
        arrays["edges"] = np.array(edges, dtype=np.int64)
    for name, array in arrays.items():
        write_packed(file, name, array)
    _write_names(file, "keypoint_names", poses.keypoints)
    if joints:
        _write_names(file, "keypoint_joints", joints)
    if individuals:
        _write_names(file, "individual_names", individuals)
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
    if np.isfinite(fps):
        file.attrs["fps"] = file["frames"].attrs["fps"] = fps
    file.attrs["provenance"] = json.dumps(provenance, default=str)


def _any_known(array: NDArray[Any]) -> bool:
    """Return whether any number of an array `[frame, ...]` is finite."""
    return any(np.isfinite(array[block]).any() for block in mapped.frame_slices(len(array)))


def _write_names(file: h5py.File, dataset: str, names: Sequence[str]) -> None:
    texts = np.array(tuple(names), dtype=object)
    file.create_dataset(dataset, data=texts, dtype=h5py.string_dtype(), track_times=False)


def _read(file: h5py.File, source: str) -> Poses3D:
    """Read the datasets. Raises FormatError, and what h5py raises on damage."""
    format, version = file.attrs["format"], file.attrs["version"]
    if format != _FORMAT or version != VERSION:
        raise ValueError(f"format {format}, version {version}")
    return Poses3D(
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
        world=_read_world(file),
    )


def _read_world(file: h5py.File) -> World:
    """Return what the attribute `world` says, that nothing is known where there is none."""
    return read_world(json.loads(file.attrs["world"]) if "world" in file.attrs else None)


def _read_if_there(file: h5py.File, name: str, source: str) -> NDArray[Any]:
    """Return a dataset, an empty array where a file does not have it."""
    return hdf5.array(file, name, source) if name in file else np.zeros(0)
