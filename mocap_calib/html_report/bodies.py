"""The bodies in space, as many frames of them as there is room for."""

from functools import partial
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import pack, quantise, small_ints
from mocap_calib.html_report.frames import fill_room, starts_of_stretches
from mocap_calib.html_report.source import ReportSource
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_CONFIG = ReportConfig()


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
        "stretches": starts_of_stretches(index),
        "fps": source.fps if np.isfinite(source.fps) else None,
        "individuals": individuals,
    }, index


def _pack_poses(poses: Poses3D, index: Ints) -> dict[str, Any]:
    """Return the numbers of the frames, the positions and what they are made of."""
    points = mapped.take(poses.positions, index)
    middle, scale = _choose_steps(points)
    steps = quantise(points - middle, scale)
    steps[(steps == -32768).any(-1)] = -32768
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
    with np.errstate(invalid="ignore"):
        known = np.isfinite(points).all(-1, keepdims=True)
        number = np.maximum(known.sum(-2, keepdims=True), 1)
        centre = np.where(known, points, 0.0).sum(-2, keepdims=True) / number
        size = np.linalg.norm(points - centre, axis=-1)
    step = float(np.median(size[np.isfinite(size)])) * _CONFIG.step
    return (low + high) / 2, max(step, reach / 65000) or 1.0
