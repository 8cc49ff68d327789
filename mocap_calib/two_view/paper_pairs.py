"""Pairs as the paper calibrates them, for the pipeline: its solver in place of our search, our yardstick on what it finds."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PairwiseConfig, PaperConfig
from mocap_calib.recording.sampling import evenly
from mocap_calib.steerpose.paper.solver import TwoViews, by_joint, seeded, solve_pair
from mocap_calib.steerpose.steer import Model
from mocap_calib.two_view.solve import PairProblem, judge_pair
from mocap_calib.two_view.view_pair import ViewPair
from mocap_calib.types import Floats, Ints, PairwiseCalibration


@dataclass(frozen=True)
class PaperPairs:
    """A `pairwise.PairSolver`. vocabulary: `[keypoint]` index in the model's joints, -1 = none; focal: `[view]` pixels."""

    model: Model
    vocabulary: Ints
    focal: Floats
    pairwise: PairwiseConfig
    config: PaperConfig

    def __call__(self, problem: PairProblem) -> PairwiseCalibration | None:
        """The relative pose that gradient descent from random rotations ends in, or None where nothing is matched."""
        pair = problem.pair
        if problem.frames == 0:
            return None
        chosen = evenly(np.arange(len(pair.frames)), self.config.frames)
        generator = seeded(int(problem.rng.integers(2**62)))
        found = solve_pair(
            self._views(pair, chosen, problem.a, problem.b), self.model, self.config, generator
        )
        if not len(found.matches):
            return None
        matched = np.zeros(pair.overlap.lifted.shape, dtype=bool)
        frame, i, j = found.matches.T
        matched[chosen[frame], i, j] = True
        return judge_pair(
            problem, found.rotation, found.translation, matched, "paper", self.pairwise
        )

    def _views(self, pair: ViewPair, frames: Ints, a: int, b: int) -> TwoViews:
        """The rays of both views in the joints of the model, NaN where it sees none."""
        sides = ((pair.a.rays, pair.a.weight), (pair.b.rays, pair.b.weight))
        seen = (
            np.where(weight[frames][..., None] > 0, rays[frames], np.nan) for rays, weight in sides
        )
        first, second = (by_joint(rays, self.vocabulary, self.model.config.joints) for rays in seen)
        return TwoViews(first, second, float(self.focal[[a, b]].mean()))
