"""What rays, bones and accelerations tell of the points of a fit, compiled.

Rays and bones are summed in tiles of `LANES` frames, rows of which are computed at once. Over time,
`LANES` joints lie side by side in a group; what the last has no joints for stays zero. The blocks
are set where `pose_bands` makes factors of them.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints

# a person's 17 keypoints in one group; loops of a fixed length below 16 do not become vector
# instructions
LANES = 20
_OWN = 9 * LANES  # blocks of the diagonal, and the gradient
_BLOCK = 6 * LANES
# of what a point is held by: rays are of length 1 to 1e-15, and no point is nearer along its ray
# than a thousandth of its distance
_ROUNDING = 4e-12
POINT = 3 * LANES  # numbers of a group in a frame: coordinates,
MOTION = 4 * LANES  # weights of accelerations, and these times them,
FACTOR = 16 * LANES  # and P, F and c of `pose_bands`
_TINY = 1e-100  # of an acceleration


@inlined
def _add_view(rays: Floats, centre: Floats, narrow: float, own: Floats) -> None:
    """Add a view's rays to the blocks and the gradient of a joint in a tile.

    rays: directions and precisions. own: `[12 * LANES]`, and the points. narrow: the loss to the
    power of -2.
    """
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        rx, ry, rz = rays[n], rays[LANES + n], rays[2 * LANES + n]
        precision = rays[3 * LANES + n]
        x, y = own[9 * LANES + n] - from_x, own[10 * LANES + n] - from_y
        z = own[11 * LANES + n] - from_z
        along = rx * x + ry * y + rz * z
        least = 1e-3 * (abs(x) + abs(y) + abs(z))
        depth = along if along > least else least
        x, y, z = x - along * rx, y - along * ry, z - along * rz
        off = x * x + y * y + z * z
        held = depth * depth + off * precision * narrow
        both = 1 / (held * depth)  # one division instead of two
        inverse, weight = both * held, precision * both * depth
        square = off * inverse
        own[6 * LANES + n] += weight * (x - square * rx)
        own[7 * LANES + n] += weight * (y - square * ry)
        own[8 * LANES + n] += weight * (z - square * rz)
        size = 1 - square * inverse
        x, y, z = x * inverse, y * inverse, z * inverse
        own[n] += weight * (1 - (size * rx + 2 * x) * rx)
        own[LANES + n] -= weight * (size * rx * ry + x * ry + y * rx)
        own[2 * LANES + n] -= weight * (size * rx * rz + x * rz + z * rx)
        own[3 * LANES + n] += weight * (1 - (size * ry + 2 * y) * ry)
        own[4 * LANES + n] -= weight * (size * ry * rz + y * rz + z * ry)
        own[5 * LANES + n] += weight * (1 - (size * rz + 2 * z) * rz)


@inlined
def _hold(own: Floats) -> None:
    """Add a trace of their size to the blocks of a joint."""
    for n in range(LANES):
        trace = _ROUNDING * (own[n] + own[3 * LANES + n] + own[5 * LANES + n])
        own[n] += trace
        own[3 * LANES + n] += trace
        own[5 * LANES + n] += trace


@inlined
def _add_rays(
    points: Floats, rays: Floats, centres: Floats, narrow: float, own: Floats, joint: int
) -> None:
    """Set the blocks and the gradient of a joint in a tile to what rays tell, and its points.

    points: `[group, frame, 3 * LANES]` of the tile. own: `[12 * LANES]`, the points last.
    """
    g, n = joint // LANES, joint % LANES
    own[:_OWN] = 0.0
    for k in range(3):
        for f in range(LANES):
            own[_OWN + k * LANES + f] = points[g, f, k * LANES + n]
    for v in range(len(centres)):
        _add_view(rays[v, joint], centres[v], narrow, own)
    _hold(own)


@inlined
def _weigh_bone(first: Floats, second: Floats, bone: Floats, narrow: float, along: Floats) -> None:
    """Set the directions of a bone times the root of their weights, and errors last.

    first, second: its joints. bone: lengths, inverse standard deviations and shortest lengths.
    """
    for n in range(LANES):
        x, y = first[_OWN + n] - second[_OWN + n], first[10 * LANES + n] - second[10 * LANES + n]
        z = first[11 * LANES + n] - second[11 * LANES + n]
        known, shortest = bone[LANES + n], bone[2 * LANES + n]
        length = math.sqrt(x * x + y * y + z * z)
        error = (length - bone[n]) * known
        held = length if length > shortest else shortest
        both = 1 / (math.sqrt(1 + error * error * narrow) * held)  # one division instead of two
        scale = known * both
        along[n], along[LANES + n], along[2 * LANES + n] = x * scale, y * scale, z * scale
        along[3 * LANES + n] = both * held * error


@inlined
def _add_bone(along: Floats, first: Floats, second: Floats) -> None:
    """Add a bone to the blocks and the gradients of the joints at its ends, in a tile."""
    for n in range(LANES):
        x, y, z = along[n], along[LANES + n], along[2 * LANES + n]
        error = along[3 * LANES + n]
        xx, xy, xz, yy, yz, zz = x * x, x * y, x * z, y * y, y * z, z * z
        x, y, z = x * error, y * error, z * error
        first[n] += xx
        first[LANES + n] += xy
        first[2 * LANES + n] += xz
        first[3 * LANES + n] += yy
        first[4 * LANES + n] += yz
        first[5 * LANES + n] += zz
        first[6 * LANES + n] += x
        first[7 * LANES + n] += y
        first[8 * LANES + n] += z
        second[n] += xx
        second[LANES + n] += xy
        second[2 * LANES + n] += xz
        second[3 * LANES + n] += yy
        second[4 * LANES + n] += yz
        second[5 * LANES + n] += zz
        second[6 * LANES + n] -= x
        second[7 * LANES + n] -= y
        second[8 * LANES + n] -= z


@inlined
def _turn(own: Floats, numbers: int, turned: Floats) -> None:
    """Set `[frame, group, numbers * LANES]` from the first numbers of joints in a tile."""
    for j in range(len(own)):
        row, g, n = own[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(numbers):
                turned[f, g, k * LANES + n] = row[k * LANES + f]


@kernel(
    "f8[:,:,:,::1], f8[:,::1], f8[:,:,::1], i8[:,::1], f8[:,:,::1], f8, f8, f8[:,:,::1], "
    "f8[:,:,::1], f8[:,:,::1]"
)
def sum_terms(
    rays: Floats,
    centres: Floats,
    points: Floats,
    edges: Ints,
    bones: Floats,
    loss: float,
    prior_loss: float,
    along: Floats,
    factor: Floats,
    gradient: Floats,
) -> None:
    """Set what rays and bones tell at these points: blocks of the diagonal, and the gradient.

    Frames fill whole tiles. rays: `[tile, view, keypoint, 4 * LANES]`, precisions last. bones:
    `[tile, edge, 3 * LANES]` lengths, inverse standard deviations and the shortest length. along:
    `[tile, edge, 4 * LANES]`. The others have two frames of zeros before and after: points and
    gradient `[group, frame, 3 * LANES]`, factor `[group, frame, 16 * LANES]`, the blocks first.
    """
    own = np.empty((rays.shape[2], 12 * LANES))
    turned = np.zeros((LANES, len(points), _OWN))
    narrow, prior_narrow = 1 / loss**2, 1 / prior_loss**2
    for k in range(len(rays)):
        first = 2 + k * LANES
        tile = points[:, first : first + LANES]
        for j in range(len(own)):
            _add_rays(tile, rays[k], centres, narrow, own[j], j)
        for e in range(len(edges)):
            a, b = edges[e, 0], edges[e, 1]
            _weigh_bone(own[a], own[b], bones[k, e], prior_narrow, along[k, e])
            _add_bone(along[k, e], own[a], own[b])
        _turn(own, 9, turned)
        for f in range(LANES):
            for g in range(len(points)):
                factor[g, first + f, :_BLOCK] = turned[f, g, :_BLOCK]
                gradient[g, first + f] = turned[f, g, _BLOCK:]


@inlined
def _invert(own: Floats, ridge: Floats, variance: Floats) -> None:
    """Set the inverse `[6 * LANES]` of what rays tell of a joint in a tile. ridge: `[LANES]`."""
    for n in range(LANES):
        held = ridge[n]
        xx, xy, xz = own[n] + held, own[LANES + n], own[2 * LANES + n]
        yy, yz, zz = own[3 * LANES + n] + held, own[4 * LANES + n], own[5 * LANES + n] + held
        of_xx, of_xy, of_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1 / (xx * of_xx + xy * of_xy + xz * of_xz)
        variance[n], variance[LANES + n] = of_xx * scale, of_xy * scale
        variance[2 * LANES + n], variance[3 * LANES + n] = (
            of_xz * scale,
            (xx * zz - xz * xz) * scale,
        )
        variance[4 * LANES + n] = (xy * xz - xx * yz) * scale
        variance[5 * LANES + n] = (xx * yy - xy * xy) * scale


@inlined
def _tell(along: Floats, variance: Floats, own: Floats) -> None:
    """Add to the blocks of a joint in a tile what a bone tells of it.

    variance: `[6 * LANES]` of the bone's other end.
    """
    for n in range(LANES):
        x, y, z = along[n], along[LANES + n], along[2 * LANES + n]
        by_x = variance[n] * x + variance[LANES + n] * y + variance[2 * LANES + n] * z
        by_y = variance[LANES + n] * x + variance[3 * LANES + n] * y + variance[4 * LANES + n] * z
        by_z = (
            variance[2 * LANES + n] * x + variance[4 * LANES + n] * y + variance[5 * LANES + n] * z
        )
        weight = 1 / (1 + x * by_x + y * by_y + z * by_z)
        own[n] += weight * x * x
        own[LANES + n] += weight * x * y
        own[2 * LANES + n] += weight * x * z
        own[3 * LANES + n] += weight * y * y
        own[4 * LANES + n] += weight * y * z
        own[5 * LANES + n] += weight * z * z


@kernel(
    "f8[:,:,:,::1], f8[:,::1], f8[:,:,::1], i8[:,::1], f8[:,:,::1], f8[:,::1], f8, f8, f8[:,:,::1]"
)
def sum_known(
    rays: Floats,
    centres: Floats,
    points: Floats,
    edges: Ints,
    bones: Floats,
    expected: Floats,
    loss: float,
    prior_loss: float,
    factor: Floats,
) -> None:
    """Set blocks of the diagonal to what is known of each joint without accelerations.

    By its rays, and by its bones as far as their other ends are known without them. Arrays are as
    of `sum_terms` and, expected, of `pose_bands.factor_bands`.
    """
    own, along = np.empty((rays.shape[2], 12 * LANES)), np.empty(4 * LANES)
    variance, ridge = np.empty((len(own), _BLOCK)), np.empty(LANES)
    turned = np.zeros((LANES, len(points), _BLOCK))
    narrow, prior_narrow = 1 / loss**2, 1 / prior_loss**2
    for k in range(len(rays)):
        first = 2 + k * LANES
        tile = points[:, first : first + LANES]
        ridge[:] = expected[first : first + LANES, 1]
        for j in range(len(own)):
            _add_rays(tile, rays[k], centres, narrow, own[j], j)
            _invert(own[j], ridge, variance[j])
        for e in range(len(edges)):
            a, b = edges[e, 0], edges[e, 1]
            _weigh_bone(own[a], own[b], bones[k, e], prior_narrow, along)
            _tell(along, variance[b], own[a])
            _tell(along, variance[a], own[b])
        _turn(own, 6, turned)
        for f in range(LANES):
            for g in range(len(points)):
                factor[g, first + f, :_BLOCK] = turned[f, g]


# --- accelerations


@inlined
def weigh_motion(
    points: Floats, steps: Floats, expected: Floats, narrow: float, motion: Floats
) -> None:
    """Set the weights of accelerations and these times them, from points of three frames."""
    first, second, third, own = steps[0], steps[1], steps[2], expected[0]
    shared_x, shared_y, shared_z = expected[2], expected[3], expected[4]
    for n in range(LANES):
        x = first * points[n] + second * points[POINT + n] + third * points[2 * POINT + n]
        m = n + LANES
        y = first * points[m] + second * points[POINT + m] + third * points[2 * POINT + m]
        m = n + 2 * LANES
        z = first * points[m] + second * points[POINT + m] + third * points[2 * POINT + m]
        x, y, z = x - shared_x, y - shared_y, z - shared_z
        pull = own / (1 + (x * x + y * y + z * z) * own * narrow)
        motion[n], motion[LANES + n] = pull, pull * x
        motion[2 * LANES + n], motion[3 * LANES + n] = pull * y, pull * z


@inlined
def add_motion(
    motion: Floats, steps: Floats, ridge: float, own: Floats, push: Floats, link: Floats
) -> None:
    """Add the accelerations of three frames to the last; set its links to the ones before.

    motion: of the three frames. steps: `[3, 3]` by frame. own: its blocks. push: its gradient.
    link: b and c.
    """
    in_last, in_middle, in_first = steps[0, 2], steps[1, 1], steps[2, 0]
    at_middle, at_end = steps[0, 1], steps[1, 0]
    at_start = steps[0, 0]
    for n in range(LANES):
        last, middle, first = motion[n], motion[MOTION + n], motion[2 * MOTION + n]
        same = last * in_last * in_last + middle * in_middle * in_middle
        same = same + first * in_first * in_first + ridge
        own[n] += same
        own[3 * LANES + n] += same
        own[5 * LANES + n] += same
        link[n] = last * at_middle * in_last + middle * at_end * in_middle
        link[LANES + n] = last * at_start * in_last
    for n in range(POINT):
        m = LANES + n
        own_push = in_last * motion[m] + in_middle * motion[MOTION + m]
        push[n] += own_push + in_first * motion[2 * MOTION + m]


# --- what the joints of a body share of their accelerations


@inlined
def _accelerate(points: Floats, steps: Floats, found: Floats, frame: int, first: int) -> None:
    """Set the accelerations of a group's joints in one of the frames side by side.

    points: of three frames. found: `[joint, 3 * LANES]`. first: the first joint of the group.
    """
    before, now, after = steps[0], steps[1], steps[2]
    for n in range(min(LANES, len(found) - first)):
        for k in range(3):
            m = k * LANES + n
            value = before * points[m] + now * points[POINT + m] + after * points[2 * POINT + m]
            found[first + n, k * LANES + frame] = value


@inlined
def _add_weighed(own: Floats, middle: Floats, sums: Floats) -> None:
    """Add a joint's accelerations times weights, and the weights: inverse distances."""
    for n in range(LANES):
        a, b, c = own[n], own[LANES + n], own[2 * LANES + n]
        x, y, z = a - middle[n], b - middle[LANES + n], c - middle[2 * LANES + n]
        weight = 1 / (math.sqrt(x * x + y * y + z * z) + _TINY)
        sums[n] += weight * a
        sums[LANES + n] += weight * b
        sums[2 * LANES + n] += weight * c
        sums[POINT + n] += weight


@kernel("f8[:,:,::1], f8[:,::1], i8, i8, f8, f8[:,::1]")
def share_accelerations(
    points: Floats, steps: Floats, joints: int, rounds: int, part: float, expected: Floats
) -> None:
    """Set what joints share of the accelerations of frames, in the last three columns.

    points: `[group, frame, 3 * LANES]`. rounds: towards the geometric median, from the mean
    (Weiszfeld 1937). part: of the median, that is expected. expected: `[frame, 5]`; its last two
    frames stay as they are.
    """
    own, middle = np.zeros((joints, POINT)), np.empty(POINT)
    sums = np.empty(4 * LANES)
    ends = len(expected) - 2
    for first in range(0, ends, LANES):
        frames = min(LANES, ends - first)
        for f in range(frames):
            t = first + f
            for g in range(len(points)):
                _accelerate(points[g, t : t + 3].reshape(-1), steps[t], own, f, g * LANES)
        middle[:] = 0.0
        for j in range(joints):
            middle += own[j]
        middle /= joints
        for _ in range(rounds):
            sums[:] = 0.0
            for j in range(joints):
                _add_weighed(own[j], middle, sums)
            for n in range(LANES):
                for k in range(3):
                    middle[k * LANES + n] = sums[k * LANES + n] / sums[POINT + n]
        for f in range(frames):
            for k in range(3):
                expected[first + f, 2 + k] = part * middle[k * LANES + f]
