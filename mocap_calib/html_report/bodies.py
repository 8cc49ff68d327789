"""The bodies in space, as many frames of them as there is room for, and what they do over time."""

from functools import partial
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.html_report.encode import (
    MISSING,
    fill_room,
    pack,
    pack_floats,
    quantiles,
    quantise,
    small_ints,
    split_evenly,
)
from mocap_calib.html_report.source import MOST_KEYPOINTS, ReportSource
from mocap_calib.kinematics import define, frame_velocity
from mocap_calib.recording.joints import choose_skeleton
from mocap_calib.recording.sampling import usual_step
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_STEP = 0.002  # that positions are rounded to, of a body's size (of a joint from its middle)
_LEAST_BINS, _MOST_BINS = 10, 300  # of lengths of bones and the like
_MOST_NUMBERS = 60_000  # of these in all


def describe_bodies(
    source: ReportSource, individuals: list[int], room: int
) -> tuple[dict[str, Any], Ints]:
    """Return the poses for a page in at most `room` bytes, and the frames `[frame]` (indices).

    individuals: numbers of those of the poses.
    """
    poses = source.poses
    total, bodies, joints = poses.positions.shape[:3]
    guess = 2 * room // max(1, 7 * bodies * joints)
    packed, index = fill_room(partial(_pack_poses, poses), total, guess, room)
    return {
        **packed,
        "total": total,
        "stretches": np.flatnonzero(np.diff(index, prepend=-2) > 1).tolist(),
        "fps": source.fps if np.isfinite(source.fps) else None,
        "individuals": individuals,
    }, index


def _pack_poses(poses: Poses3D, index: Ints) -> dict[str, Any]:
    """Return the numbers of the frames, the positions and what they are made of."""
    points = mapped.take(poses.positions, index)
    middle, scale = _choose_steps(points)
    steps = quantise(points - middle, scale)
    steps[(steps == MISSING).any(-1)] = MISSING
    return {
        "frames": pack(small_ints(poses.frames[index]), delta=0),
        "scale": scale,
        "offset": middle.tolist(),
        "points": pack(np.moveaxis(steps, 1, 0), delta=1),
        "source": pack(np.moveaxis(poses.source[index].astype(np.uint8), 1, 0), delta=1),
    }


def _choose_steps(points: Floats) -> tuple[Floats, float]:
    """Return the middle of points `[frame, individual, keypoint, 3]`, and the step to round to.

    A small part of a body's size, unless the bodies are spread so far that 16 bits allow no such
    step. Single points far away from all others do not count.
    """
    there = points[np.isfinite(points).all(-1)]
    if not len(there):
        return np.zeros(3), 1.0
    low, high = np.percentile(there, (0.5, 99.5), axis=0)
    reach = 2 * float((high - low).max())  # half as wide again on each side
    size = np.linalg.norm(points - mean_of_known(points, 2)[..., None, :], axis=-1)
    step = float(np.median(size[np.isfinite(size)])) * _STEP
    return (low + high) / 2, max(step, reach / 65000) or 1.0


def describe_series(source: ReportSource) -> dict[str, Any]:
    """Return the series for a page: medians over some consecutive frames of each bin."""
    poses = source.poses
    total, individuals, joints = poses.positions.shape[:3]
    numbers = max(1, individuals * (len(source.edges) + 2))
    bins = max(_LEAST_BINS, min(_MOST_BINS, _MOST_NUMBERS // numbers))
    edges = split_evenly(total, bins)
    begin, end = edges[:-1], edges[1:]
    each = max(3, MOST_KEYPOINTS // max(1, len(begin) * individuals * joints))
    looked = min(int((end - begin).max(initial=0)), each)
    # and a frame before and after these: a frame by itself has no speed
    index = begin[:, None] + np.arange(-1, looked + 1)
    frames, points = _take_frames(poses, index)
    speeds = _speeds(source, points, frames)[:, 1:-1]
    points = points[:, 1:-1]
    outside = index[:, 1:-1] >= end[:, None]
    points[outside] = speeds[outside] = np.nan
    pairs = np.array(source.edges, dtype=np.int64).reshape(-1, 2)
    bones = np.linalg.norm(points[..., pairs[:, 0], :] - points[..., pairs[:, 1], :], axis=-1)
    return {
        "bins": poses.frames[begin].tolist(),
        "bones": pack_floats(np.moveaxis(_medians(bones), 0, -1)),
        "height": _heights(source, points),
        "speed": pack_floats(_medians(speeds).T),
    }


def _take_frames(poses: Poses3D, index: Ints) -> tuple[Ints, Floats]:
    """Return the numbers `[bin, frame]` of frames (indices), and their positions.

    What is before the first frame and after the last has numbers that go on, and no positions.
    """
    last = len(poses.frames) - 1
    inside = index.clip(0, last)
    points = mapped.take(poses.positions, inside.ravel())
    points = points.reshape(*inside.shape, *points.shape[1:])
    points[inside != index] = np.nan
    return poses.frames[inside] + (index - inside) * usual_step(poses.frames), points


def _medians(values: Floats) -> Floats:
    """Return medians `[bin, ...]` of values `[bin, frame, ...]`."""
    return quantiles(np.moveaxis(values, 1, -1), (0.5,))[0]


def _heights(source: ReportSource, points: Floats) -> dict[str, Any] | None:
    """Return the height of the highest joint above the floor; None where that is not known."""
    world = source.poses.world
    if not (np.isfinite(world.up).all() and np.isfinite(world.floor).all()):
        return None
    height = (points - world.floor) @ world.up
    return pack_floats(_medians(np.fmax.reduce(height, axis=-1, initial=np.nan)).T)


def _speeds(source: ReportSource, points: Floats, frames: Ints) -> Floats:
    """Return the speeds of trunks `[bin, frame, individual]`, per second where fps is known.

    points: `[bin, frame, individual, keypoint, 3]`. frames: `[bin, frame]` numbers.
    """
    names = source.poses.keypoints
    trunk = list(define(names, choose_skeleton(names)).trunk) or list(range(len(names)))
    own = points[..., trunk, :]
    velocity = np.array(list(map(frame_velocity, frames, own))).reshape(own.shape)
    rate = source.fps if np.isfinite(source.fps) else 1.0
    return rate * np.linalg.norm(mean_of_known(velocity, 3), axis=-1)
