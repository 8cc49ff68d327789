"""A rig adjusted again to a sample, with the points that its covariance follows from."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.bundle_adjustment import (
    AdjustablePoints,
    choose_points,
    minimise_in_steps,
    observe_rays,
)
from mocap_calib.adjust.freedom import free_poses
from mocap_calib.adjust.ray_residuals import RayObservations
from mocap_calib.adjust.residuals import State
from mocap_calib.adjust.schur import settle_points
from mocap_calib.config import Config
from mocap_calib.types import Bools, CameraRig, Floats, Matches, Sample


@dataclass(frozen=True)
class FittedRig:
    """A rig adjusted to points of a sample."""

    rig: CameraRig
    points: AdjustablePoints
    seen: RayObservations
    state: State


def fit_again(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> FittedRig:
    """Return a rig adjusted again, to as many points as its covariance needs.

    Raises as `bundle_adjustment.adjust` does.
    """
    # what detections say together is not said better by more of them
    fewer = replace(config, adjust=replace(config.adjust, points=config.uncertainty.points))
    points = choose_points(sample, rig, matches, fewer)
    seen = observe_rays(rig, points)
    start = State(rig.rotation, rig.translation, points.points, np.zeros((len(rig.cameras), 0)))
    state = minimise_again(start, seen, points.loss_scale, config)
    state = settle_points(state, seen, loss_scale=points.loss_scale)
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    kept = np.flatnonzero(~_at_a_camera(adjusted, state.points, points.used, config))
    return FittedRig(
        rig=adjusted,
        points=points.select(kept),
        seen=seen.select(kept),
        state=replace(state, points=state.points[:, kept]),
    )


def _at_a_camera(rig: CameraRig, points: Floats, used: Bools, config: Config) -> Bools:
    """Return which points (`[3, N]`) are next to a camera that sees them (used: `[view, N]`).

    Nobody is there: rays of different things have met. The image of such a point changes so fast
    that its rounding errors outweigh all other points.
    """
    distance = np.linalg.norm(points - rig.centres[:, :, None], axis=1)  # [view, N]
    distance = np.where(used, distance, np.nan)
    usual = np.nanmedian(distance, axis=1, keepdims=True)
    return np.asarray((distance < config.uncertainty.least_distance * usual).any(0))


def minimise_again(state: State, seen: RayObservations, loss_scale: float, config: Config) -> State:
    """Return the state at the minimum that it is close to, whose points have yet to settle."""
    freedom = free_poses(len(state.rotation))
    return minimise_in_steps(
        state, seen, freedom, config.adjust, loss_scale=loss_scale, already_close=True
    )
