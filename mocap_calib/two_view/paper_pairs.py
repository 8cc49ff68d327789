"""Pairs as the paper calibrates them, for the pipeline: its solver in place of our search, our yardstick on what it finds."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PairwiseConfig, PaperConfig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.steerpose.paper.batch import TwoViews
from mocap_calib.steerpose.paper.solver import seeded_generator, solve_pair
from mocap_calib.steerpose.rays import rays_by_joint
from mocap_calib.steerpose.steer import Model
from mocap_calib.two_view.affinity import ViewPair
from mocap_calib.two_view.solve import PairProblem, judge_pair
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
        chosen = evenly_spaced(np.arange(len(pair.frames)), self.config.frames)
        generator = seeded_generator(int(problem.rng.integers(2**62)))
        found = solve_pair(
            self._views(pair, chosen, problem.a, problem.b), self.model, self.config, generator
        )
        if not len(found.matches):
            return None
        matched = np.zeros(pair.lifted.shape, dtype=bool)
        frame, i, j = found.matches.T
        matched[chosen[frame], i, j] = True
        return judge_pair(
            problem, found.rotation, found.translation, matched, "paper", self.pairwise
        )

    def _views(self, pair: ViewPair, frames: Ints, a: int, b: int) -> TwoViews:
        """The rays of both views in the joints of the model, NaN where it sees none."""
        sides = ((pair.rays_a, pair.weight_a), (pair.rays_b, pair.weight_b))
        seen = (
            np.where(weight[frames][..., None] > 0, rays[frames], np.nan) for rays, weight in sides
        )
        joints = self.model.config.joints
        first, second = (rays_by_joint(rays, self.vocabulary, joints) for rays in seen)
        return TwoViews(first, second, float(self.focal[[a, b]].mean()))
