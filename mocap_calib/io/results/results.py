"""Writing and reading what a run finds: matches, 3D poses, and the pairs."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io import hdf5
from mocap_calib.io.atomic import replacing
from mocap_calib.io.cameras.intrinsics import camera_fields, camera_from_fields, numbers, one_field
from mocap_calib.io.file import decode, malformed, one_line, read_bytes
from mocap_calib.io.keypoints.document import HDF5_DAMAGE
from mocap_calib.types import (
    Bools,
    Camera,
    Floats,
    Ints,
    Matches,
    PairwiseCalibration,
    Poses3D,
    Recording,
    check_shape,
)

VERSION = 1
_PIECE = 4096  # frames
_MATCH_COLUMNS = ["camera", "frame", "instance", "individual"]


# --- matches.csv


def matches_csv(recording: Recording, matches: Matches) -> Iterator[str]:
    """CSV, in pieces, with a row per detection: camera name, frame number, instance (order in the file), individual (-1 = nobody)."""
    yield _csv_line(_MATCH_COLUMNS)
    for view, name in enumerate(recording.names):
        camera = _csv_line([name]).rstrip("\n")
        for piece in _pieces(len(recording.frames)):
            frame, instance = np.nonzero(
                np.isfinite(recording.positions[view, piece, :, :, 0]).any(-1)
            )
            who = matches.labels[view, piece][frame, instance]
            columns = (recording.frames[piece][frame].tolist(), instance.tolist(), who.tolist())
            yield "".join(f"{camera},{f},{i},{w}\n" for f, i, w in zip(*columns, strict=True))


def _pieces(frames: int) -> Iterator[slice]:
    """Slices of the frames: Python's numbers take four times the room of numpy's."""
    for start in range(0, frames, _PIECE):
        yield slice(start, start + _PIECE)


def read_matches_csv(path_or_text: Path | str, recording: Recording) -> Matches:
    """The inverse of `matches_csv`; a detection that has no row is nobody's.

    Raises FormatError for bad content and MismatchError for a camera, frame or instance that the recording lacks.
    """
    source = str(path_or_text) if isinstance(path_or_text, Path) else "matches"
    text = (
        decode(read_bytes(path_or_text), source) if isinstance(path_or_text, Path) else path_or_text
    )
    cameras, rows = _match_rows(text, source)
    index = {name: v for v, name in enumerate(recording.names)}
    strangers = sorted(set(cameras) - set(index))
    if strangers:
        raise MismatchError(
            f"{source}: expected the cameras {', '.join(recording.names)}, found {', '.join(strangers)}; give the matches of this recording"
        )
    view = np.array([index[name] for name in cameras], dtype=np.int64)
    frame = np.searchsorted(recording.frames, rows[:, 0]).clip(max=len(recording.frames) - 1)
    instance = rows[:, 1].clip(0, recording.positions.shape[2] - 1)
    detected = np.asarray(
        np.isfinite(recording.positions[view, frame, instance, :, 0]).any(axis=-1)
    )
    known: Bools = (recording.frames[frame] == rows[:, 0]) & (instance == rows[:, 1]) & detected
    if not known.all():
        row = int(np.argmin(known))
        found = f"camera {cameras[row]} frame {rows[row, 0]} instance {rows[row, 1]}"
        raise MismatchError(
            f"{source}: row {row + 2}: expected detections of the recording, found {found}; give the matches of this recording"
        )
    _check_once(np.column_stack([view, frame, instance]), "each detection once", source)
    somebody = rows[:, 2] >= 0
    _check_once(
        np.column_stack([view, frame, rows[:, 2]])[somebody],
        "each individual once per camera and frame",
        source,
    )
    labels = np.full(recording.positions.shape[:3], -1, dtype=np.int64)
    labels[view, frame, instance] = rows[:, 2]
    return Matches(labels)


def _match_rows(text: str, source: str) -> tuple[list[str], Ints]:
    """Camera names, and `[row, 3]` frame, instance, individual."""
    remedy = "write the file as mocap-calib does"
    try:
        table = [row for row in csv.reader(io.StringIO(text, newline="")) if row]
    except csv.Error as error:
        raise malformed(source, "comma-separated values", error, remedy) from None
    if not table or table[0] != _MATCH_COLUMNS:
        raise malformed(
            source,
            f"the columns {','.join(_MATCH_COLUMNS)}",
            ",".join(table[0]) if table else "an empty file",
            remedy,
        )
    try:
        rows = np.array(
            [[int(cell) for cell in cells] for _, *cells in table[1:]], dtype=np.int64
        ).reshape(-1, 3)
    except (ValueError, OverflowError) as error:
        raise malformed(
            source, "three whole numbers after the camera in each row", error, remedy
        ) from None
    if len(rows) != len(table) - 1 or (rows[:, 2] < -1).any() or (rows[:, 2] >= len(rows)).any():
        raise malformed(
            source, "four cells a row, individuals counted from 0, -1 = nobody", "others", remedy
        )
    return [row[0] for row in table[1:]], rows


def _check_once(rows: Ints, expected: str, source: str) -> None:
    if len(np.unique(rows, axis=0)) != len(rows):
        raise malformed(source, expected, "one of them twice", "remove one of the rows")


def _csv_line(cells: Sequence[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


# --- poses.h5, poses.csv


def write_poses_h5(path: Path, poses: Poses3D, attributes: Mapping[str, Any]) -> None:
    """Writes what `poses_to_h5` gives, atomically and without a copy of it in memory."""
    with replacing(path) as work, h5py.File(work, "w") as file:
        _fill(file, poses, attributes, {}, ())


def poses_to_h5(
    poses: Poses3D,
    attributes: Mapping[str, Any],
    figures: Mapping[str, float] | None = None,
    individuals: Sequence[str] = (),
) -> bytes:
    """The poses as HDF5; the same poses and `attributes` (provenance) give the same bytes.

    Datasets: position `[frame, individual, keypoint, 3]`, error, views, confidence `[frame, individual,
    keypoint]`, frames `[frame]`, keypoint_names `[keypoint]`, and individual_names where they are given. `figures` are
    further attributes (fps); NaN is left out.
    """
    with h5py.File("poses", "w", driver="core", backing_store=False) as file:
        _fill(file, poses, attributes, figures or {}, individuals)
        file.flush()
        content: bytes = file.id.get_file_image()
    return content


def _fill(
    file: h5py.File,
    poses: Poses3D,
    attributes: Mapping[str, Any],
    figures: Mapping[str, float],
    individuals: Sequence[str],
) -> None:
    """No times in the file: they would change its bytes."""
    arrays = {
        "position": poses.positions,
        "error": poses.error,
        "views": poses.views,
        "confidence": poses.confidence,
        "frames": poses.frames,
    }
    for name, array in arrays.items():
        packed = {"compression": "gzip", "shuffle": True} if array.size else {}
        file.create_dataset(name, data=array, track_times=False, **packed)
    names = {"keypoint_names": poses.keypoints} | (
        {"individual_names": tuple(individuals)} if individuals else {}
    )
    for name, texts in names.items():
        file.create_dataset(
            name, data=np.array(texts, dtype=object), dtype=h5py.string_dtype(), track_times=False
        )
    fields = {
        "format": "mocap-calib poses",
        "version": VERSION,
        "unit": poses.unit,
        "dimensions": "frame, individual, keypoint, coordinate",
    }
    fields |= {name: value for name, value in figures.items() if np.isfinite(value)}
    for name, value in (fields | {"provenance": json.dumps(attributes, default=str)}).items():
        file.attrs[name] = value


def parse_poses_h5(content: bytes, source: str) -> Poses3D:
    """The inverse of `poses_to_h5`. Raises FormatError; call it through `formats_poses.parse_poses`, which contains HDF5."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            if file.attrs["format"] != "mocap-calib poses" or file.attrs["version"] != VERSION:
                raise ValueError(f"format {file.attrs['format']}, version {file.attrs['version']}")
            keypoints = hdf5.names(file, "keypoint_names", source)
            position, error, confidence = (
                hdf5.array(file, name, source).astype(np.float64)
                for name in ("position", "error", "confidence")
            )
            views, frames = (hdf5.integers(file, name, source) for name in ("views", "frames"))
            unit = str(file.attrs["unit"])
        check_shape("position", position, len(frames), None, len(keypoints), 3)
        for name, array in (("error", error), ("views", views), ("confidence", confidence)):
            check_shape(name, array, *position.shape[:3])
    except HDF5_DAMAGE as damage:
        raise malformed(
            source,
            f"mocap-calib poses, version {VERSION}",
            f"an error ({damage})",
            "write the file again",
        ) from None
    return Poses3D(keypoints, frames, position, error, views, confidence, unit)


def poses_csv(poses: Poses3D, individual: int) -> Iterator[str]:
    """The poses of one individual in the columns of anipose, in pieces: a row per frame, empty cells where something is missing.

    M and center are anipose's later change of axes: none here.
    """
    header = [
        f"{name}_{field}"
        for name in poses.keypoints
        for field in ("x", "y", "z", "error", "ncams", "score")
    ]
    header += (
        [f"M_{i}{j}" for i in range(3) for j in range(3)]
        + [f"center_{i}" for i in range(3)]
        + ["fnum"]
    )
    axes = ",".join(map(str, [*np.eye(3).ravel().tolist(), 0.0, 0.0, 0.0]))
    yield _csv_line(header)
    for piece in _pieces(len(poses.frames)):
        rows = zip(
            _anipose_rows(poses, individual, piece).tolist(),
            poses.frames[piece].tolist(),
            strict=True,
        )
        # a list prints its floats with repr, which is exact, and much faster than a call each
        yield "".join(
            f"{str(row)[1:-1].replace(' ', '').replace('nan', '')},{axes},{frame}\n"
            for row, frame in rows
        )


def _anipose_rows(poses: Poses3D, individual: int, piece: slice) -> Floats:
    """`[frame, 6 keypoint]` x, y, z, error, ncams, score of each keypoint."""
    who = (piece, individual)
    rest = np.stack(
        [poses.error[who], poses.views[who].astype(np.float64), poses.confidence[who]], axis=-1
    )
    table = np.concatenate([poses.positions[who], rest], axis=-1)
    return table.reshape(len(table), -1)


# --- pairs.json


def pairs_to_json(pairs: Sequence[PairwiseCalibration], cameras: Sequence[Camera]) -> str:
    """The calibrated pairs with their cameras, which is all that averaging needs; NaN is written as null."""
    entries = [
        _pair_fields(pair, cameras)
        | {"alternatives": [_pair_fields(rival, cameras) for rival in pair.alternatives]}
        for pair in pairs
    ]
    head = {
        "format": "mocap-calib pairs",
        "version": VERSION,
        "transform": "b_from_a, baseline in body sizes",
    }
    lists = {"cameras": [camera_fields(camera) for camera in cameras], "pairs": entries}
    body = [
        f"{json.dumps(k)}: [\n  "
        + ",\n  ".join(json.dumps(e, ensure_ascii=False) for e in v)
        + "\n]"
        for k, v in lists.items()
    ]
    return (
        "{\n"
        + ",\n".join([f"{json.dumps(k)}: {json.dumps(v)}" for k, v in head.items()] + body)
        + "\n}\n"
    )


def _pair_fields(pair: PairwiseCalibration, cameras: Sequence[Camera]) -> dict[str, Any]:
    """All but the rivals."""
    fields = {
        k: v.tolist() if isinstance(v, np.ndarray) else v
        for k, v in asdict(replace(pair, alternatives=())).items()
        if k != "alternatives"
    }
    fields |= {"a": cameras[pair.a].name, "b": cameras[pair.b].name}
    return {
        k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in fields.items()
    }


def pairs_from_json(
    text: str, source: str
) -> tuple[tuple[PairwiseCalibration, ...], tuple[Camera, ...]]:
    """The inverse of `pairs_to_json`; pairs may come without rivals. `source` names the text in complaints. Raises FormatError."""
    remedy = "write the file again with the first stage"
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise malformed(source, "JSON", f"an error ({error})", remedy) from None
    if (
        not isinstance(data, dict)
        or data.get("format") != "mocap-calib pairs"
        or data.get("version") != VERSION
    ):
        raise malformed(source, f"mocap-calib pairs, version {VERSION}", one_field(data), remedy)
    if not isinstance(data.get("cameras"), list) or not isinstance(data.get("pairs"), list):
        raise malformed(source, "lists of cameras and pairs", one_field(data), remedy)
    cameras = tuple(camera_from_fields(fields, source) for fields in data["cameras"])
    index = {camera.name: v for v, camera in enumerate(cameras)}
    try:
        pairs = tuple(
            _pair(fields, index, f"{source}: pair {k}") for k, fields in enumerate(data["pairs"])
        )
    except FormatError:
        raise
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise malformed(
            source, "pairs of the cameras named", f"an error ({one_line(error)})", remedy
        ) from None
    return pairs, cameras


def _pair(fields: Mapping[str, Any], index: Mapping[str, int], source: str) -> PairwiseCalibration:
    rotation = numbers(fields["rotation"], "a 3 x 3 rotation", source).reshape(3, 3)
    translation = numbers(fields["translation"], "a translation", source).reshape(3)
    matches = np.array(fields["matches"], dtype=np.int64).reshape(-1, 3)
    score, residual, in_front = (
        np.nan if fields[k] is None else float(fields[k]) for k in ("score", "residual", "in_front")
    )
    ends = index[fields["a"]], index[fields["b"]]
    alternatives = tuple(_pair(rival, index, source) for rival in fields.get("alternatives", []))
    if any({rival.a, rival.b} != set(ends) for rival in alternatives):
        raise malformed(
            source,
            "rivals of the same two cameras",
            "others",
            "write the file again with the first stage",
        )
    return PairwiseCalibration(
        *ends,
        rotation,
        translation,
        matches,
        int(fields["frames"]),
        score,
        residual,
        in_front,
        str(fields["source"]),
        alternatives,
    )
