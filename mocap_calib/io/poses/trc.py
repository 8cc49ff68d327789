"""TRC of OpenSim and Pose2Sim: one individual a file, tabs, metres or millimetres, a missing point is three empty cells."""

import numpy as np

from mocap_calib.io.file import decode, malformed
from mocap_calib.io.poses.common import (
    PoseFile,
    WrittenPoses,
    bare_poses,
    convert_unit,
    fill_gaps,
    lost_names,
    lost_quality,
    need_keypoints,
    need_rate,
)
from mocap_calib.io.units import known_unit
from mocap_calib.types import Floats, Ints

_KEYS = (
    "DataRate",
    "CameraRate",
    "NumFrames",
    "NumMarkers",
    "Units",
    "OrigDataRate",
    "OrigDataStartFrame",
    "OrigNumFrames",
)
_HEAD = 5  # lines before the data


def sniff(content: bytes) -> bool:
    """By the first word."""
    return content[:64].lstrip(b"\xef\xbb\xbf").startswith(b"PathFileType")


def parse(content: bytes, source: str) -> PoseFile:
    """The markers; numbers that are missing, not finite or blank are missing points. Raises FormatError."""
    lines = decode(content, source).splitlines()
    if len(lines) < _HEAD:
        raise malformed(
            source, "the five lines of a TRC header", f"{len(lines)}", "write the file again"
        )
    head = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    if not {"DataRate", "NumMarkers", "Units"} <= head.keys():
        raise malformed(
            f"{source}: line 2",
            "DataRate, NumMarkers, Units and their values below",
            ", ".join(head) or "nothing",
            "write the file again",
        )
    names = [cell.strip() for cell in lines[3].split("\t")[2::3] if cell.strip()]
    if str(len(names)) != head["NumMarkers"]:
        raise malformed(
            f"{source}: line 4",
            f"{head['NumMarkers']} names of markers",
            f"{len(names)}",
            "write the file again",
        )
    rows = [
        (n, line.split("\t")) for n, line in enumerate(lines[_HEAD:], _HEAD + 1) if line.strip()
    ]
    frames, positions = _numbers(rows, len(names), source)
    try:
        rate = float(head["DataRate"])
    except ValueError:
        raise malformed(
            f"{source}: line 3", "a number for DataRate", head["DataRate"], "mend it"
        ) from None
    return PoseFile(
        bare_poses(
            names, frames, positions[:, None], known_unit(head["Units"], f"{source}: line 3")
        ),
        rate,
    )


def _numbers(rows: list[tuple[int, list[str]]], markers: int, source: str) -> tuple[Ints, Floats]:
    """`[frame]` numbers and `[frame, marker, 3]` positions. Raises FormatError."""
    frames, positions = (
        np.zeros(len(rows), dtype=np.int64),
        np.full((len(rows), 3 * markers), np.nan),
    )
    for k, (number, cells) in enumerate(rows):
        values = cells[2 : 2 + 3 * markers]
        try:
            frames[k] = int(cells[0])
            positions[k, : len(values)] = [
                float(cell) if cell.strip() else np.nan for cell in values
            ]
        except (ValueError, OverflowError) as error:
            raise malformed(
                f"{source}: line {number}",
                "a frame, a time, and numbers or empty cells",
                error,
                "mend the line",
            ) from None
        if any(cell.strip() for cell in cells[2 + 3 * markers :]):
            raise malformed(
                f"{source}: line {number}",
                f"{2 + 3 * markers} cells",
                f"{len(cells)}",
                "mend the line",
            )
    points = positions.reshape(len(rows), markers, 3)
    return frames, np.where(np.isfinite(points).all(-1, keepdims=True), points, np.nan)


def write(file: PoseFile, title: str) -> WrittenPoses:
    """One individual, without gaps, frame 0 at time 0. Raises MismatchError."""
    rate = need_rate(file, "trc")
    need_keypoints(
        file,
        r"[^\t\r\n\x0b\x0c\x1c-\x1e\x85\u2028\u2029\ud800-\udfff]*[^\s\ud800-\udfff]",
        "text without tabs, not ending in a space",
        "trc",
    )
    unit = "m" if file.poses.unit == "m" else "mm"
    file = convert_unit(file, unit, "trc")
    frames, positions = fill_gaps(file.poses, "trc")
    names, count = file.poses.keypoints, len(frames)
    speed = repr(rate)
    lines = [f"PathFileType\t4\t(X/Y/Z)\t{title}", "\t".join(_KEYS)]
    lines += [
        "\t".join(
            [speed, speed, str(count), str(len(names)), unit, speed, str(frames[0]), str(count)]
        )
    ]
    lines += [
        "Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in names),
        "\t\t" + "".join(f"X{k}\tY{k}\tZ{k}\t" for k in range(1, len(names) + 1)),
    ]
    table = positions[:, 0].reshape(count, -1)
    for frame, row in zip(frames.tolist(), table.tolist(), strict=True):
        cells = "\t".join("" if value != value else repr(value) for value in row)  # noqa: PLR0124 - NaN
        # OpenSim does not count an empty cell at the end of a line without a tab behind it
        lines.append(f"{frame}\t{frame / rate!r}\t{cells}" + ("\t" if cells.endswith("\t") else ""))
    return WrittenPoses(
        ("\n".join(lines) + "\n").encode(), (*lost_quality(file), *lost_names(file))
    )
