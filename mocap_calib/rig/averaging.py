"""Average the relative poses of pairs to one rig, in the frame of its first camera.

Rotations: the best spanning tree, then iteratively reweighted least squares on SO(3) (Chatterjee
and Govindu 2018). Positions: all pairs see the same bodies, so each baseline comes with its length
in body sizes, and positions are a linear problem, not one of directions; reweighted in the same
way. A pair that contradicts its loops loses its weight and is named.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import AveragingConfig
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.geometry.rotation import (
    angle_between,
    direction_angle,
    matrix_from_vector,
    vector_from_matrix,
)
from mocap_calib.results import Averaged, PairwiseCalibration
from mocap_calib.types import Camera, CameraRig, Floats, Ints


@dataclass(frozen=True)
class _Edges:
    """The pairs as arrays.

    a, b: `[edge]` views.
    rotation: `[edge, 3, 3]` and baseline: `[edge, 3]` of b_from_a, in body sizes.
    trust: `[edge]` what a pair counts for at first, its score squared.
    """

    a: Ints
    b: Ints
    rotation: Floats
    baseline: Floats
    trust: Floats


@single_threaded_libraries()
def average(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Averaged:
    """Return the rig that agrees best with all pairs.

    The pairs must connect all cameras (see `graph.camera_groups`). The first camera is the
    world; lengths are in body sizes. The errors and weights are `[pair]`, in the order of `pairs`.
    """
    edges = _Edges(
        a=np.array([pair.a for pair in pairs]),
        b=np.array([pair.b for pair in pairs]),
        rotation=np.stack([pair.rotation for pair in pairs]),
        baseline=np.stack([pair.translation for pair in pairs]),
        trust=np.array([pair.score for pair in pairs]) ** 2 + 1e-6,
    )
    rotation, weight = _average_rotations(edges, len(cameras), config)
    centres, weight = _average_centres(edges, rotation, weight, config)
    translation = -np.einsum("vij,vj->vi", rotation, centres)

    rig_rotation = rotation[edges.b] @ np.swapaxes(rotation[edges.a], 1, 2)
    carried = np.einsum("eij,ej->ei", rig_rotation, translation[edges.a])
    rig_baseline = translation[edges.b] - carried
    return Averaged(
        rig=CameraRig(cameras, rotation, translation, "arbitrary"),
        loop_error=angle_between(rig_rotation, edges.rotation),
        translation_error=direction_angle(rig_baseline, edges.baseline),
        weight=weight / edges.trust,
    )


def _average_rotations(edges: _Edges, views: int, config: AveragingConfig) -> tuple[Floats, Floats]:
    """Return `[view, 3, 3]` cam_from_world and `[edge]` the weight that each edge keeps.

    The first camera is the world. Weights are those of Geman and McClure's loss.
    """
    rotation = _rotations_along_tree(edges, views)
    incidence = _incidence(edges, views)
    scale = np.deg2rad(config.rotation_scale_deg)
    weight = edges.trust
    for _ in range(config.iterations):
        # error in the world's frame: with R_v <- R_v exp(d_v), d_b - d_a should equal it
        world_from_b = np.swapaxes(rotation[edges.b], 1, 2)
        error = vector_from_matrix(world_from_b @ edges.rotation @ rotation[edges.a])
        error2 = ((error / scale) ** 2).sum(1)
        weight = edges.trust / (1 + error2) ** 2
        step = _solve_differences(incidence, weight, error)
        rotation = rotation @ matrix_from_vector(step)
        if np.abs(step).max() < 1e-10:
            break
    return rotation @ rotation[0].T, weight


def _rotations_along_tree(edges: _Edges, views: int) -> Floats:
    """Return `[view, 3, 3]` rotations chained along the spanning tree of the most trusted edges."""
    cost = np.full((views, views), np.inf)
    cost[edges.a, edges.b] = -edges.trust
    views_of_edges = zip(edges.a, edges.b, strict=True)
    edge_of = {views_of_edge: edge for edge, views_of_edge in enumerate(views_of_edges)}
    rotation = np.tile(np.eye(3), (views, 1, 1))
    for before, view in spanning_tree(cost).tolist():
        if (before, view) in edge_of:
            view_from_before = edges.rotation[edge_of[before, view]]
        else:
            view_from_before = edges.rotation[edge_of[view, before]].T
        rotation[view] = view_from_before @ rotation[before]
    return rotation


def _average_centres(
    edges: _Edges, rotation: Floats, trust: Floats, config: AveragingConfig
) -> tuple[Floats, Floats]:
    """Return `[view, 3]` camera centres, the first at zero, and `[edge]` the weight of each edge.

    A baseline t of b_from_a is the centre of a seen from b: C_a - C_b = R_b' t.
    """
    target = -np.einsum("eji,ej->ei", rotation[edges.b], edges.baseline)  # C_b - C_a
    length2 = np.maximum((target**2).sum(1), 1e-12)
    incidence = _incidence(edges, len(rotation))
    weight = trust
    for _ in range(config.iterations):
        centres = _solve_differences(incidence, weight / length2, target)
        gap = centres[edges.b] - centres[edges.a] - target
        error2 = (gap**2).sum(1) / length2
        weight = trust / (1 + error2 / config.translation_scale**2) ** 2
    return centres, weight


def _incidence(edges: _Edges, views: int) -> Floats:
    """Return `[edge, view]` the matrix that takes x of the views to x_b - x_a of the edges."""
    matrix = np.zeros((len(edges.a), views))
    matrix[np.arange(len(matrix)), edges.b] = 1.0
    matrix[np.arange(len(matrix)), edges.a] = -1.0
    return matrix


def _solve_differences(incidence: Floats, weight: Floats, target: Floats) -> Floats:
    """Return `[view, 3]` x that minimises sum w |x_b - x_a - target|^2; x of the first view is 0.

    incidence: `[edge, view]`; weight: `[edge]`; target: `[edge, 3]`.
    """
    root = np.sqrt(weight)[:, None]
    rows = incidence[:, 1:] * root
    solution, *_ = np.linalg.lstsq(rows, target * root, rcond=None)
    return np.concatenate([np.zeros((1, 3)), solution])
