"""Lines in space that figures and videos show: the floor, and cameras."""

import numpy as np

from mocap_calib.geometry.rotation import rig_size
from mocap_calib.results import Poses3D
from mocap_calib.types import ARBITRARY, METRES, CameraRig, Floats

_FRUSTUM = 0.15  # depth of a drawn camera, in sizes of the rig
_GRID_LINES = 10


def floor_lines(rig: CameraRig, poses: Poses3D) -> Floats:
    """Return the lines `[line, 2, 3]` of a grid on the floor where bodies are; none without floor.

    They are a metre apart, or as far as makes ten of them: a power of ten times 1, 2 or 5.
    """
    world, points = rig.world, poses.positions.reshape(-1, 3)
    points = points[np.isfinite(points[:, 0])]
    if not (np.isfinite(world.up).all() and np.isfinite(world.floor).all() and len(points)):
        return np.zeros((0, 2, 3))
    first = np.cross(world.up, np.eye(3)[np.abs(world.up).argmin()])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(world.up, first)])
    places = (points - world.floor) @ axes.T
    low, high = np.percentile(places, [1, 99], axis=0)
    reach = max(float((high - low).max()), 0.5 * (rig_size(rig) or 1.0))
    step = 1.0 / METRES[rig.unit] if rig.unit != ARBITRARY else _round_step(reach / _GRID_LINES)
    if reach / step > 5 * _GRID_LINES or reach < step:
        step = _round_step(reach / _GRID_LINES)
    begin = np.floor((low - 0.1 * reach) / step).astype(int)
    end = np.ceil((high + 0.1 * reach) / step).astype(int)
    lines = []
    for axis in (0, 1):
        for k in range(begin[axis], end[axis] + 1):
            line = np.zeros((2, 2))
            line[:, axis] = k * step
            line[:, 1 - axis] = begin[1 - axis] * step, end[1 - axis] * step
            lines.append(world.floor + line @ axes)
    return np.array(lines)


def _round_step(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(factor for factor in (1, 2, 5) if factor * power <= length * 1.001))


def camera_lines(rig: CameraRig, view: int) -> Floats:
    """Return the edges `[line, 2, 3]` of a pyramid from a camera through its image's corners."""
    camera, depth = rig.cameras[view], _FRUSTUM * (rig_size(rig) or 1.0)
    width, height = camera.size if all(camera.size) else 2 * camera.matrix[:2, 2]
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], dtype=float)
    rays = depth * corners @ np.linalg.inv(camera.matrix).T
    base = (rays - rig.translation[view]) @ rig.rotation[view]
    sides = np.stack([np.broadcast_to(rig.centres[view], base.shape), base], axis=1)
    return np.concatenate([sides, np.stack([base, np.roll(base, 1, axis=0)], axis=1)])
