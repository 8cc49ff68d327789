"""All cameras on one clock: keypoint files and cameras become a recording.

Files and cameras are joined by name, frames by number, keypoints by meaning.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads, map_in_threads
from mocap_calib.config import (
    COPY_COMPARED,
    COPY_FEW,
    COPY_SHARE,
    COPY_TOLERANCE,
    TYPICAL_PERCENTILE,
    PairwiseConfig,
)
from mocap_calib.errors import MismatchError, count
from mocap_calib.recording.joints import normalise_name
from mocap_calib.recording.names import (
    keypoint_meanings,
    pair_with_cameras,
    shared_keypoints,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import (
    Bools,
    Camera,
    Ints,
    Keypoints2D,
    Reals,
    Recording,
    Skeleton,
)


def make_recording(
    files: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
) -> Recording:
    """Join keypoint files and cameras to a recording.

    Views come in the order of `cameras`; cameras without a keypoint file or without any detection
    are left out, and so is what a file has twice (`find_repeated`). Frames are those that two views
    have. Keypoints are those that two views name: a name counts as the joint of the `skeleton` that
    it means, after `aliases` (own name -> joint) were applied. Each view's confidence is scaled to
    0..1 by itself.

    Raises MismatchError where the files do not belong together.
    """
    views, cameras = pair_with_cameras(files, cameras)
    meanings = keypoint_meanings(views, skeleton, aliases)
    check_copies(views, meanings)
    frames = _shared_frames(views)
    shared = shared_keypoints(views, meanings)
    positions, confidence = _fill_arrays(views, frames=frames, meanings=meanings, shared=shared)
    _check_covisible(confidence)
    joint_of = {normalise_name(joint): k for k, joint in enumerate(skeleton.keypoints)}
    return Recording(
        cameras=cameras,
        keypoints=tuple(shared.values()),
        frames=frames,
        positions=positions,
        confidence=confidence,
        tracked=np.array([view.tracked for view in views]),
        vocabulary=np.array([joint_of.get(meaning, -1) for meaning in shared], dtype=np.int64),
        model=skeleton.name,
    )


def split_by_view(
    cameras: Sequence[Camera],
    *,
    keypoints: tuple[str, ...],
    frames: Ints,
    positions: Reals,
    confidence: Reals,
    tracked: Bools,
    source: str,
) -> tuple[Keypoints2D, ...]:
    """Return the keypoints of each view, in the order of the cameras.

    keypoints: `[keypoint]` names. frames: `[frame]` numbers, the same in all views.
    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]`, 0 = missing.
    tracked: `[view]` whether the instance index names the same individual in all frames.
    source: where the arrays come from; the name of the camera follows it in messages.
    """
    return tuple(
        Keypoints2D(
            camera=camera.name,
            keypoints=keypoints,
            frames=frames,
            positions=positions[view],
            confidence=confidence[view],
            tracked=bool(tracked[view]),
            image_size=camera.size,
            source=f"{source} {camera.name}",
        )
        for view, camera in enumerate(cameras)
    )


def _shared_frames(views: Sequence[Keypoints2D]) -> Ints:
    """Return the frame numbers `[frame]` that two views have, ascending.

    Raises MismatchError where there are none.
    """
    numbers = np.concatenate([view.frames for view in views])
    unique, counts = np.unique(numbers, return_counts=True)
    if not (counts >= 2).any():
        ranges = ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in views)
        raise MismatchError(
            "",
            "frames that two cameras have",
            f"the frame numbers {ranges}",
            "number the frames of all cameras on one clock",
        )
    return np.asarray(unique[counts >= 2], dtype=np.int64)


def _fill_arrays(
    views: Sequence[Keypoints2D],
    *,
    frames: Ints,
    meanings: Mapping[str, str],
    shared: Mapping[str, str],
) -> tuple[Reals, Reals]:
    """Return the positions and the confidences of all views in the frames and keypoints they share.

    `[view, frame, instance, keypoint, 2]` and `[view, frame, instance, keypoint]`.

    meanings: of the names of the views. shared: by meaning, in the order of the keypoints.
    """
    instances = max(view.positions.shape[1] for view in views)
    shape = (len(views), len(frames), instances, len(shared))
    positions = mapped.empty((*shape, 2), np.float32)
    confidence = mapped.empty(shape, np.float32)
    column_of = {meaning: column for column, meaning in enumerate(shared)}

    def fill(v: int) -> None:
        """Fill the arrays of one view."""
        view = views[v]
        columns = [column_of.get(meanings[name], -1) for name in view.keypoints]
        used = np.flatnonzero(np.array(columns) >= 0)
        largest = largest_confidence(view.confidence)
        for block in mapped.frame_slices(len(frames)):
            row = np.searchsorted(view.frames, frames[block]).clip(max=len(view.frames) - 1)
            at = np.flatnonzero(view.frames[row] == frames[block])
            rows, of_view = mapped.as_slice(row[at]), mapped.as_slice(used)
            with np.errstate(over="ignore"):  # infinity is missing
                seen = view.positions[rows][:, :, of_view].astype(np.float32)
            scaled = (view.confidence[rows][:, :, of_view] / largest).clip(0.0, 1.0)
            known = np.isfinite(seen).all(-1) & ~find_repeated(seen)[..., None]
            place = np.ix_(at, np.arange(seen.shape[1]), np.array(columns)[used])
            own_positions = np.full((len(row), *shape[2:], 2), np.nan, np.float32)
            own_confidence = np.zeros((len(row), *shape[2:]), np.float32)
            own_positions[place] = np.where(known[..., None], seen, np.nan)
            own_confidence[place] = np.where(known, scaled, 0.0)
            positions[v, block], confidence[v, block] = own_positions, own_confidence

    do_in_threads(fill, range(len(views)))
    return positions, confidence


def largest_confidence(confidence: Reals) -> float:
    """Return what confidences `[...]` are divided by to lie in 0..1.

    For detectors that go beyond 1, this is what they typically reach; for others it is 1.
    """
    if confidence.max(initial=0.0) > 1.0:
        return float(np.percentile(confidence[confidence > 0], TYPICAL_PERCENTILE))
    return 1.0


def _check_covisible(confidence: Reals) -> None:
    """Raise MismatchError where no two views have a detection in the same frame.

    confidence: `[view, frame, instance, keypoint]`.
    """
    sees = mapped.in_blocks(
        lambda block: (confidence[:, block] > 0).any(axis=(2, 3)), confidence.shape[1], axis=1
    )
    if not (sees.sum(axis=0) >= 2).any():
        raise MismatchError(
            "",
            "frames in which two cameras see the subject",
            "no co-visible detections",
            "check that the files are of one recording",
        )


# --- detections given twice
#
# Detections are the same where all coordinates are, between the files of two cameras up to the
# digits that these keep: two cameras never see the same. Subjects that stand still, and cameras
# side by side, look alike but never to the hundredth of a pixel in tens of detections.


def find_repeated(positions: Reals) -> Bools:
    """Return `[frame, instance]` whether an earlier detection of the frame is the same.

    Two are the same where they have the same keypoints, three at least, at the same places:
    single points of two bodies may be the same pixel.

    positions: `[frame, instance, keypoint, 2]` in pixels, NaN = missing.
    """
    frames, instances = positions.shape[:2]
    repeated = np.zeros((frames, instances), dtype=bool)
    if instances < 2:
        return repeated
    seen = np.isfinite(positions[..., 0])
    enough = seen.sum(-1) >= PairwiseConfig.least_joints
    key = np.where(enough, np.where(seen, positions[..., 0], 0.0).sum(-1), np.nan)
    for earlier, later in combinations(range(instances), 2):
        alike = np.flatnonzero(key[:, earlier] == key[:, later])
        first, second = positions[alike, earlier], positions[alike, later]
        same = (first == second) | (np.isnan(first) & np.isnan(second))
        repeated[alike, later] |= same.all((-1, -2))
    return repeated


def check_copies(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> None:
    """Raise MismatchError where two views have the same detections.

    meanings: of the names of their keypoints, see `recording.names.keypoint_meanings`.
    """
    for says in find_copies(views, meanings):
        raise MismatchError(
            "",
            "a file of its own for each camera",
            f"that {says}",
            "give each camera its own file, or leave one of the two out",
        )


def find_copies(
    views: Sequence[Keypoints2D], meanings: Mapping[str, str], *, least: int = COPY_FEW
) -> list[str]:
    """Return which views have the same detections, in any order, at a constant shift, in words.

    meanings: of the names of their keypoints. least: distinct detections of the view that has
        fewer; of fewer nothing is certain.
    """
    own = [{meanings[name]: k for k, name in enumerate(view.keypoints)} for view in views]
    shared = [meaning for meaning in own[0] if all(meaning in of for of in own)] if own else []
    if not shared:
        return []
    columns = [np.array([of[meaning] for meaning in shared], dtype=np.int64) for of in own]
    pairs = zip(views, columns, strict=True)
    found = list(map_in_threads(lambda pair: _project_detections(*pair), pairs))
    shifts = [
        (a, b, _find_shift(found[a], found[b], least))
        for a, b in combinations(range(len(views)), 2)
    ]
    return [
        _describe_copy(views[a], views[b], shift) for a, b, shift in shifts if shift is not None
    ]


def _describe_copy(first: Keypoints2D, second: Keypoints2D, shift: int) -> str:
    """Return that two views have the same detections, those of the second so many frames later."""
    later = ""
    if shift:
        camera = second.camera if shift > 0 else first.camera
        later = f", {count(abs(shift), 'frame')} later in {camera}"
    return (
        f"{first.camera} and {second.camera} have the same detections "
        f"({first.source}, {second.source}{later})"
    )


def _project_detections(view: Keypoints2D, columns: Ints) -> tuple[Reals, Ints]:
    """Return the detections of a view as numbers `[detection]`, ascending, and their frames.

    The coordinates of some keypoints (columns: `[keypoint]`), summed with fixed weights.
    """
    weights = np.cos(np.arange(2 * len(columns)))
    numbers, frames = [np.zeros(0)], [np.zeros(0, np.int64)]
    for rows in mapped.frame_slices(len(view.frames)):
        block = view.positions[rows][:, :, mapped.as_slice(columns)]
        frame, instance = np.nonzero(np.isfinite(block).any((2, 3)))
        seen = np.nan_to_num(block[frame, instance].astype(np.float64))
        numbers.append(seen.reshape(len(seen), -1) @ weights)
        frames.append(view.frames[rows][frame])
    order = np.argsort(number := np.concatenate(numbers), kind="stable")
    return number[order], np.concatenate(frames)[order]


def _find_shift(first: tuple[Reals, Ints], second: tuple[Reals, Ints], least: int) -> int | None:
    """Return by how many frames the second view is later, None where it is another camera's.

    Some detections of the view that has fewer are held against the equal ones of the other view.
    """
    (ours, our_frames), (theirs, their_frames) = sorted((first, second), key=lambda x: len(x[0]))
    tolerance = COPY_TOLERANCE * float(np.abs(ours).max(initial=0.0))
    distinct = np.flatnonzero(np.diff(ours, prepend=-np.inf) > tolerance)
    if len(distinct) < least:
        return None
    chosen = evenly_spaced(distinct, COPY_COMPARED)
    # of equal ones, the first of both
    place = np.minimum(np.searchsorted(theirs, ours[chosen] - tolerance), len(theirs) - 1)
    equal = np.abs(theirs[place] - ours[chosen]) <= tolerance
    shifts = (their_frames[place] - our_frames[chosen])[equal]
    values, counts = np.unique(shifts, return_counts=True)
    if not len(values) or counts.max() < COPY_SHARE * len(chosen):
        return None
    shift = int(values[counts.argmax()])
    return shift if ours is first[0] else -shift
