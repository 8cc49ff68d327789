"""Our own files of 3D poses, which carry all: poses3d.h5, and a numpy archive for scripts.

Datasets: position `[frame, individual, keypoint, 3]`, error, views, confidence, source `[frame,
individual, keypoint]`, frames `[frame]`, keypoint_names `[keypoint]`; covariance `[frame,
individual, keypoint, 6]`, position_raw where that is not the position, individual_names
`[individual]`, keypoint_joints `[keypoint]` and edges `[edge, 2]` where they are known. Each says
its axes, its unit and its meaning in attributes; the file its rate (`fps`) where that is known.

The archive, which `numpy.load` reads, has the arrays of `Poses3D` by their names, and keypoints,
individuals, fps, unit, title, and the world, as JSON, where that is known. Pickled objects, which
could run anything, are not read.
"""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.io import hdf5
from mocap_calib.io.atomic import replace_file
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.poses import PoseFile, is_hdf5_that
from mocap_calib.io.units import known_unit
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import check_shape

VERSION = 1
# arrays of `Poses3D`: what they are made of; those behind `frames` may be absent
_KINDS = {
    "positions": np.float64,
    "error": np.float64,
    "views": np.int64,
    "confidence": np.float64,
    "frames": np.int64,
    "covariance": np.float32,
    "raw": np.float64,
    "source": np.int8,
}
_NEEDED = tuple(_KINDS)[:5]
_DATASET_OF = {"positions": "position", "raw": "position_raw"}  # others have their names
_WORLD = "world"
_FORMAT = "mocap-calib poses"
_POINTS = "frame, individual, keypoint"
_PLACES = f"{_POINTS}, coordinate (x, y, z)"
# dataset -> its axes, its unit ({} = that of the poses), and what it means
_DATASETS = {
    "position": (
        _PLACES,
        "{}",
        "3D position in the world that the cameras stand in, the best estimate; NaN = missing",
    ),
    "position_raw": (
        _PLACES,
        "{}",
        "the triangulated point, which the best estimate was made from; NaN = missing",
    ),
    "source": (
        _POINTS,
        "code",
        "what the position is made of: "
        + ", ".join(f"{code} = {source}" for code, source in enumerate(POINT_SOURCES)),
    ),
    "error": (
        _POINTS,
        "pixel",
        "RMS reprojection error of the triangulated point over the views used; NaN = missing or "
        "not known",
    ),
    "views": (_POINTS, "views", "number of views that the point was triangulated from"),
    "confidence": (
        _POINTS,
        "0 to 1",
        "mean confidence of the detections used; NaN = missing or not known",
    ),
    "covariance": (
        f"{_POINTS}, entry (xx, xy, xz, yy, yz, zz)",
        "{}^2",
        "covariance of the position, as far as it is due to the detectors' noise; NaN = missing",
    ),
    "frames": ("frame", "frame number", "number of each frame, as the keypoint files have it"),
    "keypoint_names": ("keypoint", "name", "name of each keypoint"),
    "keypoint_joints": (
        "keypoint",
        "name",
        "joint that each keypoint was said to be; empty = none",
    ),
    "individual_names": ("individual", "name", "name of each individual"),
    "edges": (
        "edge, end",
        "index of a keypoint",
        "pairs of keypoints that the skeleton joins, counted from 0: lines to draw",
    ),
}


def sniff(document: Document) -> bool:
    """Return whether the attribute `format` says that it is ours."""
    return is_hdf5_that(document, lambda file: file.attrs.get("format") == _FORMAT)


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses, the names of the individuals, the rate, the edges and the joints.

    Raises FormatError.
    """
    source = document.source
    with hdf5.opened_hdf5(document, f"{_FORMAT}, version {VERSION}") as file:
        format, version = file.attrs["format"], file.attrs["version"]
        if format != _FORMAT or version != VERSION:
            raise ValueError(f"format {format}, version {version}")
        names = {field: _DATASET_OF.get(field, field) for field in _KINDS}
        arrays = {}
        for field, name in names.items():
            if name in file or field in _NEEDED:
                read = hdf5.integers if _KINDS[field] is np.int64 else hdf5.array
                arrays[field] = read(file, name, source)
        poses = _make_poses(
            arrays,
            keypoints=hdf5.names(file, "keypoint_names", source),
            unit=str(file.attrs["unit"]),
            world=file.attrs.get(_WORLD, "null"),
        )
        no_edges = np.zeros((0, 2), dtype=np.int64)
        edges = hdf5.integers(file, "edges", source) if "edges" in file else no_edges
        check_shape("edges", edges, None, 2)
        return PoseFile(
            poses,
            float(file.attrs.get("fps", np.nan)),
            hdf5.names_if_there(file, "individual_names", source),
            edges=tuple(map(tuple, edges.tolist())),
            joints=hdf5.names_if_there(file, "keypoint_joints", source),
        )


def _make_poses(
    arrays: Mapping[str, NDArray[Any]], *, keypoints: Sequence[str], unit: str, world: str
) -> Poses3D:
    """Return the poses of arrays by their names. Raises TypeError for numbers of another kind.

    world: as JSON.
    """
    cast: dict[str, Any] = {
        name: array.astype(_KINDS[name], casting="same_kind") for name, array in arrays.items()
    }
    return Poses3D(
        keypoints=tuple(keypoints), unit=unit, world=read_world(json.loads(world)), **cast
    )


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
    with replace_file(path) as work, hdf5.created_hdf5(work) as file:
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
    arrays = {_DATASET_OF.get(name, name): array for name, array in _known_arrays(poses).items()}
    if given.edges:
        arrays["edges"] = np.array(given.edges, dtype=np.int64)
    for name, array in arrays.items():
        hdf5.write_packed(file, name, array)
    hdf5.write_names(file, "keypoint_names", poses.keypoints)
    for name, words in (("keypoint_joints", given.joints), ("individual_names", individuals)):
        if words:
            hdf5.write_names(file, name, words)
    for name, dataset in file.items():
        axes, unit, meaning = _DATASETS[name]
        dataset.attrs["axes"] = axes
        dataset.attrs["unit"] = unit.format(poses.unit)
        dataset.attrs["meaning"] = meaning
    file.attrs["format"] = _FORMAT
    file.attrs["version"] = VERSION
    file.attrs["unit"] = poses.unit
    file.attrs.update(_spell_world(poses))
    file.attrs["dimensions"] = "frame, individual, keypoint, coordinate"
    if np.isfinite(given.rate):
        file.attrs["fps"] = file["frames"].attrs["fps"] = given.rate
    file.attrs["provenance"] = json.dumps(provenance, default=str)


def _known_arrays(poses: Poses3D) -> dict[str, NDArray[Any]]:
    """Return the arrays of poses by their names, but for those that are not known."""
    arrays = {name: getattr(poses, name) for name in _KINDS}
    covariance = poses.covariance
    blocks = mapped.frame_slices(len(covariance))
    if not any(np.isfinite(covariance[block]).any() for block in blocks):
        del arrays["covariance"]
    if poses.raw is poses.positions:
        del arrays["raw"]
    return arrays


def _spell_world(poses: Poses3D) -> dict[str, str]:
    """Return the world as JSON by its name, nothing where it is not known."""
    stated = stated_world(poses.world, poses.unit)
    return {name: json.dumps(fields) for name, fields in stated.items()}


# --- the archive


def sniff_archive(document: Document) -> bool:
    """Return whether this is a zip archive."""
    return document.start.startswith(b"PK\x03\x04")


def read_archive(document: Document) -> PoseFile:
    """Read the arrays. Raises FormatError."""
    source = document.source
    with hdf5.damage_refused(source, f"an .npz of poses ({', '.join(_NEEDED)}, ...)"):
        hdf5.check_archive(document.content, source)
        with np.load(io.BytesIO(document.content), allow_pickle=False) as file:
            poses = _make_poses(
                {name: file[name] for name in _KINDS if name in file or name in _NEEDED},
                keypoints=list(map(str, file["keypoints"])),
                unit=known_unit(str(file["unit"]), source),
                world=str(file[_WORLD]) if _WORLD in file else "null",
            )
            return PoseFile(poses, float(file["fps"]), tuple(map(str, file["individuals"])))


def write_archive(file: PoseFile, title: str) -> bytes:
    """Write the archive."""
    texts = {
        **_spell_world(file.poses),
        "keypoints": file.poses.keypoints,
        "individuals": file.individuals,
        "unit": file.poses.unit,
        "title": title,
    }
    arrays: dict[str, Any] = {name: np.array(words, dtype=str) for name, words in texts.items()}
    arrays |= _known_arrays(file.poses) | {"fps": np.array(file.rate)}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    return content.getvalue()


POSES = Format(
    name="poses-h5",
    title="mocap-calib poses3d.h5",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".h5",),
)
ARCHIVE = Format(
    name="npz",
    title="numpy archive",
    sniff=sniff_archive,
    read=read_archive,
    write=write_archive,
    endings=(".npz",),
)
