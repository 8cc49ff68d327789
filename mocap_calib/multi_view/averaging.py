"""Relative poses of pairs -> one rig, in the frame of the first camera, in body sizes.

Rotations: the best spanning tree, then iteratively reweighted least squares on SO(3) (Chatterjee and Govindu 2018).
Positions: all pairs see the same bodies, so each baseline comes with its length and positions are a linear problem,
not one of directions; reweighted in the same way. A pair that breaks the loops loses its weight and is named.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from mocap_calib.config import AveragingConfig
from mocap_calib.geometry.rotation import (
    angle_between,
    direction_angle,
    matrix_from_vector,
    vector_from_matrix,
)
from mocap_calib.types import Averaged, Camera, CameraRig, Floats, Ints, PairwiseCalibration


def average(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Averaged:
    """The rig that agrees best with all pairs, which must connect all cameras (`loops.usable_cameras`)."""
    edge = np.array([(p.a, p.b) for p in pairs])
    relative = np.stack([p.rotation for p in pairs])
    baseline = np.stack([p.translation for p in pairs])
    trust = np.array([p.score for p in pairs]) ** 2 + 1e-6
    rotation, kept = _rotations(edge, relative, trust, len(cameras), config)
    centre, kept = _centres(edge, rotation, baseline, kept, config)
    rig = CameraRig(cameras, rotation, -np.einsum("vij,vj->vi", rotation, centre), "arbitrary")
    found = _relative(edge, rotation)
    moved = rig.translation[edge[:, 1]] - np.einsum(
        "eij,ej->ei", found, rig.translation[edge[:, 0]]
    )
    return Averaged(
        rig, angle_between(found, relative), direction_angle(moved, baseline), kept / trust
    )


def _relative(edge: Ints, rotation: Floats) -> Floats:
    """b_from_a of each edge `[E, 3, 3]` in a rig."""
    return rotation[edge[:, 1]] @ np.swapaxes(rotation[edge[:, 0]], 1, 2)


def _rotations(
    edge: Ints, relative: Floats, trust: Floats, views: int, config: AveragingConfig
) -> tuple[Floats, Floats]:
    """`[view, 3, 3]` cam_from_world with the first camera as world, and the weight of each edge."""
    rotation = _from_tree(edge, relative, trust, views)
    incidence = _incidence(edge, views)
    scale = np.deg2rad(config.rotation_scale_deg)
    weight = trust
    for _ in range(config.iterations):
        # world-frame error: with R_v <- R_v exp(d_v), d_b - d_a should equal it
        error = vector_from_matrix(
            np.swapaxes(rotation[edge[:, 1]], 1, 2) @ relative @ rotation[edge[:, 0]]
        )
        weight = trust / (1 + ((error / scale) ** 2).sum(1)) ** 2
        step = _solve(incidence, weight, error)
        rotation = rotation @ matrix_from_vector(step)
        if np.abs(step).max() < 1e-10:
            break
    return rotation @ rotation[0].T, weight


def _from_tree(edge: Ints, relative: Floats, trust: Floats, views: int) -> Floats:
    """Rotations along the spanning tree of the most trusted edges."""
    cost = 1e-6 + np.max(trust) - trust
    tree = minimum_spanning_tree(csr_array((cost, (edge[:, 0], edge[:, 1])), shape=(views, views)))
    order, parent = breadth_first_order(tree, 0, directed=False)
    index = {(a, b): k for k, (a, b) in enumerate(map(tuple, edge.tolist()))}
    rotation = np.tile(np.eye(3), (views, 1, 1))
    for view in order[1:].tolist():
        above = int(parent[view])
        step = (
            relative[index[above, view]]
            if (above, view) in index
            else relative[index[view, above]].T
        )
        rotation[view] = step @ rotation[above]
    return rotation


def _incidence(edge: Ints, views: int) -> Floats:
    matrix = np.zeros((len(edge), views))
    matrix[np.arange(len(edge)), edge[:, 1]] = 1.0
    matrix[np.arange(len(edge)), edge[:, 0]] = -1.0
    return matrix


def _solve(incidence: Floats, weight: Floats, target: Floats) -> Floats:
    """`[view, 3]` x that minimises sum w |x_b - x_a - target|^2 with x of the first view zero."""
    rows = incidence[:, 1:] * np.sqrt(weight)[:, None]
    solution = np.linalg.lstsq(rows, target * np.sqrt(weight)[:, None], rcond=None)[0]
    return np.concatenate([np.zeros((1, 3)), solution])


def _centres(
    edge: Ints, rotation: Floats, baseline: Floats, trust: Floats, config: AveragingConfig
) -> tuple[Floats, Floats]:
    """`[view, 3]` camera centres, the first at zero, and the weight of each edge.

    A baseline t of b_from_a is the centre of a seen from b: C_a - C_b = R_b' t.
    """
    target = -np.einsum("eji,ej->ei", rotation[edge[:, 1]], baseline)
    length2 = np.maximum((target**2).sum(1), 1e-12)
    incidence = _incidence(edge, len(rotation))
    weight = trust
    for _ in range(config.iterations):
        centre = _solve(incidence, weight / length2, target)
        error = ((centre[edge[:, 1]] - centre[edge[:, 0]] - target) ** 2).sum(1) / length2
        weight = trust / (1 + error / config.translation_scale**2) ** 2
    return centre, weight
