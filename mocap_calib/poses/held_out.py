"""How strongly to smooth: what predicts best the detections that the fit was not shown."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import (
    Strengths,
    accelerations,
    own_accelerations,
    squared_errors_at,
)
from mocap_calib.poses.fit import fit
from mocap_calib.poses.track import Body, Detections
from mocap_calib.poses.trust import Trust, measure_trust
from mocap_calib.types import Bools, Floats, Ints

_SEED = 0  # of which detections are hidden
# Frames for which a joint is hidden from a view. Errors go together for some time, and what is seen
# just before and after is as wrong: with 5 frames Shelf was smoothed to the end of the scale.
_RUN = 25
_VIEWS = 3  # of a point of which one is hidden: two must be left
_ALIKE = 1e-6  # logarithms of confidences that differ by less tell nothing
_LARGEST = 900.0  # squared error that counts in full
_FRAMES_OF_A_JOINT = 30  # in which two views see it, for its agility to be measured
_LARGEST_AGILITY = 3.0
_MEDIAN_LENGTH = 1.538  # of normal vectors in space, in standard deviations of a coordinate


@dataclass(frozen=True)
class Choice:
    """What was chosen, and how well it predicts.

    agility: `[keypoint]` as of `Body`.
    held_out: mean of log(1 + r^2 / 4), r the error in standard deviations of the detections that
        were hidden; without: the same where nothing is smoothed. NaN where nothing was hidden.
    """

    strengths: Strengths
    agility: Floats
    held_out: float = np.nan
    without: float = np.nan


def choose_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool
) -> Choice:
    """Return the strengths that predict hidden detections best.

    The accelerations' first, then the bones', then whether joints differ in agility, then the loss,
    then the accelerations' again, more finely. The first counts of those that are as good as the
    best within a standard error. Frames that do not follow each other are not tried: postures come
    again, and would predict. Where too few points have three views to hide one, they are what the
    points themselves show.

    points: `[keypoint, frame, 3]` to start from. moves: whether accelerations may be smoothed.
    """
    usual = usual_strengths(points, seen, body, config, moves=moves)
    moves = moves and bool(body.steps.any()) and np.isfinite(usual.acceleration)
    hidden = _hide(seen)
    if hidden.sum() < config.least_hidden:
        return Choice(usual, body.agility)
    search = _Search(points, seen, body, hidden, config)
    accelerations = (np.inf, *config.accelerations) if moves else (np.inf,)
    chosen = search.weakest([replace(usual, acceleration=sigma) for sigma in accelerations])
    if len(body.edges):
        chosen = search.weakest([replace(chosen, bones=sigma) for sigma in (np.inf, *config.bones)])
    if np.isfinite(chosen.acceleration):
        search = search.of_agile_joints(chosen)
    chosen = search.weakest([replace(chosen, loss=scale) for scale in config.losses])
    factors = (2, np.sqrt(2), 1, np.sqrt(0.5)) if np.isfinite(chosen.acceleration) else (1,)
    finely = [float(chosen.acceleration * factor) for factor in factors]
    chosen = search.weakest([replace(chosen, acceleration=sigma) for sigma in finely])
    raw = search.loss(replace(chosen, acceleration=np.inf, bones=np.inf))
    return Choice(chosen, search.body.agility, float(search.loss(chosen).mean()), float(raw.mean()))


@dataclass(frozen=True)
class _Search:
    """What strengths are tried on: see `choose_strengths`.

    hidden: `[view, keypoint, frame]` detections that a fit is not shown. losses: what each hidden
        detection counts for with strengths that were tried.
    """

    points: Floats
    seen: Detections
    body: Body
    hidden: Bools
    config: PosesConfig
    losses: dict[Strengths, Floats] = field(default_factory=dict)

    @cached_property
    def _hidden_at(self) -> Ints:
        """`[3, N]` views, keypoints and frames of the hidden detections."""
        return np.array(np.nonzero(self.hidden))

    @cached_property
    def _run(self) -> Ints:
        """`[N]` the number of the run that each of them belongs to."""
        _, joint, frame = self._hidden_at
        return np.asarray(joint * self.hidden.shape[2] + frame // _RUN)

    @cached_property
    def _shown(self) -> Detections:
        return replace(self.seen, precision=np.where(self.hidden, 0.0, self.seen.precision))

    def _fit(self, strengths: Strengths) -> Floats:
        """Return the points `[keypoint, frame, 3]` that what is shown makes."""
        steps = self.config.choice_steps
        return fit(self.points, self._shown, self.body, strengths, self.config, steps=steps)

    def loss(self, strengths: Strengths) -> Floats:
        """Return what each hidden detection counts for."""
        if strengths not in self.losses:
            square = squared_errors_at(self._fit(strengths), self.seen, self._hidden_at)
            self.losses[strengths] = np.log1p(np.minimum(square, _LARGEST) / 4)
        return self.losses[strengths]

    def weakest(self, candidates: list[Strengths]) -> Strengths:
        """Return the first of those that predict about as well as the best."""

        def mean(each: Strengths) -> float:
            return float(self.loss(each).mean())

        candidates = list(_until_worse(candidates, mean))
        best = self.loss(min(candidates, key=mean))
        more = ((each, self.loss(each) - best) for each in candidates)
        return next(each for each, lost in more if lost.mean() <= error_of_mean(lost, self._run))

    def of_agile_joints(self, strengths: Strengths) -> "_Search":
        """Return the search with the agility of each joint, where that predicts better."""
        agility = _measure_agility(self._fit(strengths), self._shown, self.body, self.config)
        other = replace(self, body=replace(self.body, agility=agility), losses={})
        better = other.loss(strengths).mean() < self.loss(strengths).mean()
        return other if better else self


def _measure_agility(points: Floats, seen: Detections, body: Body, config: PosesConfig) -> Floats:
    """Return the agility `[keypoint]` of joints; 1 of those that are seldom seen by two views.

    Hands and feet accelerate more than the trunk. It is the square root of a joint's median
    acceleration, beyond what all joints share, over the geometric mean of these medians: the root,
    because noise of the detectors is in them, too.

    points: `[keypoint, frame, 3]` of a fit.
    """
    acceleration = own_accelerations(points, body, config)
    ends = acceleration.shape[1]
    size = np.sqrt((acceleration**2).sum(-1)) / body.size[:ends]
    counted = ((seen.precision > 0).sum(0) >= 2)[:, :ends] & (body.steps[0, :ends] != 0)
    enough = counted.sum(1) >= _FRAMES_OF_A_JOINT
    agility = np.ones(len(points))
    if not enough.any():
        return agility
    known = [np.median(each[own]) for each, own in zip(size[enough], counted[enough], strict=True)]
    told = np.log(np.maximum(known, np.finfo(float).tiny))
    agility[enough] = np.exp((told - told.mean()) / 2)
    return agility.clip(1 / _LARGEST_AGILITY, _LARGEST_AGILITY)


def choose_trust(
    points: Floats,
    seen: Detections,
    body: Body,
    noise: Floats,
    config: PosesConfig,
    *,
    moves: bool,
) -> Trust:
    """Return how much confidences tell of the errors of hidden detections.

    points, seen, body, moves: as for `choose_strengths`. noise: `[view]` in radians.
    """
    confidence = seen.precision * noise[:, None, None] ** 2
    there = confidence > 0
    usual = float(np.exp(np.log(confidence[there]).mean())) if there.any() else 1.0
    hidden = _hide(seen)
    few = hidden.sum() < config.least_hidden
    if few or np.ptp(np.log(confidence[hidden])) < _ALIKE:
        return Trust(1.0, usual)
    shown = replace(seen, precision=np.where(hidden, 0.0, seen.precision))
    strengths = usual_strengths(points, seen, body, config, moves=moves)
    found = fit(points, shown, body, strengths, config, steps=config.choice_steps)
    square = squared_errors_at(found, seen, np.array(np.nonzero(hidden))) / confidence[hidden]
    return measure_trust(square, confidence[hidden], usual)


def error_of_mean(values: Floats, run: Ints) -> float:
    """Return the standard error of the mean of values `[N]`, which go together in runs.

    run: `[N]` the number of the run that each belongs to.
    """
    off = np.bincount(run, values - values.mean())
    return float(np.sqrt((off**2).sum()) / len(values))


def _until_worse(
    candidates: list[Strengths], loss: Callable[[Strengths], float]
) -> Iterator[Strengths]:
    """Yield candidates until the loss has risen twice in a row."""
    before, rises = np.inf, 0
    for each in candidates:
        yield each
        now = loss(each)
        rises = rises + 1 if now > before else 0
        before = now
        if rises == 2:
            return


def usual_strengths(
    points: Floats, seen: Detections, body: Body, config: PosesConfig, *, moves: bool = True
) -> Strengths:
    """Return strengths without held-out detections: weak ones.

    Accelerations are allowed that are as large as those of the points, noise and all; where even
    these are too large for one motion, frames do not follow each other.
    """
    acceleration = accelerations(points, body)
    ends = acceleration.shape[1]
    size = np.sqrt((acceleration**2).sum(-1)) / body.size[:ends]
    there = (seen.precision > 0).sum(0) >= 2
    counted = np.all([there[:, k : k + ends] for k in range(3)], axis=0)
    counted &= body.steps[0, :ends] != 0
    sigma = float(np.median(size[counted])) / _MEDIAN_LENGTH if counted.any() else np.inf
    follow = moves and sigma < config.largest_acceleration
    allowed = sigma if follow else np.inf
    bones = config.usual_bones if len(body.edges) else np.inf
    return Strengths(max(allowed, config.accelerations[-1]), bones, config.losses[0])


def _hide(seen: Detections) -> Bools:
    """Return which detections `[view, keypoint, frame]` are hidden: two of each point stay.

    Of all points that three views or more see, one view is hidden, so that chance has little say in
    what is chosen. Measured: with 0.3, 0.5 and 0.7 of these the errors of HumanEva were 15.5, 14.8
    and 15.0 mm, with all of them 14.7 mm.
    """
    there = seen.precision > 0
    views, joints, frames = there.shape
    rng = np.random.default_rng(_SEED)
    runs = rng.integers(0, views, size=(joints, frames // _RUN + 1))
    chosen = runs.repeat(_RUN, axis=1)[:, :frames] == np.arange(views)[:, None, None]
    return chosen & there & (there.sum(0) >= _VIEWS)
