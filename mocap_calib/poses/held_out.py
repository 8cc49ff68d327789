"""How strongly to smooth: what predicts best the detections that the fit was not shown."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import Strengths, fit, squared_errors
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Bools, Floats

_SEED = 0  # of which detections are hidden
_RUN = 5  # frames for which a joint is hidden from a view: errors go together for some time
_VIEWS = 3  # of a point of which one is hidden: two must be left
_LARGEST = 900.0  # squared error that counts in full


@dataclass(frozen=True)
class Choice:
    """What was chosen, and how well it predicts.

    held_out: mean of log(1 + r^2 / 4), r the error in standard deviations of the detections that
        were hidden; without: the same where nothing is smoothed. NaN where nothing was hidden.
    """

    strengths: Strengths
    held_out: float = np.nan
    without: float = np.nan


def choose_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool
) -> Choice:
    """Return the strengths that predict hidden detections best.

    The accelerations' first, then the bones', then the accelerations' again. The weaker one counts
    where a stronger one gains next to nothing.

    points: `[keypoint, frame, 3]` to start from. moves: whether accelerations may be smoothed.
    """
    moves = moves and bool(body.steps.any())
    hidden = _hide(seen)
    usual = config.usual_strengths if moves else (np.inf, config.usual_strengths[1])
    if hidden.sum() < config.least_hidden:
        return Choice(Strengths(*usual))
    shown = replace(seen, precision=np.where(hidden, 0.0, seen.precision))
    losses: dict[Strengths, float] = {}

    def loss(strengths: Strengths) -> float:
        if strengths not in losses:
            found = fit(points, shown, body, strengths, config, steps=config.choice_steps)
            square = np.minimum(squared_errors(found, seen)[hidden], _LARGEST)
            losses[strengths] = float(np.log1p(square / 4).mean())
        return losses[strengths]

    def weakest(candidates: list[Strengths]) -> Strengths:
        """Return the first of those that predict about as well as the best."""
        least = min(map(loss, candidates))
        return next(each for each in candidates if loss(each) <= least + config.same_loss)

    accelerations = config.accelerations if moves else (np.inf,)
    chosen = Strengths(*usual)
    chosen = weakest([replace(chosen, acceleration=sigma) for sigma in accelerations])
    if len(body.edges):
        chosen = weakest([replace(chosen, bones=sigma) for sigma in config.bones])
        at = accelerations.index(chosen.acceleration)
        near = accelerations[max(at - 1, 0) : at + 2]
        chosen = weakest([replace(chosen, acceleration=sigma) for sigma in near])
    else:
        chosen = replace(chosen, bones=np.inf)
    return Choice(chosen, loss(chosen), loss(Strengths(np.inf, np.inf)))


def _hide(seen: Detections) -> Bools:
    """Return which detections `[view, keypoint, frame]` are hidden: two of each point stay."""
    there = seen.precision > 0
    views, joints, frames = there.shape
    rng = np.random.default_rng(_SEED)
    runs = rng.integers(0, views, size=(joints, frames // _RUN + 1))
    chosen = runs.repeat(_RUN, axis=1)[:, :frames] == np.arange(views)[:, None, None]
    asked = rng.random((joints, frames // _RUN + 1)) < 0.5
    chosen &= asked.repeat(_RUN, axis=1)[:, :frames]
    return chosen & there & (there.sum(0) >= _VIEWS)
