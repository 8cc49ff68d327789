"""Triangulate points and poses from the rays of many views, in blocks of frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry import lens
from mocap_calib.geometry.intersection import intersect
from mocap_calib.geometry.point_covariance import median_angles
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import (
    Bools,
    Camera,
    CameraRig,
    Floats,
    Ints,
    Matches,
    Poses3D,
    Progress,
    Recording,
    silent,
)

_BLOCK = 8192  # points at a time: enough that calls cost little beside, few enough for the cache
# The median distance of a normal error in the plane from its centre, sqrt(2 log 2), in standard
# deviations of one coordinate
MEDIAN_DISTANCE = 1.18


@dataclass(frozen=True)
class Observations:
    """Detections by point and by component.

    pixels: `[view, 2, N]`, NaN = missing.
    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    confidence: `[view, N]`, 0 = missing.
    """

    pixels: Floats
    rays: Floats
    confidence: Floats


def gather_observations(recording: Recording, matches: Matches, frames: Ints) -> Observations:
    """Return the detections of all individuals in the frames with these indices `[frame]`.

    N = frames x individuals x keypoints, in that order.
    """
    labels = matches.labels[:, frames]
    view, frame, instance = np.nonzero(labels >= 0)
    individual = labels[view, frame, instance]
    views, keypoints = len(recording.cameras), len(recording.keypoints)
    shape = (views, len(frames), matches.individuals, keypoints)
    pixels = np.full((*shape, 2), np.nan)
    confidence = np.zeros(shape)
    pixels[view, frame, individual] = recording.positions[view, frames[frame], instance]
    confidence[view, frame, individual] = recording.confidence[view, frames[frame], instance]
    return observe(recording.cameras, pixels.reshape(views, -1, 2), confidence.reshape(views, -1))


def observe(cameras: Sequence[Camera], pixels: Floats, confidence: Floats) -> Observations:
    """Return the detections with their rays.

    pixels: `[view, N, 2]`, NaN = missing; confidence: `[view, N]`, 0 = missing.
    """
    by_component = np.ascontiguousarray(np.moveaxis(pixels, -1, 1))
    rays = [
        lens.unproject(camera, seen) for camera, seen in zip(cameras, by_component, strict=True)
    ]
    return Observations(pixels=by_component, rays=np.stack(rays), confidence=confidence)


def labelled_frames(matches: Matches) -> Ints:
    """Return the indices `[frame]` of the frames with any label."""
    return np.flatnonzero((matches.labels >= 0).any((0, 2)))


def triangulate(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: TriangulateConfig = TriangulateConfig(),
    *,
    progress: Progress = silent,
) -> Poses3D:
    """Return the 3D poses of all individuals in all frames, in the rig's unit.

    Detections are weighed by their confidence, and a view that contradicts the others is left
    out. A point needs two views that agree, whose rays are at least `config.least_angle_deg`
    apart, and lies in front of them.

    Raises MismatchError where the cameras of the rig are not those of the recording.
    """
    check_same_cameras(recording, rig)
    frames, keypoints = len(recording.frames), len(recording.keypoints)
    shape = (frames, matches.individuals, keypoints)
    found = Poses3D(
        keypoints=recording.keypoints,
        frames=recording.frames,
        positions=np.empty((*shape, 3)),
        error=np.empty(shape),
        views=np.empty(shape, dtype=np.int64),
        confidence=np.empty(shape),
        unit=rig.unit,
    )
    work = partial(
        _triangulate_block,
        recording=recording,
        rig=rig,
        matches=matches,
        noise=view_noise(recording, rig, matches, config),
        config=config,
    )
    blocks = frame_blocks(frames, matches.individuals * keypoints)
    for block, part in zip(blocks, map_in_threads(work, blocks), strict=True):
        found.positions[block] = part.positions
        found.error[block] = part.error
        found.views[block] = part.views
        found.confidence[block] = part.confidence
        progress("triangulate", int(block[-1]) + 1, frames)
    return found


def check_same_cameras(recording: Recording, rig: CameraRig) -> None:
    """Raise MismatchError where a rig has other cameras than a recording, or another order."""
    if rig.names != recording.names:
        raise MismatchError(
            f"expected a rig of the recording's cameras in their order "
            f"({', '.join(recording.names)}), found {', '.join(rig.names)}; "
            "take rig.select(recording.names)"
        )


def frame_blocks(frames: int, points: int) -> list[Ints]:
    """Return the indices of the frames, as many at a time as a block has room for.

    points: in each frame.
    """
    size = max(1, _BLOCK // max(1, points))
    return [np.arange(start, min(start + size, frames)) for start in range(0, frames, size)]


def triangulate_frames(
    frames: Ints,
    *,
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    noise: Floats,
    config: TriangulateConfig,
) -> tuple[Observations, Floats, Bools]:
    """Return what is seen in the frames with these indices, and the points that it is of.

    noise: `[view]` standard deviations in radians, see `view_noise`.
    Returns the detections; `[3, N]` points in world coordinates, NaN = unknown; and `[view, N]`
    the detections that each is made of.
    """
    seen = gather_observations(recording, matches, frames)
    points, used = triangulate_rays(
        rig, seen.rays, weight=seen.confidence, noise=noise, config=config
    )
    return seen, points, used


def _triangulate_block(
    frames: Ints,
    *,
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    noise: Floats,
    config: TriangulateConfig,
) -> Poses3D:
    """Return the poses in the frames with these indices."""
    seen, points, used = triangulate_frames(
        frames, recording=recording, rig=rig, matches=matches, noise=noise, config=config
    )
    error = reprojection_error(rig, points, pixels=seen.pixels, used=used)
    views = used.sum(0)
    confidence = (seen.confidence * used).sum(0) / np.maximum(views, 1)
    shape = (len(frames), matches.individuals, len(recording.keypoints))
    return Poses3D(
        keypoints=recording.keypoints,
        frames=recording.frames[frames],
        positions=points.T.reshape(*shape, 3),
        error=error.reshape(shape),
        views=views.reshape(shape),
        confidence=confidence.reshape(shape),
        unit=rig.unit,
    )


def view_noise(
    recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    Measured in an even sample of the frames that have labels, on one coordinate of the points
    that three views see (two where there are no more).
    """
    frames = evenly_spaced(labelled_frames(matches), config.noise_frames)
    seen = gather_observations(recording, matches, frames)
    error, counted = measure_errors(rig, seen, config)
    noise = np.full(len(rig.cameras), config.unknown_noise)
    for view in np.flatnonzero(counted.any(1)):
        noise[view] = np.median(error[view, counted[view]])
    return np.maximum(noise, least_noise(rig, config))


def measure_errors(
    rig: CameraRig, seen: Observations, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return angles `[view, N]` in radians whose medians are the views' standard deviations.

    They are those between rays and the points where they meet, over their medians where each ray
    has an error of one standard deviation (`geometry.point_covariance`).

    Also which of them count, `[view, N]`: of points that three views see (two where there are no
    more).
    """
    precision = seen.confidence / config.unknown_noise**2
    points = intersect(rig, _rays_in_world(rig, seen.rays), precision)
    angle, _ = _ray_angles(rig, points, seen.rays)
    present = seen.confidence > 0
    enough = present.sum(0) >= min(3, len(rig.cameras))
    counted = present & np.isfinite(points[0]) & enough
    return angle / median_angles(rig, points, seen.confidence), counted


def least_noise(rig: CameraRig, config: TriangulateConfig) -> Floats:
    """Return the standard deviation `[view]` in radians below which no detector is."""
    return np.array([config.least_noise_px / camera.focal for camera in rig.cameras])


def triangulate_rays(
    rig: CameraRig, rays: Floats, *, weight: Floats, noise: Floats, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return the points `[3, N]` where rays meet, and which views agree on each `[view, N]`.

    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    weight: `[view, N]`, 0 = not seen.
    noise: `[view]` standard deviation of the rays' angles in radians.

    A point is NaN where fewer than two views agree on it and have it in front of them, or where
    they see it from almost the same side.
    """
    known = np.where(np.isfinite(rays[:, 0]), weight, 0.0)
    rays_in_world = _rays_in_world(rig, rays)
    points = intersect(rig, rays_in_world, known / noise[:, None] ** 2)
    angle, in_front = _ray_angles(rig, points, rays)
    used = (weight > 0) & in_front & (angle < config.outlier * noise[:, None])
    apart = _are_apart(rays_in_world, used, np.deg2rad(config.least_angle_deg))
    good = (used.sum(0) >= 2) & apart
    return np.where(good, points, np.nan), used & good


def _are_apart(rays: Floats, used: Bools, least_angle: float) -> Bools:
    """Return whether the used rays of each point are far enough apart, `[N]`.

    rays: `[view, 3, N]` in world coordinates; used: `[view, N]`; least_angle: in radians. The mean
    of two rays is half-way between them, so half of the angle is asked of the ray that is farthest
    from the mean.
    """
    mean = np.einsum("vin,vn->in", rays, used.astype(np.float64))
    mean /= np.maximum(np.sqrt((mean**2).sum(0)), 1e-12)
    cosine = np.where(used, np.einsum("vin,in->vn", rays, mean), 1.0)
    return cosine.min(0) < np.cos(least_angle / 2)


def _rays_in_world(rig: CameraRig, rays: Floats) -> Floats:
    """Return rays `[view, 3, N]` of the cameras' frames in world coordinates, zero = missing."""
    return np.matmul(np.swapaxes(rig.rotation, 1, 2), np.nan_to_num(rays))


def _ray_angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return the angles between rays and points, and whether the points are in front of the views.

    points: `[3, N]`; rays: `[view, 3, N]`. Angles `[view, N]` in radians, pi where something is
    missing; in front `[view, N]`.
    """
    in_camera = points_in_cameras(rig, points)
    along = np.einsum("vin,vin->vn", in_camera, rays)
    z, x, y = (_cross(in_camera, rays, i) for i in range(3))
    across = np.sqrt(z * z + x * x + y * y)
    angle = np.arctan2(across, along)
    return np.where(np.isnan(angle), np.pi, angle), along > 0


def _cross(first: Floats, second: Floats, i: int) -> Floats:
    """Return one component `[view, N]` of the cross product of vectors `[view, 3, N]`.

    The components come in the order z, x, y for i = 0, 1, 2.
    """
    j = (i + 1) % 3
    return first[:, i] * second[:, j] - first[:, j] * second[:, i]


def reprojection_error(rig: CameraRig, points: Floats, *, pixels: Floats, used: Bools) -> Floats:
    """Return the RMS distance `[N]` in pixels of points from their detections in the used views.

    points: `[3, N]`; pixels: `[view, 2, N]` the detections; used: `[view, N]`.
    """
    gap = project(rig, points) - pixels
    square = gap[:, 0] ** 2 + gap[:, 1] ** 2
    total = np.where(used & np.isfinite(square), square, 0.0).sum(0)
    count = used.sum(0)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


def points_in_cameras(rig: CameraRig, points: Floats) -> Floats:
    """Return points `[3, N]` in world coordinates in each camera's frame, `[view, 3, N]`."""
    return np.matmul(rig.rotation, points) + rig.translation[:, :, None]


def project(rig: CameraRig, points: Floats) -> Floats:
    """Return the pixels `[view, 2, N]` of points `[3, N]` in world coordinates; NaN = behind."""
    return np.stack(
        [
            lens.project(camera, rotation @ points + translation[:, None])
            for camera, rotation, translation in zip(
                rig.cameras, rig.rotation, rig.translation, strict=True
            )
        ]
    )
