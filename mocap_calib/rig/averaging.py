"""The rig to begin with: averaged from relative poses of pairs, or factorised of one subject.

Of pairs it is in the frame of its first camera.

Rotations: the best spanning tree, then iteratively reweighted least squares on SO(3) (Chatterjee
and Govindu 2018). Positions: all pairs see the same bodies, so each baseline comes with its length
in body sizes, and positions are a linear problem, not one of directions; reweighted in the same
way. A pair that contradicts its loops loses its weight and is named.

One subject needs no model and no pairs: its image points are factorised (Tomasi and Kanade 1992),
under scaled orthography (Poelman and Kanade 1997). Two views of a subject that is small against its
distance leave the rotation between them open; three determine it, up to a reversal in depth (Ullman
1979). Both answers are given: the adjustment that follows knows which one the perspective speaks
for, if it speaks.
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
    nearest_rotation,
    vector_from_matrix,
)
from mocap_calib.results import Averaged, Matches, PairwiseCalibration
from mocap_calib.rig import LEAST_POINTS, gather_tracks
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Sample

_REVERSE_DEPTH = np.diag([1.0, 1.0, -1.0])


def best_scores(pairs: tuple[PairwiseCalibration, ...], views: int) -> Floats:
    """Return the score of the best pair of each view: its place in the rig rests on this pair.

    `[view]`, NaN where no pair is known.
    """
    scores = np.full(views, np.nan)
    for pair in pairs:
        scores[[pair.a, pair.b]] = np.fmax(scores[[pair.a, pair.b]], pair.score)
    return scores


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

    The pairs must connect all cameras (see `camera_groups`). The first camera is the
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
    scale = np.deg2rad(config.scale_deg)
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


# --- factorization


def factorise(sample: Sample, matches: Matches) -> tuple[CameraRig, ...]:
    """Return two rigs, reversed in depth from each other, from the points that all views see.

    The cameras are scaled orthographic: what comes out is a start for the adjustment, in units of
    the subject's RMS extent, its centroid at the origin. Returns no rig where views or points are
    too few, or where they determine no rotations.
    """
    image = _image_points(sample, matches)
    # three views determine rotations up to a reversal
    if len(image) < 3 or image.shape[1] < LEAST_POINTS:
        return ()
    middle = image.mean(1)
    centred = np.concatenate(np.swapaxes(image - middle[:, None], 1, 2))  # [2 x view, point]
    left, size, _ = np.linalg.svd(centred, full_matrices=False)
    # the measurement matrix of centred images has rank 3 (Tomasi and Kanade 1992, section 3)
    affine = (left[:, :3] * size[:3]).reshape(-1, 2, 3)
    upgrade = _metric_upgrade(affine)
    if upgrade is None:
        return ()
    cameras = affine @ upgrade
    length = np.linalg.norm(cameras, axis=-1, keepdims=True)
    rows = cameras / length
    third = np.cross(rows[:, :1], rows[:, 1:])
    rotation = nearest_rotation(np.concatenate([rows, third], axis=1))
    extent = np.linalg.norm(np.linalg.inv(upgrade)) / np.sqrt(image.shape[1])
    scale = length.mean((1, 2)) * extent  # of an image: a length of 1 in space is so long in it
    translation = np.column_stack([middle, np.ones(len(middle))]) / scale[:, None]
    return tuple(
        CameraRig(sample.cameras, each, translation, "arbitrary")
        for each in (rotation, _REVERSE_DEPTH @ rotation @ _REVERSE_DEPTH)
    )


def label_single_subject(sample: Sample) -> Matches | None:
    """Label the only detection of each view as the single subject.

    Returns labels `[view, frame, instance]`, 0 or -1; None where half of the frames or more show
    several detections in some view.
    """
    at_most_one: Bools = np.asarray((sample.detected.sum(-1) <= 1).all(0))
    if 2 * at_most_one.sum() <= len(at_most_one):
        return None
    return Matches(np.where(sample.detected & at_most_one[:, None], 0, -1))


def _image_points(sample: Sample, matches: Matches) -> Floats:
    """Return `[view, point, 2]` x / z, y / z of the points that all views see."""
    seen = gather_tracks(sample, matches, np.arange(len(sample.frames)))
    rays = np.swapaxes(seen.rays, 1, 2)
    in_front: Bools = (seen.weight > 0) & (rays[..., 2] > 0)
    everywhere = np.flatnonzero(in_front.all(0))
    return rays[:, everywhere, :2] / rays[:, everywhere, 2:]


def _metric_upgrade(affine: Floats) -> Floats | None:
    """Return the change of coordinates `[3, 3]` that makes cameras of affine ones, or None.

    In the right coordinates both rows m and n of each camera are as long, and at right angles:
    m' Q m = n' Q n and m' Q n = 0 are linear in the symmetric Q (Poelman and Kanade 1997, scaled
    orthography). affine: `[view, 2, 3]`.
    """
    m, n = affine[:, 0], affine[:, 1]
    size = ((m**2).sum(1) + (n**2).sum(1))[:, None]
    same_length = _quadratic_terms(m, m) - _quadratic_terms(n, n)
    constraints = np.concatenate([same_length, 2 * _quadratic_terms(m, n)]) / np.tile(size, (2, 1))
    q = np.zeros((3, 3))
    q[np.triu_indices(3)] = np.linalg.svd(constraints)[2][-1]
    q += np.triu(q, 1).T
    values, vectors = np.linalg.eigh(q * np.sign(np.trace(q)))
    # one negative value is noise along the direction that is seen least
    if values[-1] <= 0 or values[1] <= 0:
        return None
    return np.asarray(vectors * np.sqrt(np.maximum(values, 1e-6 * values[-1])))


def _quadratic_terms(m: Floats, n: Floats) -> Floats:
    """Return `[view, 6]` the factors of the six numbers of a symmetric Q in m' Q n.

    m, n: `[view, 3]`. The order is xx, xy, xz, yy, yz, zz.
    """
    products = m[:, :, None] * n[:, None]
    both_ways = products + np.swapaxes(products, 1, 2)
    row, column = np.triu_indices(3)
    return np.where(row == column, 0.5, 1.0) * both_ways[:, row, column]
