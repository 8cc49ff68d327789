"""What the readers share: complaints in one line, frame numbers, the marks of a missing point."""

import codecs
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.types import Bools, Floats, Ints, Keypoints2D

_LARGEST = np.iinfo(np.int64).max
NO_SCORE = "no scores in the file: every point counts fully"
MOST_INSTANCES = 1000  # in a frame
MOST_POINTS = 100_000_000  # in a camera: 2.4 GB
_MOST_CAMERAS = 200  # in a file; what compares views takes time with the square of their number
_MOST_KEYPOINTS = 5000


def one_line(value: object, width: int = 80) -> str:
    """`value` as text without line breaks, shortened to `width` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 3]}..."


def malformed(source: str, expected: str, found: object, remedy: str) -> FormatError:
    """The one shape of a complaint about a file's content."""
    return FormatError(
        f"{one_line(source, 300)}: expected {one_line(expected, 200)}, found {one_line(found, 200)}; {one_line(remedy, 200)}"
    )


def read_bytes(path: Path) -> bytes:
    """The whole file at once, so that a pipe can be sniffed as well; UTF-16, as PowerShell's `>` writes it, as UTF-8. Raises FormatError."""
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise malformed(
            str(path),
            "a readable file",
            getattr(error, "strerror", None) or error,
            "check the path",
        ) from None
    try:
        return (
            content.decode("utf-16").encode()
            if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
            else content
        )
    except UnicodeError:
        return content


def plain_path(argument: str | Path) -> Path:
    """Return the path of a file, a folder or a `name=path` pair."""
    path = Path(argument)
    _, equals, rest = str(argument).partition("=")
    return Path(rest) if equals and not path.exists() else path


def decode(content: bytes, source: str) -> str:
    """UTF-8 text without its byte order mark. Raises FormatError."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise malformed(
            source,
            "UTF-8 text",
            f"byte {content[error.start]:#04x} at {error.start}",
            "save it as UTF-8",
        ) from None


def camera_in(name: str, pattern: str) -> str:
    """The camera that a pattern finds in a name: its group `camera`, else its first group, else all it finds; "" where it finds none."""
    found = re.search(pattern, name)
    if found is None:
        return ""
    return str(
        found.groupdict().get("camera")
        or next((group for group in found.groups() if group), "")
        or found[0]
    )


def frame_number(name: str) -> int:
    """A whole number as it is, or the integer at the end of a file name's stem (`a/b_007.png` -> 7); -1 for neither."""
    stem = re.sub(
        r"\.[A-Za-z]\w*$|^(?P<whole>[0-9]+)\.0+$", lambda found: found["whole"] or "", name.strip()
    )
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
        raise malformed(
            source,
            "each frame number once",
            found,
            "give one file per camera and recording, or say which part of a name is the camera with --camera-regex",
        )
    return order


def repeated(names: Iterable[str]) -> list[str]:
    """The names that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def check_cameras(cameras: Sequence[str], source: str) -> None:
    """Raises FormatError where a file has more cameras than anybody has: another column was taken for them."""
    if len(cameras) > _MOST_CAMERAS:
        found = f"{len(cameras)} ({', '.join(cameras[:3])}, ...)"
        raise malformed(
            source,
            f"at most {_MOST_CAMERAS} cameras in a file",
            found,
            "check what names the cameras",
        )


def unique_names(names: Sequence[str], source: str) -> tuple[str, ...]:
    """The keypoint names as they are. Raises FormatError when one occurs twice, or there are more than anybody has."""
    if len(names) > _MOST_KEYPOINTS:
        found = f"{len(names)} ({', '.join(names[:3])}, ...)"
        raise malformed(
            source, f"at most {_MOST_KEYPOINTS} keypoints", found, "check what names the keypoints"
        )
    twice = repeated(names)
    if twice:
        raise malformed(
            source, "each keypoint name once", f"{', '.join(twice)} twice", "rename one of them"
        )
    return tuple(names)


def mark_missing(positions: Floats, confidence: Floats) -> tuple[Floats, Floats, dict[str, int]]:
    """`[..., keypoint, 2]` positions with NaN and `[..., keypoint]` confidences with 0 at every point that a custom calls missing.

    The customs, with how many points each marks (the first that holds counts): (0, 0) (OpenPose, COCO), (-1, -1)
    (DeepLabCut 3), not a number (counted in detections that have any point), a confidence of 0 or below.
    """
    customs = {
        "(0, 0)": (positions == 0).all(-1),
        "(-1, -1)": (positions == -1).all(-1),
        "empty or NaN": ~(np.isfinite(positions).all(-1) & np.isfinite(confidence)),
        "confidence 0": confidence <= 0,
    }
    missing: Bools = np.zeros(confidence.shape, dtype=bool)
    counts = {}
    there = ~np.logical_or.reduce(list(customs.values()))
    for name, marked in customs.items():
        counted = (
            marked & ~missing & (there.any(-1, keepdims=True) if name == "empty or NaN" else True)
        )
        counts[name] = int(counted.sum())
        missing |= marked
    marks = {name: count for name, count in counts.items() if count}
    return (
        np.where(missing[..., None], np.nan, positions),
        np.where(missing, 0.0, confidence),
        marks,
    )


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
    """The record of `[frame, instance, keypoint, 3]` values x, y, confidence: frames in order, missing points marked.

    rows: `[frame]` what complaints call the frames. Raises FormatError where a frame number or a name occurs twice.
    """
    numbers = np.asarray(frames, dtype=np.int64)
    order = frame_order(numbers, numbers.tolist() if rows is None else rows, origin.source)
    positions, confidence, missing = mark_missing(values[order, ..., :2], values[order, ..., 2])
    keypoints = unique_names(tuple(names), origin.source)
    return Keypoints2D(
        origin.camera,
        keypoints,
        numbers[order],
        positions,
        confidence,
        tracked,
        image_size,
        origin.source,
        missing,
        remarks,
    )


def blank(frames: int, instances: int, keypoints: int, source: str) -> Floats:
    """`[frame, instance, keypoint, 3]` NaN, held to what memory holds: a damaged file may ask for anything. Raises FormatError."""
    if instances > MOST_INSTANCES:
        raise malformed(
            source,
            f"at most {MOST_INSTANCES} detections in a frame",
            instances,
            "check its frame numbers and individuals",
        )
    if frames * instances * keypoints > MOST_POINTS:
        found = f"{frames} frames x {instances} detections x {keypoints} keypoints"
        raise malformed(
            source,
            f"at most {MOST_POINTS} points in a camera",
            found,
            "check its individuals, or split it",
        )
    return np.full((frames, instances, keypoints, 3), np.nan)


def stacked(detections: Sequence[Sequence[Floats]], keypoints: int, source: str) -> Floats:
    """`[frame, instance, keypoint, 3]` of each frame's `[keypoint, 3]` detections; those of (0, 3) have no point. Raises FormatError."""
    odd = next(
        (
            len(points)
            for found in detections
            for points in found
            if len(points) not in (0, keypoints)
        ),
        None,
    )
    if odd is not None:
        raise malformed(
            source,
            f"{keypoints} keypoints in every detection",
            f"{odd} in one",
            "keep the detections of one model",
        )
    values = blank(len(detections), max(map(len, detections), default=0), keypoints, source)
    for row, found in zip(values, detections, strict=True):
        for target, points in zip(row, found, strict=False):
            target[: len(points)] = points
    return values


def visibility_as_confidence(third: Floats) -> Floats:
    """COCO's flags (0 not labelled, 1 occluded, 2 visible) as 0, 0.5, 1; anything else is a confidence already."""
    known = third[third >= 0]
    flags = bool(np.isin(known, (0, 1, 2)).all() and (known == 2).any())
    return third / 2 if flags else third


def scored(values: Floats) -> tuple[Floats, tuple[str, ...]]:
    """`[..., 3]` values with score 1 where there is a point without one, as labelled by hand; and a remark where that is so."""
    bare = np.isfinite(values[..., :2]).all(-1) & np.isnan(values[..., 2])
    if not bare.any():
        return values, ()
    known = np.isfinite(values[..., 2]).any()
    remark = (
        f"{int(bare.sum())} points without a score (labelled by hand?) count fully"
        if known
        else NO_SCORE
    )
    return np.concatenate(
        [values[..., :2], np.where(bare, 1.0, values[..., 2])[..., None]], axis=-1
    ), (remark,)
