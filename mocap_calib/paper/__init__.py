"""The paper's solver of pairs of views and its baseline, as references for our own."""

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.lift.lifter import Lifter
from mocap_calib.lift.weights import GEOMETRY_ALONE, is_token
from mocap_calib.pairs.solve import PairSolver
from mocap_calib.paper.five_point import FivePointConfig, FivePointPairs
from mocap_calib.types import Recording


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
        return FivePointPairs(focal=focal, pairwise=config, config=FivePointConfig())
    from mocap_calib.paper.solver import (  # noqa: PLC0415 - torch: over 1 s
        PaperConfig,
        PaperPairs,
    )
    from mocap_calib.training.model import load_steerer, module_of  # noqa: PLC0415

    steers_by_token = recording.model != GEOMETRY_ALONE and is_token(recording.model)
    return PaperPairs(
        model=load_steerer(recording.model)[0] if steers_by_token else module_of(lifter),
        vocabulary=recording.vocabulary,
        focal=focal,
        pairwise=config,
        config=PaperConfig(),
    )
