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
from collections.abc import Sequence

import c3d
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import damage_refused
from mocap_calib.io.poses import (
    QUALITY,
    PoseFile,
    bare_poses,
    convert_unit,
    fill_gaps,
    mark_missing,
    need_keypoints,
    need_rate,
    up_axis,
)
from mocap_calib.io.units import known_unit

_MOST_MARKERS = 255
_START = b"\x02\x50"  # the block where the parameters begin, and the mark of a C3D file
_SHORTEST = 512  # bytes
_ONLY_INDIVIDUAL = "individual_0"  # what one without a name is called
_NAMES = r"(?! )[ -9;-~]{1,60}(?<! )"


def sniff(document: Document) -> bool:
    """Return whether the mark is there, and parameters begin in the second block."""
    return document.size >= _SHORTEST and document.start.startswith(_START)


# --- reading


def read(document: Document) -> PoseFile:
    """Read the markers; where all are called `name:marker`, those of each individual.

    Raises FormatError.
    """
    source = document.source
    with (
        damage_refused(source, "a whole C3D file"),
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        reader = c3d.Reader(io.BytesIO(document.content))
        labels = [label.strip() for label in reader.point_labels]
        read = [(k - 1, own[:, :4].astype(np.float64)) for k, own, _ in reader.read_frames()]
        if not read:
            raise ValueError("no whole frame")
        points = np.stack([own for _, own in read])
        if not 0 < len(labels) <= points.shape[1]:
            raise ValueError(f"{points.shape[1]} markers and {len(labels)} labels")
        unit, rate = reader.get("POINT:UNITS"), float(reader.point_rate)
        stated = "" if unit is None else unit.string_value
    if any("end of file" in str(warning.message) for warning in caught):
        raise document.refuse("a whole C3D file", "one that is cut", "copy it again")
    individuals, keypoints = _split_labels(labels)
    markers = _label_markers(individuals, keypoints)
    if len(set(labels)) < len(labels) or sorted(markers) != sorted(labels):
        expected = "the same markers of every individual, each once"
        raise document.refuse(expected, ", ".join(labels[:8]), "rename the markers")
    own = points[:, [labels.index(marker) for marker in markers]]
    positions = np.where(own[..., 3:] < 0, np.nan, mark_missing(own[..., :3]))
    poses = bare_poses(
        keypoints,
        np.array([frame for frame, _ in read], dtype=np.int64),
        positions.reshape(len(read), len(individuals), len(keypoints), 3),
        unit=known_unit(stated, f"{source}: POINT:UNITS"),
    )
    return PoseFile(poses, rate, tuple(name or _ONLY_INDIVIDUAL for name in individuals))


def _split_labels(labels: list[str]) -> tuple[list[str], list[str]]:
    """Return individuals ("" where the markers are nobody's) and keypoints."""
    pairs = [label.partition(":") for label in labels]
    if not all(individual and keypoint for individual, _, keypoint in pairs):
        return [""], labels
    individuals = dict.fromkeys(individual for individual, _, _ in pairs)
    keypoints = dict.fromkeys(keypoint for _, _, keypoint in pairs)
    return list(individuals), list(keypoints)


def _label_markers(individuals: Sequence[str], keypoints: Sequence[str]) -> list[str]:
    """Return what the markers are called; an individual may have no name ("")."""
    return [
        f"{individual}:{keypoint}" if individual else keypoint
        for individual in individuals
        for keypoint in keypoints
    ]


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write all individuals; the markers of a single one without a name keep their names.

    Raises MismatchError.
    """
    rate = need_rate(file, "c3d")
    need_keypoints(file, _NAMES, "1 to 60 letters of ASCII without a colon", "c3d")
    individuals = ("",) if file.individuals == (_ONLY_INDIVIDUAL,) else file.individuals
    labels = _label_markers(individuals, file.poses.keypoints)
    if not 0 < len(labels) <= _MOST_MARKERS:
        expected = f"1 to {_MOST_MARKERS} markers"
        found = f"{len(labels)} (individuals x keypoints)"
        raise MismatchError("c3d", expected, found, "write fewer individuals or another format")
    frames, positions = fill_gaps(convert_unit(file, "mm", "c3d").poses, "c3d")
    if frames[0] < 0 or rate >= np.finfo(np.float32).max:
        expected, found = (
            "frames from 0 on and a rate that fits",
            f"frame {frames[0]} and rate {rate}",
        )
        raise MismatchError("c3d", expected, found, "shift the frames")
    points = positions.reshape(len(frames), len(labels), 3)
    missing = np.isnan(points).any(-1, keepdims=True)
    # beside a point its residual, -1 where it is missing, and the number of cameras: 0, not known
    residuals = np.where(missing, [-1.0, 0.0], 0.0)
    table = np.concatenate([np.where(missing, 0.0, points), residuals], axis=-1)
    content = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses analog channels
        writer = c3d.Writer(point_rate=rate, point_units="mm")
        writer.set_point_labels(labels)
        writer.set_start_frame(int(frames[0]) + 1)
        if up := up_axis(file):
            sign = "-" if up.startswith("-") else "+"
            writer.set_screen_axis("+Y" if up[-1] == "x" else "+X", f"{sign}{up[-1].upper()}")
        no_analog = np.zeros((0, 1))
        writer.add_frames([(frame, no_analog) for frame in table])
        writer.write(content)
    return content.getvalue()


POSES = Format(
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
