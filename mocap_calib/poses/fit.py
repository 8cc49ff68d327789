"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`, compiled where numba is."""

from dataclasses import replace

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import (
    SHARED_LEAST,
    SHARED_ROUNDS,
    Strengths,
    linearise,
    shared_part,
    solve,
)
from mocap_calib.poses.lanes import (
    AROUND,
    BandKernels,
    band_kernels,
    from_lanes,
    in_lanes,
    in_tiles,
)
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints


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

    The loss of rays starts wide and narrows: what to start from may rest on a wrong detection.
    """
    losses = [strengths.loss * max(config.first_loss / 2**step, 1.0) for step in range(steps)]
    kernels = band_kernels()
    if kernels:
        return _fit_compiled(points, seen, body, strengths, config, losses=losses, kernels=kernels)
    return _fit(points, seen, body, strengths, config, losses=losses)


def _fit(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
    *,
    losses: list[float],
) -> Floats:
    """Return the points after a step for each of these losses of rays."""
    ridge = config.ridge / body.size**2
    for loss in losses:
        system = linearise(points, seen, body, replace(strengths, loss=loss), config)
        points = points - solve(system, body, ridge, config)
    return points


def _fit_compiled(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
    *,
    losses: list[float],
    kernels: BandKernels,
) -> Floats:
    """Return what `_fit` returns."""
    joints, frames = points.shape[:2]
    lanes = kernels.energy.LANES
    tiles = -(-frames // lanes)
    packed = _pack_rays(seen, lanes)
    found = in_lanes(points, lanes)
    usual = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    there, stiffness = np.zeros((len(found), lanes)), np.ones((len(found), lanes))
    there.reshape(-1)[:joints], stiffness.reshape(-1)[:joints] = 1.0, body.agility**-2
    part = shared_part(joints, config)
    expected = np.zeros((5, frames))
    expected[0], expected[1] = usual, config.ridge / body.size**2
    expected = np.ascontiguousarray(in_tiles(expected, lanes).T)
    motion = np.ascontiguousarray(in_tiles(body.steps, lanes).T)
    edges, bones = _bones(body, strengths, lanes)
    along = np.empty((tiles, len(edges), 4 * lanes))
    factor = np.zeros((len(found), found.shape[1], 16 * lanes))
    centres = np.ascontiguousarray(seen.centres)
    gradient, work = np.zeros_like(found), np.zeros((5, *found.shape))
    for loss in losses:
        if usual.any():
            kernels.motion.share_accelerations(
                found, motion, there, SHARED_ROUNDS, SHARED_LEAST, part, expected
            )
        kernels.energy.factor_bands(
            packed,
            centres,
            found,
            motion,
            expected,
            stiffness,
            edges,
            bones,
            loss,
            config.prior_loss,
            along,
            factor,
            gradient,
        )
        kernels.step.take_step(
            along, factor, edges, joints, config.inner_steps, work, gradient, found
        )
    return from_lanes(found, lanes, joints, frames)


def _pack_rays(seen: Detections, lanes: int) -> Floats:
    """Return rays and precisions `[tile, view, keypoint, 4 * lanes]`."""
    rows = in_tiles(np.concatenate([seen.rays, seen.precision[None]]), lanes)
    rows = rows[..., AROUND:-AROUND]
    _, views, joints, frames = rows.shape
    rows[3, ..., seen.rays.shape[-1] :] = 0
    rows = rows.reshape(4, views, joints, frames // lanes, lanes).transpose(3, 1, 2, 0, 4)
    return np.ascontiguousarray(rows).reshape(frames // lanes, views, joints, 4 * lanes)


def _bones(body: Body, strengths: Strengths, lanes: int) -> tuple[Ints, Floats]:
    """Return the edges that tell `[edge, 2]`, and of these `[tile, edge, 3 * lanes]`.

    The lengths, their inverse standard deviations, and the shortest length to divide by.
    """
    edges = body.edges if np.isfinite(strengths.bones) else body.edges[:0]
    lengths, varies = body.lengths[: len(edges)], body.varies[: len(edges)]
    known = np.isfinite(lengths)
    sigma = np.hypot(strengths.bones * body.size, np.where(known, varies, 0.0))
    shortest = np.broadcast_to(1e-9 * body.size, lengths.shape)
    rows = np.stack([np.where(known, lengths, 0.0), known / sigma, shortest], axis=1)
    rows = in_tiles(rows, lanes)[..., AROUND:-AROUND]
    rows[:, 1, lengths.shape[1] :] = 0
    tiles = rows.shape[-1] // lanes
    rows = rows.reshape(len(edges), 3, tiles, lanes).transpose(2, 0, 1, 3)
    rows = np.ascontiguousarray(rows).reshape(tiles, len(edges), 3 * lanes)
    return np.ascontiguousarray(edges), rows
