"""The methods of the paper's protocol, all called alike: problems -> answers, seconds a pair."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from mocap_calib.config import FIVE_POINT_CONFIDENCE, LEAST_FORWARD, PairwiseConfig
from mocap_calib.geometry.epipolar import pose_from_essential
from mocap_calib.lift import lift, rays_by_joint
from mocap_calib.lift.lifter import Lifter
from mocap_calib.pairs.solve import calibrate_pair
from mocap_calib.pairs.view_pair import gather_view_pair
from mocap_calib.paper.five_point import (
    FIVE_POINT_LEAST_JOINTS,
    Estimator,
    FivePointConfig,
    Found,
    RelativePose,
    estimate_by_loransac,
    five_point_over_matches,
    match_by_pose,
)
from mocap_calib.paper.solver import PaperConfig, TwoViews, solve_pairs
from mocap_calib.recording.joints import SHIPPED, load_skeleton, match_names
from mocap_calib.results import LiftedPoses
from mocap_calib.training.model import LifterModule, Model, load_steerer
from mocap_calib.types import Bools, Floats, Sample, Skeleton, silent

from .full_system import full_geometric_loss
from .rivals import LiftedPair, adjust, lifted_pair, procrustes, sphere

TIMED = 1  # pairs that the paper's solver does alone, to know its seconds
BATCH = 50  # of the others


@dataclass(frozen=True)
class Problem:
    """Views a and b of a recording, all of its frames.

    identities: `[frame, I, J]` matches, for methods `...-informed` alone.
    """

    recording: Sample
    a: int
    b: int
    identities: Bools | None = None


Answers = tuple[list[Found | None], float]
Method = Callable[[Sequence[Problem], dict[str, Model]], Answers]


def load_models(methods: Sequence[str], skeleton: str = "people") -> dict[str, Model]:
    """Load the shipped networks that these methods need: not all skeletons have rotation tokens."""
    models: dict[str, Model] = {"factorised": load_steerer(skeleton)[0]}
    if any("token" in method for method in methods):
        models["token"] = load_steerer(f"{skeleton}_token")[0]
    return models


def lifter_of(module: LifterModule) -> Lifter:
    """Return what a module has learnt, without torch."""
    return Lifter(module.config, {name: each.numpy() for name, each in module.state_dict().items()})


def _each(problems: Sequence[Problem], solve: Callable[[Problem], Found | None]) -> Answers:
    """Solve each problem by itself, and take the time."""
    start = time.perf_counter()
    found = [solve(problem) for problem in problems]
    return found, (time.perf_counter() - start) / len(problems)


def _threshold(problem: Problem) -> float:
    """Return the inlier threshold of RANSAC in radians: two standard deviations of the noise."""
    focals = [problem.recording.cameras[view].focal for view in (problem.a, problem.b)]
    return FivePointConfig().inlier_px / float(np.mean(focals))


def five_point(estimator: Estimator) -> Method:
    """Run RANSAC over instance matches, five-point on joints."""

    def solve(problem: Problem) -> Found | None:
        rays_a, rays_b = _rays(problem)
        rng = np.random.default_rng(0)
        return five_point_over_matches(
            rays_a, rays_b, _threshold(problem), rng, estimator=estimator
        )

    return lambda problems, _: _each(problems, solve)


def all_pairs(estimator: Estimator) -> Method:
    """Run RANSAC on the joints of all pairs of detections of a frame."""

    def solve(problem: Problem) -> Found | None:
        rays_a, rays_b = _rays(problem)
        threshold = _threshold(problem)
        shape = np.broadcast_shapes(rays_a[:, :, None].shape, rays_b[:, None].shape)
        every_a = np.broadcast_to(rays_a[:, :, None], shape).reshape(-1, 3)
        every_b = np.broadcast_to(rays_b[:, None], shape).reshape(-1, 3)
        forward = (np.stack([every_a[:, 2], every_b[:, 2]]) > LEAST_FORWARD).all(0)
        trials = FivePointConfig().ransac_iterations
        pose = estimator(every_a[forward], every_b[forward], threshold, trials)
        if pose is None:
            return None
        return Found(*pose, np.argwhere(match_by_pose(rays_a, rays_b, pose, threshold)))

    return lambda problems, _: _each(problems, solve)


def estimate_by_magsac(
    rays_a: Floats, rays_b: Floats, threshold: float, trials: int
) -> RelativePose | None:
    """Return the relative pose by OpenCV's MAGSAC++."""
    if len(rays_a) < FIVE_POINT_LEAST_JOINTS:
        return None
    model, mask = cv2.findEssentialMat(
        rays_a[:, :2] / rays_a[:, 2:],
        rays_b[:, :2] / rays_b[:, 2:],
        np.eye(3),
        method=cv2.USAC_MAGSAC,
        prob=FIVE_POINT_CONFIDENCE,
        threshold=threshold,
        maxIters=trials,
    )
    if model is None or model.shape != (3, 3) or not np.any(mask):
        return None
    inlier = mask.ravel() > 0
    return pose_from_essential(np.asarray(model), rays_a[inlier], rays_b[inlier])


def _rays(problem: Problem) -> tuple[Floats, Floats]:
    """Return the rays of both views, `[frame, I | J, keypoint, 3]`."""
    rays = problem.recording.rays
    return rays[problem.a], rays[problem.b]


def _lifting(solve: Callable[[Problem, LiftedPoses], Found | None]) -> Method:
    """Return a method of lifted bodies; its seconds include the lifting."""

    def method(problems: Sequence[Problem], models: dict[str, Model]) -> Answers:
        module = models["factorised"]
        assert isinstance(module, LifterModule)
        lifter = lifter_of(module)
        return _each(
            problems, lambda each: solve(each, lift(each.recording, lifter, progress=silent))
        )

    return method


def ours(config: PairwiseConfig) -> Method:
    """Search and refine, as `mocap-calib pairwise` does."""

    def solve(problem: Problem, lifted: LiftedPoses) -> Found | None:
        views, rng = (problem.a, problem.b), np.random.default_rng(0)
        gathered = gather_view_pair(problem.recording, lifted, views, config=config, rng=rng)
        found = calibrate_pair(gathered, config)
        return None if found is None else Found(found.rotation, found.translation, found.matches)

    return _lifting(solve)


Rival = Callable[[LiftedPair, Bools | None], Found | None]


def rival(register: Rival, *, adjusted: bool, informed: bool = False) -> Method:
    """Register lifted bodies. informed: identities are given."""

    def solve(problem: Problem, lifted: LiftedPoses) -> Found | None:
        sample = problem.recording
        pair = lifted_pair(sample, lifted, _skeleton_of(sample), problem.a, problem.b)
        if informed and problem.identities is None:
            raise ValueError("expected problems with identities, found one without")
        found = register(pair, problem.identities if informed else None)
        return adjust(pair, found) if found is not None and adjusted else found

    return _lifting(solve)


def _skeleton_of(recording: Sample) -> Skeleton:
    """Return the shipped skeleton whose joints a recording's vocabulary means."""
    for skeleton in map(load_skeleton, SHIPPED):
        if np.array_equal(match_names(recording.keypoints, skeleton), recording.vocabulary):
            return skeleton
    raise ValueError("expected a recording with the joints of a shipped skeleton, found others")


def _two_views(problem: Problem, joints: int) -> TwoViews:
    """Return the detections of the two views, in the order of the model's joints."""
    recording = problem.recording
    rays_a, rays_b = (
        rays_by_joint(recording.rays[view], recording.vocabulary, joints)
        for view in (problem.a, problem.b)
    )
    focal = (recording.cameras[problem.a].focal + recording.cameras[problem.b].focal) / 2
    return TwoViews(rays_a, rays_b, focal)


def _as_many_instances(views: Sequence[TwoViews]) -> list[TwoViews]:
    """Return problems with equal numbers of instances: those that are added show nothing."""
    most_a = max((each.rays_a.shape[1] for each in views), default=0)
    most_b = max((each.rays_b.shape[1] for each in views), default=0)

    def filled(rays: Floats, most: int) -> Floats:
        """Return rays `[frame, instance, joint, 3]` of so many instances."""
        nobody = (0, most - rays.shape[1])
        return np.pad(rays, ((0, 0), nobody, (0, 0), (0, 0)), constant_values=np.nan)

    return [
        replace(each, rays_a=filled(each.rays_a, most_a), rays_b=filled(each.rays_b, most_b))
        for each in views
    ]


def paper(architecture: str, config: PaperConfig) -> Method:
    """Solve by the paper's solver; its seconds are those of pairs solved alone."""

    def method(problems: Sequence[Problem], models: dict[str, Model]) -> Answers:
        model = models[architecture]
        views = [_two_views(problem, model.config.joints) for problem in problems]
        start = time.perf_counter()
        for k in range(min(TIMED, len(views))):
            solve_pairs(views[k : k + 1], model, config, torch.Generator().manual_seed(k))
        seconds = (time.perf_counter() - start) / max(min(TIMED, len(views)), 1)
        generator = torch.Generator().manual_seed(0)
        alike = _as_many_instances(views)
        found = [
            s
            for k in range(0, len(views), BATCH)
            for s in solve_pairs(alike[k : k + BATCH], model, config, generator)
        ]
        return [Found(s.rotation, s.translation, s.matches) for s in found], seconds

    return method


METHODS: dict[str, Method] = {
    "five-point": five_point(estimate_by_loransac),
    "all-pairs": all_pairs(estimate_by_loransac),
    "five-point-magsac": five_point(estimate_by_magsac),
    "magsac": all_pairs(estimate_by_magsac),
    "procrustes-adjusted": rival(procrustes, adjusted=True),
    "sphere": rival(sphere, adjusted=False),
    "sphere-adjusted": rival(sphere, adjusted=True),
    "paper-token": paper("token", PaperConfig()),
    "paper-token-full": paper("token", PaperConfig(geometric_loss=full_geometric_loss)),
    "paper-token-nogeom": paper("token", PaperConfig(geometric_weight=0.0)),
    "paper-factorised": paper("factorised", PaperConfig()),
    "paper-factorised-full": paper("factorised", PaperConfig(geometric_loss=full_geometric_loss)),
    "paper-factorised-nogeom": paper("factorised", PaperConfig(geometric_weight=0.0)),
    "ours": ours(PairwiseConfig()),
    "ours-norays": ours(replace(PairwiseConfig(), loss_widths=())),
    # these are given the identities (`Problem.identities`); the others are not
    "procrustes-adjusted-informed": rival(procrustes, adjusted=True, informed=True),
    "sphere-adjusted-informed": rival(sphere, adjusted=True, informed=True),
}
