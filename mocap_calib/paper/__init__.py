"""Reference solvers of pairs of views: the paper's in `solver` (with torch), and its baseline."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.lift.lifter import GEOMETRY_ALONE, Lifter, is_token
from mocap_calib.pairs.solve import PairSolver, judge_pair, mean_focal
from mocap_calib.pairs.view_pair import ViewPair
from mocap_calib.paper.five_point import Found, find_by_five_point
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Floats, Recording


@dataclass(frozen=True)
class ReferencePairs:
    """A `solve.PairSolver` by a reference; what it finds is scored as any other relative pose.

    find: of a problem and the mean focal length of both views, the pose, or None. source: its
        name. focal: `[view]` pixels.
    """

    find: Callable[[ViewPair, float], Found | None]
    source: str
    focal: Floats
    pairwise: PairwiseConfig

    def __call__(self, pair: ViewPair) -> PairwiseCalibration | None:
        """Return the relative pose, or None where nothing is matched."""
        if pair.shared_frames == 0:
            return None
        found = self.find(pair, mean_focal(pair, self.focal))
        if found is None:
            return None
        return judge_pair(pair, **found._asdict(), source=self.source, config=self.pairwise)


def choose_pair_solver(
    name: str, recording: Recording, lifter: Lifter, config: PairwiseConfig
) -> PairSolver | None:
    """Return the solver of that name, one of `config.PAIR_SOLVERS`, for the pairs of a recording.

    None stands for "search", the solver of this program. "paper" is the gradient descent of the
    paper, "five-point" its baseline; what they find is scored as the hypotheses of "search" are.
    The descent is through the network of the recording's model: the lifter, or a rotation token.
    """
    if name == "search":
        return None
    focal = np.array([camera.focal for camera in recording.cameras])
    if name == "five-point":
        return ReferencePairs(find_by_five_point, "five-point", focal, config)
    from mocap_calib.paper.solver import find_by_descent  # noqa: PLC0415 - torch: over 1 s
    from mocap_calib.training.model import load_steerer, module_of  # noqa: PLC0415

    steers_by_token = recording.model != GEOMETRY_ALONE and is_token(recording.model)
    model = load_steerer(recording.model)[0] if steers_by_token else module_of(lifter)
    descend = partial(find_by_descent, model=model, vocabulary=recording.vocabulary)
    return ReferencePairs(descend, "paper", focal, config)
