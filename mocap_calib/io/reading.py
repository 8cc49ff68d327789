"""What the readers share: complaints in one line, frame numbers, the marks of a missing point."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.types import Bools, Floats, Ints, Reals

_LARGEST = np.iinfo(np.int64).max


def one_line(value: object, width: int = 80) -> str:
    """`value` as text without line breaks, shortened to `width` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 3]}..."


def malformed(source: str, expected: str, found: object, remedy: str) -> FormatError:
    """The one shape of a complaint about a file's content."""
    return FormatError(f"{one_line(source, 300)}: expected {one_line(expected, 200)}, found {one_line(found, 200)}; {one_line(remedy, 200)}")


def read_bytes(path: Path) -> bytes:
    """The whole file at once, so that a pipe can be sniffed as well. Raises FormatError."""
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise malformed(str(path), "a readable file", getattr(error, "strerror", None) or error, "check the path") from None


def decode(content: bytes, source: str) -> str:
    """UTF-8 text without its byte order mark. Raises FormatError."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise malformed(source, "UTF-8 text", f"byte {content[error.start]:#04x} at {error.start}", "save it as UTF-8") from None


def frame_number(name: str) -> int:
    """A whole number as it is, or the integer at the end of a file name's stem (`a/b_007.png` -> 7); -1 for neither."""
    stem = re.sub(r"\.[A-Za-z]\w*$|\.0+$", "", name.strip())
    digits = None if re.fullmatch(r"-[0-9.]+|[0-9]*\.[0-9]+", stem) else re.search(r"[0-9]+$", stem)
    number = int(digits[0]) if digits and len(digits[0]) < 30 else -1
    return number if number <= _LARGEST else -1


def frame_order(frames: Ints, names: Sequence[object], source: str) -> Ints:
    """`[frame]` indices that sort the frame numbers. Raises FormatError, with both `names`, when one occurs twice."""
    order = np.argsort(frames, kind="stable")
    twice = np.flatnonzero(np.diff(frames[order]) == 0)
    if twice.size:
        first, second = (one_line(names[i], 60) for i in order[twice[0] : twice[0] + 2])
        found = f"frame {frames[order[twice[0]]]} twice, at {first} and {second}"
        raise malformed(source, "each frame number once", found, "give one file per camera and recording")
    return order


def unique_names(names: Sequence[str], source: str) -> tuple[str, ...]:
    """The keypoint names as they are. Raises FormatError when one occurs twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise malformed(source, "each keypoint name once", f"{', '.join(twice)} twice", "rename one of them")
    return tuple(names)


def mark_missing(positions: Floats, confidence: Floats) -> tuple[Reals, Reals]:
    """`[..., 2]` positions with NaN and `[...]` confidences with 0 at every point that one of the customs calls missing; float32.

    The customs: not a number, a confidence of 0 or below, (0, 0) (OpenPose, COCO), (-1, -1) (DeepLabCut 3).
    """
    with np.errstate(over="ignore"):  # what float32 cannot hold is no pixel
        kept = positions.astype(np.float32), confidence.astype(np.float32)
    missing: Bools = np.asarray(~(np.isfinite(kept[0]).all(-1) & (kept[1] > 0) & np.isfinite(kept[1])))
    missing |= (positions == 0).all(-1) | (positions == -1).all(-1)
    kept[0][missing], kept[1][missing] = np.nan, 0.0
    return kept
