"""What two views say about a relative pose of the cameras: steered bodies, places, and epipolar geometry.

Lengths are in body sizes and image errors are measured at the body (an angle times the distance of the body), so
that one yardstick serves a mouse in a box and a team in a hall.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import essential_matrix
from mocap_calib.types import CameraRig, Floats, Ints, LiftedPoses, Sample


@dataclass(frozen=True)
class ViewPair:
    """The detections of views a and b in some frames.

    frames: `[frame]` index into the recording. rays_a: `[frame, I, keypoint, 3]`, weight_a: `[frame, I, keypoint]`
    (0 = missing), place_a: `[frame, I, 3]` lifted centre, distance_a: `[frame, I]` its distance, likewise for b with J
    instances. cross: `[frame, I, J, 3, 3]` sum w X_a X_b' of the lifted bodies, norm: `[frame, I, J]` sum
    w (|X_a|^2 + |X_b|^2), both with sum w = 1; doubt: `[frame, I, J]` sum w (s_a^2 + s_b^2) of the network's own spreads, how
    far apart two lifts of one body are to be expected; lifted: `[frame, I, J]` 1 where both are lifted, else 0.
    """

    frames: Ints
    rays_a: Floats
    rays_b: Floats
    weight_a: Floats
    weight_b: Floats
    place_a: Floats
    place_b: Floats
    distance_a: Floats
    distance_b: Floats
    cross: Floats
    norm: Floats
    doubt: Floats
    lifted: Floats


def view_pair(recording: Sample, lifted: LiftedPoses, a: int, b: int, frames: Ints) -> ViewPair:
    """Gathers the evidence of two views in the given frames (indices into the recording)."""
    weight_a, weight_b = recording.confidence[a, frames], recording.confidence[b, frames]
    body_a, precision_a = _bodies(lifted, a, frames)
    body_b, precision_b = _bodies(lifted, b, frames)
    total = np.einsum("fik,fjk->fij", precision_a, precision_b)
    safe = np.where(total > 0, total, 1.0)
    # in C order, which pickling keeps: the last digit of sums over it depends on the order in memory
    cross = np.einsum(
        "fikx,fjky->fijxy",
        body_a * precision_a[..., None],
        body_b * precision_b[..., None],
        optimize=True,
        order="C",
    )
    square_a, square_b = (body_a**2).sum(-1) * precision_a, (body_b**2).sum(-1) * precision_b
    norm = np.einsum("fik,fjk->fij", square_a, precision_b) + np.einsum(
        "fik,fjk->fij", precision_a, square_b
    )
    spread_a, spread_b = (np.nan_to_num(lifted.spread[view, frames]) ** 2 for view in (a, b))
    doubt = np.einsum("fik,fjk->fij", spread_a * precision_a, precision_b) + np.einsum(
        "fik,fjk->fij", precision_a, spread_b * precision_b
    )
    place_a, place_b = lifted.centre[a, frames], lifted.centre[b, frames]
    return ViewPair(
        frames,
        np.nan_to_num(recording.rays[a, frames]),
        np.nan_to_num(recording.rays[b, frames]),
        weight_a,
        weight_b,
        np.nan_to_num(place_a),
        np.nan_to_num(place_b),
        _distance(place_a, recording.rays[a, frames]),
        _distance(place_b, recording.rays[b, frames]),
        cross / safe[..., None, None],
        norm / safe,
        doubt / safe,
        (total > 0).astype(np.float64),
    )


def _bodies(lifted: LiftedPoses, view: int, frames: Ints) -> tuple[Floats, Floats]:
    """Bodies with zeros for nobody, and the precision of each joint (the prior's floor: a twentieth of a body)."""
    body, spread = lifted.body[view, frames], lifted.spread[view, frames]
    precision = 1.0 / (spread**2 + 0.05**2)
    return np.nan_to_num(body), np.nan_to_num(precision)


def _distance(place: Floats, rays: Floats) -> Floats:
    """`[frame, I]` distances of lifted bodies; of the others, how far a body of their angular size would be."""
    seen = np.isfinite(rays[..., :1])
    known = np.where(seen, rays, 0.0)
    middle = known.sum(-2, keepdims=True) / np.maximum(seen.sum(-2, keepdims=True), 1)
    square = np.where(seen, (known - middle) ** 2, 0.0).sum((-1, -2)) / np.maximum(
        seen.sum((-1, -2)), 1
    )
    by_size = np.sqrt(2 / 3) / np.sqrt(np.maximum(square, 1e-8))  # two of three dimensions are seen
    lifted = np.linalg.norm(place, axis=-1)
    return np.where(np.isfinite(lifted), lifted, by_size)


def steering_error(pair: ViewPair, rotation: Floats) -> Floats:
    """Mean squared joint distance |R X_a - X_b|^2 in body sizes for rotations `[M, 3, 3]`: `[M, frame, I, J]`.

    One matrix product for all hypotheses: the error is linear in R once the bodies' cross-covariance is known.
    """
    transposed = np.swapaxes(pair.cross, -1, -2).reshape(-1, 9)
    turned = (rotation.reshape(-1, 9) @ transposed.T).reshape(
        -1, *pair.norm.shape
    )  # tr(R sum w X_a X_b')
    return np.maximum(pair.norm - 2 * turned, 0.0)


def pose_variance(pair: ViewPair, config: PairwiseConfig) -> Floats:
    """`[frame, I, J]` squared distance at which two lifts still pass for one body: the tolerance, or what the network says where that is more."""
    return np.maximum(config.pose_tolerance**2, config.pose_doubt**2 * pair.doubt)


def place_error(pair: ViewPair, rotation: Floats, translation: Floats) -> Floats:
    """|R c_a + t - c_b|^2 of lifted centres relative to their distance, `[M, frame, I, J]`; t in body sizes `[M, 3]`."""
    frames, rows, columns = pair.lifted.shape
    # |R a + t - b|^2 = |a|^2 + |b|^2 + |t|^2 + 2 t.(R a - b) - 2 b.R a: one matrix product for all hypotheses
    outer = (pair.place_b[:, None, :, :, None] * pair.place_a[:, :, None, None, :]).reshape(-1, 9)
    gap = (-2 * rotation.reshape(-1, 9) @ outer.T).reshape(-1, frames, rows, columns)
    back = np.einsum("mij,mi->mj", rotation, translation)
    square_a = (
        (pair.place_a**2).sum(-1)
        + (translation**2).sum(-1)[:, None, None]
        + 2 * np.tensordot(back, pair.place_a, (1, 2))
    )
    square_b = (pair.place_b**2).sum(-1) - 2 * np.tensordot(translation, pair.place_b, (1, 2))
    gap += square_a[..., None]
    gap += square_b[:, :, None]
    scale = pair.distance_a[:, :, None] ** 2 + pair.distance_b[:, None, :] ** 2
    return np.maximum(gap, 0.0) / scale


def epipolar_error(pair: ViewPair, rotation: Floats, translation: Floats) -> tuple[Floats, Floats]:
    """Sampson errors of all joints of all possible matches, measured at the body, and the weight of each.

    rotation `[M, 3, 3]`, translation `[M, 3]`. Returns errors `[M, frame, I, J, keypoint]` in body sizes (unsigned) and
    weights `[frame, I, J, keypoint]`.
    """
    matrix = essential_matrix(rotation, translation / np.linalg.norm(translation, axis=-1, keepdims=True))
    from_a = np.einsum("mxy,faky->mfakx", matrix, pair.rays_a, optimize=True)
    from_b = np.einsum("myx,fbky->mfbkx", matrix, pair.rays_b, optimize=True)
    value = np.einsum("mfakx,fbkx->mfabk", from_a, pair.rays_b, optimize=True)
    slope = (from_a**2).sum(-1)[:, :, :, None] + (from_b**2).sum(-1)[:, :, None] - 2 * value**2
    weight = pair.weight_a[:, :, None] * pair.weight_b[:, None]
    return np.abs(value) / np.sqrt(np.maximum(slope, 1e-18)) * reach(pair)[None, ..., None], weight


def reach(pair: ViewPair) -> Floats:
    """`[frame, I, J]` body sizes per radian of Sampson's angle: the harmonic mean of both squared distances."""
    near = 1 / pair.distance_a[:, :, None] ** 2 + 1 / pair.distance_b[:, None, :] ** 2
    return np.sqrt(2.0 / near)


def agreement(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> Floats:
    """`[M, frame, I, J]` in 0..1 how well the lifted bodies and their places agree; 0 where there is no body."""
    pose = steering_error(pair, rotation) / pose_variance(pair, config)
    place = place_error(pair, rotation, translation) / config.place_tolerance**2
    return pair.lifted * np.exp(-0.5 * pose) / (1 + 0.5 * place)


def epipolar_fit(error: Floats, weight: Floats, config: PairwiseConfig) -> Floats:
    """`[M, frame, I, J]` in 0..1 weighted share of joints that fit the epipolar geometry; 0 below three joints in common."""
    fit = (weight / (1 + (error / config.inlier) ** 2)).sum(-1)
    return fit / np.maximum(weight.sum(-1), 1e-9) * ((weight > 0).sum(-1) >= 3)


def match_affinity(
    pair: ViewPair, rotation: Floats, translation: Floats, epipolar: Floats, config: PairwiseConfig
) -> Floats:
    """`[M, frame, I, J]` in 0..1 that two detections are one individual: geometry, tempered by the lifted bodies.

    A detection that could not be lifted has less to say than others, unless none could be: then geometry is all there is.
    """
    bodies = np.sqrt(agreement(pair, rotation, translation, config))
    return epipolar * np.where(pair.lifted > 0, bodies, 0.3 if pair.lifted.any() else 1.0)


def epipolar_affinity(
    some: Sample, rig: CameraRig, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Affinity of all pairs of detections of a frame `[frame, N, N]`, N = views x instances, by the rig alone; and 1 where it means something.

    `epipolar_fit` written out for one rig and many frames: by component, and nothing is kept by keypoint.
    """
    views, frames, instances, keypoints = some.confidence.shape
    rays = np.ascontiguousarray(np.moveaxis(np.nan_to_num(some.rays), -1, 1)).reshape(views, 3, -1)
    nowhere = np.full((frames, instances, 3), np.nan)
    near = [1 / _distance(nowhere, own) ** 2 for own in some.rays]
    affinity = np.zeros((frames, views, instances, views, instances))
    comparable = np.zeros_like(affinity)
    shape = (3, frames, instances, keypoints)
    for a, b in combinations(range(views), 2):
        rotation = rig.rotation[b] @ rig.rotation[a].T
        translation = rig.translation[b] - rotation @ rig.translation[a]
        matrix = essential_matrix(rotation, translation / np.linalg.norm(translation))
        from_a, from_b = (matrix @ rays[a]).reshape(shape), (matrix.T @ rays[b]).reshape(shape)
        value = np.einsum("cfik,cfjk->fijk", from_a, rays[b].reshape(shape)) ** 2
        slope = (from_a**2).sum(0)[:, :, None] + (from_b**2).sum(0)[:, None]
        slope -= 2 * value
        reach = 2 / (near[a][:, :, None] + near[b][:, None]) / config.inlier**2
        weight = some.confidence[a][:, :, None] * some.confidence[b][:, None]
        value *= reach[..., None]
        value += slope
        common = (weight > 0).sum(-1) >= 3
        found = (
            np.einsum("fijk,fijk->fij", weight, slope / np.maximum(value, 1e-18))
            / np.maximum(weight.sum(-1), 1e-9)
            * common
        )
        affinity[:, a, :, b], affinity[:, b, :, a] = found, np.swapaxes(found, 1, 2)
        comparable[:, a, :, b], comparable[:, b, :, a] = common, np.swapaxes(common, 1, 2)
    nodes = views * instances
    return affinity.reshape(frames, nodes, nodes), comparable.reshape(frames, nodes, nodes)
