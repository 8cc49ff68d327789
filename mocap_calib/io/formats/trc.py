"""TRC of OpenSim and Pose2Sim: tab-separated text of the markers of one individual.

* Five lines stand before the data: file type, names of fields, their values, names of markers
  (each above the first of its three columns), X1 Y1 Z1 X2 ...
* A missing point is three empty cells. OpenSim does not count an empty cell at the end of a line
  unless a tab stands behind it.
* Frames have no gaps. Lengths are metres or millimetres, and y is up.
* Joints of people are called as the markers of Pose2Sim's OpenSim models.
"""

import math

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_FRAME
from mocap_calib.io.format import Format
from mocap_calib.io.poses import (
    INDIVIDUALS,
    QUALITY,
    PoseFile,
    bare_poses,
    convert_unit,
    fill_gaps,
    mark_missing,
    need_keypoints,
    need_rate,
)
from mocap_calib.io.units import known_unit
from mocap_calib.recording.joints import choose_skeleton, match_names
from mocap_calib.types import Ints

_HEADER_LINES = 5
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_NAMES = r"[^\t\r\n\x0b\x0c\x1c-\x1e\x85\u2028\u2029\ud800-\udfff]*[^\s\ud800-\udfff]"
_PEOPLE = "people"
# joint of the skeleton `people`, without its side -> marker; a side becomes an L or an R before it
_MARKERS = {
    "nose": "Nose",
    "eye": "Eye",
    "ear": "Ear",
    "shoulder": "Shoulder",
    "elbow": "Elbow",
    "wrist": "Wrist",
    "hip": "Hip",
    "knee": "Knee",
    "ankle": "Ankle",
    "head_top": "Head",
    "neck": "Neck",
    "mid_hip": "Hip",
    "big_toe": "BigToe",
    "small_toe": "SmallToe",
    "heel": "Heel",
}


def sniff(document: Document) -> bool:
    """Return whether the first word is that of a TRC."""
    return document.start[:64].lstrip(_BYTE_ORDER_MARK).startswith(b"PathFileType")


# --- reading


def read(document: Document) -> PoseFile:
    """Read the markers. Raises FormatError."""
    source, remedy = document.source, "write the file again"
    lines = document.text.splitlines()
    if len(lines) < _HEADER_LINES:
        raise document.refuse("the five lines of a TRC header", len(lines), remedy)
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    try:
        rate, count, unit = float(header["DataRate"]), int(header["NumMarkers"]), header["Units"]
    except (LookupError, ValueError):
        expected = "numbers of DataRate and NumMarkers, and Units"
        found = one_line(", ".join(f"{name} {value}" for name, value in header.items()))
        raise FormatError(f"{source}: line 2", expected, found or "nothing", remedy) from None
    names = [cell.strip() for cell in lines[3].split("\t")[2::3] if cell.strip()]
    if len(names) != count:
        expected = f"{count} names of markers"
        raise FormatError(f"{source}: line 4", expected, f"{len(names)}", remedy)
    rows = [
        _parse_row(line, 3 * count, f"{source}: line {number}")
        for number, line in enumerate(lines[_HEADER_LINES:], _HEADER_LINES + 1)
        if line.strip()
    ]
    frames = np.array([frame for frame, _ in rows], dtype=np.int64)
    positions = np.array([numbers for _, numbers in rows]).reshape(len(rows), 1, count, 3)
    unit = known_unit(unit, f"{source}: line 3")
    return PoseFile(bare_poses(names, frames, mark_missing(positions), unit=unit), rate)


def _parse_row(line: str, columns: int, where: str) -> tuple[int, list[float]]:
    """Return the frame number and the numbers of a line, NaN where a cell is blank.

    Raises FormatError.
    """
    first, _, *cells = [*line.split("\t"), ""]
    try:
        frame = int(first)
        numbers = [float(cell) if cell.strip() else np.nan for cell in cells]
        if abs(frame) > LARGEST_FRAME or not np.isnan(numbers[columns:]).all():
            raise ValueError(f"{len(cells) + 1} cells from frame {frame} on")
    except ValueError as error:
        expected = f"a frame, a time, and {columns} numbers or empty cells"
        raise FormatError(where, expected, error, "correct the line") from None
    return frame, (numbers + [np.nan] * columns)[:columns]


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write one individual without gaps, frame 0 at time 0. Raises MismatchError."""
    rate = need_rate(file, "trc")
    need_keypoints(file, _NAMES, "text without tabs, not ending in a space", "trc")
    file = convert_unit(file, "m" if file.poses.unit == "m" else "mm", "trc")
    frames, positions = fill_gaps(file.poses, "trc")
    lines = _format_header(file, title, frames, rate)
    table = positions[:, 0].reshape(len(frames), -1) + 0.0  # which takes the sign from zeros
    for frame, row in zip(frames.tolist(), table.tolist(), strict=True):
        lines.append(f"{frame}\t{frame / rate!r}\t{_format_row(row)}")
    return ("\n".join(lines) + "\n").encode()


def _format_header(file: PoseFile, title: str, frames: Ints, rate: float) -> list[str]:
    """Return the five lines before the data.

    frames: `[frame]` numbers that are written.
    """
    names = _marker_names(file)
    own_rate, count = repr(rate), str(len(frames))
    fields = {"DataRate": own_rate, "CameraRate": own_rate, "NumFrames": count}
    fields |= {"NumMarkers": str(len(names)), "Units": file.poses.unit, "OrigDataRate": own_rate}
    fields |= {"OrigDataStartFrame": str(frames[0]), "OrigNumFrames": count}
    axes = "".join(f"X{number}\tY{number}\tZ{number}\t" for number in range(1, len(names) + 1))
    return [
        f"PathFileType\t4\t(X/Y/Z)\t{title}",
        "\t".join(fields),
        "\t".join(fields.values()),
        "Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in names),
        f"\t\t{axes}",
    ]


def _marker_names(file: PoseFile) -> tuple[str, ...]:
    """Return the names `[keypoint]` of markers: left_hip -> LHip, mid_hip -> Hip.

    Those of the models in Pose2Sim's OpenSim_Setup (Halpe26, Body25, Coco17). Keypoints that they
    do not have, and those of animals, keep their names.
    """
    names = file.poses.keypoints
    skeleton = choose_skeleton(file.spelt)
    if skeleton.name != _PEOPLE:
        return names
    markers = dict(_MARKERS)
    for side in ("left", "right"):
        markers |= {f"{side}_{joint}": side[0].upper() + own for joint, own in _MARKERS.items()}
    joints = match_names(file.spelt, skeleton)
    found = tuple(
        markers.get(skeleton.keypoints[joint], name) if joint >= 0 else name
        for name, joint in zip(names, joints, strict=True)
    )
    return found if len(set(found)) == len(names) else names


def _format_row(row: list[float]) -> str:
    """Return the cells of a frame, empty for NaN, the last with a tab behind it if empty."""
    cells = "\t".join("" if math.isnan(value) else repr(value) for value in row)
    return cells + "\t" if cells.endswith("\t") else cells


POSES = Format(
    name="trc",
    title="OpenSim TRC",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".trc",),
    single=True,
    timed=True,
    unit="mm",
    up="y",
    loses=(*QUALITY, INDIVIDUALS),
)
