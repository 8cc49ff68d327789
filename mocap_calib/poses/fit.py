"""Bodies over time, the fit of their poses to detections, motion and bones, and its covariance.

The energy of the points X `[keypoint, frame, 3]` of a track is the sum of the squared angles
between points and rays in standard deviations, of the squared accelerations beyond those that the
joints of a body share, and of the squared errors of bone lengths, each under Cauchy's loss (weights
1 / (1 + r^2 / c^2)). Gauss-Newton: joints are coupled over time by bands, which are factored for
each joint alone, and along bones, for which the bands precondition conjugate gradients, so the cost
grows linearly with the joints. Covariances over time are exact (Takahashi 1973), along bones to
first order: a bone adds the information about its other end without it.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels import pose_bands, pose_energy
from mocap_calib.kernels.pose_energy import FACTOR, LANES
from mocap_calib.types import Floats, Ints

AROUND = 2  # frames of padding at each end: as far as accelerations reach
ROUNDS = 5  # of reweighting: lengths of bones, and the median of accelerations
_MEDIAN_SQUARE = NormalDist().inv_cdf(0.75) ** 2  # of normal errors of variance 1


@dataclass(frozen=True, eq=False, repr=False)
class Detections:
    """Rays of one track.

    rays: `[3, view, keypoint, frame]` unit vectors in the world's axes; zero = missing.
    precision: `[view, keypoint, frame]` inverse variance of the ray's angle in each of the two
        directions across it, in 1 / radians squared; 0 = missing.
    centres: `[view, 3]` of the cameras.
    """

    rays: Floats
    precision: Floats
    centres: Floats


@dataclass(frozen=True)
class Body:
    """What is expected of the body of a track.

    edges: `[edge, 2]` keypoints whose distance is constant. lengths: `[edge]` these distances, NaN
        where they are not known. varies: `[edge]` by how much (standard deviation) they vary all
        the same. size: of the body: strengths are in it.
    steps: `[3, frame]` what the positions in a frame, the next one and the one after that are
        multiplied by for the acceleration there, zero where these frames do not follow each other.
        Times are in the usual step from one frame to the next.
    """

    edges: Ints
    lengths: Floats
    varies: Floats
    size: float
    steps: Floats


@dataclass(frozen=True)
class Strengths:
    """Scales of the terms of the energy.

    acceleration: standard deviation in body sizes per squared frame step, beyond what the joints
        share; inf = off.
    bones: standard deviation of bone lengths in body sizes, beyond their measured variation;
        inf = off.
    loss: error of a ray, in standard deviations, at which its weight is one half.
    """

    acceleration: float
    bones: float
    loss: float


def fit(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
    *,
    steps: int,
) -> Floats:
    """Return the points `[keypoint, frame, 3]` of least energy, from those to start from.

    steps: number of Gauss-Newton steps.
    """
    packed = _pack(points, seen, body, strengths, config)
    losses = (strengths.loss, config.prior_loss)
    _, _, found, edges, bones = packed.terms
    gradient, work = np.zeros_like(found), np.zeros((5, *found.shape))
    along = np.empty((len(bones), len(edges), 4 * LANES))
    rounds = config.steps // 2 if len(edges) else 0
    for _ in range(steps):
        packed.share_accelerations(config)
        pose_energy.sum_terms(*packed.terms, *losses, along, packed.factor, gradient)
        packed.factor_bands(gradient, config.prior_loss)
        pose_bands.take_step(
            along, packed.factor, edges, len(points), rounds, work, gradient, found
        )
    return _unpack(found, *points.shape[:2])


def covariances(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> Floats:
    """Return the covariance `[keypoint, frame, 6]` of each fitted point, xx xy xz yy yz zz.

    points: `[keypoint, frame, 3]` of a fit. A point without any information has the variance
    1 / ridge.
    """
    packed = _pack(points, seen, body, strengths, config)
    losses = (strengths.loss, config.prior_loss)
    packed.share_accelerations(config)
    pose_energy.sum_known(*packed.terms, packed.expected, *losses, packed.factor)
    packed.factor_bands(np.zeros_like(packed.points), config.prior_loss)
    found = np.zeros((*packed.factor.shape[:2], 6 * LANES))
    pose_bands.invert_bands(packed.factor, found)
    return _unpack(found, *points.shape[:2])


def squared_errors(points: Floats, seen: Detections) -> Floats:
    """Return squared angles `[view, keypoint, frame]` between rays and points in variances.

    points: `[keypoint, frame, 3]`.
    """
    offset = points.transpose(2, 0, 1)[:, None] - seen.centres.T[:, :, None, None]
    along = np.einsum("iv...,iv...->v...", offset, seen.rays)
    depth = np.maximum(along, 1e-3 * np.abs(offset).sum(0))
    offset -= along * seen.rays
    return np.einsum("iv...,iv...->v...", offset, offset) * seen.precision / depth**2


# What is expected of a body


def acceleration_steps(frames: Floats, longest_gap: float) -> Floats:
    """Return `Body.steps` `[3, frame]` of one stretch.

    frames: numbers, in the usual step from one to the next. Second divided differences, doubled.
    longest_gap: steps between frames that still follow each other.
    """
    steps = np.zeros((3, len(frames)))
    if len(frames) < 3:
        return steps
    gap = np.diff(frames)
    before, after = gap[:-1], gap[1:]
    follow = np.maximum(before, after) <= longest_gap
    first, last = 2 / (before * (before + after)), 2 / (after * (before + after))
    steps[:, :-2] = np.where(follow, np.stack([first, -first - last, last]), 0.0)
    return steps


def accelerations(points: Floats, body: Body) -> Floats:
    """Return the accelerations `[keypoint, frame - 2, 3]` by the first of their frames.

    0 where frames do not follow each other. points: `[keypoint, frame, 3]`.
    """
    ends = max(points.shape[1] - 2, 0)
    steps = body.steps[:, :ends, None]
    parts = (step * points[:, k : k + ends] for k, step in enumerate(steps))
    return np.asarray(sum(parts))


def bone_lengths(points: Floats, sigma: Floats, edges: Ints) -> tuple[Floats, Floats]:
    """Return the length `[edge]` of each bone and how much it varies; NaN where it was never seen.

    points: `[frame, keypoint, 3]` triangulated; sigma: `[frame, keypoint]` of these, of all axes
    together. Noise across a bone makes it longer: that is taken off. A bone's length varies beyond
    its noise (standard deviation): detectors see joints elsewhere as a body turns, and spines bend.
    Half of the values are within the median of a normal error; each counts by its whole variance,
    robustly.
    """
    a, b = edges.T
    length = np.linalg.norm(points[:, a] - points[:, b], axis=-1)
    noise = (sigma[:, a] ** 2 + sigma[:, b] ** 2) / 3
    known = np.isfinite(length) & np.isfinite(noise) & (length > 0)
    seen = np.flatnonzero(known.any(0))
    known, length, noise = (each[:, seen].T for each in (known, length, noise))
    length, noise = (np.where(known, each, np.nan) for each in (length, noise))
    length -= np.minimum(noise / length, length / 2)
    usual = np.nanmedian(noise, axis=1)[:, None]
    middle = np.nanmedian(np.where(noise <= usual, length, np.nan), axis=1)
    varies = np.zeros(len(seen))
    for _ in range(ROUNDS):
        square = (length - middle[:, None]) ** 2
        varies = np.maximum(np.nanmedian(square / _MEDIAN_SQUARE - noise, axis=1), 0.0)
        weight = np.where(known, 1 / (noise + varies[:, None] + square / 4), 0.0)
        middle = (weight * np.where(known, length, 0.0)).sum(1) / weight.sum(1)
    found = np.full((2, len(edges)), np.nan)
    found[:, seen] = middle, np.sqrt(varies)
    return found[0], found[1]


def with_second_neighbours(bones: Ints, keypoints: int) -> Ints:
    """Return bones `[bone, 2]` and then the pairs that two bones join, all of them `[edge, 2]`.

    Hips, shoulders and heads barely change shape: the ends of two bones of theirs are as far
    from each other as those of one. Those of a leg are not; how much they vary is measured.
    """
    joined = np.zeros((keypoints, keypoints), dtype=np.int64)
    a, b = bones.T
    joined[a, b] = joined[b, a] = 1
    second = np.triu((joined @ joined > 0) & (joined == 0), k=1)
    return np.concatenate([bones, np.argwhere(second)])


def fill_gaps(points: Floats, times: Floats) -> Floats:
    """Return points `[frame, keypoint, 3]` without gaps.

    The joint that is known most often is interpolated in time, and the others by their offsets from
    it. times: `[frame]`.
    """
    known = np.isfinite(points[..., 0])
    middle = int(known.sum(0).argmax())
    filled = np.zeros(points.shape)
    for joint in (middle, *range(points.shape[1])):
        there, base = known[:, joint], filled[:, middle]
        between = np.zeros(base.shape)
        if there.any():
            offset = points[there, joint] - base[there]
            between = np.transpose([np.interp(times, times[there], axis) for axis in offset.T])
        filled[:, joint] = base + between
    return filled


# The layout of the kernels: tiles of `LANES` frames, and groups of `LANES` joints side by side


@dataclass(frozen=True)
class _Packed:
    """A track as the kernels take it. Points, expected and factor are overwritten.

    terms: rays, centres of the cameras, points, edges and bones, as of `pose_energy.sum_terms`.
    expected: `[frame, 5]` inverse variance of accelerations, the ridge, and the acceleration that
        joints share.
    """

    joints: int
    terms: tuple[Floats, Floats, Floats, Ints, Floats]
    steps: Floats
    expected: Floats
    factor: Floats

    @property
    def points(self) -> Floats:
        """The points of the track."""
        return self.terms[2]

    def share_accelerations(self, config: PosesConfig) -> None:
        """Set the acceleration that the joints share at the points.

        Of accelerations of variance s^2 around a common one of variance v, N joints are expected
        to share N v / (s^2 + N v) of their middle.
        """
        if self.expected[:, 0].any():
            known = self.joints * config.shared_acceleration
            part = known / (1 + known)
            pose_energy.share_accelerations(
                self.points, self.steps, self.joints, ROUNDS, part, self.expected
            )

    def factor_bands(self, gradient: Floats, prior_loss: float) -> None:
        """Add accelerations to the blocks and the gradient, and factor the bands."""
        pose_bands.factor_bands(
            self.points, self.steps, self.expected, prior_loss, self.factor, gradient
        )


def _pack(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> _Packed:
    """Return a track packed, from the points `[keypoint, frame, 3]`."""
    found = _in_lanes(points)
    usual = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    expected = np.zeros((5, len(usual)))
    expected[0], expected[1] = usual, config.ridge / body.size**2
    rays = _in_tiles(np.stack([*seen.rays, seen.precision], axis=2))
    rays = rays.reshape(*rays.shape[:3], 4 * LANES)  # 0 beyond the frames
    bones = _pack_bones(body, strengths, len(usual))
    return _Packed(
        joints=len(points),
        terms=(rays, np.ascontiguousarray(seen.centres), found, *bones),
        steps=np.ascontiguousarray(_padded(body.steps).T),
        expected=np.ascontiguousarray(_padded(expected).T),
        factor=np.zeros((len(found), found.shape[1], FACTOR)),
    )


def _pack_bones(body: Body, strengths: Strengths, frames: int) -> tuple[Ints, Floats]:
    """Return the edges in use `[edge, 2]`, and of these `[tile, edge, 3 * LANES]`.

    The lengths, their inverse standard deviations, and the shortest length to divide by.
    """
    edges = body.edges if np.isfinite(strengths.bones) else body.edges[:0]
    lengths, varies = body.lengths[: len(edges)], body.varies[: len(edges)]
    known = np.isfinite(lengths)
    sigma = np.hypot(strengths.bones * body.size, np.where(known, varies, 0.0))
    rows = np.stack([np.where(known, lengths, 0.0), known / sigma], axis=1)
    found = _in_tiles(np.repeat(rows[..., None], frames, axis=2))
    # beyond the frames too: joints may coincide there
    shortest = np.full_like(found[:, :, :1], 1e-9 * body.size)
    found = np.concatenate([found, shortest], axis=2)
    return np.ascontiguousarray(edges), found.reshape(len(found), len(edges), 3 * LANES)


def _in_lanes(values: Floats) -> Floats:
    """Return values `[keypoint, frame, N]` as `[group, frame, N * LANES]`, see `_padded`."""
    joints, _, numbers = values.shape
    padded = np.pad(_padded(values.swapaxes(1, 2)), ((0, -joints % LANES), (0, 0), (0, 0)))
    rows = padded.reshape(-1, LANES, *padded.shape[1:]).transpose(0, 3, 2, 1)
    return np.ascontiguousarray(rows).reshape(*rows.shape[:2], numbers * LANES)


def _unpack(rows: Floats, joints: int, frames: int) -> Floats:
    """Return values `[keypoint, frame, N]` of rows `[group, frame, N * LANES]`."""
    numbers = rows.shape[2] // LANES
    by_lane = rows[:, AROUND : AROUND + frames].reshape(len(rows), frames, numbers, LANES)
    own = by_lane.transpose(0, 3, 1, 2).reshape(-1, frames, numbers)
    return np.ascontiguousarray(own[:joints])


def _padded(values: Floats) -> Floats:
    """Return values `[..., frame]` padded by their first and last frames.

    To whole tiles, and by two frames at each end.
    """
    after = -values.shape[-1] % LANES + AROUND
    return np.pad(values, [*[(0, 0)] * (values.ndim - 1), (AROUND, after)], mode="edge")


def _in_tiles(values: Floats) -> Floats:
    """Return tiles `[tile, ..., LANES]` of values `[..., frame]`, 0 beyond the frames."""
    *others, frames = values.shape
    tiles = -(-frames // LANES)
    padded = np.pad(values, [*[(0, 0)] * len(others), (0, tiles * LANES - frames)])
    return np.ascontiguousarray(np.moveaxis(padded.reshape(*others, tiles, LANES), -2, 0))
