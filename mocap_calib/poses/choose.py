"""What detections decide: strengths of smoothing, exchanged sides, and outliers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.fit import Strengths, fit, squared_errors
from mocap_calib.poses.track import Body, Detections, accelerations
from mocap_calib.types import Bools, Floats, Ints

_MEDIAN_LENGTH = 1.538  # of normal vectors in space, in standard deviations of a coordinate


@dataclass(frozen=True)
class Choice:
    """The chosen strengths, and how well they predict.

    held_out: mean of log(1 + r^2 / 4), r the error of the hidden detections in standard deviations;
        without: the same without smoothing. NaN where no detection was hidden.
    """

    strengths: Strengths
    held_out: float = np.nan
    without: float = np.nan


def choose_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool
) -> Choice:
    """Return the strengths that predict hidden detections best.

    Of each parameter in turn the weakest within a standard error of the best is taken:
    accelerations, bones, loss, and accelerations again, more finely. Where too few points have
    three views to hide one, the strengths follow from the accelerations of the points themselves.

    points: `[keypoint, frame, 3]` to start from. moves: whether accelerations may be smoothed.
    """
    chosen = usual_strengths(points, seen, body, config, moves=moves)
    hidden, run = _hide(seen, config)
    if len(run) < 2 * config.held_out_stretch:
        return Choice(chosen)
    shown = replace(seen, precision=np.where(hidden, 0.0, seen.precision))

    @cache
    def loss(strengths: Strengths) -> Floats:
        """Return the loss `[N]` of each hidden detection."""
        found = fit(points, shown, body, strengths, config, steps=config.steps)
        return np.log1p(squared_errors(found, seen)[hidden] / 4)

    def weakest(name: str, values: Sequence[float]) -> Strengths:
        """Return the strengths with the first value that predicts about as well as the best."""
        tried = [replace(chosen, **{name: value}) for value in values]
        best = min(map(loss, tried), key=np.mean)
        more = ((each, loss(each) - best) for each in tried)
        return next(each for each, lost in more if lost.mean() <= error_of_mean(lost, run))

    if moves and body.steps.any() and np.isfinite(chosen.acceleration):
        chosen = weakest("acceleration", (np.inf, *config.accelerations))
    if len(body.edges):
        chosen = weakest("bones", (np.inf, *config.bones))
    chosen = weakest("loss", config.losses)
    chosen = weakest("acceleration", (chosen.acceleration * np.sqrt([4, 2, 1, 0.5])).tolist())
    raw = loss(replace(chosen, acceleration=np.inf, bones=np.inf))
    return Choice(chosen, float(loss(chosen).mean()), float(raw.mean()))


def error_of_mean(values: Floats, run: Ints) -> float:
    """Return the standard error of the mean of values `[N]`, which are correlated in runs.

    run: `[N]` the number of the run that each belongs to.
    """
    off = np.bincount(run, values - values.mean())
    return float(np.sqrt((off**2).sum()) / len(values))


def usual_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool
) -> Strengths:
    """Return strengths without held-out detections: weak ones.

    Accelerations are allowed that are as large as those of the points, noise included; where even
    these are too large for one motion, frames do not follow each other.
    """
    acceleration = accelerations(points, body)
    ends = acceleration.shape[1]
    size = np.sqrt((acceleration**2).sum(-1)) / body.size[:ends]
    there = (seen.precision > 0).sum(0) >= 2
    counted = np.all([there[:, k : k + ends] for k in range(3)], axis=0)
    counted &= body.steps[0, :ends] != 0
    sigma = float(np.median(size[counted])) / _MEDIAN_LENGTH if counted.any() else np.inf
    follow = moves and sigma < config.accelerations[0]
    allowed = sigma if follow else np.inf
    bones = config.bones[1] if len(body.edges) else np.inf
    return Strengths(max(allowed, config.accelerations[-1]), bones, config.losses[0])


def _hide(seen: Detections, config: PosesConfig) -> tuple[Bools, Ints]:
    """Return which detections `[view, keypoint, frame]` are hidden, and the run `[N]` of each.

    Of every point that three views or more detect, one view is hidden: two of each point stay. A
    joint is hidden from a view for runs of half a stretch, as errors are correlated in time: with 5
    frames the detections just before and after are as wrong, and Shelf is smoothed as much as can
    be.
    """
    there = seen.precision > 0
    views, joints, frames = there.shape
    length = max(config.held_out_stretch // 2, 1)
    views_of_runs = np.random.default_rng(0).integers(views, size=(joints, frames // length + 1))
    chosen = views_of_runs.repeat(length, axis=1)[:, :frames] == np.arange(views)[:, None, None]
    hidden = chosen & there & (there.sum(0) >= 3)
    _, joint, frame = np.nonzero(hidden)
    return hidden, joint * frames + frame // length


def exchange_sides(
    points: Floats, seen: Detections, mirror: Ints, config: PosesConfig
) -> tuple[Detections, Bools]:
    """Return the detections with left and right exchanged where that explains a view.

    points: `[keypoint, frame, 3]`. mirror: `[keypoint]` the joint of the other side, itself where
    there is none. A pair is exchanged in one view of one frame where both were seen.

    Returns which were, `[view, keypoint, frame]`, both of a pair.
    """
    paired = mirror != np.arange(len(mirror))
    scale, other = config.losses[0] ** 2, squared_errors(points[mirror], seen)
    gain = np.log1p(squared_errors(points, seen) / scale) - np.log1p(other / scale)
    gain += gain[:, mirror]
    fits = paired[:, None] & (seen.precision > 0) & (other < config.outlier**2)
    exchanged = fits & fits[:, mirror] & (gain * scale / 2 > config.outlier)
    return (
        replace(
            seen,
            rays=np.where(exchanged, seen.rays[:, :, mirror], seen.rays),
            precision=np.where(exchanged, seen.precision[:, mirror], seen.precision),
        ),
        exchanged,
    )


def drop_outliers(
    points: Floats, seen: Detections, config: PosesConfig
) -> tuple[Detections, Bools]:
    """Return the detections without those far from the points, and which these are.

    points: `[keypoint, frame, 3]`. Which: `[view, keypoint, frame]`.
    """
    far = (seen.precision > 0) & (squared_errors(points, seen) > config.outlier**2)
    return replace(seen, precision=np.where(far, 0.0, seen.precision)), far
