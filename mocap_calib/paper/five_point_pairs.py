"""Calibrate pairs by the five-point baseline, for the pipeline; no network is needed."""

from dataclasses import dataclass

from mocap_calib.config import FivePointConfig, PairwiseConfig
from mocap_calib.pairs.solve import PairProblem, judge_pair, mean_focal
from mocap_calib.paper.five_point import five_point_over_matches
from mocap_calib.types import Floats, PairwiseCalibration


@dataclass(frozen=True)
class FivePointPairs:
    """A `solve.PairSolver`: RANSAC over matches of detections, five-point on their joints.

    What it finds is scored as any other relative pose. focal: `[view]` pixels.
    """

    focal: Floats
    pairwise: PairwiseConfig
    config: FivePointConfig

    def __call__(self, problem: PairProblem) -> PairwiseCalibration | None:
        """Return the relative pose with most inliers, or None where nothing is matched."""
        pair = problem.pair
        if problem.shared_frames == 0:
            return None
        focal = mean_focal(problem, self.focal)
        found = five_point_over_matches(
            pair.a.rays_or_nan,
            pair.b.rays_or_nan,
            self.config.inlier_px / focal,
            problem.rng,
            config=self.config,
        )
        if found is None:
            return None
        return judge_pair(
            problem,
            rotation=found.rotation,
            translation=found.translation,
            matches=found.matches,
            source="five-point",
            config=self.pairwise,
        )
