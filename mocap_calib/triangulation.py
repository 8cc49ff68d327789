"""Triangulation, and what the adjustment starts from: points from rays, many at once."""

from itertools import combinations

import numpy as np

from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches, Poses3D, Progress, Recording

_SMALL_RIG = 7  # views up to which all pairs of them propose points
_STEPS = 6
_BLOCK = 20_000
_START = 0.01  # radians: error of a keypoint before anything is known of it


def by_individual(recording: Recording, matches: Matches, frames: Ints) -> tuple[Floats, Floats, Floats]:
    """Sorts detections by individual: rays `[view, frame, individual, keypoint, 3]`, positions `[..., 2]`, confidence `[...]`."""
    labels = matches.labels[:, frames]
    view, frame, instance = np.nonzero(labels >= 0)
    shape = (len(recording.cameras), len(frames), matches.individuals, len(recording.keypoints))
    rays, positions, confidence = np.full((*shape, 3), np.nan), np.full((*shape, 2), np.nan), np.zeros(shape)
    target, source = (view, frame, labels[view, frame, instance]), (view, frames[frame], instance)
    rays[target], positions[target] = recording.rays[source], recording.positions[source]
    confidence[target] = recording.confidence[source]
    return rays, positions, confidence


def within_frames(matches: Matches) -> Matches:
    """The same groups, numbered from 0 in each frame by their first detection: what they are called elsewhere is forgotten."""
    labels = matches.labels
    flat = np.swapaxes(labels, 0, 1).reshape(labels.shape[1], -1)
    first = (flat[:, :, None] == flat[:, None]).argmax(-1)
    begins = (first == np.arange(flat.shape[1])) & (flat >= 0)
    number = np.take_along_axis(begins.cumsum(1) - 1, first, axis=1)
    named = np.where(flat >= 0, number, -1)
    return Matches(np.swapaxes(named.reshape(labels.shape[1], labels.shape[0], -1), 0, 1))


def triangulate(recording: Recording, rig: CameraRig, matches: Matches, config: TriangulateConfig, *, progress: Progress) -> Poses3D:
    """3D poses of all individuals in all frames: confidence-weighted, robust against an outlying view.

    A point needs two views that agree, rays at least `least_angle_deg` apart, and to lie in front of the cameras.
    """
    frames, keypoints = len(recording.frames), len(recording.keypoints)
    shape = (frames, matches.individuals, keypoints)
    position, error = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    views, confidence = np.zeros(shape, dtype=np.int64), np.zeros(shape)
    noise = view_noise(recording, rig, matches)
    step = max(1, _BLOCK // max(1, matches.individuals * keypoints))
    for start in range(0, frames, step):
        block = np.arange(start, min(start + step, frames))
        rays, pixels, weight = by_individual(recording, matches, block)
        flat = rays.reshape(len(rays), -1, 3), weight.reshape(len(weight), -1)
        points, used = triangulate_rays(rig, *flat, noise, config)
        where = points.reshape(len(block), *shape[1:], 3), used.reshape(len(used), len(block), *shape[1:])
        position[block] = where[0]
        error[block], views[block] = reprojection_error(rig, where[0], pixels, where[1])
        confidence[block] = (weight * where[1]).sum(0) / np.maximum(where[1].sum(0), 1)
        progress("triangulate", int(block[-1]) + 1, frames)
    return Poses3D(recording.keypoints, recording.frames, position, error, views, confidence, rig.unit)


def view_noise(recording: Recording, rig: CameraRig, matches: Matches) -> Floats:
    """`[view]` robust standard deviation of the angular error, in radians, from an even sample of the frames."""
    labelled = np.flatnonzero((matches.labels >= 0).any((0, 2)))
    sample = labelled[np.linspace(0, len(labelled) - 1, min(len(labelled), 200)).astype(int)]
    rays, _, weight = by_individual(recording, matches, sample)
    rays, weight = rays.reshape(len(rays), -1, 3), weight.reshape(len(weight), -1)
    points = _intersect(rig, rays, weight, np.full(len(rig.cameras), _START))
    angle = _angles(rig, points, rays)[0]
    counted = (weight > 0) & np.isfinite(points[:, 0]) & ((weight > 0).sum(0) >= min(3, len(rig.cameras)))
    # two coordinates share the angle: its median is 1.18 standard deviations of one
    found = [np.median(a[c]) / 1.18 if c.any() else np.nan for a, c in zip(angle, counted, strict=True)]
    floor = np.array([0.25 / camera.focal for camera in rig.cameras])
    return np.maximum(np.nan_to_num(np.array(found), nan=_START), floor)


def triangulate_rays(rig: CameraRig, rays: Floats, weight: Floats, noise: Floats, config: TriangulateConfig) -> tuple[Floats, Bools]:
    """Points `[N, 3]` from rays `[view, N, 3]` and weights `[view, N]` (0 = not seen), and which views agree `[view, N]`.

    noise: `[view]` radians. NaN where fewer than two views agree, see it in front, and from different enough sides.
    """
    points = _intersect(rig, rays, weight, noise)
    angle, ahead = _angles(rig, points, rays)
    used = (weight > 0) & ahead & (angle < config.outlier * noise[:, None])
    world = np.einsum("vji,vnj->vni", rig.rotation, np.nan_to_num(rays)) * used[..., None]
    # the widest angle between any two used rays is at least the one to their mean
    mean = world.sum(0) / np.maximum(np.linalg.norm(world.sum(0), axis=-1, keepdims=True), 1e-12)
    spread = np.where(used, np.einsum("vni,ni->vn", world, mean), 1.0).min(0)
    good = (used.sum(0) >= 2) & (spread < np.cos(np.deg2rad(config.least_angle_deg) / 2))
    return np.where(good[:, None], points, np.nan), used & good


def _intersect(rig: CameraRig, rays: Floats, weight: Floats, noise: Floats) -> Floats:
    """`[N, 3]` robust least squares on angles, from the best of the points that pairs of views propose."""
    world = np.nan_to_num(np.einsum("vji,vnj->vni", rig.rotation, rays))
    precision = np.where(np.isfinite(rays[..., 0]), weight, 0.0) / noise[:, None] ** 2
    project = np.eye(3) - world[..., :, None] * world[..., None, :]  # onto the plane normal to the ray
    points, cost = np.full((rays.shape[1], 3), np.nan), np.full(rays.shape[1], np.inf)
    first, others = _seed_pairs(rig)
    for turn, (a, b) in enumerate([*first, *others]):
        both = np.flatnonzero((precision[a] > 0) & (precision[b] > 0) & ((turn < len(first)) | ~np.isfinite(cost)))
        proposal = _weighted_point(rig.centres[[a, b]], project[[a, b]][:, both], precision[[a, b]][:, both])
        residual = _robust_cost(rig, proposal, world[:, both], precision[:, both])
        better = residual < cost[both]
        points[both[better]], cost[both[better]] = proposal[better], residual[better]
    known = np.flatnonzero(np.isfinite(cost))
    for _ in range(_STEPS):
        offset = points[known] - rig.centres[:, None]
        square = np.maximum((offset**2).sum(-1), 1e-18)
        error = np.einsum("vni,vnij,vnj->vn", offset, project[:, known], offset) / square * precision[:, known]
        robust = precision[:, known] / square / (1 + error / 9.0) ** 2
        points[known] = _weighted_point(rig.centres, project[:, known], robust)
    return points


def _seed_pairs(rig: CameraRig) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs of views that propose every point they see, and pairs that propose those that none of the first sees.

    All are of the first kind in a small rig; in a large one those to the next view and to one a third of the rig away.
    """
    views = len(rig.cameras)
    pairs = list(combinations(range(views), 2))
    if views <= _SMALL_RIG:
        return pairs, []
    first = sorted({(min(v, (v + s) % views), max(v, (v + s) % views)) for v in range(views) for s in (1, views // 3)})
    return first, [pair for pair in pairs if pair not in set(first)]


def _weighted_point(centres: Floats, project: Floats, weight: Floats) -> Floats:
    """`[N, 3]` the point nearest to weighted lines. centres `[view, 3]`, project `[view, N, 3, 3]`, weight `[view, N]`."""
    scale = np.maximum(weight.sum(0), 1e-300)
    matrix = np.einsum("vn,vnij->nij", weight / scale, project)
    vector = np.einsum("vn,vnij,vj->ni", weight / scale, project, centres)
    return np.linalg.solve(matrix + 1e-10 * np.eye(3), vector[..., None])[..., 0]


def _robust_cost(rig: CameraRig, points: Floats, world: Floats, precision: Floats) -> Floats:
    """`[N]` truncated cost of points; rays that would be behind their camera cost as much as outliers."""
    offset = points - rig.centres[:, None]
    along = np.einsum("vni,vni->vn", offset, world)
    square = np.maximum((offset**2).sum(-1), 1e-18)
    error = np.where(along > 0, (1 - along**2 / square) * precision, np.inf)
    return np.where(precision > 0, np.minimum(error, 16.0), 0.0).sum(0)


def _angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Angles `[view, N]` in radians between the rays and the points, and whether the point is in front."""
    inside = np.einsum("vij,nj->vni", rig.rotation, points) + rig.translation[:, None]
    along = (inside * rays).sum(-1)
    across = np.linalg.norm(np.cross(inside, rays), axis=-1)
    return np.nan_to_num(np.arctan2(across, along), nan=np.pi), np.nan_to_num(along, nan=-1.0) > 0


def reprojection_error(rig: CameraRig, points: Floats, pixels: Floats, used: Bools) -> tuple[Floats, Ints]:
    """RMS distance in pixels over the used views, and their number. points `[..., 3]`, pixels `[view, ..., 2]`, used `[view, ...]`."""
    square = np.zeros(points.shape[:-1])
    for view, camera in enumerate(rig.cameras):
        image = pixels_from_points(camera, points @ rig.rotation[view].T + rig.translation[view])
        gap = ((image - pixels[view]) ** 2).sum(-1)
        square += np.where(used[view] & np.isfinite(gap), gap, 0.0)
    count = used.sum(0)
    return np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan), count
