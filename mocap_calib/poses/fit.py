"""Fit poses: Gauss-Newton steps on the energy of `poses.energy`.

Joints are coupled over time by bands, which are factored for each joint alone, and by bones, for
which the bands precondition conjugate gradients: the cost grows with the number of joints, not
with its cube. What joints share is that of the points before each step.
"""

from typing import NamedTuple

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels.pose_energy import LANES, sum_terms
from mocap_calib.kernels.pose_step import take_step
from mocap_calib.poses.energy import Strengths
from mocap_calib.poses.lanes import from_lanes
from mocap_calib.poses.packing import pack
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
    packed = pack(points, seen, body, strengths, config)
    found = packed.points
    gradient, work = np.zeros_like(found), np.zeros((5, *found.shape))
    rounds = config.inner_steps if len(packed.edges) else 0
    for step in plan_steps(strengths.loss, config, steps):
        packed.share_accelerations()
        sum_terms(
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
        take_step(
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
    return from_lanes(found, LANES, packed.joints, points.shape[1])
