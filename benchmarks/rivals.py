"""Compare ours with the rivals of today on the pairs of the paper's protocol.

    .venv/bin/python benchmarks/rivals.py --poses ../shared/poses3d
    .venv/bin/python benchmarks/rivals.py --kinds dog --scenarios 4x1 --methods ours sphere

Prints Markdown: AUC@20 with its 95 % interval, from 2,000 resamples of the pairs. Methods whose
name ends in `-informed` are told who is who.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from protocol_methods import INFORMED, METHODS, Answers, Problem, load_models
from protocol_scenes import KINDS, Subjects, Truth, scene

from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.types import Floats

NOISE_PX = 3.0
FAILED = 180.0  # degrees: what no answer counts as
RESAMPLES = 2000
THRESHOLD = 20  # degrees
COMPARED = (
    *("five-point", "five-point-opencv", "five-point-magsac", "magsac"),
    *(name for name in METHODS if name.startswith(("procrustes", "sphere"))),
    *INFORMED,
    "ours-norays",
    "ours",
)


def main() -> None:
    """Print the table, a row as soon as it is measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--poses", type=Path, required=True, help="folder with the sets of 3D poses"
    )
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=["people", "dog", "cheetah"])
    parser.add_argument("--scenarios", nargs="*", default=["1x1", "4x1"], help="subjects x frames")
    parser.add_argument("--methods", nargs="*", choices=(*METHODS, *INFORMED), default=COMPARED)
    parser.add_argument("--pairs", type=int, default=100)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        "| scenario | method | pairs | RRA@20 | RTA@20 | AUC@20 | 95 % | median E_R | median E_t "
        "| P | s / pair |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for kind in options.kinds:
        for scenario in options.scenarios:
            problems, truths = scenes(options.poses, kind, scenario, options.pairs)
            models = load_models(["ours"], KINDS[kind].model)
            for name in options.methods:
                answers = {**METHODS, **INFORMED}[name](problems, models)
                cells = _cells(answers, problems, truths)
                print(f"| {kind} {scenario} | {name} | {len(problems)} | {cells} |", flush=True)


def scenes(folder: Path, kind: str, scenario: str, count: int) -> tuple[list[Problem], list[Truth]]:
    """Return the first pairs of views of a scenario of the protocol, and the truth about them."""
    subjects = Subjects(folder, KINDS[kind])
    bodies, frames = (int(part) for part in scenario.split("x"))
    problems, truths = [], []
    for k in range(count):
        rng = np.random.default_rng([0, bodies, frames, 2, k])
        sample, truth = scene(
            subjects,
            rng,
            count=bodies,
            frames=frames,
            views=2,
            noise_px=NOISE_PX,
            joints=subjects.joints,
        )
        same = truth.ids[0][:, :, None] == truth.ids[1][:, None]
        known = truth.ids[0][:, :, None] >= 0
        problems.append(replace(Problem(sample, 0, 1), identities=same & known))
        truths.append(truth)
    return problems, truths


def _cells(answers: Answers, problems: list[Problem], truths: list[Truth]) -> str:
    """Return the figures of a row."""
    errors = np.full((len(problems), 2), FAILED)
    right = matched = 0
    for k, (found, problem, truth) in enumerate(zip(answers[0], problems, truths, strict=True)):
        if found is None:
            continue
        rotation, translation = truth.rig.relative(problem.a, problem.b)
        errors[k] = np.degrees(
            [
                angle_between(found.rotation, rotation),
                direction_angle(found.translation, translation),
            ]
        )
        assert problem.identities is not None
        right += int(problem.identities[tuple(found.matches.T)].sum())
        matched += len(found.matches)
    below = (errors < THRESHOLD).mean(0)
    drawn = np.random.default_rng(0).integers(len(errors), size=(RESAMPLES, len(errors)))
    low, high = np.percentile([auc(errors[k]) for k in drawn], [2.5, 97.5])
    median = np.median(errors, axis=0)
    return (
        f"{below[0]:.2f} | {below[1]:.2f} | {auc(errors):.3f} | {low:.3f} to {high:.3f} "
        f"| {median[0]:.2f} | {median[1]:.2f} | {right / max(matched, 1):.3f} | {answers[1]:.2g}"
    )


def auc(errors: Floats) -> float:
    """Return the area under min(RRA, RTA) of errors `[pair, 2]` over 1 .. 20 degrees."""
    thresholds = np.arange(1, THRESHOLD + 1)
    return float((errors[None] < thresholds[:, None, None]).mean(1).min(-1).mean())


if __name__ == "__main__":
    main()
