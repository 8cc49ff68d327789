"""What the readers share: complaints in one line, frame numbers, detections."""

import codecs
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import FormatError, argument, one_line
from mocap_calib.io.missing import MISSING_CUSTOMS, mark_missing
from mocap_calib.types import Floats, Ints, Keypoints2D

NO_SCORE = "no scores in the file: every point counts fully"
ABSENT_FRAMES = "frames without a detection are not in the file"
MOST_INSTANCES = 1000  # in a frame
MOST_POINTS = 100_000_000  # in a camera: 2.4 GB
_POINTS_AT_A_TIME = 50_000
_MOST_CAMERAS = 200  # in a file; the time to compare views grows with the square of their number
_MOST_KEYPOINTS = 5000
LARGEST_FRAME = 2**62  # so that the difference of two frame numbers is an int64 as well
LARGEST_EXACT_FLOAT = 2**53  # whole numbers beyond it are not exact in a float
_PLAIN_DIGITS = 18  # of a number that no limit concerns
_MOST_DIGITS = 30  # of a frame number that is looked at
_SUFFIX_OR_ZEROS = r"\.[A-Za-z]\w*$|^(?P<whole>[0-9]+)\.0+$"  # `.png`, or `.0` of a whole number
_NOT_WHOLE = r"-[0-9.]+|[0-9]*\.[0-9]+"


# --- complaints


# --- paths and content


def plain_path(argument: str | Path) -> Path:
    """Return the path of a file, a folder or a `name=path` pair."""
    path = Path(argument)
    _, equals, rest = str(argument).partition("=")
    return Path(rest) if equals and not path.exists() else path


def read_bytes(path: Path) -> bytes:
    """Read a whole file at once, so that a pipe can be recognised by its content as well.

    UTF-16, which PowerShell's `>` writes, becomes UTF-8. Raises FormatError.
    """
    with opened(path) as file:
        content = file.read()
    if not is_utf16(content):
        return content
    try:
        return content.decode("utf-16").encode()
    except UnicodeError:
        return content


def is_utf16(content: bytes) -> bool:
    """Return whether content begins with the mark of UTF-16."""
    return content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file whose bytes are read. Raises FormatError where it cannot be."""
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError:
        raise FormatError(str(path), "a file or folder", "none", "check the path") from None
    except IsADirectoryError:
        raise FormatError(str(path), "a file", "a folder", "give a file in it") from None
    except (OSError, ValueError) as error:
        found = getattr(error, "strerror", None) or error
        raise FormatError(str(path), "a readable file", found, "check the path") from None


def decode(content: bytes, source: str) -> str:
    """Return UTF-8 text without its byte order mark. Raises FormatError."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        found = f"byte {content[error.start]:#04x} at {error.start}"
        raise FormatError(source, "UTF-8 text", found, "save it as UTF-8") from None


# --- names and numbers


def find_camera(name: str, pattern: str) -> str:
    """Return the camera that a pattern finds in a name, "" where it finds none.

    It is the pattern's group `camera`, else its first group, else all that it finds.
    """
    found = re.search(pattern, name)
    if found is None:
        return ""
    named = found.groupdict().get("camera")
    first = next((group for group in found.groups() if group), "")
    return str(named or first or found[0])


def frame_number(name: str) -> int:
    """Return the frame number in a text: a whole number, or the end of a file's stem.

    `a/b_007.png` is 7; -1 stands for a text with neither.
    """
    if name.isascii() and name.isdigit() and len(name) < _PLAIN_DIGITS:
        return int(name)
    stem = re.sub(_SUFFIX_OR_ZEROS, lambda found: found["whole"] or "", name.strip())
    if re.fullmatch(_NOT_WHOLE, stem):
        return -1
    digits = re.search(r"[0-9]+$", stem)
    if digits is None or len(digits[0]) >= _MOST_DIGITS:
        return -1
    number = int(digits[0])
    return number if number < LARGEST_FRAME else -1


def frame_order(frames: Ints, names: Sequence[object], source: str) -> Ints:
    """Return `[frame]` indices that sort `[frame]` frame numbers.

    names: `[frame]` what complaints call the frames.

    Raises FormatError where a number occurs twice.
    """
    order = np.argsort(frames, kind="stable")
    twice = np.flatnonzero(np.diff(frames[order]) == 0)
    if twice.size:
        first, second = order[twice[0]], order[twice[0] + 1]
        places = f"{one_line(names[first], 60)} and {one_line(names[second], 60)}"
        raise FormatError(
            source,
            "each frame number once",
            f"frame {frames[first]} twice, at {places}",
            "give one file per camera and recording, or say which part of a name is the camera "
            f"with {argument('camera_regex')}",
        )
    return order


def find_repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def check_cameras(cameras: Sequence[str], source: str) -> None:
    """Raise FormatError where a file has more cameras than anybody: another column was taken."""
    if len(cameras) > _MOST_CAMERAS:
        expected = f"at most {_MOST_CAMERAS} cameras in a file"
        raise FormatError(source, expected, _count(cameras), "check what names the cameras")


def unique_names(names: Sequence[str], source: str) -> tuple[str, ...]:
    """Return the keypoint names as they are.

    Raises FormatError where one occurs twice, or there are more than anybody has.
    """
    if len(names) > _MOST_KEYPOINTS:
        expected = f"at most {_MOST_KEYPOINTS} keypoints"
        raise FormatError(source, expected, _count(names), "check what names the keypoints")
    twice = find_repeated(names)
    if twice:
        found = f"{', '.join(twice)} twice"
        raise FormatError(source, "each keypoint name once", found, "rename one of them")
    return tuple(names)


def _count(names: Sequence[str]) -> str:
    return f"{len(names)} ({', '.join(names[:3])}, ...)"


# --- detections


@dataclass(frozen=True)
class Origin:
    """Where detections come from: the camera's name, and the file as complaints name it."""

    camera: str
    source: str


def make_view(
    origin: Origin,
    names: Sequence[str],
    frames: Sequence[int] | Ints,
    values: Floats,
    *,
    tracked: bool,
    image_size: tuple[int, int] = (0, 0),
    rows: Sequence[object] | None = None,
    remarks: tuple[str, ...] = (),
) -> Keypoints2D:
    """Return the record of detections, with frames in order and missing points marked.

    names: `[keypoint]`.
    frames: `[frame]` numbers, in any order.
    values: `[frame, instance, keypoint, 3]` x, y (pixels) and confidence.
    rows: `[frame]` what complaints call the frames.

    Raises FormatError where a frame number or a name occurs twice.
    """
    numbers = np.asarray(frames, dtype=np.int64)
    order = frame_order(numbers, numbers.tolist() if rows is None else rows, origin.source)
    shape = values.shape[:3]
    positions, confidence = mapped.empty((*shape, 2)), mapped.empty(shape)
    missing: Counter[str] = Counter()
    step = max(1, _POINTS_AT_A_TIME // max(1, values[0].size // 3 if len(values) else 1))
    for start in range(0, len(order), step):  # so that nothing of this size is made in between
        part = values[mapped.as_slice(order[start : start + step])]
        marked = mark_missing(part[..., :2], part[..., 2])
        positions[start : start + step], confidence[start : start + step] = marked[:2]
        missing.update(marked[2])
        mapped.let_go()
    return Keypoints2D(
        camera=origin.camera,
        keypoints=unique_names(tuple(names), origin.source),
        frames=numbers[order],
        positions=positions,
        confidence=confidence,
        tracked=tracked,
        image_size=image_size,
        source=origin.source,
        missing={name: missing[name] for name in MISSING_CUSTOMS if name in missing},
        remarks=remarks,
    )


def blank(frames: int, instances: int, keypoints: int, source: str) -> Floats:
    """Return NaN for x, y and confidence of each point: `[frame, instance, keypoint, 3]`.

    Raises FormatError as `check_size` does.
    """
    check_size(frames, instances, keypoints, source)
    return np.full((frames, instances, keypoints, 3), np.nan)


def check_size(frames: int, instances: int, keypoints: int, source: str) -> None:
    """Raise FormatError for more points than memory holds: a damaged file may ask for anything."""
    if instances > MOST_INSTANCES:
        expected = f"at most {MOST_INSTANCES} detections in a frame"
        raise FormatError(source, expected, instances, "check its frame numbers and individuals")
    if frames * instances * keypoints > MOST_POINTS:
        expected = f"at most {MOST_POINTS} points in a camera"
        found = f"{frames} frames x {instances} detections x {keypoints} keypoints"
        raise FormatError(source, expected, found, "check its individuals, or split it")


def stack_detections(detections: Sequence[Sequence[Floats]], keypoints: int, source: str) -> Floats:
    """Stack the detections of frames: `[frame, instance, keypoint, 3]`, NaN where there are fewer.

    detections: of each frame, each `[keypoint, 3]`, or `[0, 3]` for one without a point.

    Raises FormatError where a detection has another number of keypoints.
    """
    for found in detections:
        for points in found:
            if len(points) not in (0, keypoints):
                expected = f"{keypoints} keypoints in every detection"
                remedy = "keep the detections of one model"
                raise FormatError(source, expected, f"{len(points)} in one", remedy)
    values = blank(len(detections), max(map(len, detections), default=0), keypoints, source)
    for row, found in zip(values, detections, strict=True):
        for target, points in zip(row, found, strict=False):
            target[: len(points)] = points
    return values


def visibility_as_confidence(third: Floats) -> Floats:
    """Return COCO's flags `[...]` (0 not labelled, 1 occluded, 2 visible) as 0, 0.5, 1.

    Anything else is a confidence already.
    """
    known = third[third >= 0]
    are_flags = bool(np.isin(known, (0, 1, 2)).all() and (known == 2).any())
    return third / 2 if are_flags else third


def fill_missing_scores(values: Floats) -> tuple[Floats, tuple[str, ...]]:
    """Give score 1 to points without one, as labelled by hand; return also a remark of them.

    values: `[..., 3]` x, y, score.
    """
    has_score = np.isfinite(values[..., 2])
    bare = np.isfinite(values[..., :2]).all(-1) & np.isnan(values[..., 2])
    if not bare.any():
        return values, ()
    remark = NO_SCORE
    if has_score.any():
        remark = f"{int(bare.sum())} points without a score (labelled by hand?) count fully"
    score = np.where(bare, 1.0, values[..., 2])
    return np.concatenate([values[..., :2], score[..., None]], axis=-1), (remark,)
