"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`, compiled where numba is."""

from dataclasses import replace
from types import ModuleType

import numpy as np

from mocap_calib.compute.kernels import compiled, contiguous
from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import Strengths, linearise, solve
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats

_EQUATIONS = "mocap_calib.poses.energy_kernels"
_STEP = "mocap_calib.poses.step_kernels"
_AROUND = 2  # frames of zeros before and after: as far as accelerations reach


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
    views = len(seen.centres)
    lanes = equations.LANES
    groups = -(-joints // lanes)
    packed = np.zeros((groups, frames, views * 4 * lanes))
    equations.pack_rays(*contiguous(seen.rays, seen.precision), packed)
    found = _in_lanes(points, lanes)
    stiffness = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    by_frame = _between_zeros(np.stack([stiffness, config.ridge / body.size**2]), axis=1)
    motion = _between_zeros(np.ascontiguousarray(body.steps.T), axis=0)
    edges, bones = _bones(body, strengths)
    along = np.empty((frames, 4, len(edges)))
    factor = np.zeros((groups, found.shape[1], 16 * lanes))
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
        step.take_step(along, factor, edges, config.inner_steps, gradient, found)
    return _from_lanes(found, joints)


def _in_lanes(points: Floats, lanes: int) -> Floats:
    """Return points `[keypoint, frame, 3]` as `[group, frame, 3 * lanes]`, between zeros."""
    joints, frames = points.shape[:2]
    groups = -(-joints // lanes)
    index = np.minimum(np.arange(groups * lanes), joints - 1).reshape(groups, lanes)
    found = np.zeros((groups, frames + 2 * _AROUND, 3, lanes))
    found[:, _AROUND:-_AROUND] = points[index].transpose(0, 2, 3, 1)
    return found.reshape(groups, -1, 3 * lanes)


def _from_lanes(found: Floats, joints: int) -> Floats:
    """Return points `[keypoint, frame, 3]`: the inverse of `_in_lanes`."""
    groups, frames, _ = found.shape
    points = found.reshape(groups, frames, 3, -1)[:, _AROUND:-_AROUND].transpose(0, 3, 1, 2)
    return np.ascontiguousarray(points.reshape(-1, frames - 2 * _AROUND, 3)[:joints])


def _between_zeros(values: Floats, *, axis: int) -> Floats:
    """Return values with two frames of zeros before and after, along the axis of frames."""
    widths = [(_AROUND, _AROUND) if k == axis else (0, 0) for k in range(values.ndim)]
    return np.pad(values, widths)


def _bones(body: Body, strengths: Strengths) -> tuple[Floats, Floats]:
    """Return the edges that tell `[edge, 2]`, and of each frame `[frame, 3, edge]`.

    The lengths, their inverse standard deviations, and the shortest length to divide by.
    """
    edges = body.edges if np.isfinite(strengths.bones) else body.edges[:0]
    lengths, varies = body.lengths[: len(edges)], body.varies[: len(edges)]
    known = np.isfinite(lengths)
    sigma = np.hypot(strengths.bones * body.size, np.where(known, varies, 0.0))
    shortest = np.broadcast_to(1e-9 * body.size, lengths.shape)
    rows = np.stack([np.where(known, lengths, 0.0), known / sigma, shortest])
    return np.ascontiguousarray(edges), np.ascontiguousarray(rows.transpose(2, 0, 1))
