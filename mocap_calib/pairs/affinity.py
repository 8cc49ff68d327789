"""What detections say about the relative pose of two views, and about who is who.

Three sources: lifted bodies, turned into the other view; where their centres are; and epipolar
geometry. Lengths are in body sizes and image errors are measured at the body (an angle times the
distance of the body), so that one tolerance serves scenes of any size.

M relative poses are looked at in one go; a frame holds I instances in view a and J in view b.
"""

from dataclasses import replace
from functools import reduce

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import essential_matrix
from mocap_calib.kernels.all_views import fit_all_views
from mocap_calib.kernels.loading import contiguous
from mocap_calib.pairs.view_pair import ViewPair
from mocap_calib.types import CameraRig, Floats, Ints, Sample


def steering_error(pair: ViewPair, rotation: Floats) -> Floats:
    """Return the mean squared joint distance |R X_a - X_b|^2 of the lifted bodies.

    One matrix product for all rotations: the error is linear in R once the cross-covariance of
    the bodies is known. Of several readings the nearest counts. rotation: `[M, 3, 3]`. Returns
    `[M, frame, I, J]` squared body sizes.
    """
    nearest = reduce(np.maximum, np.moveaxis(_traces(pair, rotation), 1, 0))
    return np.maximum(pair.overlap.norm - 2 * nearest, 0.0)


def _traces(pair: ViewPair, rotation: Floats) -> Floats:
    """Return tr(R sum w X_a X_b'), `[M, reading, frame, I, J]`."""
    cross = np.swapaxes(pair.overlap.cross, -1, -2)
    traces = rotation.reshape(-1, 9) @ cross.reshape(-1, 9).T
    return traces.reshape(-1, *cross.shape[:-2])


def weigh_readings(pair: ViewPair, rotation: Floats, weight: Floats) -> Floats:
    """Return weights `[M, frame, I, J]` as those of the nearest reading, `[M, reading, ...]`.

    rotation: `[M, 3, 3]`.
    """
    if len(pair.overlap.cross) == 1:
        return weight[:, None]
    nearest = _traces(pair, rotation).argmax(1)
    each = np.arange(len(pair.overlap.cross))[:, None, None, None]
    return np.asarray(weight[:, None] * (nearest[:, None] == each))


def in_one_reading(pair: ViewPair, rotation: Floats) -> ViewPair:
    """Return the pair with the reading alone of each match that is nearest at R `[3, 3]`."""
    cross = pair.overlap.cross
    if len(cross) == 1:
        return pair
    nearest = _traces(pair, rotation[None])[0].argmax(0)[None, ..., None, None]
    return replace(
        pair, overlap=replace(pair.overlap, cross=np.take_along_axis(cross, nearest, axis=0))
    )


def steering_variance(pair: ViewPair, config: PairwiseConfig) -> Floats:
    """Return the squared distance at which two lifts still pass for one body, `[frame, I, J]`.

    The tolerance, or what the network expects where that is more.
    """
    expected = config.pose_doubt**2 * pair.overlap.doubt
    return np.maximum(config.pose_tolerance**2, expected)


def body_agreement(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> Floats:
    """Return in 0..1 how well the lifted bodies and their centres agree, 0 where there is no body.

    exp(-p / 2) / (1 + c / 2), where p is `steering_error` over its variance, and c is
    |R c_a + t - c_b|^2 of the centres over the squares of their distances and of the tolerance.
    One matrix product each, of the N possible matches of lifted bodies alone.
    rotation: `[M, 3, 3]`; translation: `[M, 3]` in body sizes. Returns `[M, frame, I, J]`.
    """
    cells = np.flatnonzero(pair.overlap.lifted)
    turns = _terms_of_rotation(rotation)
    of_readings = (
        turns @ _pose_terms(pair, cells, config, cross=cross) for cross in pair.overlap.cross
    )
    agreement = reduce(np.minimum, of_readings)
    agreement *= -0.5
    np.exp(np.minimum(agreement, 0.0, out=agreement), out=agreement)
    distance = _terms_of_relative_pose(rotation, translation) @ _centre_terms(pair, cells)
    distance *= 0.5 / config.centre_tolerance**2
    agreement /= 1 + np.maximum(distance, 0.0, out=distance)
    found = np.zeros((len(rotation), pair.overlap.lifted.size))
    found[:, cells] = agreement
    return found.reshape(-1, *pair.overlap.lifted.shape)


def _pose_terms(pair: ViewPair, cells: Ints, config: PairwiseConfig, *, cross: Floats) -> Floats:
    """Return `[10, N]`, of which `_terms_of_rotation` make p of `body_agreement`.

    cells: `[N]` places in `[frame, I, J]`; cross: `[frame, I, J, 3, 3]` of a reading.
    """
    terms = np.empty((10, len(cells)))
    of_cells = cross.reshape(-1, 9).take(cells, axis=0).T
    terms[:9] = of_cells.reshape(3, 3, -1).swapaxes(0, 1).reshape(9, -1)
    terms[9] = pair.overlap.norm.take(cells)
    terms /= steering_variance(pair, config).take(cells)
    return terms


def _terms_of_rotation(rotation: Floats) -> Floats:
    """Return `[M, 10]` of rotations `[M, 3, 3]`: see `steering_error`."""
    return np.column_stack([-2 * rotation.reshape(-1, 9), np.ones(len(rotation))])


def _centre_terms(pair: ViewPair, cells: Ints) -> Floats:
    """Return `[17, N]`, of which `_terms_of_relative_pose` make the error of the centres.

    |R a + t - b|^2 = -2 b.R a + 2 t.R a - 2 t.b + |t|^2 + (|a|^2 + |b|^2), over the distances.
    cells: `[N]` places in `[frame, I, J]`.
    """
    of_a, of_j = np.divmod(cells, pair.b.centre.shape[1])
    of_b = of_a // pair.a.centre.shape[1] * pair.b.centre.shape[1] + of_j
    terms = np.empty((17, len(cells)))
    outer, a, b = terms[:9].reshape(3, 3, -1), terms[9:12], terms[12:15]
    a[:] = pair.a.centre.reshape(-1, 3).take(of_a, axis=0).T
    b[:] = pair.b.centre.reshape(-1, 3).take(of_b, axis=0).T
    np.multiply(b[:, None], a, out=outer)
    terms[15] = 1.0
    terms[16] = (a**2).sum(0) + (b**2).sum(0)
    terms /= pair.a.distance.take(of_a) ** 2 + pair.b.distance.take(of_b) ** 2
    return terms


def _terms_of_relative_pose(rotation: Floats, translation: Floats) -> Floats:
    """Return `[M, 17]` of rotations `[M, 3, 3]` and translations `[M, 3]`: see `_centre_terms`."""
    terms = np.ones((len(rotation), 17))
    terms[:, :9] = -2 * rotation.reshape(-1, 9)
    terms[:, 9:12] = 2 * np.einsum("mij,mi->mj", rotation, translation)
    terms[:, 12:15] = -2 * translation
    terms[:, 15] = (translation**2).sum(-1)
    return terms


def unit_essential_matrix(rotation: Floats, translation: Floats) -> Floats:
    """Return the essential matrices of relative poses `[M, ...]`, the baseline being 1."""
    return essential_matrix(
        rotation, translation / np.linalg.norm(translation, axis=-1, keepdims=True)
    )


def weight_of_matches(weight_a: Floats, weight_b: Floats) -> Floats:
    """Return `[frame, I, J, keypoint]` the weights of the joints of all possible matches."""
    return weight_a[:, :, None] * weight_b[:, None]


def match_affinity(
    pair: ViewPair,
    rotation: Floats,
    translation: Floats,
    config: PairwiseConfig,
    *,
    epipolar: Floats,
) -> Floats:
    """Return in 0..1 that two detections are one individual: geometry, tempered by lifted bodies.

    A detection that could not be lifted has less to say than others, unless none could be: then
    geometry is all there is. rotation: `[M, 3, 3]`; translation: `[M, 3]` in body sizes;
    epipolar: `[M, frame, I, J]` of `scoring.fit_matches`. Returns `[M, frame, I, J]`.
    """
    bodies = np.sqrt(body_agreement(pair, rotation, translation, config))
    unlifted = config.unlifted_affinity if pair.overlap.lifted.any() else 1.0
    return epipolar * np.where(pair.overlap.lifted > 0, bodies, unlifted)


def epipolar_affinity(
    sample: Sample, rig: CameraRig, distance: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Return the affinity of all pairs of detections of each frame by the rig alone.

    distance: `[view, frame, instance]` of the bodies in body sizes (see `view_pair.distances`).
    Returns the affinity `[frame, N, N]` in 0..1, N = views x instances, and 1 where it means
    something, else 0.
    """
    views, frames, instances, _ = sample.confidence.shape
    affinity = np.zeros((frames, views, instances, views, instances))
    comparable = np.zeros_like(affinity)
    fit_all_views(
        *contiguous(sample.rays, sample.confidence, distance, _essential_matrices(rig)),
        config.inlier,
        config.least_common_joints,
        affinity,
        comparable,
    )
    nodes = views * instances
    return affinity.reshape(frames, nodes, nodes), comparable.reshape(frames, nodes, nodes)


def _essential_matrices(rig: CameraRig) -> Floats:
    """Return `[view, view, 3, 3]` the essential matrices of all pairs a < b, transposed at (b, a).

    0 on the diagonal.
    """
    a, b = np.triu_indices(len(rig.cameras), 1)
    rotation = rig.rotation[b] @ np.swapaxes(rig.rotation[a], 1, 2)
    translation = rig.translation[b] - (rotation @ rig.translation[a][..., None])[..., 0]
    length = np.linalg.norm(translation, axis=-1, keepdims=True)
    matrices = np.zeros((len(rig.cameras), len(rig.cameras), 3, 3))
    matrices[a, b] = essential_matrix(rotation, translation / length)
    matrices[b, a] = np.swapaxes(matrices[a, b], 1, 2)
    return matrices
