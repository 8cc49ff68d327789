"""What two views show in the frames they share: the detections of each, and their overlap.

Lengths are in body sizes (RMS distance of the joints from their centroid).
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import LEAST_LIFT_SPREAD, PairwiseConfig
from mocap_calib.geometry.epipolar import depths
from mocap_calib.kernels import sizes
from mocap_calib.pairs.reversal import readings, reversal_in_spreads
from mocap_calib.types import Bools, Floats, Ints, LiftedPoses, Sample

RAYS_OF_A_BLOCK = 64  # loops of a fixed length over arrays in the cache are quick


@dataclass(frozen=True, eq=False, repr=False)
class Detections:
    """The detections of one view in some frames; what is missing is 0.

    rays: `[frame, instance, keypoint, 3]` unit vectors in the frame of the camera.
    weight: `[frame, instance, keypoint]` confidence in 0..1, 0 = missing.
    centre: `[frame, instance, 3]` centroid of the lifted body in the frame of the camera.
    distance: `[frame, instance]` of the body from the camera, by its lifted centre or its size.
    """

    rays: Floats
    weight: Floats
    centre: Floats
    distance: Floats

    @property
    def present(self) -> Bools:
        """`[frame, instance]` where there is a detection."""
        return np.asarray((self.weight > 0).any(-1))

    @property
    def rays_or_nan(self) -> Floats:
        """`[frame, instance, keypoint, 3]` the rays, NaN = missing."""
        return np.where(self.weight[..., None] > 0, self.rays, np.nan)


@dataclass(frozen=True)
class Overlap:
    """How the lifted bodies X_a of one view compare with the X_b of another, I x J in each frame.

    w are the weights of the joints that both have, their sum is 1; s are their standard
    deviations as the network gives them.

    cross: `[reading, frame, I, J, 3, 3]` sum w X_a X_b'. One reading, as the bodies were lifted;
        or four, where they may as well be reversed (see `reversal`).
    norm: `[frame, I, J]` sum w (|X_a|^2 + |X_b|^2).
    doubt: `[frame, I, J]` sum w (s_a^2 + s_b^2), the squared distance to be expected between two
        lifts of one body.
    lifted: `[frame, I, J]` 1 where both are lifted, else 0.
    """

    cross: Floats
    norm: Floats
    doubt: Floats
    lifted: Floats


@dataclass(frozen=True)
class ViewPair:
    """The detections of the views a and b (I and J instances) in some frames.

    frames: `[frame]` index into the sample that they were taken from.
    reversal: how far bodies the other way round in depth differ from those that were lifted, in
        spreads that the network states. Below 1 the overlap is of all readings.
    """

    frames: Ints
    a: Detections
    b: Detections
    overlap: Overlap
    reversal: float


@dataclass(frozen=True)
class MatchedRays:
    """The joints that both detections of a match show, of all matches: N correspondences.

    Batches of equal size have more axes in front.

    a and b: `[N, 3]` unit rays of the two views.
    weight: `[N]` product of the confidences.
    body_sizes_per_radian: `[N]` of an epipolar error, see the function of this name.
    """

    a: Floats
    b: Floats
    weight: Floats
    body_sizes_per_radian: Floats

    def __len__(self) -> int:
        return len(self.a)

    def in_blocks(self) -> Floats:
        """Return `[..., block, 8, RAYS_OF_A_BLOCK]` all of it by component, as kernels take it.

        Rays of no weight fill up the last block.
        """
        columns = (self.weight[..., None], self.body_sizes_per_radian[..., None])
        *batch, count, _ = self.a.shape
        blocks = -(-count // RAYS_OF_A_BLOCK)
        filled = np.zeros((*batch, blocks * RAYS_OF_A_BLOCK, 8))
        np.concatenate([self.a, self.b, *columns], axis=-1, out=filled[..., :count, :])
        by_block = filled.reshape(*batch, blocks, RAYS_OF_A_BLOCK, 8)
        return np.ascontiguousarray(np.swapaxes(by_block, -1, -2))

    def __getitem__(self, index: Ints) -> "MatchedRays":
        return MatchedRays(
            self.a[index], self.b[index], self.weight[index], self.body_sizes_per_radian[index]
        )


@dataclass(frozen=True)
class _Bodies:
    """The lifted bodies of one view with zeros for nobody.

    joints: `[frame, instance, joint, 3]`; precision and variance: `[frame, instance, joint]`.
    """

    joints: Floats
    precision: Floats
    variance: Floats


def shared_frames(sample: Sample, a: int, b: int, config: PairwiseConfig) -> Ints:
    """Return the indices `[frame]` of the frames in which both views show enough of a body."""
    seen = np.isfinite(sample.positions[..., 0][[a, b]])
    joints = seen.sum(-1)
    return np.flatnonzero((joints >= config.least_joints).any(-1).all(0))


def gather_view_pair(
    sample: Sample, lifted: LiftedPoses, views: tuple[int, int], frames: Ints
) -> ViewPair:
    """Gather what the views a and b show in some frames (`[frame]` indices into the sample)."""
    a, b = (gather_detections(sample, lifted, view, frames) for view in views)
    overlap = _overlap(*(_bodies(lifted, view, frames) for view in views))
    reversal = reversal_in_spreads(sample, lifted, views, frames)
    pair = ViewPair(frames=frames, a=a, b=b, overlap=overlap, reversal=reversal)
    return in_all_readings(pair) if reversal < 1 else pair


def in_all_readings(pair: ViewPair) -> ViewPair:
    """Return a pair of one reading with all four: see `reversal.readings`."""
    cross = readings(pair.overlap.cross[0], pair.a.centre, pair.b.centre)
    return replace(pair, overlap=replace(pair.overlap, cross=cross))


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
    """Return how far bodies are: as they were lifted, or by their angular size where they were not.

    centre: `[..., 3]` in body sizes, NaN = not lifted; rays: `[..., keypoint, 3]` unit vectors,
    NaN = missing. Returns `[...]` body sizes.
    """
    found = np.asarray(np.linalg.norm(centre, axis=-1))
    unknown = ~np.isfinite(found)
    found[unknown] = distances_by_size(rays[unknown])
    return found


def distances_by_size(rays: Floats) -> Floats:
    """Return how far bodies are that look as large as these.

    A body of size 1 has an RMS distance of sqrt(2/3) from its centroid across the line of sight,
    since two of three dimensions are seen. rays: `[..., keypoint, 3]` unit vectors, NaN = missing.
    Returns `[...]` body sizes.
    """
    distance = np.empty(rays.shape[:-2])
    bodies = np.ascontiguousarray(rays).reshape(-1, *rays.shape[-2:])
    sizes.distances_by_size(bodies, distance.reshape(-1))
    return distance


def _bodies(lifted: LiftedPoses, view: int, frames: Ints) -> _Bodies:
    """Gather the lifted bodies of one view."""
    spread = lifted.spread[view, frames]
    precision = 1.0 / (spread**2 + LEAST_LIFT_SPREAD**2)
    return _Bodies(
        joints=np.nan_to_num(lifted.body[view, frames]),
        precision=np.nan_to_num(precision),
        variance=np.nan_to_num(spread) ** 2,
    )


def _overlap(a: _Bodies, b: _Bodies) -> Overlap:
    """Compare all lifted bodies of one view with all of the other, frame by frame."""
    total = _sum_over_joints(a.precision, b.precision)
    divisor = np.where(total > 0, total, 1.0)
    # in C order, which pickling keeps: the last digit of sums over it depends on the memory order
    cross = np.einsum(
        "fikx,fjky->fijxy",
        a.joints * a.precision[..., None],
        b.joints * b.precision[..., None],
        optimize=True,
        order="C",
    )
    square_a = (a.joints**2).sum(-1) * a.precision
    square_b = (b.joints**2).sum(-1) * b.precision
    norm = _sum_over_joints(square_a, b.precision) + _sum_over_joints(a.precision, square_b)
    doubt_a = _sum_over_joints(a.variance * a.precision, b.precision)
    doubt_b = _sum_over_joints(a.precision, b.variance * b.precision)
    return Overlap(
        cross=(cross / divisor[..., None, None])[None],
        norm=norm / divisor,
        doubt=(doubt_a + doubt_b) / divisor,
        lifted=(total > 0).astype(np.float64),
    )


def _sum_over_joints(of_a: Floats, of_b: Floats) -> Floats:
    """Return the sums of products over the joints, `[frame, I, joint]` and `[frame, J, joint]`."""
    return np.einsum("fik,fjk->fij", of_a, of_b)


def body_sizes_per_radian(pair: ViewPair) -> Floats:
    """Return the body sizes per radian of Sampson's angle, `[frame, I, J]`.

    The harmonic mean of both squared distances, under the root.
    """
    inverse_a = 1 / pair.a.distance[:, :, None] ** 2
    inverse_b = 1 / pair.b.distance[:, None, :] ** 2
    return np.sqrt(2.0 / (inverse_a + inverse_b))


def matched_rays(pair: ViewPair, matched: Bools) -> MatchedRays:
    """Return the rays of all joints of the matches `[frame, I, J]`."""
    frame, i, j = np.nonzero(matched)
    weight = pair.a.weight[frame, i] * pair.b.weight[frame, j]
    seen = weight > 0
    body_sizes_of_joints = np.broadcast_to(
        body_sizes_per_radian(pair)[frame, i, j][:, None], seen.shape
    )
    return MatchedRays(
        a=pair.a.rays[frame, i][seen],
        b=pair.b.rays[frame, j][seen],
        weight=weight[seen],
        body_sizes_per_radian=body_sizes_of_joints[seen],
    )


def distance_ratios(
    a: Detections, b: Detections, rotation: Floats, translation: Floats, matched: Bools
) -> Floats:
    """Return how far bodies were lifted over how far matches are triangulated, joint by joint.

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
