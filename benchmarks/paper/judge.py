"""Judge answers of the paper's protocol against the truth, which no method sees."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.types import CameraRig, Floats

from .methods import Found, Problem
from .scenes import Truth

FAILED = 180.0  # degrees: what no answer counts as


def judge(
    found: Sequence[Found | None], problems: Sequence[Problem], truths: Sequence[Truth]
) -> tuple[Floats, int, int]:
    """Compare answers, None where a method has none, with the truth.

    Returns E_R and E_t `[pair, 2]` in degrees, how many matches, and how many right ones; matches
    of detections of unknown identity do not count.
    """
    errors = np.full((len(problems), 2), FAILED)
    right = matched = 0
    for k, (one, problem, truth) in enumerate(zip(found, problems, truths, strict=True)):
        if one is None:
            continue
        errors[k] = pair_errors((one.rotation, one.translation), truth.rig, problem.a, problem.b)
        frame, i, j = one.matches.reshape(-1, 3).T
        who_a, who_b = truth.ids[problem.a][frame, i], truth.ids[problem.b][frame, j]
        known = (who_a >= 0) & (who_b >= 0)
        matched += int(known.sum())
        right += int((known & (who_a == who_b)).sum())
    return errors, matched, right


def pair_errors(
    found: tuple[Floats, Floats], truth: CameraRig, a: int, b: int
) -> tuple[float, float]:
    """Return E_R and E_t in degrees of a relative pose, R `[3, 3]` and t `[3]` of b_from_a."""
    rotation, translation = truth.relative(a, b)
    return (
        float(np.degrees(angle_between(found[0], rotation))),
        float(np.degrees(direction_angle(found[1], translation))),
    )


def rig_errors(found: CameraRig, truth: CameraRig) -> tuple[float, float]:
    """Return the median E_R and E_t in degrees over the pairs of a rig."""
    pairs = combinations(range(len(truth.cameras)), 2)
    errors = [pair_errors(found.relative(a, b), truth, a, b) for a, b in pairs]
    rotation, translation = np.median(errors, axis=0)
    return float(rotation), float(translation)
