"""Triangulate poses of individuals, tracks, and single pixels from the rays of many views."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import TriangulateConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry import lens
from mocap_calib.geometry.intersection import (
    POINT_BLOCK,
    ViewBlock,
    intersect,
    point_blocks,
    point_covariance,
    view_blocks,
)
from mocap_calib.geometry.lens import agreeing_views, rays_in_world, reprojection_error
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Matches, ObservedPoints, Poses3D
from mocap_calib.rig.tracks import Tracks, gather_tracks, least_noise, measure_errors, view_noise
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Progress, Reals, Recording, silent

_LEAST_POINTS = 30  # of a view: with fewer, the noise of all views together is taken


@single_threaded_libraries()
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
    apart, and lies in front of them. Its covariance is what the detectors' noise does to it: see
    `Poses3D`.

    Raises MismatchError where the cameras of the rig are not those of the recording.
    """
    check_same_cameras(recording, rig)
    frames, keypoints = len(recording.frames), len(recording.keypoints)
    shape = (frames, matches.individuals, keypoints)
    found: dict[str, NDArray[Any]] = {
        "positions": mapped.empty((*shape, 3)),
        "error": mapped.empty(shape),
        "views": mapped.empty(shape, np.int64),
        "confidence": mapped.empty(shape),
        "covariance": mapped.empty((*shape, 6), np.float32),
    }
    noise = view_noise(recording, rig, matches, config)

    def work(block: Ints) -> None:
        part = _triangulate_block(
            block, recording=recording, rig=rig, matches=matches, noise=noise, config=config
        )
        for name, array in found.items():
            array[mapped.as_slice(block)] = getattr(part, name)

    blocks = frame_blocks(frames, matches.individuals * keypoints)
    for block, _ in zip(blocks, map_in_threads(work, blocks), strict=True):
        mapped.let_go()
        progress("triangulate", int(block[-1]) + 1, frames)
    return Poses3D(
        keypoints=recording.keypoints,
        frames=recording.frames,
        positions=found["positions"],
        error=found["error"],
        views=found["views"],
        confidence=found["confidence"],
        unit=rig.unit,
        covariance=found["covariance"],
        world=rig.world,
    )


def observe_points(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: TriangulateConfig = TriangulateConfig(),
) -> ObservedPoints:
    """Return the points that `triangulate` finds, and the detections that each was made of.

    The points are in the order frame, individual, keypoint.
    """
    noise = view_noise(recording, rig, matches, config)

    def observe(block: Ints) -> tuple[Floats, Ints, Ints, Floats]:
        """Return points `[n, 3]`, and the view, the point and the pixels of each detection."""
        seen, points, used = triangulate_frames(
            block, recording=recording, rig=rig, matches=matches, noise=noise, config=config
        )
        known = np.isfinite(points[0])
        view, point = np.nonzero(used[:, known])
        return points[:, known].T, view, point, seen.pixels[:, :, known][view, :, point]

    blocks = frame_blocks(len(recording.frames), matches.individuals * len(recording.keypoints))
    positions, view, point, pixels = zip(*map_in_threads(observe, blocks), strict=True)
    starts = np.cumsum([0, *map(len, positions)])
    return ObservedPoints(
        positions=np.concatenate(positions),
        view=np.concatenate(view),
        point=np.concatenate([own + start for own, start in zip(point, starts, strict=False)]),
        pixels=np.concatenate(pixels),
    )


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
    size = max(1, POINT_BLOCK // max(1, points))
    return [np.arange(start, min(start + size, frames)) for start in range(0, frames, size)]


def triangulate_frames(
    frames: Ints,
    *,
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    noise: Floats,
    config: TriangulateConfig,
) -> tuple[Tracks, Floats, Bools]:
    """Return the tracks of some frames (indices) and their points.

    noise: `[view]` standard deviations in radians, see `view_noise`.
    Returns the tracks; `[3, N]` points in world coordinates, NaN = unknown; and `[view, N]`
    which detections each point is made of.
    """
    seen = gather_tracks(recording, matches, frames)
    points, used = triangulate_rays(rig, seen.rays, weight=seen.weight, noise=noise, config=config)
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
    views, weight = used.sum(0), seen.weight * used
    covariance = _covariance(rig, points, seen.rays, weight=weight, noise=noise)
    shape = (len(frames), matches.individuals, len(recording.keypoints))
    return Poses3D(
        keypoints=recording.keypoints,
        frames=recording.frames[frames],
        positions=points.T.reshape(*shape, 3),
        error=error.reshape(shape),
        views=views.reshape(shape),
        confidence=(weight.sum(0) / np.maximum(views, 1)).reshape(shape),
        unit=rig.unit,
        covariance=covariance.T.reshape(*shape, 6),
    )


def _covariance(
    rig: CameraRig, points: Floats, rays: Floats, *, weight: Floats, noise: Floats
) -> Reals:
    """Return the entries `[6, N]` of the covariances of points, NaN where these are.

    rays: `[view, 3, N]` in the cameras' frames. weight: `[view, N]` of those that points are made
    of, 0 for the others. noise: `[view]` of these in radians, which does not depend on their
    confidence.
    """
    entries = point_covariance(
        rig,
        points,
        rays_in_world(rig, rays),
        precision=weight / noise[:, None] ** 2,
        variance=noise**2,
    )
    with np.errstate(over="ignore"):  # points that are nearly at infinity
        return np.where(np.isfinite(points[0]), entries, np.nan).astype(np.float32)


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
    points = np.full((3, weight.shape[1]), np.nan)
    used = np.zeros(weight.shape, dtype=bool)

    def work(block: ViewBlock) -> tuple[Floats, Bools]:
        """Return the points of a block, and the views that agree on them."""
        return _triangulate_some(
            rig.select(block.views),
            block.take(rays),
            weight=block.take(weight),
            noise=noise[block.views],
            config=config,
        )

    blocks = view_blocks(weight > 0)
    for block, (found, agree) in zip(blocks, map_in_threads(work, blocks), strict=True):
        points[:, block.points] = found
        block.put(agree, used)
    return points, used


def _triangulate_some(
    rig: CameraRig, rays: Floats, *, weight: Floats, noise: Floats, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Return what `triangulate_rays` does, all points at once."""
    known = np.where(np.isfinite(rays[:, 0]), weight, 0.0)
    world = rays_in_world(rig, rays)
    points = intersect(rig, world, known / noise[:, None] ** 2)
    used = agreeing_views(
        rig,
        points,
        world,
        known,
        limits=config.outlier * noise[:, None] * _share_left(len(noise)),
        least_angle=np.deg2rad(config.least_angle_deg),
    )
    return np.where(used.any(0), points, np.nan), used


def _share_left(views: int) -> Floats:
    """Return what points leave of the errors of their rays, sqrt(1 - 3 / (2 V)) of V rays.

    `[count]`, of no view up to all. The point takes three of the 2 V numbers.
    """
    return np.sqrt(1 - 3 / (2 * np.maximum(np.arange(views + 1), 2)))


# Single pixels


def triangulate_pixels(
    rig: CameraRig,
    pixels: Floats,
    confidence: Floats,
    config: TriangulateConfig = TriangulateConfig(),
) -> tuple[Floats, Floats]:
    """Return the points `[..., 3]` that pixels show, in the rig's unit, and their errors `[...]`.

    Of each point by itself, as `triangulate` does it: no points need belong together. A view of
    which few points are known is taken to be as noisy as all views together.

    pixels: `[view, ..., 2]`, NaN = missing. confidence: `[view, ...]`, 0 = missing.

    Errors are RMS reprojection errors in pixels over the views that were used.
    """
    shape = confidence.shape[1:]
    flat = pixels.reshape(len(rig), -1, 2)
    weight = np.where(np.isfinite(flat).all(-1), np.nan_to_num(confidence.reshape(len(rig), -1)), 0)
    count = flat.shape[1]
    sample = evenly_spaced(np.arange(count), POINT_BLOCK)
    noise = _noise_of_few(rig, _unproject(rig, flat[:, sample]), weight[:, sample], config)

    def triangulate_block(block: slice) -> tuple[Floats, Floats]:
        """Return points `[3, n]` and errors `[n]` of some of the points."""
        own = flat[:, block]
        points, used = triangulate_rays(
            rig, _unproject(rig, own), weight=weight[:, block], noise=noise, config=config
        )
        return points, reprojection_error(rig, points, pixels=np.moveaxis(own, -1, 1), used=used)

    found = list(map_in_threads(triangulate_block, point_blocks(count)))
    points = np.concatenate([block for block, _ in found], axis=1)
    error = np.concatenate([block for _, block in found])
    return points.T.reshape(*shape, 3), error.reshape(shape)


def _unproject(rig: CameraRig, pixels: Floats) -> Floats:
    """Return the rays `[view, 3, N]` of pixels `[view, N, 2]`."""
    return lens.unproject_views(rig.cameras, pixels, by_component=True)


def _noise_of_few(
    rig: CameraRig, rays: Floats, weight: Floats, config: TriangulateConfig
) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    The median of few points is not robust: views with few have that of all views together.
    """
    error, counted = measure_errors(rig, rays, weight, config)
    together = config.unknown_noise
    if counted.any():
        together = float(np.median(error[counted]))
    noise = np.full(len(rig), together)
    for view in np.flatnonzero(counted.sum(1) >= _LEAST_POINTS):
        noise[view] = np.median(error[view, counted[view]])
    return np.maximum(noise, least_noise(rig, config))
