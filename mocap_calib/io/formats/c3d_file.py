"""C3D of motion capture: binary, all individuals in one file.

* Numbers are float32, lengths millimetres, frames are counted from 1 without gaps.
* The header counts markers in a byte: there are at most 255.
* The format has no individuals: their markers are called `name:marker`.
* POINT:Y_SCREEN says which axis is up, POINT:X_SCREEN which lies across, where that is known; the
  format leaves it to the laboratory, and z is usual.
* A point has a residual besides x, y, z; -1 marks a missing one.
"""

import io
import warnings
from dataclasses import dataclass

import c3d
import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.pose_axes import up_axis
from mocap_calib.io.poses import (
    QUALITY,
    PoseFile,
    bare_poses,
    convert_unit,
    fill_gaps,
    mark_missing,
    need_keypoints,
    need_rate,
    refuse_damage,
)
from mocap_calib.io.units import known_unit
from mocap_calib.types import Floats, Ints

_MOST_MARKERS = 255
_START = b"\x02\x50"  # the block where the parameters begin, and the mark of a C3D file
_SHORTEST = 512  # bytes
_ONLY_INDIVIDUAL = "individual_0"  # what one without a name is called
_NAMES = r"(?! )[ -9;-~]{1,60}(?<! )"


@dataclass(frozen=True)
class _Content:
    """What a file holds.

    labels: `[marker]`. frames: `[frame]` numbers from 0. positions: `[frame, marker, 3]`.
    """

    labels: list[str]
    frames: Ints
    positions: Floats
    rate: float
    unit: str


def sniff(document: Document) -> bool:
    """Return whether the mark is there, and parameters begin in the second block."""
    return document.size >= _SHORTEST and document.start.startswith(_START)


# --- reading


def read(document: Document) -> PoseFile:
    """Read the markers; where all are called `name:marker`, those of each individual.

    Raises FormatError.
    """
    with (
        refuse_damage(document.source, "a whole C3D file"),
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        found = _read(document.content)
    cut = any("end of file" in str(warning.message) for warning in caught)
    if cut or not len(found.frames):
        raise document.refuse("a whole C3D file", "one that is cut", "copy it again")
    unit = known_unit(found.unit, f"{document.source}: POINT:UNITS")
    individuals, keypoints = _split_labels(found.labels)
    positions = _split_markers(found, individuals, keypoints, document.source)
    poses = bare_poses(keypoints, found.frames, positions, unit=unit)
    names = tuple(individual or _ONLY_INDIVIDUAL for individual in individuals)
    return PoseFile(poses, found.rate, names)


def _read(content: bytes) -> _Content:
    """Read a file with the library c3d, which raises much on damage."""
    reader = c3d.Reader(io.BytesIO(content))
    labels = [label.strip() for label in reader.point_labels]
    frames = []
    tables = []
    for number, points, _ in reader.read_frames():
        frames.append(number - 1)
        tables.append(points[:, :4].astype(np.float64))
    points = np.stack(tables) if tables else np.zeros((0, len(labels), 4))
    if points.shape[1] < len(labels) or not labels:
        raise ValueError(f"{points.shape[1]} markers and {len(labels)} labels")
    points = points[:, : len(labels)]
    positions = mark_missing(points[..., :3])
    unit = reader.get("POINT:UNITS")
    return _Content(
        labels=labels,
        frames=np.array(frames, dtype=np.int64),
        positions=np.where(points[..., 3:] < 0, np.nan, positions),
        rate=float(reader.point_rate),
        unit="" if unit is None else unit.string_value.strip(),
    )


def _split_labels(labels: list[str]) -> tuple[list[str], list[str]]:
    """Return individuals ("" where the markers are nobody's) and keypoints."""
    pairs = [label.partition(":") for label in labels]
    if not all(individual and keypoint for individual, _, keypoint in pairs):
        return [""], labels
    individuals = dict.fromkeys(individual for individual, _, _ in pairs)
    keypoints = dict.fromkeys(keypoint for _, _, keypoint in pairs)
    return list(individuals), list(keypoints)


def _split_markers(
    found: _Content, individuals: list[str], keypoints: list[str], source: str
) -> Floats:
    """Return `[frame, individual, keypoint, 3]`; the markers of one need not stand together.

    Raises FormatError where the individuals have different markers.
    """
    labels = found.labels
    if len(individuals) * len(keypoints) != len(labels) or len(set(labels)) < len(labels):
        expected = "the same markers of every individual, each once"
        raise FormatError(source, expected, ", ".join(labels[:8]), "rename the markers")
    markers = [
        labels.index(_label(individual, keypoint))
        for individual in individuals
        for keypoint in keypoints
    ]
    shape = (len(found.frames), len(individuals), len(keypoints), 3)
    return found.positions[:, markers].reshape(shape)


def _label(individual: str, keypoint: str) -> str:
    """Return what a marker is called; the individual may have no name ("")."""
    return f"{individual}:{keypoint}" if individual else keypoint


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write all individuals; the markers of a single one without a name keep their names.

    Raises MismatchError.
    """
    rate = need_rate(file, "c3d")
    need_keypoints(file, _NAMES, "1 to 60 letters of ASCII without a colon", "c3d")
    labels = _make_labels(file)
    frames, positions = fill_gaps(convert_unit(file, "mm", "c3d").poses, "c3d")
    first = int(frames[0])
    if first < 0 or not 0 < rate < float(np.finfo(np.float32).max):
        raise MismatchError(
            "c3d",
            "frames from 0 on and a rate that fits",
            f"frame {first} and rate {rate}",
            "shift the frames",
        )
    table = _make_table(positions.reshape(len(frames), len(labels), 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses analog channels
        return _format_file(table, labels, rate=rate, first=first + 1, up=up_axis(file))


def _make_labels(file: PoseFile) -> list[str]:
    """Return what the markers are called. Raises MismatchError where there are too many or none."""
    individuals = file.individuals
    if individuals == (_ONLY_INDIVIDUAL,):
        individuals = ("",)
    labels = [
        _label(individual, keypoint)
        for individual in individuals
        for keypoint in file.poses.keypoints
    ]
    if not individuals:
        raise MismatchError("c3d", "at least one individual", "none", "nothing to write")
    if not 0 < len(labels) <= _MOST_MARKERS:
        raise MismatchError(
            "c3d",
            f"1 to {_MOST_MARKERS} markers",
            f"{len(labels)} (individuals x keypoints)",
            "write fewer individuals or another format",
        )
    return labels


def _make_table(points: Floats) -> Floats:
    """Return `[frame, marker, 5]` x, y, z, residual, cameras of `[frame, marker, 3]` points.

    In its terms neither a residual nor the number of cameras is known; -1 marks a missing point.
    """
    missing = ~np.isfinite(points).all(-1, keepdims=True)
    positions = np.where(missing, 0.0, points)
    residuals = np.where(missing, -1.0, 0.0)
    return np.concatenate([positions, residuals, np.zeros_like(residuals)], axis=-1)


def _format_file(table: Floats, labels: list[str], *, rate: float, first: int, up: str) -> bytes:
    """Return a file.

    table: `[frame, marker, 5]`. labels: `[marker]`. first: number of the first frame, from 1 on.
    up: the axis that points up, "" = not known.
    """
    writer = c3d.Writer(point_rate=rate, point_units="mm")
    writer.set_point_labels(labels)
    writer.set_start_frame(first)
    if up:
        sign = "-" if up.startswith("-") else "+"
        writer.set_screen_axis("+Y" if up[-1] == "x" else "+X", f"{sign}{up[-1].upper()}")
    no_analog = np.zeros((0, 1))
    writer.add_frames([(frame, no_analog) for frame in table])
    content = io.BytesIO()
    writer.write(content)
    return content.getvalue()


POSES = Format(
    kind="poses",
    name="c3d",
    title="C3D",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".c3d",),
    timed=True,
    unit="mm",
    loses=(*QUALITY,),
)
