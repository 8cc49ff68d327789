"""Angles between rays and points."""

from mocap_calib.kernels.jit import changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats

_ROWS = floats(3)


@inlined
def _square_row(
    points: Floats, x_ray: Floats, y_ray: Floats, z_ray: Floats, centre: Floats, found: Floats
) -> None:
    """Set the squared tangents of a view's rays to a joint in all frames. points: `[3, frame]`."""
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for t in range(len(found)):
        rx, ry, rz = x_ray[t], y_ray[t], z_ray[t]
        x, y, z = points[0, t] - from_x, points[1, t] - from_y, points[2, t] - from_z
        along = rx * x + ry * y + rz * z
        least = 1e-3 * (abs(x) + abs(y) + abs(z))
        depth = along if along > least else least
        x, y, z = x - along * rx, y - along * ry, z - along * rz
        found[t] = (x * x + y * y + z * z) / (depth * depth)


@kernel(_ROWS, floats(4), _ROWS, floats(2), changed_floats(3))
def square_angles(
    points: Floats, rays: Floats, precision: Floats, centres: Floats, found: Floats
) -> None:
    """Set squared angles `[view, keypoint, frame]` in variances. points: `[keypoint, 3, frame]`."""
    views, joints, frames = found.shape
    for v in range(views):
        for j in range(joints):
            row = found[v, j]
            _square_row(points[j], rays[0, v, j], rays[1, v, j], rays[2, v, j], centres[v], row)
            for t in range(frames):
                row[t] *= precision[v, j, t]
