"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`, compiled where numba is."""

from dataclasses import replace
from types import ModuleType

import numpy as np

from mocap_calib.compute.kernels import compiled, contiguous
from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import Strengths, linearise, solve
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints

_EQUATIONS = "mocap_calib.poses.energy_kernels"
_STEP = "mocap_calib.poses.step_kernels"
_AROUND = 2  # frames before and after all: as far as accelerations reach


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
    equations, step = compiled(_EQUATIONS), compiled(_STEP)
    if equations and step:
        return _fit_compiled(points, seen, body, strengths, config, losses, (equations, step))
    return _fit(points, seen, body, strengths, config, losses)


def _fit(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
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
    losses: list[float],
    kernels: tuple[ModuleType, ModuleType],
) -> Floats:
    """Return what `_fit` returns."""
    equations, step = kernels
    joints, frames = points.shape[:2]
    lanes = equations.LANES
    tiles = -(-frames // lanes)
    packed = np.zeros((tiles, len(seen.centres), joints, 4 * lanes))
    equations.pack_rays(*contiguous(seen.rays, seen.precision), packed)
    found = _in_lanes(points, lanes)
    stiffness = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    by_frame = _in_tiles(np.stack([stiffness, config.ridge / body.size**2]), lanes)
    motion = np.ascontiguousarray(_in_tiles(body.steps, lanes).T)
    edges, bones = _bones(body, strengths, lanes)
    along = np.empty((tiles, len(edges), 4 * lanes))
    factor = np.zeros((len(found), found.shape[1], 16 * lanes))
    centres = np.ascontiguousarray(seen.centres)
    for loss in losses:
        gradient = np.zeros_like(found)
        equations.factor_bands(
            packed,
            centres,
            found,
            motion,
            by_frame,
            edges,
            bones,
            loss,
            config.prior_loss,
            along,
            factor,
            gradient,
        )
        step.take_step(along, factor, edges, joints, config.inner_steps, gradient, found)
    return _from_lanes(found, joints, frames)


def _in_lanes(points: Floats, lanes: int) -> Floats:
    """Return points `[keypoint, frame, 3]` as `[group, frame, 3 * lanes]`, in tiles."""
    joints = len(points)
    groups = -(-joints // lanes)
    padded = _in_tiles(points.swapaxes(1, 2), lanes)
    found = np.zeros((groups * lanes, *padded.shape[1:]))
    found[:joints] = padded
    found = found.reshape(groups, lanes, 3, -1).transpose(0, 3, 2, 1)
    return np.ascontiguousarray(found).reshape(groups, -1, 3 * lanes)


def _from_lanes(found: Floats, joints: int, frames: int) -> Floats:
    """Return points `[keypoint, frame, 3]`: the inverse of `_in_lanes`."""
    groups = len(found)
    points = found.reshape(groups, found.shape[1], 3, -1)[:, _AROUND : _AROUND + frames]
    points = points.transpose(0, 3, 1, 2).reshape(-1, frames, 3)
    return np.ascontiguousarray(points[:joints])


def _in_tiles(values: Floats, lanes: int) -> Floats:
    """Return values `[..., frame]` with more frames, alike the first and the last.

    So many that they fill tiles, and two on each side.
    """
    short = -values.shape[-1] % lanes
    widths = [(0, 0)] * (values.ndim - 1) + [(_AROUND, _AROUND + short)]
    return np.pad(values, widths, mode="edge")


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
    rows = _in_tiles(rows, lanes)[..., _AROUND:-_AROUND]
    rows[:, 1, lengths.shape[1] :] = 0
    tiles = rows.shape[-1] // lanes
    rows = rows.reshape(len(edges), 3, tiles, lanes).transpose(2, 0, 1, 3)
    rows = np.ascontiguousarray(rows).reshape(tiles, len(edges), 3 * lanes)
    return np.ascontiguousarray(edges), rows
