"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`, compiled where numba is."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import Strengths, linearise, solve
from mocap_calib.poses.lanes import band_kernels, from_lanes
from mocap_calib.poses.packing import Packed, pack
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats


class Step(NamedTuple):
    """A step of a fit: the loss of rays, and how many times what solves the equations is taken."""

    loss: float
    overshoot: float


def plan_steps(loss: float, config: PosesConfig, steps: int) -> list[Step]:
    """Return the steps of a fit that ends with this loss of rays.

    The loss starts wide and narrows: what to start from may rest on a wrong detection. A robust
    energy is never above the quadratic that a step minimises, and it curves less: steps are too
    short. A step of up to twice the length does not raise the energy either. The last one is taken
    once, so that points do not swing around the minimum.
    """
    wide = [config.first_loss / 2**step for step in range(steps)]
    return [
        Step(
            loss * max(each, 1.0),
            config.overshoot if each < 1 and step < steps - 1 else 1.0,
        )
        for step, each in enumerate(wide)
    ]


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

    steps: as many of `plan_steps`.
    """
    planned = plan_steps(strengths.loss, config, steps)
    kernels = band_kernels()
    if kernels:
        packed = pack(points, seen, body, strengths, config, kernels=kernels)
        return _fit_compiled(packed, planned, points.shape[1])
    return _fit(points, seen, body, strengths, config, planned=planned)


def _fit(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
    *,
    planned: list[Step],
) -> Floats:
    """Return the points after these steps."""
    ridge = config.ridge / body.size**2
    for step in planned:
        system = linearise(points, seen, body, replace(strengths, loss=step.loss), config)
        points = points - step.overshoot * solve(system, body, ridge, config)
    return points


def _fit_compiled(packed: Packed, planned: list[Step], frames: int) -> Floats:
    """Return what `_fit` returns."""
    kernels, config, found = packed.kernels, packed.config, packed.points
    gradient, work = np.zeros_like(found), np.zeros((5, *found.shape))
    rounds = config.inner_steps if len(packed.edges) else 0
    for step in planned:
        packed.share_accelerations()
        kernels.energy.sum_terms(
            packed.rays,
            packed.centres,
            found,
            packed.edges,
            packed.bones,
            step.loss,
            config.prior_loss,
            packed.along,
            packed.factor,
            gradient,
        )
        packed.factor_bands(gradient)
        kernels.step.take_step(
            packed.along,
            packed.factor,
            packed.edges,
            packed.joints,
            rounds,
            config.inner_tolerance,
            step.overshoot,
            work,
            gradient,
            found,
        )
    return from_lanes(found, kernels.energy.LANES, packed.joints, frames)
