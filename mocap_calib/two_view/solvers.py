"""Ways to calibrate a pair of views, by the names that a user gives."""

import numpy as np

from mocap_calib.config import FivePointConfig, PairwiseConfig, PaperConfig
from mocap_calib.steerpose.lifter import Lifter
from mocap_calib.two_view.five_point_pairs import FivePointPairs
from mocap_calib.two_view.solve import PairSolver
from mocap_calib.types import Recording


def choose_pair_solver(
    name: str, recording: Recording, lifter: Lifter, config: PairwiseConfig
) -> PairSolver | None:
    """Return the solver of that name, one of `config.PAIR_SOLVERS`, for the pairs of a recording.

    None stands for "search", the solver of this program. "paper" is the gradient descent of the
    paper, "five-point" its baseline; what they find is scored as the hypotheses of "search" are.
    """
    if name == "search":
        return None
    focal = np.array([camera.focal for camera in recording.cameras])
    if name == "five-point":
        return FivePointPairs(focal=focal, pairwise=config, config=FivePointConfig())
    from mocap_calib.steerpose.model import module_of  # noqa: PLC0415 - torch: over a second
    from mocap_calib.two_view.paper_pairs import PaperPairs  # noqa: PLC0415

    return PaperPairs(
        model=module_of(lifter),
        vocabulary=recording.vocabulary,
        focal=focal,
        pairwise=config,
        config=PaperConfig(),
    )
