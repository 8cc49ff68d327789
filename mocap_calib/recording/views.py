"""The keypoints of single views: from arrays, with assumed cameras, and detections given twice.

Detections are the same where all coordinates are, between the files of two cameras up to the digits
that these keep: two cameras never see the same. Subjects that stand still, and cameras side by
side, look alike but never to the hundredth of a pixel in tens of detections.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    COPY_COMPARED,
    COPY_FEW,
    COPY_SHARE,
    COPY_TOLERANCE,
    DEFAULT_FOCAL,
    REFINEMENTS,
    IntrinsicsConfig,
    Refinement,
)
from mocap_calib.errors import MismatchError
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import (
    AssumedCamera,
    Bools,
    Camera,
    Ints,
    Keypoints2D,
    Reals,
)
from mocap_calib.wording import count


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


ASSUMED_NOTE = (
    "no intrinsics were given: focal lengths and lenses are estimated together with the rig"
)


def assume_cameras(views: Sequence[Keypoints2D]) -> tuple[AssumedCamera, ...]:
    """Return a camera for each view, with a typical focal length.

    Its principal point is the middle of the image, and it has no distortion.

    Raises MismatchError where the size of the images is not known.
    """
    return tuple(_assume_camera(view) for view in views)


def choose_refinement(
    cameras: Sequence[Camera], config: IntrinsicsConfig, refine: Refinement | None
) -> IntrinsicsConfig:
    """Return the configuration for the estimation of the intrinsics of these cameras.

    refine: None: as in `config`, or focal lengths and lenses where no intrinsics were given.

    Raises MismatchError for an unknown choice, and for one that is impossible for these cameras.
    """
    assumed = any(isinstance(camera, AssumedCamera) for camera in cameras)
    chosen = refine or config.refine
    if refine is None and chosen == "none" and assumed:
        chosen = ASSUMED_REFINEMENT
    if chosen not in REFINEMENTS:
        known = ", ".join(REFINEMENTS)
        raise MismatchError(f"refine: expected one of {known}, found {chosen!r}; choose one")
    if chosen == "none" and assumed:
        raise MismatchError(
            "refine: expected focal or focal+k1, as nothing is known of the intrinsics, "
            "found none; give the intrinsics, or leave it out"
        )
    return replace(config, refine=chosen)


def _assume_camera(view: Keypoints2D) -> AssumedCamera:
    """Return the camera of a view. Raises MismatchError where its image size is not known."""
    width, height = view.image_size
    if (width, height) == (0, 0):
        raise MismatchError(
            f"{view.source}: expected the size of the images of camera {view.camera}, by which "
            "its focal length is guessed, found none; use --image-size "
            f"{view.camera}:WIDTHxHEIGHT, or give the intrinsics with --cameras"
        )
    focal = DEFAULT_FOCAL * max(width, height)
    middle = (width - 1) / 2, (height - 1) / 2
    return AssumedCamera(
        name=view.camera,
        size=(width, height),
        matrix=np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        fisheye=False,
    )


# --- detections given twice

_LEAST_JOINTS = 3  # seen: single points of two bodies may be the same pixel


def find_repeated(positions: Reals) -> Bools:
    """Return `[frame, instance]` whether an earlier detection of the frame is the same.

    Two are the same where they have the same keypoints, three at least, at the same places.
    positions: `[frame, instance, keypoint, 2]` in pixels, NaN = missing.
    """
    frames, instances = positions.shape[:2]
    repeated = np.zeros((frames, instances), dtype=bool)
    if instances < 2:
        return repeated
    seen = np.isfinite(positions[..., 0])
    enough = seen.sum(-1) >= _LEAST_JOINTS
    key = np.where(enough, np.where(seen, positions[..., 0], 0.0).sum(-1), np.nan)
    for earlier, later in combinations(range(instances), 2):
        alike = np.flatnonzero(key[:, earlier] == key[:, later])
        first, second = positions[alike, earlier], positions[alike, later]
        same = (first == second) | (np.isnan(first) & np.isnan(second))
        repeated[alike, later] |= same.all((-1, -2))
    return repeated


@dataclass(frozen=True)
class Copy:
    """Two views with the same detections.

    shift: frames by which those of the second come later.
    """

    first: Keypoints2D
    second: Keypoints2D
    shift: int

    @property
    def says(self) -> str:
        """Which cameras and files have the same detections, for a person."""
        first, second = self.first, self.second
        later = ""
        if self.shift:
            view = second if self.shift > 0 else first
            later = f", {count(abs(self.shift), 'frame')} later in {view.camera}"
        return (
            f"{first.camera} and {second.camera} have the same detections "
            f"({first.source}, {second.source}{later})"
        )


def check_copies(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> None:
    """Raise MismatchError where two views have the same detections.

    meanings: of the names of their keypoints, see `recording.names.keypoint_meanings`.
    """
    copies = find_copies(views, meanings)
    if copies:
        raise MismatchError(
            "expected a file of its own for each camera, "
            f"found that {copies[0].says}; "
            "give each camera its own file, or leave one of the two out"
        )


def find_copies(
    views: Sequence[Keypoints2D], meanings: Mapping[str, str], *, least: int = COPY_FEW
) -> list[Copy]:
    """Return the pairs of views with the same detections, in any order, at a constant shift.

    meanings: of the names of their keypoints. least: distinct detections of the view that has
        fewer; of fewer nothing is certain.
    """
    own = [{meanings[name]: k for k, name in enumerate(view.keypoints)} for view in views]
    shared = [meaning for meaning in own[0] if all(meaning in of for of in own)] if own else []
    if not shared:
        return []
    columns = [np.array([of[meaning] for meaning in shared], dtype=np.int64) for of in own]
    pairs = zip(views, columns, strict=True)
    found = map_in_threads(lambda pair: _list_detections(*pair), pairs)
    copies = []
    for first, second in combinations(found, 2):
        shift = _find_shift(first, second, least)
        if shift is not None:
            copies.append(Copy(first.view, second.view, shift))
    return copies


@dataclass(frozen=True)
class _Detections:
    """The detections of a view, by the mean of their coordinates.

    columns: `[keypoint]` of the keypoints that all views have, in one order.
    mean: `[detection]` of the coordinates that are seen, ascending. frame: `[detection]` index of
        the frame; instance: `[detection]`.
    """

    view: Keypoints2D
    columns: Ints
    mean: Reals
    frame: Ints
    instance: Ints

    def positions(self, some: Ints) -> Reals:
        """Return the positions `[N, keypoint, 2]` of some detections `[N]`."""
        return self.view.positions[self.frame[some], self.instance[some]][:, self.columns]

    def numbers(self, some: Ints) -> Ints:
        """Return the numbers `[N]` of the frames of some detections `[N]`."""
        return self.view.frames[self.frame[some]]


def _list_detections(view: Keypoints2D, columns: Ints) -> _Detections:
    """Return the detections of a view by their means."""
    parts = [(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for rows in mapped.frame_slices(len(view.frames)):
        block = view.positions[rows][:, :, mapped.as_slice(columns)]
        seen = np.isfinite(block)
        number = np.count_nonzero(seen, axis=(2, 3))
        total = np.where(seen, block, 0.0).sum((2, 3))
        frame, instance = np.nonzero(number)
        mean = total[frame, instance] / number[frame, instance]
        parts.append((mean, frame + rows.start, instance))
    mean, frame, instance = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(mean, kind="stable")
    return _Detections(view, columns, mean[order], frame[order], instance[order])


def _find_shift(first: _Detections, second: _Detections, least: int) -> int | None:
    """Return by how many frames the second view is later, None where it is another camera's.

    Some detections of the view that has fewer are compared with those of the other view that have
    the same mean.
    """
    fewer, more = sorted((first, second), key=lambda each: len(each.mean))
    tolerance = COPY_TOLERANCE * float(np.abs(fewer.mean).max(initial=0.0))
    distinct = np.flatnonzero(np.diff(fewer.mean, prepend=-np.inf) > tolerance)
    if len(distinct) < least:
        return None
    chosen = evenly_spaced(distinct, COPY_COMPARED)
    low = np.searchsorted(more.mean, fewer.mean[chosen] - tolerance)
    high = np.searchsorted(more.mean, fewer.mean[chosen] + tolerance)
    candidates = low[:, None] + np.arange(COPY_FEW)
    of, column = np.nonzero(candidates < high[:, None])
    candidate = candidates[of, column]
    ours, theirs = fewer.positions(chosen[of]), more.positions(candidate)
    mapped.let_go()
    equal = np.isclose(ours, theirs, rtol=0.0, atol=tolerance, equal_nan=True).all((1, 2))
    shifts = more.numbers(candidate) - fewer.numbers(chosen[of])
    found = np.unique(np.column_stack([of, shifts])[equal], axis=0)[:, 1]
    values, counts = np.unique(found, return_counts=True)
    if not len(values) or counts.max() < COPY_SHARE * len(chosen):
        return None
    shift = int(values[counts.argmax()])
    return shift if fewer is first else -shift
