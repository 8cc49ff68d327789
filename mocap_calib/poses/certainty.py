"""How sure the points of a fit are: the blocks of the inverse of its normal equations.

Over time exactly: the bands of a joint are block-tridiagonal in pairs of frames, and the diagonal
of the inverse follows from what is known up to a pair and what is known from it on (Rauch, Tung
and Striebel 1965). Stretches of frames are done all at once, with as many frames on each side as
anything reaches. Along bones to first order: a bone tells of a joint what is known of its other
end without it.
"""

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.geometry import symmetric
from mocap_calib.poses.energy import (
    Strengths,
    System,
    couplings,
    linearise,
    outer_products,
    spread,
)
from mocap_calib.poses.lanes import band_kernels, from_lanes
from mocap_calib.poses.packing import Packed, pack
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints

_PAIRS = 32  # of frames in a stretch
_MARGIN = 12  # pairs before it and after
_ROWS = ((0, 1, 2), (1, 3, 4), (2, 4, 5))


def covariances(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> Floats:
    """Return the covariance `[keypoint, frame, 6]` of each point, xx xy xz yy yz zz.

    points: `[keypoint, frame, 3]` of a fit. What nothing tells of has the variance 1 / ridge.
    """
    kernels = band_kernels()
    if kernels:
        packed = pack(points, seen, body, strengths, config, kernels=kernels)
        return _invert_compiled(packed, strengths.loss, points.shape[1])
    system = linearise(points, seen, body, strengths, config)
    ridge = config.ridge / body.size**2
    known = system.data + _from_bones(system, body.edges, ridge)
    return invert_bands(known, system.pull, body.steps, ridge)


def invert_bands(known: Floats, pull: Floats, steps: Floats, ridge: Floats) -> Floats:
    """Return the blocks `[keypoint, frame, 6]` of the inverse, from those of the diagonal.

    pull: `[keypoint, frame]` as in `System`. steps: as in `Body`. ridge: `[frame]`.
    """
    same, next_one, one_after = couplings(pull, steps)
    blocks = known[..., _ROWS] + (same + ridge)[..., None, None] * np.eye(3)
    joints, frames = same.shape
    pairs = -(-frames // 2)
    short = 2 * pairs - frames
    blocks = np.concatenate([blocks, np.broadcast_to(np.eye(3), (joints, short, 3, 3))], axis=1)
    links = np.pad(np.stack([next_one, one_after]), ((0, 0), (0, 0), (0, short)))
    diagonal, upper = _pair_up(blocks, *links)
    inverse = _inverse_blocks(diagonal, upper)
    halves = np.stack([inverse[..., :3, :3], inverse[..., 3:, 3:]], axis=2)
    found = halves.reshape(joints, 2 * pairs, 3, 3)[:, :frames]
    return found[..., (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]


def _invert_compiled(packed: Packed, loss: float, frames: int) -> Floats:
    """Return what `covariances` returns, without stretches. loss: of rays."""
    kernels, lanes = packed.kernels, packed.kernels.energy.LANES
    packed.share_accelerations()
    kernels.energy.sum_known(
        packed.rays,
        packed.centres,
        packed.points,
        packed.edges,
        packed.bones,
        packed.expected,
        loss,
        packed.config.prior_loss,
        packed.factor,
    )
    packed.factor_bands(np.zeros_like(packed.points))
    found = np.zeros((*packed.factor.shape[:2], 6 * lanes))
    kernels.step.invert_bands(packed.factor, found)
    return from_lanes(found, lanes, packed.joints, frames)


def _from_bones(system: System, edges: Ints, ridge: Floats) -> Floats:
    """Return what bones tell of each joint, `[keypoint, frame, 6]`."""
    direction = system.direction
    joints = len(system.data)
    if not len(direction):
        return np.zeros_like(system.data)
    alone = system.data + ridge[:, None] * np.array([1.0, 0, 0, 1, 0, 1])
    shape = alone.shape[:2]
    inverse = symmetric.invert(tuple(alone.reshape(-1, 6).T))
    variance = np.stack(inverse, axis=-1).reshape(*shape, 6)[..., _ROWS]
    entries = outer_products(direction)
    found = np.zeros_like(system.data)
    for near, far in (edges.T, edges.T[::-1]):
        along = np.einsum("eti,etij,etj->et", direction, variance[far], direction)
        found += spread(near, entries / (1 + along)[..., None], joints)
    return found


def _pair_up(blocks: Floats, next_one: Floats, one_after: Floats) -> tuple[Floats, Floats]:
    """Return the blocks `[keypoint, pair, 6, 6]` of the diagonal, and those above it.

    blocks: `[keypoint, frame, 3, 3]`; next_one, one_after: `[keypoint, frame]` times the identity.
    """
    joints, frames = next_one.shape
    shape = (joints, frames // 2, 2, 3, 2, 3)
    diagonal, upper = np.zeros(shape), np.zeros(shape)
    own = blocks.reshape(joints, -1, 2, 3, 3)
    first, second = next_one.reshape(joints, -1, 2).transpose(2, 0, 1)
    after = one_after.reshape(joints, -1, 2)
    for axis in range(3):
        diagonal[:, :, 0, axis, 1, axis] = diagonal[:, :, 1, axis, 0, axis] = first
        upper[:, :, 1, axis, 0, axis] = second
        upper[:, :, 0, axis, 0, axis] = after[..., 0]
        upper[:, :, 1, axis, 1, axis] = after[..., 1]
    for k in range(2):
        diagonal[:, :, k, :, k, :] = own[:, :, k]
    square = (joints, frames // 2, 6, 6)
    return diagonal.reshape(square), upper.reshape(square)


def _inverse_blocks(diagonal: Floats, upper: Floats) -> Floats:
    """Return the diagonal blocks `[keypoint, pair, 6, 6]` of the inverse."""
    joints, pairs = diagonal.shape[:2]
    stretches = -(-pairs // _PAIRS)
    size = _PAIRS + 2 * _MARGIN
    at = np.arange(stretches)[:, None] * _PAIRS + np.arange(size) - _MARGIN
    inside = (at >= 0) & (at < pairs)
    at = np.clip(at, 0, pairs - 1)
    eye = np.eye(6)
    own = np.where(inside[..., None, None], diagonal[:, at], eye)
    linked = inside & np.roll(inside, -1, axis=1)
    linked[:, -1] = False
    above = np.where(linked[..., None, None], upper[:, at], 0.0)
    own = np.moveaxis(own, 2, 0)  # [pair of the stretch, keypoint, stretch, 6, 6]
    above = np.moveaxis(above, 2, 0)
    before, after = own.copy(), own.copy()
    for k in range(1, size):
        link = above[k - 1]
        before[k] -= link.swapaxes(-1, -2) @ np.linalg.solve(before[k - 1], link)
    for k in range(size - 2, -1, -1):
        link = above[k]
        after[k] -= link @ np.linalg.solve(after[k + 1], link.swapaxes(-1, -2))
    middle = slice(_MARGIN, _MARGIN + _PAIRS)
    inverse = np.linalg.inv(before[middle] + after[middle] - own[middle])
    return np.moveaxis(inverse, 0, 2).reshape(joints, -1, 6, 6)[:, :pairs]
