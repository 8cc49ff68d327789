"""Which frames of a recording are worked on: all of a short one but the overcrowded, and of a long one a fixed number that shows everything.

Cameras stand where they stand however long the recording is, so calibration looks at a sample whose size does not grow; only
labels and 3D poses are made of all frames, and those in blocks.
"""

from itertools import combinations

import numpy as np

from mocap_calib.config import SampleConfig
from mocap_calib.geometry.projection import rays_from_pixels
from mocap_calib.types import Bools, Floats, Ints, Recording, Sample

_CANDIDATES = 4  # frames looked at for each that is chosen
_CROWD = 2  # times as many detections, and two, as nine tenths of the frames have
_GRID = 6  # cells of the image along each side
_SIZES = 8  # classes of size, which is nearness, by half powers of two
_POSTURES = 16  # classes of posture in each view


def evenly(values: Ints, count: int) -> Ints:
    """An even choice of at most `count` of the values, first and last among them."""
    return values[np.linspace(0, len(values) - 1, min(len(values), count)).astype(int)]


def take_sample(recording: Recording, index: Ints | slice) -> Sample:
    """The frames with these indices, in double precision and with their rays; as many instances as these frames show."""
    part = recording.select(frames=index)
    shown = np.flatnonzero(np.isfinite(part.positions).any((0, 1, 3, 4))).max(initial=0) + 1
    positions, confidence = part.positions[:, :, :shown], part.confidence[:, :, :shown]
    rays = np.stack(
        [
            rays_from_pixels(camera, seen)
            for camera, seen in zip(part.cameras, positions, strict=True)
        ]
    )
    exact = positions.astype(np.float64), confidence.astype(np.float64)
    return Sample(
        part.cameras, part.keypoints, part.frames, *exact, part.tracked, part.vocabulary, rays
    )


def choose_sample_frames(recording: Recording, config: SampleConfig) -> Ints:
    """Indices of the frames that calibration looks at, ascending: all that are not overcrowded, or as many as the budget allows.

    Chosen one by one, each the one that adds most to what the others show: places in each image, sizes of bodies (near and
    far), postures, and what pairs of views see together. What has been seen often counts less and less. Frames with several times the usual
    number of detections are left out: all arrays would be as large as theirs, and most of what they show is false.
    """
    crowd = np.isfinite(recording.positions[..., 0]).any(-1).sum(-1).max(0)  # (frame)
    every = np.flatnonzero(crowd <= _CROWD * np.quantile(crowd, 0.9) + _CROWD)
    candidates = evenly(every, _CANDIDATES * config.frames)
    shown = _shown(recording.select(frames=candidates))
    detections = np.isfinite(recording.positions[:, candidates, :, :, 0]).any(-1).sum() / len(
        candidates
    )
    budget = int(
        np.clip(config.detections / max(detections, 1.0), config.least_frames, config.frames)
    )
    if len(every) <= budget:
        return every
    counts = np.zeros(shown.shape[1])
    left = np.ones(len(candidates), dtype=bool)
    for _ in range(budget):
        gain = shown @ (np.sqrt(counts + 1) - np.sqrt(counts))
        best = int(np.argmax(np.where(left, gain, -1.0)))
        left[best] = False
        counts += shown[best]
    return candidates[~left]


def _shown(recording: Recording) -> Floats:
    """`[frame, feature]` 1 where a frame shows it."""
    frames = len(recording.frames)
    there: Bools = np.asarray(
        np.isfinite(recording.positions[..., 0]).any(-1)
    )  # (view, frame, instance)
    features: list[Bools] = []
    for view, camera in enumerate(recording.cameras):
        frame, instance = np.nonzero(there[view])
        if len(frame):
            pose = recording.positions[view, frame, instance].astype(np.float64)
            classes = _classes(pose, np.array(camera.size))
            for kind, of in classes:
                shown = np.zeros((frames, kind), dtype=bool)
                shown[frame, of] = True
                features.append(shown)
    present: Bools = np.asarray(there.any(-1))
    features += [
        (present[a] & present[b])[:, None] for a, b in combinations(range(len(present)), 2)
    ]
    return np.concatenate(features, axis=1).astype(np.float64)


def _classes(pose: Floats, size: Ints) -> list[tuple[int, Ints]]:
    """Number of classes and the class `[N]` of each detection `[N, keypoint, 2]`: by place, size and posture."""
    seen = np.isfinite(pose)
    count = np.maximum(seen.sum(1, keepdims=True), 1)
    middle = np.where(seen, pose, 0.0).sum(1, keepdims=True) / count
    offset = np.where(seen, pose - middle, 0.0)
    radius = np.sqrt((offset**2).sum((1, 2)) / count[:, 0, 0])
    extent = np.where(size > 0, size, np.maximum(np.nanmax(pose, axis=(0, 1)), 1.0))
    cell = (_GRID * middle[:, 0] / extent).clip(0, _GRID - 1).astype(int)
    half_powers = np.log2(np.maximum(radius, 1e-9) / max(float(np.median(radius)), 1e-9)) * 2
    near = (half_powers + _SIZES / 2).clip(0, _SIZES - 1).astype(int)
    shape = (offset / np.maximum(radius, 1e-9)[:, None, None]).reshape(len(pose), -1)
    typical = shape[evenly(np.arange(len(shape)), _POSTURES)]
    posture = ((typical**2).sum(1) - 2 * shape @ typical.T).argmin(1)
    return [
        (_GRID * _GRID, cell[:, 0] * _GRID + cell[:, 1]),
        (_SIZES, near),
        (len(typical), posture),
    ]
