"""Fit poses to detections, motion and bone lengths; covariance of the fitted points.

The energy of the points X `[keypoint, frame, 3]` of a track is the sum of the squared angles
between points and rays in standard deviations, of the squared accelerations beyond those that the
joints of a body share, and of the squared errors of bone lengths, each under Cauchy's loss (weights
1 / (1 + r^2 / c^2)). Gauss-Newton: joints are coupled over time by bands, which are factored for
each joint alone, and along bones, for which the bands precondition conjugate gradients, so the cost
grows linearly with the joints. Covariances over time are exact (Takahashi 1973), along bones to
first order: a bone adds the information about its other end without it.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels import pose_bands, pose_energy, pose_step
from mocap_calib.kernels.pose_energy import LANES
from mocap_calib.poses.track import ROUNDS, Body, Detections
from mocap_calib.types import Floats, Ints

AROUND = 2  # frames of padding at each end: as far as accelerations reach


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
    found = packed.points
    gradient, work = np.zeros_like(found), np.zeros((5, *found.shape))
    rounds = config.steps if len(packed.edges) else 0
    for _ in range(steps):
        packed.share_accelerations(config)
        pose_energy.sum_terms(
            packed.rays,
            packed.centres,
            found,
            packed.edges,
            packed.bones,
            strengths.loss,
            config.prior_loss,
            packed.along,
            packed.factor,
            gradient,
        )
        packed.factor_bands(gradient, config.prior_loss)
        pose_step.take_step(
            packed.along,
            packed.factor,
            packed.edges,
            packed.joints,
            rounds,
            work,
            gradient,
            found,
        )
    return _unpack(found, packed.joints, points.shape[1])


def covariances(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> Floats:
    """Return the covariance `[keypoint, frame, 6]` of each fitted point, xx xy xz yy yz zz.

    points: `[keypoint, frame, 3]` of a fit. A point without any information has the variance
    1 / ridge.
    """
    packed = _pack(points, seen, body, strengths, config)
    packed.share_accelerations(config)
    pose_energy.sum_known(
        packed.rays,
        packed.centres,
        packed.points,
        packed.edges,
        packed.bones,
        packed.expected,
        strengths.loss,
        config.prior_loss,
        packed.factor,
    )
    packed.factor_bands(np.zeros_like(packed.points), config.prior_loss)
    found = np.zeros((*packed.factor.shape[:2], 6 * LANES))
    pose_step.invert_bands(packed.factor, found)
    return _unpack(found, packed.joints, points.shape[1])


def squared_errors(points: Floats, seen: Detections) -> Floats:
    """Return squared angles `[view, keypoint, frame]` between rays and points in variances.

    points: `[keypoint, frame, 3]`.
    """
    offset = points.transpose(2, 0, 1)[:, None] - seen.centres.T[:, :, None, None]
    along = np.einsum("iv...,iv...->v...", offset, seen.rays)
    depth = np.maximum(along, 1e-3 * np.abs(offset).sum(0))
    offset -= along * seen.rays
    return np.einsum("iv...,iv...->v...", offset, offset) * seen.precision / depth**2


# The layout of the kernels: tiles of `LANES` frames, and groups of `LANES` joints side by side


@dataclass(frozen=True)
class _Packed:
    """A track as the kernels take it. Points, expected, along and factor are overwritten.

    expected: `[frame, 5]` inverse variance of accelerations, the ridge, and the acceleration that
        joints share.
    """

    joints: int
    rays: Floats
    centres: Floats
    points: Floats
    steps: Floats
    expected: Floats
    edges: Ints
    bones: Floats
    along: Floats
    factor: Floats

    def share_accelerations(self, config: PosesConfig) -> None:
        """Set the acceleration that the joints share at the points.

        Of accelerations of variance s^2 around a common one of variance v, N joints are expected
        to share N v / (s^2 + N v) of their middle.
        """
        if self.expected[:, 0].any():
            known = self.joints * config.shared_acceleration
            part = known / (1 + known)
            pose_bands.share_accelerations(
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
    edges, bones = _pack_bones(body, strengths, len(usual))
    return _Packed(
        joints=len(points),
        rays=_pack_rays(seen),
        centres=np.ascontiguousarray(seen.centres),
        points=found,
        steps=np.ascontiguousarray(_padded(body.steps).T),
        expected=np.ascontiguousarray(_padded(expected).T),
        edges=edges,
        bones=bones,
        along=np.empty((len(bones), len(edges), 4 * LANES)),
        factor=np.zeros((len(found), found.shape[1], 16 * LANES)),
    )


def _pack_rays(seen: Detections) -> Floats:
    """Return rays and precisions `[tile, view, keypoint, 4 * LANES]`, 0 beyond the frames."""
    found = _in_tiles(np.stack([*seen.rays, seen.precision], axis=2))
    return found.reshape(*found.shape[:3], 4 * LANES)


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
