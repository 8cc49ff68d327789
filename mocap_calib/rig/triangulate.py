"""Triangulate poses of individuals, tracks, and single pixels from the rays of many views."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import Config, TriangulateConfig
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
from mocap_calib.results import GroupResult, Matches, ObservedPoints, Poses3D
from mocap_calib.rig import (
    Observed,
    Tracks,
    gather_tracks,
    noise_of_rays,
    per_frame_labels,
    view_noise,
)
from mocap_calib.types import (
    Bools,
    CameraRig,
    Floats,
    Ints,
    Progress,
    Reals,
    Recording,
    Sample,
    silent,
)

T = TypeVar("T")


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

    def keep(frames: Ints, seen: Tracks, points: Floats, used: Bools) -> None:
        """Keep what is found in some frames."""
        views, weight = used.sum(0), seen.weight * used
        parts: dict[str, NDArray[Any]] = {
            "positions": points.T,
            "error": reprojection_error(rig, points, pixels=seen.pixels, used=used),
            "views": views,
            "confidence": weight.sum(0) / np.maximum(views, 1),
            "covariance": _covariance(rig, points, seen.rays, weight=weight, noise=noise).T,
        }
        for name, part in parts.items():
            whole = found[name]
            whole[mapped.as_slice(frames)] = part.reshape(len(frames), *whole.shape[1:])

    for block, _ in triangulate_blocks(recording, rig, matches, keep, noise=noise, config=config):
        mapped.let_go()
        progress("triangulate", int(block[-1]) + 1, frames)
    return Poses3D(
        keypoints=recording.keypoints,
        frames=recording.frames,
        unit=rig.unit,
        world=rig.world,
        **found,
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

    def observe(
        _: Ints, seen: Tracks, points: Floats, used: Bools
    ) -> tuple[Floats, Ints, Ints, Floats]:
        """Return points `[n, 3]`, and the view, the point and the pixels of each detection."""
        known = np.isfinite(points[0])
        view, point = np.nonzero(used[:, known])
        return points[:, known].T, view, point, seen.pixels[:, :, known][view, :, point]

    blocks = triangulate_blocks(recording, rig, matches, observe, noise=noise, config=config)
    positions, view, point, pixels = zip(*(found for _, found in blocks), strict=True)
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
            "",
            f"a rig of the recording's cameras in their order ({', '.join(recording.names)})",
            ", ".join(rig.names),
            "take rig.select(recording.names)",
        )


def triangulate_blocks(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    work: Callable[[Ints, Tracks, Floats, Bools], T],
    *,
    noise: Floats,
    config: TriangulateConfig,
) -> Iterator[tuple[Ints, T]]:
    """Yield the frames (indices) of one block after another, and what `work` returns of them.

    work: is called in threads, with the frames, their tracks, the points `[3, N]` in world
        coordinates (NaN = unknown), and which detections each is made of `[view, N]`.
    noise: `[view]` standard deviations in radians, see `view_noise`.
    """

    def triangulate_block(frames: Ints) -> T:
        """Return what `work` does of some frames."""
        seen = gather_tracks(recording, matches, frames)
        points, used = triangulate_rays(
            rig, seen.rays, weight=seen.weight, noise=noise, config=config
        )
        return work(frames, seen, points, used)

    blocks = frame_blocks(len(recording.frames), matches.individuals * len(recording.keypoints))
    yield from zip(blocks, map_in_threads(triangulate_block, blocks), strict=True)


def frame_blocks(frames: int, points: int) -> list[Ints]:
    """Return the indices of the frames, as many at a time as a block has room for.

    points: in each frame.
    """
    size = max(1, POINT_BLOCK // max(1, points))
    return [np.arange(start, min(start + size, frames)) for start in range(0, frames, size)]


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
        own, own_rays, own_noise = rig.select(block.views), block.take(rays), noise[block.views]
        known = np.where(np.isfinite(own_rays[:, 0]), block.take(weight), 0.0)
        world = rays_in_world(own, own_rays)
        points = intersect(own, world, known / own_noise[:, None] ** 2)
        # a point takes three of the 2 V numbers of V rays: what it leaves of their errors
        left = np.sqrt(1 - 3 / (2 * np.maximum(np.arange(len(own) + 1), 2)))
        agree = agreeing_views(
            own,
            points,
            world,
            known,
            limits=config.outlier * own_noise[:, None] * left,
            least_angle=np.deg2rad(config.least_angle_deg),
        )
        return np.where(agree.any(0), points, np.nan), agree

    blocks = view_blocks(weight > 0)
    for block, (found, agree) in zip(blocks, map_in_threads(work, blocks), strict=True):
        points[:, block.points] = found
        block.put(agree, used)
    return points, used


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

    def unproject(points: slice | Ints) -> Floats:
        """Return the rays `[view, 3, n]` of some of the points."""
        return lens.unproject_views(rig.cameras, flat[:, points], by_component=True)

    sample = evenly_spaced(np.arange(count), POINT_BLOCK)
    noise = noise_of_rays(rig, unproject(sample), weight[:, sample], config)

    def triangulate_block(block: slice) -> tuple[Floats, Floats]:
        """Return points `[3, n]` and errors `[n]` of some of the points."""
        points, used = triangulate_rays(
            rig, unproject(block), weight=weight[:, block], noise=noise, config=config
        )
        pixels = np.moveaxis(flat[:, block], -1, 1)
        return points, reprojection_error(rig, points, pixels=pixels, used=used)

    found = list(map_in_threads(triangulate_block, point_blocks(count)))
    points = np.concatenate([block for block, _ in found], axis=1)
    error = np.concatenate([block for _, block in found])
    return points.T.reshape(*shape, 3), error.reshape(shape)


# Bodies


@dataclass(frozen=True)
class PlacedCameras:
    """Cameras that place bodies.

    rig: of all views of a recording. matches: labels of its frames, frame by frame.
    noise: `[view]` of each, in radians.
    """

    rig: CameraRig
    matches: Matches
    noise: Floats

    @classmethod
    def of(
        cls, recording: Recording, rig: CameraRig, matches: Matches, config: Config
    ) -> "PlacedCameras":
        """Return cameras whose noise is measured on the matches."""
        matches = per_frame_labels(matches)
        return cls(rig, matches, view_noise(recording, rig, matches, config.triangulate))

    @classmethod
    def of_group(
        cls, observed: Observed, group: GroupResult, config: Config
    ) -> tuple[Observed, "PlacedCameras"]:
        """Return what was known of the cameras of a group alone, and these cameras.

        observed: of all cameras.
        """
        names = observed.recording.names
        own = observed.select(np.array([names.index(name) for name in group.rig.names]))
        instances = own.sample.positions.shape[2]
        matches = group.matches.select(frames=own.sample_frames, instances=instances)
        return own, cls.of(own.sample, group.rig, matches, config)


def choose_frames(sample: Sample, wanted: int, config: Config) -> Ints:
    """Return evenly spread frames (indices into the sample) with so many detections a view, about.

    So many of all views together as eight views have: large rigs say the same many times.
    """
    detections = sample.detected.sum(2)  # [view, frame]
    usual = max(1.0, float(detections.mean()))
    views = max(1.0, len(detections) / 8)
    count = max(2 * config.moved.stretches, round(wanted / usual / views))
    return evenly_spaced(np.arange(len(sample.frames)), count)


def place_bodies(
    recording: Recording,
    placed: PlacedCameras,
    frames: Ints,
    config: Config,
    *,
    seen: Tracks | None = None,
    without: int | None = None,
) -> Floats:
    """Return the bodies `[frame, body, joint, 3]` of some frames (indices), NaN = missing.

    seen: the tracks of these frames, where they are gathered already. without: a view whose rays do
    not count.
    """
    seen = seen or gather_tracks(recording, placed.matches, frames)
    weight = seen.weight.copy()
    if without is not None:
        weight[without] = 0.0
    points, _ = triangulate_rays(
        placed.rig, seen.rays, weight=weight, noise=placed.noise, config=config.triangulate
    )
    shape = len(frames), placed.matches.individuals, len(recording.keypoints)
    return points.T.reshape(*shape, 3)
