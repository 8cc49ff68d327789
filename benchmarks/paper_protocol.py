"""Run the paper's protocol: two views, single frames, identities unknown.

    .venv/bin/python benchmarks/paper_protocol.py two-view
        --poses ../shared/poses3d/human_body29.npz
    .venv/bin/python benchmarks/paper_protocol.py two-view --scenarios 1x5 --wrong 0.3
        --methods five-point five-point-opencv
    .venv/bin/python benchmarks/paper_protocol.py ablation | multi-view --poses ...
    .venv/bin/python benchmarks/paper_protocol.py detectors --recordings ../shared/recordings

Prints Markdown. Poses are of held-out subjects; references are read here, never by the methods.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from protocol_methods import METHODS, Found, Problem, load_models
from protocol_scenes import KINDS, Subjects, Truth, misplace, scene

from mocap_calib.config import Config
from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.io.cameras.read import read_cameras, read_rig
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.multi_view.triangulation import triangulate
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.steerpose.loading import load_lifter
from mocap_calib.types import CameraRig, silent

NOISE_PX = 3.0
FAILED = 180.0  # degrees: what no answer counts as


@dataclass(frozen=True)
class Judged:
    """Errors `[pair]` in degrees, matching precision, seconds a pair."""

    rotation: np.ndarray
    translation: np.ndarray
    precision: float
    seconds: float


def main() -> None:
    """One table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=["two-view", "ablation", "multi-view", "detectors"])
    parser.add_argument(
        "--poses",
        type=Path,
        default=Path("../shared/poses3d"),
        help="folder with the sets of poses",
    )
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=["people"])
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings"))
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument(
        "--token-pairs",
        type=int,
        default=100,
        help="the first so many for the token network, which takes long",
    )
    parser.add_argument(
        "--scenarios", nargs="*", default=["1x1", "4x1", "1x5", "4x5"], help="subjects x frames"
    )
    parser.add_argument(
        "--wrong",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="of the points of the second view, which change places with each other",
    )
    parser.add_argument("--methods", nargs="*", help="default: those of the table")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    {"two-view": two_view, "ablation": ablation, "multi-view": multi_view, "detectors": detectors}[
        options.table
    ](options)


def two_view(options: argparse.Namespace) -> None:
    """Print the paper's Tables 1 and 2."""
    methods = options.methods or [
        "five-point",
        "five-point-opencv",
        "magsac",
        "paper-token",
        "paper-factorised",
        "ours",
    ]
    _synthetic(options, methods)


def ablation(options: argparse.Namespace) -> None:
    """Print the paper's Table 3: with and without the geometric loss.

    Ours with and without the refinement on rays.
    """
    methods = options.methods or [
        "paper-factorised-nogeom",
        "paper-factorised",
        "ours-norays",
        "ours",
    ]
    _synthetic(options, methods)


def _synthetic(options: argparse.Namespace, methods: Sequence[str]) -> None:
    header()
    for kind in options.kinds:
        for name in options.scenarios:
            subjects, frames = (int(part) for part in name.split("x"))
            problems, truths = _scenes(
                options, kind, subjects, frames, views=2, scenes=options.pairs
            )
            rows(
                f"{kind}: {subjects}, {frames} frame{'s' if frames > 1 else ''}",
                methods,
                problems,
                truths,
                options,
                model=KINDS[kind].model,
            )


def _scenes(
    options: argparse.Namespace, kind: str, count: int, frames: int, *, views: int, scenes: int
) -> tuple[list[Problem], list[Truth]]:
    subjects = Subjects(options.poses, KINDS[kind])
    made = []
    for k in range(scenes):
        rng = np.random.default_rng([options.seed, count, frames, views, k])
        made.append(
            scene(
                subjects,
                rng,
                count=count,
                frames=frames,
                views=views,
                noise_px=NOISE_PX,
                joints=subjects.joints,
            )
        )
    if options.wrong:
        made = [(misplace(sample, options.wrong), truth) for sample, truth in made]
    return [Problem(recording, 0, 1) for recording, _ in made], [truth for _, truth in made]


def header() -> None:
    """Of the two-view tables."""
    print(
        "| scenario | method | pairs | RRA@20 | RTA@20 | AUC@20 | RRA@30 | RTA@30 | AUC@30 "
        "| median E_R | median E_t | P | s / pair |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|")


def rows(
    label: str,
    methods: Sequence[str],
    problems: list[Problem],
    truths: list[Truth],
    options: argparse.Namespace,
    *,
    model: str = "people",
) -> None:
    """One row a method."""
    models = load_models(methods, model)
    for method in methods:
        count = min(len(problems), options.token_pairs) if "token" in method else len(problems)
        found, seconds = METHODS[method](problems[:count], models)
        judged = judge(found, problems[:count], truths[:count], seconds)
        print(f"| {label} | {method} | {count} | {figures(judged)} |", flush=True)


def judge(
    found: Sequence[Found | None],
    problems: Sequence[Problem],
    truths: Sequence[Truth],
    seconds: float,
) -> Judged:
    """Compare with the truth."""
    rotation, translation, right, matched = [], [], 0, 0
    for one, problem, truth in zip(found, problems, truths, strict=True):
        r, t = truth.rig.relative(problem.a, problem.b)
        rotation.append(FAILED if one is None else np.degrees(angle_between(one.rotation, r)))
        translation.append(
            FAILED if one is None else np.degrees(direction_angle(one.translation, t))
        )
        if one is not None and len(one.matches):
            frame, i, j = one.matches.T
            who_a, who_b = truth.ids[problem.a][frame, i], truth.ids[problem.b][frame, j]
            known = (who_a >= 0) & (who_b >= 0)
            right, matched = (
                right + int((known & (who_a == who_b)).sum()),
                matched + int(known.sum()),
            )
    return Judged(np.array(rotation), np.array(translation), right / max(matched, 1), seconds)


def auc(rotation: np.ndarray, translation: np.ndarray, tau: int) -> float:
    """Area under min(RRA, RTA) over the thresholds 1..tau degrees."""
    return float(
        np.mean([min((rotation < t).mean(), (translation < t).mean()) for t in range(1, tau + 1)])
    )


def figures(judged: Judged) -> str:
    """Return the columns of a row."""
    r, t = judged.rotation, judged.translation
    shares = [
        f"{(r < tau).mean():.2f} | {(t < tau).mean():.2f} | {auc(r, t, tau):.3f}"
        for tau in (20, 30)
    ]
    errors = f"{np.median(r):.2f} | {np.median(t):.2f}"
    return f"{' | '.join(shares)} | {errors} | {judged.precision:.3f} | {judged.seconds:.3g}"


def multi_view(options: argparse.Namespace) -> None:
    """Print the paper's Table 5: four cameras, after averaging and after adjustment.

    20 frames a scene.
    """
    lifter, _ = load_lifter()
    config = Config()
    print("| people | scenes | stage | E_R | E_t | E_2D (px) |")
    print("|---|---|---|---|---|---|")
    for people in (1, 4):
        problems, truths = _scenes(
            options, "people", people, 20, views=4, scenes=min(options.pairs, 10)
        )
        stages: dict[str, list[tuple[float, float, float]]] = {"averaging": [], "adjustment": []}
        for problem, truth in zip(problems, truths, strict=True):
            done = calibrate(
                problem.recording, lifter, config, seed=0, device="cpu", progress=silent
            ).groups[0]
            before = triangulate(
                done.recording, done.averaged.rig, done.matches, config.triangulate, progress=silent
            )
            stages["averaging"].append(
                (*rig_errors(done.averaged.rig, truth.rig), float(np.nanmedian(before.error)))
            )
            stages["adjustment"].append(
                (*rig_errors(done.rig, truth.rig), float(np.nanmedian(done.poses.error)))
            )
        for stage, found in stages.items():
            middle = np.median(np.array(found), axis=0)
            print(
                f"| {people} | {len(found)} | {stage} "
                f"| {middle[0]:.2f} | {middle[1]:.2f} | {middle[2]:.2f} |",
                flush=True,
            )


def rig_errors(found: CameraRig, truth: CameraRig) -> tuple[float, float]:
    """Median E_R and E_t in degrees over the pairs of a rig."""
    rotation, translation = [], []
    for a, b in combinations(range(len(truth.cameras)), 2):
        (r, t), (s, u) = (rig.relative(a, b) for rig in (found, truth))
        rotation.append(np.degrees(angle_between(r, s)))
        translation.append(np.degrees(direction_angle(t, u)))
    return float(np.median(rotation)), float(np.median(translation))


def detectors(options: argparse.Namespace) -> None:
    """Judge single frames of real recordings, two views at a time.

    Frames where two people, or all there are, share both views.
    """
    header()
    for name in ("shelf", "h36m_S5_multi3", "mvor_openpose"):
        problems, truths = _real_pairs(options.recordings / name, options.pairs, options.seed)
        rows(
            name,
            options.methods or ["five-point", "magsac", "paper-token", "paper-factorised", "ours"],
            problems,
            truths,
            options,
        )


def _real_pairs(folder: Path, count: int, seed: int) -> tuple[list[Problem], list[Truth]]:
    """Return pairs of views and frames in which at least two known people are in both views.

    One person where no frame has more.
    """
    files = read_keypoints([folder / "keypoints"])
    recording = make_recording(
        files, read_cameras(folder / "intrinsics.toml"), load_skeleton("people"), {}
    )
    rig = read_rig(folder / "reference.toml")
    order = [rig.names.index(name) for name in recording.names]
    ids = np.load(folder / "truth.npz")["ids"][order]
    padded = np.full(recording.positions.shape[:3], -1)
    known = recording.frames < ids.shape[1]
    width = min(ids.shape[2], padded.shape[2])
    padded[:, known, :width] = ids[:, recording.frames[known], :width]
    padded[recording.seen.sum(-1) < 4] = -1
    choices = []
    for a, b in combinations(range(len(order)), 2):
        same = (padded[a][:, :, None] == padded[b][:, None]) & (padded[a][:, :, None] >= 0)
        shared = same.any(-1).sum(-1)
        choices += [(a, b, int(f)) for f in np.flatnonzero(shared >= min(2, shared.max(initial=1)))]
    rng = np.random.default_rng(seed)
    problems, truths = [], []
    for k in rng.permutation(len(choices))[:count]:
        a, b, f = choices[k]
        chosen = recording.select(frames=np.array([f]), views=np.array([a, b]))
        one = take_sample(chosen, slice(None))
        problems.append(Problem(one, 0, 1))
        views = [order[a], order[b]]
        truths.append(
            Truth(
                CameraRig(one.cameras, rig.rotation[views], rig.translation[views], rig.unit),
                padded[[a, b], f : f + 1],
            )
        )
    return problems, truths


if __name__ == "__main__":
    main()
