"""Choose the frames of a recording from which the rig is calibrated.

All frames of a short recording except overcrowded ones; of a long one a fixed number that covers
the images and the pairs of views. Labels and 3D poses are made for all frames, in blocks.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from mocap_calib.config import CROWDED_SHARE, LEAST_JOINTS, SampleConfig, SyncConfig
from mocap_calib.errors import MismatchError, argument
from mocap_calib.geometry import lens
from mocap_calib.types import Camera, Floats, Ints, Reals, Recording, Sample

_STRETCH_FRAMES = 400  # at most, in all stretches together, and half the detections of a sample


def evenly_spaced(values: Ints, count: int) -> Ints:
    """Return at most `count` of the values `[N]`, evenly spaced, first and last among them."""
    positions = np.linspace(0, len(values) - 1, min(len(values), count))
    return values[positions.astype(int)]


def take_sample(recording: Recording, index: Ints | slice) -> Sample:
    """Return some frames in double precision, with their rays.

    The sample has as many instances as these frames need. Detections that the lens model cannot
    undistort are left out.

    index: `[frame]` indices of the frames (not numbers), or a slice.
    """
    part = recording.select(frames=index)
    instances = _count_instances(part.positions)
    positions = part.positions[:, :, :instances].astype(np.float64)
    sample = Sample(
        cameras=part.cameras,
        keypoints=part.keypoints,
        frames=part.frames,
        positions=positions,
        confidence=part.confidence[:, :, :instances].astype(np.float64),
        tracked=part.tracked,
        vocabulary=part.vocabulary,
        rays=np.empty((*positions.shape[:4], 3)),
        model=part.model,
    )
    return with_cameras(sample, part.cameras)


def _count_instances(positions: Reals) -> int:
    """Return the most instances of a frame, of positions `[view, frame, instance, keypoint, 2]`."""
    for last in range(positions.shape[2] - 1, 0, -1):
        if np.isfinite(positions[:, :, last]).any():
            return last + 1
    return 1


def with_cameras(sample: Sample, cameras: tuple[Camera, ...]) -> Sample:
    """Return the sample with the rays of other intrinsics.

    Detections that the lens model cannot undistort are left out.
    """
    views, *rest, _ = sample.positions.shape
    pixels = sample.positions.reshape(views, -1, 2)
    rays = lens.unproject_views(cameras, pixels, by_component=False).reshape(views, *rest, 3)
    blind = np.isnan(rays[..., 0])
    positions, confidence = sample.positions, sample.confidence
    if (blind & (np.isfinite(positions[..., 0]) | (confidence > 0))).any():
        positions = np.where(blind[..., None], np.nan, positions)
        confidence = np.where(blind, 0.0, confidence)
    return replace(sample, cameras=cameras, rays=rays, positions=positions, confidence=confidence)


def choose_sample_frames(recording: Recording, config: SampleConfig) -> Ints:
    """Return the indices `[frame]` of the frames that calibration looks at, ascending.

    They are all frames that are not overcrowded, or as many as the budget allows, chosen one by
    one: each adds most to what the chosen ones show. What is shown often counts less and less.

    Frames with several times the usual number of detections are left out: they would set the size
    of all arrays, and most of their detections are false.
    """
    detections = recording.detected.sum(-1)  # [view, frame]
    most = detections.max(0)
    usual = np.quantile(most, config.usual_share)
    uncrowded = np.flatnonzero(most <= config.crowd * usual + config.crowd)
    in_frame = max(detections[:, uncrowded].sum() / len(uncrowded), 1.0)
    budget = int(np.clip(config.detections / in_frame, config.least_frames, config.frames))
    if len(uncrowded) <= budget:
        return uncrowded
    candidates = evenly_spaced(uncrowded, config.candidates * config.frames)
    shown = _shown_features(recording.select(frames=candidates), config.cells)
    counts, chosen = np.zeros(shown.shape[1]), np.zeros(len(candidates), dtype=bool)
    for _ in range(budget):
        gain = shown @ (np.sqrt(counts + 1) - np.sqrt(counts))
        best = int(np.argmax(np.where(chosen, -1.0, gain)))
        chosen[best] = True
        counts += shown[best]
    return candidates[chosen]


def _shown_features(recording: Recording, cells: int) -> Floats:
    """Return `[frame, feature]` 1 where a frame shows a feature, else 0.

    Features are pairs of views that both have a detection, and cells of each view that hold the
    middle of one: so many along each side of the box of all middles.
    """
    sees = np.asarray(recording.detected.any(-1))  # [view, frame]
    frames = len(recording.frames)
    features = [sees[a] & sees[b] for a, b in combinations(range(len(sees)), 2)]
    for there, positions in zip(recording.detected, recording.positions, strict=True):
        frame, instance = np.nonzero(there)
        if not len(frame):
            continue
        middle = np.nanmean(positions[frame, instance].astype(np.float64), axis=1)
        share = (middle - middle.min(0)) / np.maximum(np.ptp(middle, axis=0), 1.0)
        column, row = np.minimum(cells * share, cells - 1).astype(int).T
        shown = np.zeros((cells, cells, frames), dtype=bool)
        shown[column, row, frame] = True
        features.extend(shown.reshape(-1, frames))
    return np.stack(features, axis=1).astype(np.float64)


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
            "",
            f"at least {LEAST_JOINTS} joint names that the model knows",
            f"{known} among {names}",
            f"map them with {argument('skeleton')}",
        )


def check_known_joints(recording: Recording) -> None:
    """Raise MismatchError where the model knows too few joints to lift a body."""
    if (recording.vocabulary >= 0).sum() < LEAST_JOINTS:
        raise MismatchError(
            "",
            f"at least {LEAST_JOINTS} joints that a model knows",
            ", ".join(recording.keypoints),
            f"map them with {argument('skeleton')}",
        )


def check_shared_keypoints(keypoints: Sequence[str]) -> None:
    """Raise MismatchError where two views share too few keypoints for a calibration."""
    if len(keypoints) < LEAST_JOINTS:
        raise MismatchError(
            "",
            f"at least {LEAST_JOINTS} joints that two views have in common",
            ", ".join(keypoints),
            "detect more",
        )


# --- stretches of consecutive frames, in which clocks are compared


def choose_stretches(recording: Recording, config: SyncConfig) -> Ints:
    """Return the frames `[stretch, frame]` (indices, -1 = not in the recording) of stretches.

    Within a stretch, frames follow each other by the usual distance of frame numbers. A short
    recording is one stretch; of a long one there are several, which begin with its first frame and
    are spread over it, each three windows long.
    """
    frames = recording.frames
    step = usual_step(frames)
    first = frames.min()  # frames may come in any order
    position = np.round((frames - first) / step).astype(np.int64)
    on_grid = first + position * step == frames
    length = int(position.max()) + 1
    in_frame = max(recording.detected.sum() / len(frames), 1.0)
    budget = int(min(_STRETCH_FRAMES, SampleConfig.detections / 2 / in_frame))
    each = max(3 * config.window, 1)
    count = max(1, budget // each)
    if length <= max(budget, each):
        starts, each = np.zeros(1, dtype=np.int64), length
    else:
        starts = np.unique(np.linspace(0, max(length - each, 0), count).astype(np.int64))
    index = np.full(length, -1, dtype=np.int64)
    index[position[on_grid]] = np.flatnonzero(on_grid)
    return index[starts[:, None] + np.arange(min(each, length))]


def usual_step(frames: Ints) -> int:
    """Return the usual difference of successive frame numbers `[frame]`."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1
