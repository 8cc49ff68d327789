"""Calibrate pairs as the paper does, for the pipeline.

Its solver takes the place of our search; what it finds is scored as ours is.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PairwiseConfig, PaperConfig
from mocap_calib.lift.lift import rays_by_joint
from mocap_calib.pairs.solve import PairProblem, judge_pair, mean_focal
from mocap_calib.paper.batch import TwoViews
from mocap_calib.paper.solver import seeded_generator, solve_pair
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.training.device import torch_threads
from mocap_calib.training.steer import Model
from mocap_calib.types import Floats, Ints, PairwiseCalibration


@dataclass(frozen=True)
class PaperPairs:
    """A `solve.PairSolver`: gradient descent through a network from random rotations.

    vocabulary: `[keypoint]` index of each keypoint in the model's joints, -1 = none.
    focal: `[view]` pixels.
    """

    model: Model
    vocabulary: Ints
    focal: Floats
    pairwise: PairwiseConfig
    config: PaperConfig

    def __call__(self, problem: PairProblem) -> PairwiseCalibration | None:
        """Return the relative pose that the descent ends in, or None where nothing is matched."""
        if problem.shared_frames == 0:
            return None
        frames = evenly_spaced(np.arange(len(problem.pair.frames)), self.config.frames)
        generator = seeded_generator(int(problem.rng.integers(2**62)))
        with torch_threads(1):
            found = solve_pair(self._two_views(problem, frames), self.model, self.config, generator)
        frame, instances = found.matches[:, 0], found.matches[:, 1:]
        return judge_pair(
            problem,
            rotation=found.rotation,
            translation=found.translation,
            matches=np.column_stack([frames[frame], instances]),
            source="paper",
            config=self.pairwise,
        )

    def _two_views(self, problem: PairProblem, frames: Ints) -> TwoViews:
        """Return the rays of both views in the joints of the model, in some of the frames."""
        pair, joints = problem.pair, self.model.config.joints
        rays_a = rays_by_joint(pair.a.rays_or_nan[frames], self.vocabulary, joints)
        rays_b = rays_by_joint(pair.b.rays_or_nan[frames], self.vocabulary, joints)
        return TwoViews(rays_a, rays_b, mean_focal(problem, self.focal))
