"""Say how far a rig can be trusted, and why; docs/how-good.md has the rule in words."""

from dataclasses import replace

import numpy as np

from mocap_calib.config import Config, VerdictConfig
from mocap_calib.types import (
    VERDICTS,
    Check,
    EstimatedCamera,
    GroupResult,
    Uncertainty,
    Verdict,
)
from mocap_calib.verdict.checks import check_rig
from mocap_calib.verdict.reasons import explain

# checks that fail together only where bodies, identities and cameras do not go together at all
DOUBTS = ("convergence", "bones", "loops")
# checks that fail together where a camera saw another scene than the others. Measured: in three of
# the 225 cases of benchmarks/certainty.py, rigs that mix two scenes and were weak without this; in
# no rig of 403 damaged recordings that was right
STRANGERS = {"bridge", "pair score", "unmatched", "errors"}
# checks that fail together where the matches do not hold, whatever the rig says of itself: a camera
# whose frames are in another order, or whose tracks are none. Measured there: rigs that were off by
# 1.4, 4.2, 21, 126, 151 and 174 deg, four of them *usable* without this; in no rig of 200 simulated
# scenes and of 15 recordings
LOOSE = {"convergence", "pair score", "unmatched"}

_UNCHECKED = (
    "the intrinsics of both cameras were estimated, and no third camera checks them; "
    "give their intrinsics, or add a camera"
)


def judge_group(group: GroupResult, config: Config) -> GroupResult:
    """Return the group with the verdict on its rig, the checks it rests on, and the reasons."""
    checks = check_rig(group, config)
    reversible = group.adjusted.depth_reversed_rig is not None
    verdict = judge_rig(group.uncertainty, checks, config.verdict, reversible=reversible)
    judged = replace(group, verdict=verdict, checks=checks)
    judged = replace(judged, reasons=tuple(explain(judged, config)))
    if _has_unchecked_intrinsics(group):
        judged = no_better_than(judged, "weak", _UNCHECKED)
    return _without_accusations(judged, config)


def _has_unchecked_intrinsics(group: GroupResult) -> bool:
    """Return whether the intrinsics of two cameras were estimated, which no third one checks.

    Measured: rotations off by 2.2 to 5.0 deg in five of eight recordings, 21 to 40 in three.
    """
    cameras = group.rig.cameras
    return len(cameras) == 2 and all(isinstance(each, EstimatedCamera) for each in cameras)


def _without_accusations(group: GroupResult, config: Config) -> GroupResult:
    """Return a group that names only cameras that can be told to be the odd ones.

    A rig that is not determined accuses nobody. Where most places of cameras are uncertain, or half
    of the cameras contradict the other half, none is the odd one. The reasons say all the same that
    cameras contradict each other.
    """
    nobody = np.zeros(len(group.rig), dtype=bool)
    known = group.uncertainty
    usual = np.rad2deg(np.median(known.covariance.rotation_sigma))
    halves = 2 * known.outlier_cameras.sum() >= len(nobody)
    if group.verdict == "not determined":
        known = replace(known, outlier_cameras=nobody, wrong_focal=nobody)
    elif halves or usual > config.diagnosis.core_deg:
        known = replace(known, outlier_cameras=nobody)
    return replace(group, uncertainty=known)


def judge_rig(
    uncertainty: Uncertainty, checks: tuple[Check, ...], config: VerdictConfig, *, reversible: bool
) -> Verdict:
    """Return the verdict on a rig.

    The expected error of the worst camera decides. It cannot be better than *usable* where a check
    fails or a focal length is wrong; than *weak* where cameras contradict the others, a reversed
    rig fits as well, all that was seen is flat, or checks together put the model in doubt; and than
    *not determined* where most cameras contradict each other, hardly any check is passed, or what
    was seen is flat and the expected error is not below the least limit.

    reversible: the rig reversed in depth fits as well.
    """
    outliers = uncertainty.outlier_cameras
    by_error = VERDICTS.index(verdict_of_error(uncertainty, config))
    failed = [check.name for check in checks if not check.passed]
    # of two cameras, their pair is the bridge
    unbridged = ("bridge" if len(outliers) > 2 else "pair score") in failed
    several = unbridged + sum(name in DOUBTS for name in failed) >= 2
    many = len(failed) >= config.fails_of_weak
    in_doubt = several or unbridged or many or set(failed) >= LOOSE
    in_vain = (several and (unbridged or many)) or len(failed) >= config.fails_of_none
    in_vain = in_vain or set(failed) >= STRANGERS
    at_best = [
        (1, uncertainty.wrong_focal.any() or bool(failed)),
        (2, outliers.any() or reversible or in_doubt or "flat" in failed),
        (3, 2 * outliers.sum() > len(outliers) or in_vain or ("flat" in failed and by_error > 0)),
    ]
    return VERDICTS[max([by_error, *(place for place, holds in at_best if holds)])]


def verdict_of_error(uncertainty: Uncertainty, config: VerdictConfig) -> Verdict:
    """Return the verdict that the expected error of the worst camera alone allows."""
    limits = (config.well_determined_deg, config.usable_deg, config.weak_deg)
    worst = np.rad2deg(uncertainty.covariance.rotation_sigma.max())
    return VERDICTS[int(np.searchsorted(limits, worst, side="right"))]


def no_better_than(group: GroupResult, verdict: Verdict, reason: str) -> GroupResult:
    """Return the group with a verdict that is no better than one, and why."""
    place = max(VERDICTS.index(group.verdict), VERDICTS.index(verdict))
    return replace(group, verdict=VERDICTS[place], reasons=(*group.reasons, reason))
