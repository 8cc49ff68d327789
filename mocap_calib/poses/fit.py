"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`, compiled where numba is."""

from dataclasses import replace
from types import ModuleType

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import Strengths, linearise, shared_accelerations, solve
from mocap_calib.poses.lanes import AROUND, band_kernels, from_lanes, in_lanes, in_tiles
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
    kernels: tuple[ModuleType, ModuleType],
) -> Floats:
    """Return what `_fit` returns."""
    equations, step = kernels
    joints, frames = points.shape[:2]
    lanes = equations.LANES
    tiles = -(-frames // lanes)
    packed = _pack_rays(seen, lanes)
    found = in_lanes(points, lanes)
    usual = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    stiffness = np.ones((len(found), lanes))
    stiffness.reshape(-1)[:joints] = body.agility**-2
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
            expected[:-2, 2:] = shared_accelerations(_accelerations(found, motion, joints), config)
        equations.factor_bands(
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
        step.take_step(along, factor, edges, joints, config.inner_steps, work, gradient, found)
    return from_lanes(found, lanes, joints, frames)


def _accelerations(found: Floats, motion: Floats, joints: int) -> Floats:
    """Return accelerations `[frame, 3, keypoint]` by the first of their frames, in lanes."""
    total = motion[:-2, 0, None] * found[:, :-2]
    total += motion[:-2, 1, None] * found[:, 1:-1]
    total += motion[:-2, 2, None] * found[:, 2:]
    groups, rows, _ = total.shape
    by_group = total.reshape(groups, rows, 3, -1).transpose(1, 2, 0, 3)
    return by_group.reshape(rows, 3, -1)[..., :joints]


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
