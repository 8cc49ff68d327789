"""What detections decide: strengths of smoothing, exchanged sides, and outliers."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.fit import Strengths, fit, squared_errors
from mocap_calib.poses.track import Body, Detections, accelerations
from mocap_calib.types import Bools, Floats, Ints

_LARGEST = 900.0  # squared error that counts in full
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
    usual = usual_strengths(points, seen, body, config, moves=moves)
    hidden = _hide(seen, config)
    if hidden.sum() < 2 * config.held_out_stretch:
        return Choice(usual)
    search = _Search(points, seen, body, hidden, config)
    chosen = usual
    if moves and body.steps.any() and np.isfinite(usual.acceleration):
        chosen = search.weakest(usual, "acceleration", (np.inf, *config.accelerations))
    if len(body.edges):
        chosen = search.weakest(chosen, "bones", (np.inf, *config.bones))
    chosen = search.weakest(chosen, "loss", config.losses)
    finely = tuple(float(chosen.acceleration) * factor for factor in (2, 2**0.5, 1, 2**-0.5))
    chosen = search.weakest(chosen, "acceleration", finely)
    raw = search.loss(replace(chosen, acceleration=np.inf, bones=np.inf))
    return Choice(chosen, float(search.loss(chosen).mean()), float(raw.mean()))


@dataclass(frozen=True)
class _Search:
    """A search over strengths: see `choose_strengths`.

    hidden: `[view, keypoint, frame]` detections that a fit is not shown. losses: of each hidden
        detection under the strengths tried so far.
    """

    points: Floats
    seen: Detections
    body: Body
    hidden: Bools
    config: PosesConfig
    losses: dict[Strengths, Floats] = field(default_factory=dict)

    @cached_property
    def _run(self) -> Ints:
        """`[N]` the number of the run that each hidden detection belongs to."""
        _, joint, frame = np.nonzero(self.hidden)
        return np.asarray(joint * self.hidden.shape[2] + frame // _run_length(self.config))

    def loss(self, strengths: Strengths) -> Floats:
        """Return the loss of each hidden detection."""
        if strengths not in self.losses:
            shown = replace(self.seen, precision=np.where(self.hidden, 0.0, self.seen.precision))
            steps = self.config.refit_steps
            points = fit(self.points, shown, self.body, strengths, self.config, steps=steps)
            square = squared_errors(points, self.seen)[self.hidden]
            self.losses[strengths] = np.log1p(np.minimum(square, _LARGEST) / 4)
        return self.losses[strengths]

    def weakest(self, strengths: Strengths, name: str, values: tuple[float, ...]) -> Strengths:
        """Return the strengths with the first value that predicts about as well as the best."""
        candidates = [replace(strengths, **{name: value}) for value in values]
        tried = list(self._until_worse(dict.fromkeys(candidates)))
        best = min((self.loss(each) for each in tried), key=np.mean)
        more = ((each, self.loss(each) - best) for each in tried)
        return next(each for each, lost in more if lost.mean() <= error_of_mean(lost, self._run))

    def _until_worse(self, candidates: dict[Strengths, None]) -> Iterator[Strengths]:
        """Yield candidates until the loss has risen twice in a row."""
        before, rises = np.inf, 0
        for each in candidates:
            yield each
            now = float(self.loss(each).mean())
            rises = rises + 1 if now > before else 0
            before = now
            if rises == 2:
                return


def error_of_mean(values: Floats, run: Ints) -> float:
    """Return the standard error of the mean of values `[N]`, which are correlated in runs.

    run: `[N]` the number of the run that each belongs to.
    """
    off = np.bincount(run, values - values.mean())
    return float(np.sqrt((off**2).sum()) / len(values))


def usual_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool = True
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


def _run_length(config: PosesConfig) -> int:
    """Return for how many frames a joint is hidden from a view.

    Errors are correlated in time: with 5 frames the detections just before and after are as wrong,
    and Shelf is smoothed as much as can be.
    """
    return max(config.held_out_stretch // 2, 1)


def _hide(seen: Detections, config: PosesConfig) -> Bools:
    """Return which detections `[view, keypoint, frame]` are hidden: two of each point stay.

    Of every point that three views or more detect, one view is hidden.
    """
    there = seen.precision > 0
    views, joints, frames = there.shape
    rng = np.random.default_rng(0)
    length = _run_length(config)
    runs = rng.integers(0, views, size=(joints, frames // length + 1))
    chosen = runs.repeat(length, axis=1)[:, :frames] == np.arange(views)[:, None, None]
    return chosen & there & (there.sum(0) >= 3)


def exchange_sides(
    points: Floats, seen: Detections, mirror: Ints, config: PosesConfig
) -> tuple[Detections, Bools]:
    """Return the detections with left and right exchanged where that explains a view.

    points: `[keypoint, frame, 3]`. mirror: `[keypoint]` the joint of the other side, itself where
    there is none. A pair is exchanged in one view of one frame where both were seen.

    Returns which were, `[view, keypoint, frame]`, both of a pair.
    """
    paired = mirror != np.arange(len(mirror))
    as_seen = squared_errors(points, seen)
    other = squared_errors(points[mirror], seen)
    there = seen.precision > 0
    fits = paired[:, None] & there & (other < config.outlier**2)
    # logarithms are never more than what they are of, and few detections are so far off
    far = as_seen + as_seen[:, mirror] > 2 * config.outlier
    exchanged = fits & fits[:, mirror] & far
    view, joint, frame = np.nonzero(exchanged)
    scale = config.losses[0] ** 2
    gain = sum(
        np.log1p(as_seen[view, each, frame] / scale) - np.log1p(other[view, each, frame] / scale)
        for each in (joint, mirror[joint])
    )
    exchanged[view, joint, frame] = gain * scale / 2 > config.outlier
    if not exchanged.any():
        return seen, exchanged
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
