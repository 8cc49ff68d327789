"""Make the detections of a camera of what files hold: frames, names, points and missing points."""

import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import FormatError, argument, one_line
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_FRAME, MOST_POINTS, Origin, find_repeated
from mocap_calib.io.format import Loss
from mocap_calib.io.layouts import choose_layout
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

NO_SCORE = "no scores in the file: every point counts fully"
ABSENT_FRAMES = "frames without a detection are not in the file"
MOST_INSTANCES = 1000  # in a frame
_MISSING = ("(0, 0)", "(-1, -1)", "empty or NaN", "confidence 0")  # how files mark missing points
_POINTS_AT_A_TIME = 50_000
_MOST_CAMERAS = 200  # in a file; the time to compare views grows with the square of their number
_MOST_KEYPOINTS = 5000
_PLAIN_DIGITS = 18  # of a number below LARGEST_FRAME, whatever the digits are
_MOST_DIGITS = 30  # of a frame number that is looked at
_SUFFIX_OR_ZEROS = r"\.[A-Za-z]\w*$|^(?P<whole>[0-9]+)\.0+$"  # `.png`, or `.0` of a whole number
_NOT_WHOLE = r"-[0-9.]+|[0-9]*\.[0-9]+"

Views = Sequence[Keypoints2D]


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


def cameras_by_pattern(names: Sequence[str], pattern: str, *, named: str, source: str) -> list[str]:
    """Return the camera of each name as the user's pattern finds it.

    named: what the format calls a name. Nothing is returned where there is no pattern, or where it
    finds no camera at all; FormatError is raised where it finds some only.
    """
    cameras = [find_camera(name, pattern) for name in names] if pattern else []
    if any(cameras) and not all(cameras):
        expected = f"a camera in each {named} by the pattern {pattern}"
        raise FormatError(source, expected, names[cameras.index("")], "change it")
    return cameras if any(cameras) else []


def check_cameras(cameras: Sequence[str], source: str) -> None:
    """Raise FormatError where a file has more cameras than anybody: another column was taken."""
    _check_count(cameras, _MOST_CAMERAS, "cameras in a file", "the cameras", source)


def unique_names(names: Sequence[str], source: str) -> tuple[str, ...]:
    """Return the keypoint names as they are.

    Raises FormatError where one occurs twice, or there are more than anybody has.
    """
    _check_count(names, _MOST_KEYPOINTS, "keypoints", "the keypoints", source)
    twice = find_repeated(names)
    if twice:
        found = f"{', '.join(twice)} twice"
        raise FormatError(source, "each keypoint name once", found, "rename one of them")
    return tuple(names)


def _check_count(names: Sequence[str], most: int, what: str, named: str, source: str) -> None:
    if len(names) > most:
        found = f"{len(names)} ({', '.join(names[:3])}, ...)"
        raise FormatError(source, f"at most {most} {what}", found, f"check what names {named}")


def frame_number(name: str) -> int:
    """Return the frame number in a text: a whole number, or the end of a file's stem.

    `a/b_007.png` is 7; -1 stands for a text with neither.
    """
    if name.isascii() and name.isdigit() and len(name) <= _PLAIN_DIGITS:
        return int(name)
    stem = re.sub(_SUFFIX_OR_ZEROS, lambda found: found["whole"] or "", name.strip())
    if re.fullmatch(_NOT_WHOLE, stem):
        return -1
    digits = re.search(r"[0-9]+$", stem)
    if digits is None or len(digits[0]) >= _MOST_DIGITS:
        return -1
    number = int(digits[0])
    return number if number < LARGEST_FRAME else -1


def frames_of(document: Document) -> tuple[list[str], list[int]]:
    """Return the names and numbers of the frames in a folder with a file per frame.

    Raises FormatError.
    """
    names = [path.name for path in document.members or (document.path,)]
    return names, frame_numbers(names, document.source)


def frame_numbers(names: Sequence[str], source: str) -> list[int]:
    """Return the integer at the end of each name, before its suffix and `_keypoints`.

    Where a name has none there, the last integer of each name is taken. Raises FormatError.
    """
    # file names without their folders and without OpenPose's addition
    files = [re.split(r"[/\\]", name)[-1] for name in names]
    stems = [re.sub(r"_keypoints(?=(\.\w+)?$)", "", file) for file in files]
    numbers = [frame_number(stem) for stem in stems]
    if -1 in numbers:
        numbers = [frame_number((re.findall(r"[0-9]+", stem) or [""])[-1]) for stem in stems]
    if -1 in numbers:
        found = stems[numbers.index(-1)]
        raise FormatError(source, "a frame number in each file name", found, "rename or remove it")
    return numbers


# --- JSON


def is_list_of(entries: Any, *keys: str) -> bool:
    """Return whether this is a list whose first entries are objects with these keys."""
    if not isinstance(entries, list) or not entries:
        return False
    return all(isinstance(entry, dict) and set(keys) <= entry.keys() for entry in entries[:20])


def triples(numbers: Sequence[float | None], source: str, named: str) -> Floats:
    """Return `[keypoint, 3]` of a flat list x, y, c; `named` is what messages call it.

    Raises FormatError.
    """
    if len(numbers) % 3:
        expected = f"`{named}` to be a list of x, y, c"
        raise FormatError(source, expected, f"{len(numbers)} numbers", "export it again")
    return np.array(numbers, dtype=np.float64).reshape(-1, 3)


def view_of_frames(
    document: Document,
    options: ReadOptions,
    frames: Sequence[int],
    detections: Sequence[Sequence[Any]],
    *,
    unambiguous: tuple[str, ...] = (),
    rows: Sequence[object] | None = None,
    remarks: tuple[str, ...] = (),
    visibility: bool = False,
) -> Keypoints2D:
    """Return the camera of detections in any order whose keypoints have no names.

    frames: `[frame]` numbers.
    detections: `[keypoint, 3]` x, y and confidence of each detection of each frame.
    unambiguous: see `choose_layout`. rows, remarks: see `make_view`.
    visibility: confidences may be COCO's flags.

    Raises FormatError.
    """
    count = max((len(points) for frame in detections for points in frame), default=0)
    if count == 0:
        found, remedy = f"none in {len(detections)} frames", "check the detector's output"
        raise document.refuse("detections in one of its frames", found, remedy)
    names = choose_layout(
        count, given=options.layout, source=document.source, unambiguous=unambiguous
    )
    values = stack_detections(detections, count, document.source)
    if visibility:
        values[..., 2] = visibility_as_confidence(values[..., 2])
    origin = document.origin
    return make_view(origin, names, frames, values, tracked=False, rows=rows, remarks=remarks)


# --- detections


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
    rows: `[frame]` what messages call the frames.

    Raises FormatError where a frame number or a name occurs twice.
    """
    numbers = np.asarray(frames, dtype=np.int64)
    order = _frame_order(numbers, numbers.tolist() if rows is None else rows, origin.source)
    shape = values.shape[:3]
    positions, confidence = mapped.empty((*shape, 2)), mapped.empty(shape)
    missing: Counter[str] = Counter()
    step = max(1, _POINTS_AT_A_TIME // max(1, values[0].size // 3 if len(values) else 1))
    for start in range(0, len(order), step):  # so that nothing of this size is made in between
        part = values[mapped.as_slice(order[start : start + step])]
        block = slice(start, start + step)
        positions[block], confidence[block] = _mark_missing(part, missing)
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
        missing={name: missing[name] for name in _MISSING if missing[name]},
        remarks=remarks,
    )


def _frame_order(frames: Ints, names: Sequence[object], source: str) -> Ints:
    """Return `[frame]` indices that sort `[frame]` frame numbers.

    names: `[frame]` what messages call the frames.

    Raises FormatError where a number occurs twice.
    """
    order = np.argsort(frames, kind="stable")
    twice = np.flatnonzero(np.diff(frames[order]) == 0)
    if twice.size:
        first, second = order[twice[0]], order[twice[0] + 1]
        places = f"{one_line(names[first], 60)} and {one_line(names[second], 60)}"
        found = f"frame {frames[first]} twice, at {places}"
        which = f"or say which part of a name is the camera with {argument('camera_regex')}"
        remedy = f"give one file per camera and recording, {which}"
        raise FormatError(source, "each frame number once", found, remedy)
    return order


def _mark_missing(values: Floats, counts: Counter[str]) -> tuple[Floats, Floats]:
    """Return positions with NaN and confidences with 0 where a point is missing; count these.

    values: `[frame, instance, keypoint, 3]`. counts: how many points each mark says are missing,
    which is added to; of several marks the first counts.

    The marks are (0, 0) (OpenPose, COCO), (-1, -1) (DeepLabCut 3), not a number (counted in
    detections that have any point), and a confidence of 0 or below.
    """
    x, y, confidence = values[..., 0], values[..., 1], values[..., 2]
    marks = (
        (x == 0) & (y == 0),
        (x == -1) & (y == -1),
        ~(np.isfinite(x) & np.isfinite(y) & np.isfinite(confidence)),
        confidence <= 0,
    )
    missing = np.logical_or.reduce(marks)
    counted = np.zeros_like(missing)
    for name, marked in zip(_MISSING, marks, strict=True):
        if marked.any():
            added = marked & ~counted
            if name == "empty or NaN":
                added &= ~missing.all(-1, keepdims=True)
            counts[name] += int(added.sum())
            counted |= marked
    positions = np.where(missing[..., None], np.nan, values[..., :2])
    return positions, np.where(missing, 0.0, confidence)


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


def stack_detections(detections: Sequence[Sequence[Any]], keypoints: int, source: str) -> Floats:
    """Stack the detections of frames: `[frame, instance, keypoint, 3]`, NaN where there are fewer.

    detections: of each frame, each `[keypoint, 3]`, or empty for one without a point.

    Raises FormatError where a detection has another number of keypoints.
    """
    values = blank(len(detections), max(map(len, detections), default=0), keypoints, source)
    for row, found in zip(values, detections, strict=True):
        for target, points in zip(row, found, strict=False):
            if len(points) not in (0, keypoints):
                expected = f"{keypoints} keypoints in every detection"
                remedy = "keep the detections of one model"
                raise FormatError(source, expected, f"{len(points)} in one", remedy)
            if len(points):
                target[:] = points
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
    bare = np.isfinite(values[..., :2]).all(-1) & np.isnan(values[..., 2])
    if not bare.any():
        return values, ()
    remark = NO_SCORE
    if np.isfinite(values[..., 2]).any():
        remark = f"{int(bare.sum())} points without a score (labelled by hand?) count fully"
    score = np.where(bare, 1.0, values[..., 2])
    return np.concatenate([values[..., :2], score[..., None]], axis=-1), (remark,)


# --- what a format may have no place for


def _follow_individuals(views: Views) -> bool:
    return any(view.tracked and view.positions.shape[1] > 1 for view in views)


def _follow_in_some_cameras(views: Views) -> bool:
    return _follow_individuals(views) and not all(view.tracked for view in views)


def _have_sizes(views: Views) -> bool:
    return any(view.image_size != (0, 0) for view in views)


def _have_gaps(views: Views) -> bool:
    return any(len(view.frames) <= view.frames.max(initial=-1) for view in views)


def _lack_scores(views: Views) -> bool:
    return any(NO_SCORE in view.remarks for view in views)


NAMES = Loss("the names of keypoints", bool)
FOLLOWED = Loss("who is who from frame to frame", _follow_individuals)
# one column for all cameras says either individual or instance
MIXED = Loss(
    "who is who from frame to frame, as one of the cameras does not say it",
    _follow_in_some_cameras,
)
SIZES = Loss("image sizes", _have_sizes)
GAPS = Loss("which frames are absent: they become empty ones", _have_gaps)
SCORES = Loss("that there are no scores: each point gets 1", _lack_scores)
