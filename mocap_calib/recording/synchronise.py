"""All cameras on one clock: keypoint files and cameras become a recording.

Files and cameras are joined by name, frames by number, keypoints by meaning.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import CROWDED_SHARE, LEAST_JOINTS, TYPICAL_PERCENTILE
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.lens import rays_from_pixels
from mocap_calib.recording.joints import normalise_name
from mocap_calib.recording.names import (
    keypoint_meanings,
    match_cameras,
    pair_with_cameras,
    shared_keypoints,
)
from mocap_calib.recording.views import check_copies, find_repeated
from mocap_calib.types import (
    Bools,
    Camera,
    Ints,
    Keypoints2D,
    Reals,
    Recording,
    Skeleton,
)


@dataclass(frozen=True)
class JoinedViews:
    """Keypoint files joined with their cameras by name, and their keypoints by meaning.

    files: all views, as they were read.
    camera_names: `[file]` name of the camera that each belongs to.
    views: those with detections, in the order of the cameras.
    cameras: `[view]` with the image sizes of the files where they had none.
    meanings: own name of a keypoint -> meaning, see `keypoint_meanings`.
    skeleton: whose joints the meanings are.
    """

    files: tuple[Keypoints2D, ...]
    camera_names: tuple[str, ...]
    views: tuple[Keypoints2D, ...]
    cameras: tuple[Camera, ...]
    meanings: Mapping[str, str]
    skeleton: Skeleton


def join_views(
    files: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
) -> JoinedViews:
    """Find the camera of each keypoint file, and what its keypoint names mean.

    aliases: other names of joints, own name -> joint of the skeleton.

    Raises MismatchError where the names or the images of files and cameras do not go together.
    """
    camera_names = match_cameras(files, cameras)
    views, sized_cameras = pair_with_cameras(files, camera_names, cameras)
    meanings = keypoint_meanings(views, skeleton, aliases)
    return JoinedViews(tuple(files), camera_names, views, sized_cameras, meanings, skeleton)


def make_recording(
    views: Sequence[Keypoints2D],
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
    return recording_of_views(join_views(views, cameras, skeleton, aliases))


def recording_of_views(joined: JoinedViews) -> Recording:
    """Return the recording of views that have been joined, see `make_recording`.

    Raises MismatchError where they share no frames, keypoints or detections, and where a file was
    given twice.
    """
    views = joined.views
    check_copies(views, joined.meanings)
    frames = _shared_frames(views)
    shared = shared_keypoints(views, joined.meanings)
    positions, confidence = _fill_arrays(
        views, frames=frames, meanings=joined.meanings, shared=shared
    )
    _check_covisible(confidence)
    joint_of = {normalise_name(joint): k for k, joint in enumerate(joined.skeleton.keypoints)}
    return Recording(
        cameras=joined.cameras,
        keypoints=tuple(shared.values()),
        frames=frames,
        positions=positions,
        confidence=confidence,
        tracked=np.array([view.tracked for view in views]),
        vocabulary=np.array([joint_of.get(meaning, -1) for meaning in shared], dtype=np.int64),
        model=joined.skeleton.name,
    )


def hide_blind_spots(recording: Recording) -> Recording:
    """Return the recording without the detections that the cameras' lens models cannot undo.

    With right intrinsics there are hardly any, and without distortion none.
    """
    if not any(camera.fisheye or camera.distortion.any() for camera in recording.cameras):
        return recording
    frames = len(recording.frames)

    def find_blind(block: slice) -> Bools:
        """Return `[view, frame, instance, keypoint]` where a ray is missing that was seen."""
        views = zip(recording.cameras, recording.positions[:, block], strict=True)
        return np.stack(
            [
                np.isnan(rays_from_pixels(camera, seen)[..., 0]) & np.isfinite(seen[..., 0])
                for camera, seen in views
            ]
        )

    blind = mapped.in_blocks(find_blind, frames, axis=1)
    if not blind.any():
        return recording

    def hide(name: str, value: float) -> Reals:
        array = getattr(recording, name)
        hidden = blind[..., None] if name == "positions" else blind
        return mapped.in_blocks(
            lambda block: np.where(hidden[:, block], np.float32(value), array[:, block]),
            frames,
            axis=1,
        )

    return replace(
        recording, positions=hide("positions", np.nan), confidence=hide("confidence", 0.0)
    )


def check_joints(recording: Recording) -> None:
    """Raise MismatchError where the keypoints do not suffice for a calibration.

    There are too few of them, or a crowd asks for a model and it knows too few of them.
    """
    check_shared_keypoints(recording.keypoints)
    known = int((recording.vocabulary >= 0).sum())
    crowded = (recording.detected.sum(-1) > 1).mean() > CROWDED_SHARE
    if known < LEAST_JOINTS and crowded and not recording.tracked.all():
        names = ", ".join(recording.keypoints)
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joint names that the model knows, "
            f"found {known} among {names}; map them with --skeleton"
        )


def check_known_joints(recording: Recording) -> None:
    """Raise MismatchError where the model knows too few joints to lift a body."""
    if (recording.vocabulary >= 0).sum() < LEAST_JOINTS:
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joints that a model knows, "
            f"found {', '.join(recording.keypoints)}; map them with --skeleton"
        )


def check_shared_keypoints(keypoints: Sequence[str]) -> None:
    """Raise MismatchError where two views share too few keypoints for a calibration."""
    if len(keypoints) < LEAST_JOINTS:
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joints that two views have in common, "
            f"found {', '.join(keypoints)}; detect more"
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
            f"expected frames that two cameras have, found the frame numbers {ranges}; "
            "number the frames of all cameras on one clock"
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
        columns = [column_of.get(meanings[name], -1) for name in views[v].keypoints]
        _fill_view(
            views[v],
            frames=frames,
            columns=np.array(columns, dtype=np.int64),
            positions=positions[v],
            confidence=confidence[v],
        )

    list(map_in_threads(fill, range(len(views))))
    return positions, confidence


def _fill_view(
    view: Keypoints2D,
    *,
    frames: Ints,
    columns: Ints,
    positions: Reals,
    confidence: Reals,
) -> None:
    """Fill the arrays of one view of a recording in place.

    frames: `[frame]` numbers of the recording.
    columns: `[keypoint]` index in the recording of each keypoint of the view, -1 = not shared.
    positions: `[frame, instance, keypoint, 2]`. confidence: `[frame, instance, keypoint]`.
    """
    absent = np.flatnonzero(~np.isin(frames, view.frames))
    for block in mapped.frame_slices(len(absent)):
        positions[absent[block]], confidence[absent[block]] = np.nan, 0.0
    used = np.flatnonzero(columns >= 0)
    of_view, of_recording = mapped.as_slice(used), mapped.as_slice(columns[used])
    instances = slice(view.positions.shape[1])
    largest = largest_confidence(view.confidence)
    shared_rows = np.flatnonzero(np.isin(view.frames, frames))
    for block in mapped.frame_slices(len(shared_rows)):
        rows = mapped.as_slice(shared_rows[block])
        at = mapped.as_slice(np.searchsorted(frames, view.frames[rows]))
        seen = view.positions[rows][:, :, of_view].astype(np.float32)
        scaled = (view.confidence[rows][:, :, of_view] / largest).clip(0.0, 1.0)
        known = np.isfinite(seen[..., 0]) & np.isfinite(seen[..., 1])
        missing = ~known | find_repeated(seen)[..., None]
        own_positions = np.full((len(seen), *positions.shape[1:]), np.nan, np.float32)
        own_confidence = np.zeros(own_positions.shape[:-1], np.float32)
        own_positions[:, instances, of_recording] = np.where(missing[..., None], np.nan, seen)
        own_confidence[:, instances, of_recording] = np.where(missing, 0.0, scaled)
        positions[at], confidence[at] = own_positions, own_confidence


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
            "expected frames in which two cameras see the subject, "
            "found no co-visible detections; check that the files are of one recording"
        )
