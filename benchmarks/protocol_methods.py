"""The methods of the paper's protocol, all called alike: problems -> answers, seconds a pair."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from mocap_calib.config import FivePointConfig, PairwiseConfig, PaperConfig
from mocap_calib.steerpose.checkpoint import load_steerer
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.model import Lifter
from mocap_calib.steerpose.paper.batch import TwoViews
from mocap_calib.steerpose.paper.solver import solve_pair, solve_pairs
from mocap_calib.steerpose.rays import rays_by_joint
from mocap_calib.steerpose.steer import Model
from mocap_calib.two_view.five_point import Found, all_pairs_magsac, five_point_over_matches
from mocap_calib.two_view.solve import calibrate_pair, pair_problem
from mocap_calib.types import Sample, silent

TIMED = 3  # pairs that the paper's solver does alone, to know its seconds
BATCH = 50  # of the others


@dataclass(frozen=True)
class Problem:
    """Views a and b of a recording, all of its frames."""

    recording: Sample
    a: int
    b: int


Answers = tuple[list[Found | None], float]
Method = Callable[[Sequence[Problem], dict[str, Model]], Answers]


def load_models(methods: Sequence[str], skeleton: str = "people") -> dict[str, Model]:
    """Load the shipped networks that these methods need; rotation tokens are for people alone."""
    models: dict[str, Model] = {"factorised": load_steerer(skeleton)[0]}
    if any("token" in method for method in methods):
        models["token"] = load_steerer(skeleton, architecture="token")[0]
    return models


def _each(problems: Sequence[Problem], solve: Callable[[Problem], Found | None]) -> Answers:
    """Solve each problem by itself, and take the time."""
    start = time.perf_counter()
    found = [solve(problem) for problem in problems]
    return found, (time.perf_counter() - start) / len(problems)


def _threshold(problem: Problem) -> float:
    """Return the inlier threshold of RANSAC in radians: two standard deviations of the noise."""
    focals = [problem.recording.cameras[view].focal for view in (problem.a, problem.b)]
    return FivePointConfig().inlier_px / float(np.mean(focals))


def five_point(problems: Sequence[Problem], _: dict[str, Model]) -> Answers:
    """Run RANSAC over instance matches, five-point on joints."""

    def solve(problem: Problem) -> Found | None:
        rays = problem.recording.rays
        return five_point_over_matches(
            rays[problem.a], rays[problem.b], _threshold(problem), np.random.default_rng(0)
        )

    return _each(problems, solve)


def magsac(problems: Sequence[Problem], _: dict[str, Model]) -> Answers:
    """Run MAGSAC on all cross pairs of detections."""

    def solve(problem: Problem) -> Found | None:
        rays = problem.recording.rays
        return all_pairs_magsac(rays[problem.a], rays[problem.b], _threshold(problem))

    return _each(problems, solve)


def ours(config: PairwiseConfig) -> Method:
    """Lift and search, as `mocap-calib pairwise` does; the seconds include the lifting."""

    def method(problems: Sequence[Problem], models: dict[str, Model]) -> Answers:
        lifter = models["factorised"]
        assert isinstance(lifter, Lifter)

        def solve(problem: Problem) -> Found | None:
            lifted = lift(problem.recording, lifter, progress=silent)
            gathered = pair_problem(
                problem.recording,
                lifted,
                problem.a,
                problem.b,
                config=config,
                rng=np.random.default_rng(0),
            )
            found = calibrate_pair(gathered, config)
            if found is None:
                return None
            return Found(found.rotation, found.translation, found.matches)

        return _each(problems, solve)

    return method


def _two_views(problem: Problem, joints: int) -> TwoViews:
    """Return the detections of the two views, in the order of the model's joints."""
    recording = problem.recording
    rays_a, rays_b = (
        rays_by_joint(recording.rays[view], recording.vocabulary, joints)
        for view in (problem.a, problem.b)
    )
    focal = (recording.cameras[problem.a].focal + recording.cameras[problem.b].focal) / 2
    return TwoViews(rays_a, rays_b, focal)


def paper(architecture: str, config: PaperConfig) -> Method:
    """Solve by the paper's solver; its seconds are those of pairs solved alone."""

    def method(problems: Sequence[Problem], models: dict[str, Model]) -> Answers:
        model = models[architecture]
        views = [_two_views(problem, model.config.joints) for problem in problems]
        start = time.perf_counter()
        for k in range(min(TIMED, len(views))):
            solve_pair(views[k], model, config, torch.Generator().manual_seed(k))
        seconds = (time.perf_counter() - start) / max(min(TIMED, len(views)), 1)
        generator = torch.Generator().manual_seed(0)
        found = [
            s
            for k in range(0, len(views), BATCH)
            for s in solve_pairs(views[k : k + BATCH], model, config, generator)
        ]
        return [Found(s.rotation, s.translation, s.matches) for s in found], seconds

    return method


METHODS: dict[str, Method] = {
    "five-point": five_point,
    "magsac": magsac,
    "paper-token": paper("token", PaperConfig()),
    "paper-token-nogeom": paper("token", PaperConfig(geometric_weight=0.0)),
    "paper-factorised": paper("factorised", PaperConfig()),
    "paper-factorised-nogeom": paper("factorised", PaperConfig(geometric_weight=0.0)),
    "ours": ours(PairwiseConfig()),
    "ours-norays": ours(replace(PairwiseConfig(), points=0)),
}
