"""How large the errors of each view's detections are, measured on the points that others see too.

A point bends to what was seen of it, so what is left is less than the errors were. Weights and
covariances of points need the errors themselves, `view_noise`; what limits and losses are held
against are residuals, whose spread is `view_residual`.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.intersection import intersect
from mocap_calib.geometry.point_covariance import median_angles
from mocap_calib.geometry.rays import ray_angles, rays_in_world
from mocap_calib.geometry.view_blocks import ViewBlock, view_blocks
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.observations import (
    Observations,
    gather_observations,
    labelled_frames,
)
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches, Recording

# The median distance of a normal error in the plane from its centre, sqrt(2 log 2), in standard
# deviations of one coordinate
MEDIAN_DISTANCE = 1.18


@dataclass(frozen=True)
class MeasuredSample:
    """Angles between the rays of an even sample of the frames that have labels, and their points.

    frames: `[frame]` indices. seen: the detections of N points; points: `[3, N]`.
    angle: `[view, N]` in radians. counted: `[view, N]` those of points that three views see (two
        where there are no more).
    """

    frames: Ints
    seen: Observations
    points: Floats
    angle: Floats
    counted: Bools


def measure_sample(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> MeasuredSample:
    """Return the angles between rays and the points where they meet, of a sample of frames."""
    frames, seen = _choose_sample(recording, matches, config)
    return MeasuredSample(frames, seen, *_measure_angles(rig, seen, config))


def _choose_sample(
    recording: Recording, matches: Matches, config: TriangulateConfig
) -> tuple[Ints, Observations]:
    """Return some of the frames that have labels, evenly spaced, and what is seen in them."""
    frames = evenly_spaced(labelled_frames(matches), config.noise_frames)
    return frames, gather_observations(recording, matches, frames)


def view_noise(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    Of one coordinate. Measured in an even sample of the frames that have labels, on the points
    that three views see (two where there are no more).
    """
    _, seen = _choose_sample(recording, matches, config)
    return _medians_of_views(rig, *measure_errors(rig, seen, config), config)


def view_residual(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return what is left `[view]` of `view_noise` where points have bent to what was seen.

    The robust standard deviation of residuals, measured on the same points.
    """
    return residual_noise(rig, measure_sample(recording, rig, matches, config), config)


def residual_noise(rig: CameraRig, measured: MeasuredSample, config: TriangulateConfig) -> Floats:
    """Return what `view_residual` does, of a sample that was measured."""
    return _medians_of_views(rig, measured.angle / MEDIAN_DISTANCE, measured.counted, config)


def _medians_of_views(
    rig: CameraRig, measured: Floats, counted: Bools, config: TriangulateConfig
) -> Floats:
    """Return the medians `[view]` of what is measured `[view, N]`, of those that count."""
    medians = np.full(len(rig.cameras), config.unknown_noise)
    for view in np.flatnonzero(counted.any(1)):
        medians[view] = np.median(measured[view, counted[view]])
    return np.maximum(medians, least_noise(rig, config))


def measure_errors(
    rig: CameraRig, seen: Observations, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return angles `[view, N]` in radians whose medians are the views' standard deviations.

    They are those between rays and the points where they meet, over their medians where each ray
    has an error of one standard deviation (`geometry.point_covariance`).

    Also which of them count, `[view, N]`: of points that three views see (two where there are no
    more).
    """
    points, angle, counted = _measure_angles(rig, seen, config)
    return angle / median_angles(rig, points, seen.confidence), counted


def _measure_angles(
    rig: CameraRig, seen: Observations, config: TriangulateConfig
) -> tuple[Floats, Floats, Bools]:
    """Return points `[3, N]`, their angles to the rays `[view, N]`, and which of these count.

    An angle is pi where nothing is seen.
    """
    present = seen.confidence > 0
    points, angle = np.full((3, present.shape[1]), np.nan), np.full(present.shape, np.pi)

    def measure(block: ViewBlock) -> tuple[Floats, Floats]:
        """Return points and angles of a block."""
        own, rays = rig.select(block.views), block.take(seen.rays)
        precision = block.take(seen.confidence) / config.unknown_noise**2
        points = intersect(own, rays_in_world(own, rays), precision)
        return points, ray_angles(own, points, rays)[0]

    blocks = view_blocks(present)
    for block, (found, measured) in zip(blocks, map_in_threads(measure, blocks), strict=True):
        points[:, block.points] = found
        block.put(measured, angle)
    enough = present.sum(0) >= min(3, len(rig.cameras))
    return points, angle, present & np.isfinite(points[0]) & enough


def least_noise(rig: CameraRig, config: TriangulateConfig) -> Floats:
    """Return the standard deviation `[view]` in radians below which no detector is."""
    return np.array([config.least_noise_px / camera.focal for camera in rig.cameras])
