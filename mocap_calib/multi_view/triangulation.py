"""3D points and poses from rays, many at once; pure functions of blocks of frames."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.compute.parallel import in_order
from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry import lens
from mocap_calib.geometry.intersection import intersect
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
)

_BLOCK = 8192  # points at a time: enough that calls cost little beside, few enough for the cache
_SAMPLE = 200  # frames that tell how well each view sees
_START = 0.01  # radians: error of a keypoint before anything is known of it


@dataclass(frozen=True)
class Observations:
    """Detections by point, by component. pixels: `[view, 2, N]`, rays: `[view, 3, N]`, NaN = missing; confidence: `[view, N]`, 0 = missing."""

    pixels: Floats
    rays: Floats
    confidence: Floats


def observations(recording: Recording, matches: Matches, frames: Ints) -> Observations:
    """The detections of all individuals in some frames (indices), N = frames x individuals x keypoints in that order."""
    labels = matches.labels[:, frames]
    view, frame, instance = np.nonzero(labels >= 0)
    shape = (len(recording.cameras), len(frames), matches.individuals, len(recording.keypoints))
    pixels, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    target, source = (view, frame, labels[view, frame, instance]), (view, frames[frame], instance)
    pixels[target], confidence[target] = recording.positions[source], recording.confidence[source]
    columns = np.ascontiguousarray(np.moveaxis(pixels.reshape(len(pixels), -1, 2), -1, 1))
    rays = np.stack(
        [lens.unproject(camera, seen) for camera, seen in zip(recording.cameras, columns, strict=True)]
    )
    return Observations(columns, rays, confidence.reshape(len(confidence), -1))


def per_frame_labels(matches: Matches) -> Matches:
    """The same groups, numbered from 0 in each frame by their first detection: what they are called elsewhere is forgotten."""
    labels = matches.labels
    flat = np.swapaxes(labels, 0, 1).reshape(labels.shape[1], -1)
    first = (flat[:, :, None] == flat[:, None]).argmax(-1)
    begins = (first == np.arange(flat.shape[1])) & (flat >= 0)
    number = np.take_along_axis(begins.cumsum(1) - 1, first, axis=1)
    named = np.where(flat >= 0, number, -1)
    return Matches(np.swapaxes(named.reshape(labels.shape[1], labels.shape[0], -1), 0, 1))


def triangulate(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: TriangulateConfig,
    *,
    progress: Progress,
) -> Poses3D:
    """3D poses of all individuals in all frames: confidence-weighted, robust against an outlying view.

    A point needs two views that agree, rays at least `least_angle_deg` apart, and to lie in front of the cameras.
    """
    frames, keypoints = len(recording.frames), len(recording.keypoints)
    shape = (frames, matches.individuals, keypoints)
    position, error = np.empty((*shape, 3)), np.empty(shape)
    views, confidence = np.empty(shape, dtype=np.int64), np.empty(shape)
    noise = view_noise(recording, rig, matches)
    step = max(1, _BLOCK // max(1, matches.individuals * keypoints))
    blocks = [np.arange(start, min(start + step, frames)) for start in range(0, frames, step)]

    def work(block: Ints) -> tuple[Floats, Floats, Ints, Floats]:
        seen = observations(recording, matches, block)
        points, used = triangulate_rays(rig, seen.rays, seen.confidence, noise, config)
        count = used.sum(0)
        trust = (seen.confidence * used).sum(0) / np.maximum(count, 1)
        return points, reprojection_error(rig, points, seen.pixels, used), count, trust

    for block, (points, *rest) in zip(blocks, in_order(work, blocks), strict=True):
        here = (len(block), *shape[1:])
        position[block] = points.T.reshape(*here, 3)
        error[block], views[block], confidence[block] = (one.reshape(here) for one in rest)
        progress("triangulate", int(block[-1]) + 1, frames)
    return Poses3D(
        recording.keypoints, recording.frames, position, error, views, confidence, rig.unit
    )


def view_noise(recording: Recording, rig: CameraRig, matches: Matches) -> Floats:
    """`[view]` robust standard deviation of the angular error, in radians, from an even sample of the frames."""
    seen = observations(
        recording, matches, evenly_spaced(np.flatnonzero((matches.labels >= 0).any((0, 2))), _SAMPLE)
    )
    weight = seen.confidence
    points = intersect(rig, _world(rig, seen.rays), weight / _START**2)
    angle = _angles(rig, points, seen.rays)[0]
    counted = (
        (weight > 0) & np.isfinite(points[0]) & ((weight > 0).sum(0) >= min(3, len(rig.cameras)))
    )
    # two coordinates share the angle: its median is 1.18 standard deviations of one
    found = [
        np.median(a[c]) / 1.18 if c.any() else np.nan for a, c in zip(angle, counted, strict=True)
    ]
    floor = np.array([0.25 / camera.focal for camera in rig.cameras])
    return np.maximum(np.nan_to_num(np.array(found), nan=_START), floor)


def triangulate_rays(
    rig: CameraRig, rays: Floats, weight: Floats, noise: Floats, config: TriangulateConfig
) -> tuple[Floats, Bools]:
    """Points `[3, N]` from rays `[view, 3, N]` and weights `[view, N]` (0 = not seen), and which views agree `[view, N]`.

    noise: `[view]` radians. NaN where fewer than two views agree, see it in front, and from different enough sides.
    """
    world = _world(rig, rays)
    points = intersect(
        rig, world, np.where(np.isfinite(rays[:, 0]), weight, 0.0) / noise[:, None] ** 2
    )
    angle, ahead = _angles(rig, points, rays)
    used = (weight > 0) & ahead & (angle < config.outlier * noise[:, None])
    # the widest angle between any two used rays is at least the one to their mean
    mean = np.einsum("vin,vn->in", world, used.astype(np.float64))
    mean /= np.maximum(np.sqrt((mean**2).sum(0)), 1e-12)
    spread = np.where(used, np.einsum("vin,in->vn", world, mean), 1.0).min(0)
    good = (used.sum(0) >= 2) & (spread < np.cos(np.deg2rad(config.least_angle_deg) / 2))
    return np.where(good, points, np.nan), used & good


def _world(rig: CameraRig, rays: Floats) -> Floats:
    """Rays in the world's axes, zero where missing."""
    return np.matmul(np.swapaxes(rig.rotation, 1, 2), np.nan_to_num(rays))


def _angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Angles `[view, N]` in radians between the rays and the points, and whether the point is in front."""
    inside = np.matmul(rig.rotation, points) + rig.translation[:, :, None]
    along = np.einsum("vin,vin->vn", inside, rays)
    x, y, z = (
        inside[:, i] * rays[:, (i + 1) % 3] - inside[:, (i + 1) % 3] * rays[:, i] for i in range(3)
    )
    angle = np.arctan2(np.sqrt(x * x + y * y + z * z), along)
    return np.where(np.isnan(angle), np.pi, angle), along > 0


def reprojection_error(rig: CameraRig, points: Floats, seen: Floats, used: Bools) -> Floats:
    """`[N]` RMS distance in pixels over the used views. points `[3, N]`, seen `[view, 2, N]` pixels, used `[view, N]`."""
    square = np.zeros(points.shape[1])
    for view, camera in enumerate(rig.cameras):
        gap = project(camera, rig.rotation[view], rig.translation[view], points) - seen[view]
        distance = gap[0] ** 2 + gap[1] ** 2
        square += np.where(used[view] & np.isfinite(distance), distance, 0.0)
    count = used.sum(0)
    return np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan)


def project(camera: Camera, rotation: Floats, translation: Floats, points: Floats) -> Floats:
    """`[2, N]` pixels of points `[3, N]` of the world."""
    return lens.project(camera, rotation @ points + translation[:, None])
