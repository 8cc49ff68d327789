"""Estimate the angular noise of each view's detections from points that other views see too.

A triangulated point absorbs a part of the errors of its rays, so residuals are smaller than the
errors. `view_noise` is the standard deviation of the errors, for weights and covariances of points;
`view_residual` is that of the residuals, for limits and robust losses.
"""

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.intersection import ViewBlock, intersect, median_angles, view_blocks
from mocap_calib.geometry.lens import ray_angles, rays_in_world
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import Tracks, gather_tracks, labelled_frames
from mocap_calib.types import Bools, CameraRig, Floats, Recording

# The median distance of a normal error in the plane from its centre, sqrt(2 log 2), in standard
# deviations of one coordinate
MEDIAN_DISTANCE = 1.18


def view_noise(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    Of one coordinate, from an even sample of the labelled frames, on the points that three views
    see (two where there are no more).
    """
    tracks = _sample_tracks(recording, matches, config)
    error, counted = measure_errors(rig, tracks.rays, tracks.weight, config)
    return _medians_of_views(rig, error, counted, config)


def view_residual(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular residual, in radians.

    On the same points as `view_noise`.
    """
    return measure_residuals(recording, rig, matches, config)[0]


def measure_residuals(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> tuple[Floats, Floats]:
    """Return what `view_residual` does, and the lengths `[N]` of the errors behind the residuals.

    In standard deviations of one coordinate of each view's own; what points took up is made up for.
    """
    tracks = _sample_tracks(recording, matches, config)
    points, angle, counted = _measure_angles(rig, tracks.rays, tracks.weight, config)
    residual = _medians_of_views(rig, angle / MEDIAN_DISTANCE, counted, config)
    error = angle / median_angles(rig, points, tracks.weight)
    noise = _medians_of_views(rig, error, counted, config)
    return residual, (MEDIAN_DISTANCE * error / noise[:, None])[counted]


def measure_errors(
    rig: CameraRig, rays: Floats, weight: Floats, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return angles `[view, N]` in radians whose medians are the views' standard deviations.

    They are the angles between rays (`[view, 3, N]`, weights `[view, N]`) and the points where
    these meet, divided by their medians where each ray has an error of one standard deviation
    (`geometry.intersection`).

    Also which of them count, `[view, N]`: of points that three views see (two where there are no
    more).
    """
    points, angle, counted = _measure_angles(rig, rays, weight, config)
    return angle / median_angles(rig, points, weight), counted


def least_noise(rig: CameraRig, config: TriangulateConfig) -> Floats:
    """Return the lower bound `[view]` of the noise of a detector, in radians."""
    return np.array([config.least_noise_px / camera.focal for camera in rig.cameras])


def _sample_tracks(recording: Recording, matches: Matches, config: TriangulateConfig) -> Tracks:
    """Return the tracks of an even sample of the labelled frames."""
    frames = evenly_spaced(labelled_frames(matches), config.noise_frames)
    return gather_tracks(recording, matches, frames)


def _medians_of_views(
    rig: CameraRig, measured: Floats, counted: Bools, config: TriangulateConfig
) -> Floats:
    """Return the medians `[view]` of the measured values `[view, N]` that are counted."""
    medians = np.full(len(rig.cameras), config.unknown_noise)
    for view in np.flatnonzero(counted.any(1)):
        medians[view] = np.median(measured[view, counted[view]])
    return np.maximum(medians, least_noise(rig, config))


def _measure_angles(
    rig: CameraRig, rays: Floats, weight: Floats, config: TriangulateConfig
) -> tuple[Floats, Floats, Bools]:
    """Return points `[3, N]`, their angles to the rays `[view, N]`, and which of these count.

    An angle is pi where nothing is seen.
    """
    present = np.asarray(weight > 0)
    points, angle = np.full((3, present.shape[1]), np.nan), np.full(present.shape, np.pi)

    def measure(block: ViewBlock) -> tuple[Floats, Floats]:
        """Return points and angles of a block."""
        own, own_rays = rig.select(block.views), block.take(rays)
        precision = block.take(weight) / config.unknown_noise**2
        points = intersect(own, rays_in_world(own, own_rays), precision)
        return points, ray_angles(own, points, own_rays)[0]

    blocks = view_blocks(present)
    for block, (found, measured) in zip(blocks, map_in_threads(measure, blocks), strict=True):
        points[:, block.points] = found
        block.put(measured, angle)
    enough = present.sum(0) >= min(3, len(rig.cameras))
    return points, angle, present & np.isfinite(points[0]) & enough
