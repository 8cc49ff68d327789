"""Rigs of parts of what was seen: how much they differ, and how well each fits the rest.

Without a fifth of the moments, and of halves of the joints (the delete-a-group jackknife; Shao and
Wu 1989: "A General Theory for Jackknife Variance Estimation").
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_calib.adjust.fitted_rig import FittedRig, minimise_again
from mocap_calib.adjust.residuals import State
from mocap_calib.adjust.schur import settle_points
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config
from mocap_calib.geometry.gauge import rig_change
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class LeftOut:
    """What rigs of parts of what was seen tell.

    variance: of all turns together, in square radians, by what these rigs differ by.
    held_out: median error of what such a rig was made without, in those that it has in the rig of
        all: of the part where that is most; NaN where nothing was left out in time.
    """

    variance: float
    held_out: float


def leave_out_moments(fitted: FittedRig, config: Config) -> LeftOut:
    """Return what rigs tell that are made without a fifth of the recording each.

    Of hardly more moments than parts, each part would weigh too much: all is NaN.
    """
    count = config.uncertainty.parts
    if len(np.unique(fitted.points.frame)) < config.uncertainty.moments_of_a_part * count:
        return LeftOut(variance=np.nan, held_out=np.nan)
    part = fitted.points.time_blocks(count)

    def without(number: int) -> tuple[Floats, float]:
        """Return the turns of the cameras without a part, and its medians of errors, see below."""
        bent = _refit(np.flatnonzero(part != number), fitted, config)
        return _turns(bent, fitted), _error_with(bent, np.flatnonzero(part == number), fitted)

    turns, errors = zip(*map_in_threads(without, range(int(part.max()) + 1)), strict=True)
    return LeftOut(variance=jackknife(np.stack(turns)), held_out=max(errors))


def halves_variance(fitted: FittedRig, config: Config, *, seed: int) -> float:
    """Return the variance of all turns together by what rigs of halves of the joints differ by."""
    joints, joint = np.unique(fitted.points.keypoint, return_inverse=True)
    if len(joints) < 2:
        return np.inf
    rng = np.random.default_rng(seed)
    half = [(rng.permutation(len(joints)) % 2)[joint] for _ in range(config.uncertainty.splits)]
    kept = (np.flatnonzero(each == one) for each in half for one in (0, 1))
    refit = partial(_refit, fitted=fitted, config=config)
    turns = np.stack([_turns(bent, fitted) for bent in map_in_threads(refit, kept)])
    # a half errs by twice the variance of the whole, and two of them differ by four times that
    return float(((turns[::2] - turns[1::2]) ** 2).sum()) / (4 * len(half))


def _error_with(bent: State, left_out: Ints, fitted: FittedRig) -> float:
    """Return the median error of points (indices) in a rig made without them.

    In their median error in the rig of all. The points settle in both.
    """
    seen = fitted.seen.select(left_out)
    own = replace(fitted.state, points=fitted.state.points[:, left_out])
    moved = replace(bent, points=own.points)
    moved = settle_points(moved, seen, loss_scale=fitted.points.loss_scale)
    residuals = [seen.residuals(slice(None), state).residual for state in (moved, own)]
    counted = seen.weight > 0
    found, usual = (np.median(np.linalg.norm(each, axis=1)[counted]) for each in residuals)
    return float(found / max(usual, 1e-30))


def jackknife(turns: Floats) -> float:
    """Return the variance of all turns together by what rigs without a part differ by.

    In square radians: what the trace of the covariance of the turns should be.
    turns: `[part, view, 3]`.
    """
    count = len(turns)
    return (count - 1) / count * float(((turns - turns.mean(0)) ** 2).sum())


def _refit(kept: Ints, fitted: FittedRig, config: Config) -> State:
    """Return where the cameras stand when only some points (indices) are kept."""
    state = fitted.state
    some = replace(state, points=state.points[:, kept])
    tolerance = config.uncertainty.bend_tolerance
    rougher = replace(config, adjust=replace(config.adjust, tolerance=tolerance))
    return minimise_again(some, fitted.seen.select(kept), fitted.points.loss_scale, rougher)


def _turns(bent: State, fitted: FittedRig) -> Floats:
    """Return the turns `[view, 3]` of the cameras of a state from those of the rig."""
    rig = replace(fitted.rig, rotation=bent.rotation, translation=bent.translation)
    return rig_change(fitted.rig, rig)[:, :3]
