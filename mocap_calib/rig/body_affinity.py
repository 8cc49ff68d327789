"""How well the lifted bodies of all views agree, all of them in one go, given the rig.

What `pairs.affinity.match_affinity` says of one pair of views after the other. Turned into the
world, two bodies are compared by products that know nothing of their views: of N detections in a
frame, a few products of N x K by K x N matrices take the place of N^2 comparisons.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import LEAST_LIFT_SPREAD, PairwiseConfig
from mocap_calib.types import Bools, CameraRig, Floats, Ints, LiftedPoses


@dataclass(frozen=True)
class _WorldBodies:
    """The lifted bodies of N = views x instances detections, in the axes of the world; 0 = nobody.

    joints: `[frame, N, joint, 3]` about their centroid, in body sizes.
    precision, variance: `[frame, N, joint]`.
    place: `[frame, N, 3]` of the centroid in the world, in body sizes.
    """

    joints: Floats
    precision: Floats
    variance: Floats
    place: Floats


def temper_by_bodies(
    affinity: Floats,
    lifted: LiftedPoses,
    rig: CameraRig,
    frames: Ints,
    *,
    distance: Floats,
    scale: float,
    compared: Bools,
    config: PairwiseConfig,
) -> Floats:
    """Return affinities by geometry, `[frame, N, N]`, tempered by how well lifted bodies agree.

    A detection that could not be lifted has less to say than others, unless no lifted bodies of two
    views could be compared in any frame: then geometry is all there is.

    affinity: `[frame, N, N]` of `pairs.affinity.epipolar_affinity`, N = views x instances.
    frames: `[frame]` indices into what was lifted. distance: `[view, frame, instance]` of the
    bodies in body sizes. scale: body sizes per unit of the rig. compared: `[view, view]` of
    `ever_compared`.
    """
    instances = distance.shape[2]
    bodies = _turn_into_world(lifted, rig, frames, scale=scale)
    agreement, comparable = _agreement(bodies, _by_frame(distance), config)
    of_views = np.where(compared, config.unlifted_affinity, 1.0)
    unlifted = of_views.repeat(instances, axis=0).repeat(instances, axis=1)
    return np.asarray(affinity * np.where(comparable, np.sqrt(agreement), unlifted))


def _turn_into_world(
    lifted: LiftedPoses, rig: CameraRig, frames: Ints, *, scale: float
) -> _WorldBodies:
    """Return the lifted bodies of some frames as the cameras of a rig see them in the world."""
    spread = lifted.spread[:, frames]
    body = np.nan_to_num(lifted.body[:, frames])
    seen = np.nan_to_num(lifted.centre[:, frames]) - scale * rig.translation[:, None, None]
    turned = rig.rotation[:, None, None]  # a row times R is R' times the column
    return _WorldBodies(
        joints=_by_frame(body @ turned),
        precision=_by_frame(np.nan_to_num(1.0 / (spread**2 + LEAST_LIFT_SPREAD**2))),
        variance=_by_frame(np.nan_to_num(spread) ** 2),
        place=_by_frame((seen[..., None, :] @ turned)[..., 0, :]),
    )


def ever_compared(lifted: LiftedPoses) -> Bools:
    """Return `[view, view]` whether lifted bodies of both have a joint in common in some frame."""
    known: Bools = np.asarray(np.isfinite(lifted.spread).any(2))
    by_view = known.reshape(len(known), -1).astype(np.float32)
    return np.asarray(by_view @ by_view.T > 0)


def _by_frame(array: Floats) -> Floats:
    """Return `[frame, N, ...]` of an array `[view, frame, instance, ...]`."""
    moved = np.moveaxis(array, 0, 1)
    return np.ascontiguousarray(moved.reshape(len(moved), -1, *array.shape[3:]))


def _agreement(
    bodies: _WorldBodies, distance: Floats, config: PairwiseConfig
) -> tuple[Floats, Bools]:
    """Return what `pairs.affinity.body_agreement` does, `[frame, N, N]`, and who was compared.

    distance: `[frame, N]`.
    """
    weighted = (bodies.joints * bodies.precision[..., None]).reshape(*distance.shape, -1)
    square = (bodies.joints**2).sum(-1) * bodies.precision
    total = _products(bodies.precision, bodies.precision)
    divisor = np.where(total > 0, total, 1.0)
    apart = _both_ways(square, bodies.precision) - 2 * _products(weighted, weighted)
    apart = np.maximum(apart, 0.0) / divisor
    doubt = _both_ways(bodies.variance * bodies.precision, bodies.precision) / divisor
    pose = apart / np.maximum(config.pose_tolerance**2, config.pose_doubt**2 * doubt)
    gap = sum(
        (bodies.place[:, :, None, axis] - bodies.place[:, None, :, axis]) ** 2 for axis in range(3)
    )
    squared = distance**2
    centre = gap / (squared[:, :, None] + squared[:, None]) / config.centre_tolerance**2
    compared = total > 0
    agreement = compared * np.exp(-0.5 * pose) / (1 + 0.5 * centre)
    # a product of matrices may differ from its transpose in the last digit
    return (agreement + np.swapaxes(agreement, 1, 2)) / 2, compared


def _products(first: Floats, second: Floats) -> Floats:
    """Return the sums of products, `[frame, N, N]`, of `[frame, N, K]` and `[frame, N, K]`."""
    return np.asarray(first @ np.swapaxes(second, 1, 2))


def _both_ways(first: Floats, second: Floats) -> Floats:
    """Return the sums of products of both orders, `[frame, N, N]`, symmetric."""
    products = _products(first, second)
    return products + np.swapaxes(products, 1, 2)
