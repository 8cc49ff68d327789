"""How large the errors of each view's detections are, measured on the points that others see too.

A point bends to what was seen of it, so what is left is less than the errors were. Weights and
covariances of points need the errors themselves, `view_noise`; what limits and losses are held
against are residuals, whose spread is `view_residual`.
"""

from collections.abc import Callable

import numpy as np

from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.intersection import intersect
from mocap_calib.geometry.point_covariance import median_angles
from mocap_calib.geometry.rays import ray_angles, rays_in_world
from mocap_calib.multi_view.observations import (
    Observations,
    gather_observations,
    labelled_frames,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, CameraRig, Floats, Matches, Recording

# The median distance of a normal error in the plane from its centre, sqrt(2 log 2), in standard
# deviations of one coordinate
MEDIAN_DISTANCE = 1.18


def view_noise(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    Of one coordinate. Measured in an even sample of the frames that have labels, on the points
    that three views see (two where there are no more).
    """
    return _medians_of_views(recording, rig, matches, config, measure_errors)


def view_residual(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return what is left `[view]` of `view_noise` where points have bent to what was seen.

    The robust standard deviation of residuals, measured on the same points.
    """
    return _medians_of_views(recording, rig, matches, config, measure_residuals)


def _medians_of_views(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: TriangulateConfig,
    measure: Callable[[CameraRig, Observations, TriangulateConfig], tuple[Floats, Bools]],
) -> Floats:
    """Return the medians `[view]` of what is measured of the detections of some frames."""
    frames = evenly_spaced(labelled_frames(matches), config.noise_frames)
    measured, counted = measure(rig, gather_observations(recording, matches, frames), config)
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


def measure_residuals(
    rig: CameraRig, seen: Observations, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return the same angles `[view, N]` as if the points took up nothing of the errors."""
    _, angle, counted = _measure_angles(rig, seen, config)
    return angle / MEDIAN_DISTANCE, counted


def _measure_angles(
    rig: CameraRig, seen: Observations, config: TriangulateConfig
) -> tuple[Floats, Floats, Bools]:
    """Return points `[3, N]`, their angles to the rays `[view, N]`, and which of these count."""
    precision = seen.confidence / config.unknown_noise**2
    points = intersect(rig, rays_in_world(rig, seen.rays), precision)
    angle, _ = ray_angles(rig, points, seen.rays)
    present = seen.confidence > 0
    enough = present.sum(0) >= min(3, len(rig.cameras))
    return points, angle, present & np.isfinite(points[0]) & enough


def least_noise(rig: CameraRig, config: TriangulateConfig) -> Floats:
    """Return the standard deviation `[view]` in radians below which no detector is."""
    return np.array([config.least_noise_px / camera.focal for camera in rig.cameras])
