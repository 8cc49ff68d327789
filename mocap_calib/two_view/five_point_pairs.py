"""Calibrate pairs by the five-point baseline, for the pipeline; no network is needed."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import FivePointConfig, PairwiseConfig
from mocap_calib.two_view.five_point import five_point_over_matches
from mocap_calib.two_view.solve import PairProblem, judge_pair
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
        focal = float(self.focal[[problem.a, problem.b]].mean())
        found = five_point_over_matches(
            pair.a.rays_or_nan,
            pair.b.rays_or_nan,
            self.config.inlier_px / focal,
            problem.rng,
            config=self.config,
        )
        if found is None or not len(found.matches):
            return None
        matched = np.zeros(pair.overlap.lifted.shape, dtype=bool)
        frame, i, j = found.matches.T
        matched[frame, i, j] = True
        return judge_pair(
            problem,
            rotation=found.rotation,
            translation=found.translation,
            matched=matched,
            source="five-point",
            config=self.pairwise,
        )
