"""Make the detections of a camera of what files hold: frames, names, points and missing points."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import FormatError, argument, one_line
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_FRAME, MOST_POINTS, Origin, find_repeated
from mocap_calib.io.format import Loss
from mocap_calib.io.read_options import ReadOptions, choose_layout
from mocap_calib.recording.names import compose_name
from mocap_calib.types import Floats, Ints, Keypoints2D

NO_SCORE = "no scores in the file: every point counts fully"
ABSENT_FRAMES = "frames without a detection are not in the file"
MOST_INSTANCES = 1000  # in a frame
_NO_SCORE = "no score"
_MISSING = ("(0, 0)", "(-1, -1)", "empty or NaN", "confidence 0")  # how files mark missing points
_POINTS_AT_A_TIME = 10_000  # which a processor holds
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
    found = re.search(compose_name(pattern), compose_name(name))
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
    _check_count(cameras, _MOST_CAMERAS, "cameras in a file", source)


def _check_count(names: Sequence[str], most: int, what: str, source: str) -> None:
    """Raise FormatError for more names than anybody has: another column was taken for them."""
    if len(names) > most:
        found = f"{len(names)} ({', '.join(names[:3])}, ...)"
        raise FormatError(source, f"at most {most} {what}", found, "check what names them")


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


def triples(numbers: Sequence[float | None] | None, source: str, named: str) -> Floats:
    """Return `[keypoint, 3]` of a flat list x, y, c, or of none; `named` is what messages call it.

    Raises FormatError.
    """
    if len(numbers or ()) % 3:
        expected = f"`{named}` to be a list of x, y, c"
        raise FormatError(source, expected, f"{len(numbers or ())} numbers", "export it again")
    return np.array(numbers or (), dtype=np.float64).reshape(-1, 3)


# --- detections


def make_view(
    origin: Origin,
    names: Sequence[str],
    frames: Sequence[int] | Ints,
    values: Floats,
    *,
    tracked: bool = False,
    image_size: tuple[int, int] = (0, 0),
    row_name: Callable[[int], object] | None = None,
    remarks: tuple[str, ...] = (),
) -> Keypoints2D:
    """Return the record of detections, with frames in order and missing points marked.

    Points without a score get 1, as labelled by hand, and a remark.

    names: `[keypoint]`.
    frames: `[frame]` numbers, in any order.
    values: `[frame, instance, keypoint, 3]` x, y (pixels) and a score, or COCO's visibility
        (0 not labelled, 1 occluded, 2 visible), which becomes 0, 0.5, 1.
    row_name: what messages call a frame (an index); None: its number.

    Raises FormatError where a frame number or a name occurs twice.
    """
    frame_count, instances, keypoints = values.shape[:3]
    check_size(frame_count, instances, keypoints, origin.source)
    _check_count(names, _MOST_KEYPOINTS, "keypoints", origin.source)
    twice = find_repeated(names)
    if twice:
        found = f"{', '.join(twice)} twice"
        raise FormatError(origin.source, "each keypoint name once", found, "rename one of them")
    numbers = np.asarray(frames, dtype=np.int64)
    order = _frame_order(numbers, row_name or numbers.item, origin.source)
    third = values[..., 2]
    are_flags = (third == 2).any() and np.isin(third[third >= 0], (0, 1, 2)).all()
    shape = values.shape[:3]
    positions, confidence = mapped.empty((*shape, 2)), mapped.empty(shape)
    counts: Counter[str] = Counter()
    step = max(1, _POINTS_AT_A_TIME // max(1, shape[1] * shape[2]))
    for start in range(0, len(order), step):  # so that nothing of this size is made in between
        x, y, score = np.moveaxis(values[mapped.as_slice(order[start : start + step])], -1, 0)
        block = slice(start, start + step)
        scale = 0.5 if are_flags else 1.0
        positions[block], confidence[block] = _mark_missing(x, y, scale * score, counts)
        mapped.let_go()
    bare = counts[_NO_SCORE]
    if bare:
        some = f"{bare} points without a score (labelled by hand?) count fully"
        remarks = (*remarks, some if np.isfinite(third).any() else NO_SCORE)
    return Keypoints2D(
        camera=origin.camera,
        keypoints=tuple(names),
        frames=numbers[order],
        positions=positions,
        confidence=confidence,
        tracked=tracked,
        image_size=image_size,
        source=origin.source,
        missing={name: counts[name] for name in _MISSING if counts[name]},
        remarks=remarks,
    )


def _frame_order(frames: Ints, row_name: Callable[[int], object], source: str) -> Ints:
    """Return `[frame]` indices that sort frame numbers. Raises FormatError where one is twice."""
    order = np.argsort(frames, kind="stable")
    twice = np.flatnonzero(np.diff(frames[order]) == 0)
    if twice.size:
        first, second = order[twice[0] : twice[0] + 2].tolist()
        places = " and ".join(one_line(row_name(row), 60) for row in (first, second))
        found = f"frame {frames[first]} twice, at {places}"
        which = f"or say which part of a name is the camera with {argument('camera_regex')}"
        remedy = f"give one file per camera and recording, {which}"
        raise FormatError(source, "each frame number once", found, remedy)
    return order


def _mark_missing(
    x: Floats, y: Floats, score: Floats, counts: Counter[str]
) -> tuple[Floats, Floats]:
    """Return positions with NaN and confidences with 0 where a point is missing; count these.

    x, y, score: `[frame, instance, keypoint]`. counts: how many points each mark says are missing,
    and how many have no score, which is added to; of several marks the first counts.

    The marks are (0, 0) (OpenPose, COCO), (-1, -1) (DeepLabCut 3), not a number (counted in
    detections that have any point), and a confidence of 0 or below.
    """
    positions = np.stack([x, y], axis=-1)
    is_there = np.isfinite(positions).all(-1)
    bare = is_there & np.isnan(score)
    score[bare] = 1.0
    marks = (
        (x == 0) & (y == 0),
        (x == -1) & (y == -1),
        ~(is_there & np.isfinite(score)),
        score <= 0,
    )
    missing = marks[0] | marks[1] | marks[2] | marks[3]
    counts[_NO_SCORE] += int(np.count_nonzero(bare & ~missing))
    if missing.any():
        is_detected = ~missing.all(-1, keepdims=True)
        left = np.ones_like(missing)
        for name, marked in zip(_MISSING, marks, strict=True):
            counted = marked & left & is_detected if name == "empty or NaN" else marked & left
            counts[name] += int(np.count_nonzero(counted))
            left &= ~marked
        positions[missing], score[missing] = np.nan, 0.0
    return positions, score


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


def view_of_frames(
    document: Document,
    options: ReadOptions,
    frames: Sequence[str] | Sequence[int] | Ints,
    detections: Sequence[Sequence[Any]],
    *,
    names: Sequence[str] = (),
    unambiguous: tuple[str, ...] = (),
    **further: Any,
) -> Keypoints2D:
    """Return the camera of detections, which are individuals or in any order.

    frames: `[frame]` numbers, or names of files or images that end in them.
    detections: of each frame, each `[keypoint, 3]` x, y and score, or empty for one without a
        point.
    names: `[keypoint]`, where the file has them; else those of a layout, of the options or one of
        the `unambiguous`, see `choose_layout`.
    further: see `make_view`.

    Raises FormatError where there is no point, or a detection has another number of keypoints.
    """
    source = document.source
    labels = [frame for frame in frames if isinstance(frame, str)]
    if labels:
        further = {"row_name": labels.__getitem__} | further
    if not names:
        count = max((len(points) for found in detections for points in found), default=0)
        if count == 0:
            found, remedy = f"none in {len(detections)} frames", "check the detector's output"
            raise document.refuse("detections in one of its frames", found, remedy)
        names = choose_layout(count, options.layout, source, unambiguous)
    values = blank(len(detections), max(map(len, detections), default=0), len(names), source)
    for row, each in zip(values, detections, strict=True):
        for target, points in zip(row, each, strict=False):
            if len(points) not in (0, len(names)):
                expected = f"{len(names)} keypoints in every detection"
                remedy = "keep the detections of one model"
                raise document.refuse(expected, f"{len(points)} in one", remedy)
            if len(points):
                target[:] = points
    numbers = frame_numbers(labels, source) if labels else np.asarray(frames, dtype=np.int64)
    return make_view(document.origin, names, numbers, values, **further)


def collect_remarks(views: Views) -> tuple[str, ...]:
    """Return what the readers remark, each line once, with the cameras that it is of."""
    cameras: dict[str, list[str]] = {}
    for view in views:
        for remark in view.remarks:
            cameras.setdefault(remark, []).append(view.camera)
    return tuple(f"{', '.join(names)}: {remark}" for remark, names in cameras.items())


# --- what a format may have no place for


def _follow_individuals(views: Views) -> bool:
    return any(view.tracked and view.positions.shape[1] > 1 for view in views)


def _follow_in_some_cameras(views: Views) -> bool:
    return _follow_individuals(views) and not all(view.tracked for view in views)


def _have_sizes(views: Views) -> bool:
    return any(any(view.image_size) for view in views)


def _lack_scores(views: Views) -> bool:
    return any(NO_SCORE in view.remarks for view in views)


def _have_gaps(views: Views) -> bool:
    return any(len(view.frames) <= view.frames.max(initial=-1) for view in views)


NAMES = Loss("the names of keypoints", bool)
FOLLOWED = Loss("identities from frame to frame", _follow_individuals)
# one column for all cameras says either individual or instance
MIXED = Loss(
    "identities from frame to frame, which one of the cameras lacks",
    _follow_in_some_cameras,
)
SIZES = Loss("image sizes", _have_sizes)
GAPS = Loss("which frames are absent: they become empty ones", _have_gaps)
SCORES = Loss("that there are no scores: each point gets 1", _lack_scores)
