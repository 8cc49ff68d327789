"""Detections of two views in the frames they share, and how their lifted bodies compare.

Lengths are in body sizes (RMS distance of the joints from their centroid).
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import LEAST_LIFT_SPREAD, PairwiseConfig
from mocap_calib.geometry.epipolar import depths
from mocap_calib.kernels.lens import LANES
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import LiftedPoses
from mocap_calib.types import Bools, Floats, Ints, Sample


@dataclass(frozen=True, eq=False, repr=False)
class Detections:
    """Detections of one view in some frames; missing entries are 0.

    rays: `[frame, instance, keypoint, 3]` unit rays in the frame of the camera.
    weight: `[frame, instance, keypoint]` confidence in 0..1, 0 = missing.
    centre: `[frame, instance, 3]` centroid of the lifted body in the frame of the camera.
    distance: `[frame, instance]` from the camera, by the lifted centre or the apparent size.
    """

    rays: Floats
    weight: Floats
    centre: Floats
    distance: Floats

    @property
    def present(self) -> Bools:
        """`[frame, instance]` whether there is a detection."""
        return np.asarray((self.weight > 0).any(-1))

    @property
    def rays_or_nan(self) -> Floats:
        """`[frame, instance, keypoint, 3]` rays, NaN = missing."""
        return np.where(self.weight[..., None] > 0, self.rays, np.nan)


@dataclass(frozen=True)
class ViewPair:
    """All that is needed to calibrate two views, and no more.

    It may be pickled and travel to another machine. Lifted bodies X_a of one view are compared with
    all X_b of the other (I x J a frame): sums run over the joints that both bodies have, with
    weights w of sum 1. s are the standard deviations that the network predicts.

    views: their indices. frames: `[frame]` indices into the sample of the frames looked at.
    a, b: their detections (I and J instances).
    cross: `[reading, frame, I, J, 3, 3]` sum w X_a X_b'. One reading, or four for flat bodies,
        whose front and back cannot be told apart (see `with_reversals`).
    norm: `[frame, I, J]` sum w (|X_a|^2 + |X_b|^2).
    doubt: `[frame, I, J]` sum w (s_a^2 + s_b^2), the expected squared distance between two lifts
        of one body.
    lifted: `[frame, I, J]` 1 if both are lifted, else 0.
    shared_frames: how many frames the two views share.
    tracked: in both views the instance index names the same individual in all frames.
    rng: of this pair alone, so that the order in which pairs are calibrated does not matter. It
        is consumed.
    """

    views: tuple[int, int]
    frames: Ints
    a: Detections
    b: Detections
    cross: Floats
    norm: Floats
    doubt: Floats
    lifted: Floats
    shared_frames: int
    tracked: bool
    rng: np.random.Generator


def gather_view_pair(
    sample: Sample,
    lifted: LiftedPoses,
    views: tuple[int, int],
    *,
    config: PairwiseConfig,
    rng: np.random.Generator,
) -> ViewPair:
    """Gather what two views show in an even choice of the frames they share.

    These are the frames in which both show enough of a body.
    """
    joints = np.isfinite(sample.positions[..., 0][list(views)]).sum(-1)
    shared = np.flatnonzero((joints >= config.least_joints).any(-1).all(0))
    affordable = max(config.least_frames, config.possible_matches // joints.shape[2] ** 2)
    frames = evenly_spaced(shared, min(config.frames, affordable))
    a, b = (gather_detections(sample, lifted, view, frames) for view in views)
    cross, norm, doubt, both = _compare_bodies(*(_bodies(lifted, view, frames) for view in views))
    flat = are_flat(sample, lifted, views, frames)
    return ViewPair(
        views=views,
        frames=frames,
        a=a,
        b=b,
        cross=with_reversals(cross, a.centre, b.centre) if flat else cross[None],
        norm=norm,
        doubt=doubt,
        lifted=both,
        shared_frames=len(shared),
        tracked=bool(sample.tracked[list(views)].all()),
        rng=rng,
    )


def gather_detections(sample: Sample, lifted: LiftedPoses, view: int, frames: Ints) -> Detections:
    """Gather the detections of one view in some frames (`[frame]` indices into the sample)."""
    rays, centre = sample.rays[view, frames], lifted.centre[view, frames]
    return Detections(
        rays=np.nan_to_num(rays),
        weight=sample.confidence[view, frames],
        centre=np.nan_to_num(centre),
        distance=distances(centre, rays),
    )


def distances(centre: Floats, rays: Floats) -> Floats:
    """Return the distances of bodies from the camera: of the lifted centre, or by apparent size.

    centre: `[..., 3]` in body sizes, NaN = not lifted; rays: `[..., keypoint, 3]` unit rays,
    NaN = missing. Returns `[...]` body sizes.
    """
    found = np.asarray(np.linalg.norm(centre, axis=-1))
    unknown = ~np.isfinite(found)
    found[unknown] = distances_by_size(rays[unknown])
    return found


def distances_by_size(rays: Floats) -> Floats:
    """Return the distances of bodies from the camera by their apparent size.

    A body of size 1 has an RMS distance of sqrt(2/3) from its centroid across the line of sight,
    since two of three dimensions are seen. rays: `[..., keypoint, 3]` unit rays, NaN = missing.
    Returns `[...]` body sizes.
    """
    count = np.isfinite(rays[..., :1]).sum(-2)
    mean = np.nansum(rays, axis=-2) / np.maximum(count, 1)
    square = np.where(count[..., 0] > 0, 1 - (mean**2).sum(-1), 0.0)
    return np.sqrt(2 / 3 / np.maximum(square, 1e-8))


def _bodies(lifted: LiftedPoses, view: int, frames: Ints) -> tuple[Floats, Floats, Floats]:
    """Return the lifted bodies of one view, 0 = not lifted.

    joints `[frame, instance, joint, 3]`, precision and variance `[frame, instance, joint]`.
    """
    variance = lifted.spread[view, frames] ** 2
    precision = 1.0 / (variance + LEAST_LIFT_SPREAD**2)
    joints = lifted.body[view, frames]
    return np.nan_to_num(joints), np.nan_to_num(precision), np.nan_to_num(variance)


def _compare_bodies(
    a: tuple[Floats, ...], b: tuple[Floats, ...]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Compare the lifted bodies of one view with those of the other; a, b: of `_bodies`.

    Returns cross `[frame, I, J, 3, 3]`, norm, doubt and lifted, see `ViewPair`.
    """
    (joints_a, precision_a, variance_a), (joints_b, precision_b, variance_b) = a, b
    total = _sum_over_joints(precision_a, precision_b)
    divisor = np.where(total > 0, total, 1.0)
    # in C order, which pickling keeps: the last digit of sums over it depends on the memory order
    cross = np.einsum(
        "fikx,fjky->fijxy",
        joints_a * precision_a[..., None],
        joints_b * precision_b[..., None],
        optimize=True,
        order="C",
    )
    square_a, square_b = (joints_a**2).sum(-1), (joints_b**2).sum(-1)

    def mean_sum(of_a: Floats, of_b: Floats) -> Floats:
        """Return the weighted means `[frame, I, J]` of sums of one value of each body."""
        sum_a = _sum_over_joints(of_a * precision_a, precision_b)
        return (sum_a + _sum_over_joints(precision_a, of_b * precision_b)) / divisor

    cross /= divisor[..., None, None]
    norm, doubt = mean_sum(square_a, square_b), mean_sum(variance_a, variance_b)
    return cross, norm, doubt, (total > 0).astype(np.float64)


def _sum_over_joints(of_a: Floats, of_b: Floats) -> Floats:
    """Return sums of products over the joints, of `[frame, I, joint]` and `[frame, J, joint]`."""
    return np.einsum("fik,fjk->fij", of_a, of_b)


def are_flat(sample: Sample, lifted: LiftedPoses, views: tuple[int, ...], frames: Ints) -> bool:
    """Return whether bodies are too thin for the network to determine their front and back.

    A reversal in depth (Necker's) moves the joints of a body by twice its thickness, after the
    best rotation. That is compared with the variance that the network predicts for the joints that
    are seen, by medians over bodies. frames: `[frame]` indices into the sample.
    """
    few = evenly_spaced(frames, PairwiseConfig.least_frames)
    known = sample.vocabulary >= 0
    moved = expected = 0.0
    for view in views:
        seen = sample.confidence[view, few][..., known] > 0
        of_joints = (part[:, :, sample.vocabulary[known]] for part in _bodies(lifted, view, few))
        joints, precision, variance = of_joints
        weight = seen * precision
        some = weight.any(-1)
        if not some.any():
            return False
        body, weight = joints[some], weight[some] / weight[some].sum(-1, keepdims=True)
        body = body - np.einsum("nk,nkx->nx", weight, body)[:, None]
        scatter = np.swapaxes(body, 1, 2) @ (body * weight[..., None])
        moved += float(np.median(4 * np.linalg.eigvalsh(scatter)[:, 0]))
        expected += float(np.median((weight * variance[some]).sum(-1)))
    return moved < 2 * expected


def with_reversals(cross: Floats, centre_a: Floats, centre_b: Floats) -> Floats:
    """Return cross-covariances with no body, that of a, that of b, and both reversed in depth.

    cross: `[frame, I, J, 3, 3]` sum w X_a X_b'; centre_a: `[frame, I, 3]`; centre_b:
    `[frame, J, 3]`. Returns `[4, frame, I, J, 3, 3]`.
    """
    mirror_a, mirror_b = _mirror(centre_a)[:, :, None], _mirror(centre_b)[:, None]
    return np.stack([cross, mirror_a @ cross, cross @ mirror_b, mirror_a @ cross @ mirror_b])


def _mirror(centre: Floats) -> Floats:
    """Return the reflections `[..., 3, 3]` along the lines of sight to centres `[..., 3]`."""
    sight = centre / np.maximum(np.linalg.norm(centre, axis=-1, keepdims=True), 1e-12)
    return np.asarray(np.eye(3) - 2 * sight[..., :, None] * sight[..., None, :])


def body_sizes_per_radian(pair: ViewPair) -> Floats:
    """Return the body sizes per radian of Sampson's angle, `[frame, I, J]`.

    The root of the harmonic mean of both squared distances.
    """
    inverse_a = 1 / pair.a.distance[:, :, None] ** 2
    inverse_b = 1 / pair.b.distance[:, None, :] ** 2
    return np.sqrt(2.0 / (inverse_a + inverse_b))


def matched_rays(pair: ViewPair, matched: Bools) -> Floats:
    """Return the rays `[N, 8]` of the joints that both detections of a match have, of all matches.

    Unit rays of both views, the product of the confidences, and `body_sizes_per_radian`.
    matched: `[frame, I, J]`.
    """
    frame, i, j = np.nonzero(matched)
    weight = pair.a.weight[frame, i] * pair.b.weight[frame, j]
    seen = weight > 0
    body_sizes = np.broadcast_to(body_sizes_per_radian(pair)[frame, i, j][:, None], seen.shape)
    rays_a, rays_b = pair.a.rays[frame, i][seen], pair.b.rays[frame, j][seen]
    return np.column_stack([rays_a, rays_b, weight[seen], body_sizes[seen]])


def in_blocks(rays: Floats, size: int) -> Floats:
    """Return rays `[N, 8]` as `[block, 8, LANES]`, padded with rays of weight 0 to `size` rays."""
    filled = np.zeros((-(-size // LANES) * LANES, 8))
    filled[: len(rays)] = rays
    return np.ascontiguousarray(np.swapaxes(filled.reshape(-1, LANES, 8), 1, 2))


def distance_ratios(
    a: Detections, b: Detections, rotation: Floats, translation: Floats, matched: Bools
) -> Floats:
    """Return the ratio of lifted to triangulated distance of the joints of matches.

    a, b: of two views. rotation: `[3, 3]` and translation: `[3]` of b_from_a, in any unit;
    matched: `[frame, I, J]`.
    Returns `[N]` body sizes per unit, of the joints in front of both cameras.
    """
    frame, i, j = np.nonzero(matched)
    seen = (a.weight[frame, i] > 0) & (b.weight[frame, j] > 0)
    rays_a = a.rays[frame, i][seen]
    rays_b = b.rays[frame, j][seen]
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    body_distance = a.distance[frame, i] + b.distance[frame, j]
    lifted = np.broadcast_to(body_distance[:, None], seen.shape)[seen]
    in_front = (depth_a > 0) & (depth_b > 0)
    return lifted[in_front] / (depth_a + depth_b)[in_front]
