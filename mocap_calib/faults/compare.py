"""Compare hypotheses about the input of one camera against the rig of the others.

What would its images, its labels or its intrinsics have to be, for the camera to see what the
others place? The evidence of each hypothesis is in nats. One camera is named at a time: the others
are compared again once its input was corrected, as it spoils every rig that it is part of.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mocap_calib.config import DECISIVE_NATS, Config, DiagnosisConfig
from mocap_calib.faults.fits import FittedHypothesis, add_rig_uncertainty, fit_hypotheses
from mocap_calib.faults.hypotheses import evidence_of_unknowns, mend_of
from mocap_calib.faults.leave_one_out import (
    Held,
    bent_points,
    leave_out,
    pose_beside,
    screen_cameras,
)
from mocap_calib.faults.words import describe
from mocap_calib.recording.corrections import Exchanged
from mocap_calib.results import CalibrationResult, Fault, GroupResult
from mocap_calib.rig import Observed
from mocap_calib.types import POSE

_LEAST_DIFFERENCE = 0.01  # of the logarithms of focal lengths; to exchange equal ones is harmless
_SYSTEMATIC = 0.01  # error of a change of focal length beyond its standard deviation
_EXACT = ("mirrored", "sides", "rotated")  # faults without unknowns


@dataclass(frozen=True)
class Alternative:
    """Faults that may explain the errors of a rig, and their evidence in nats."""

    faults: tuple[Fault, ...]
    evidence: float


def find_faulty_cameras(
    observed: Observed, result: CalibrationResult, held: list[Held], config: Config
) -> list[Alternative]:
    """Return alternatives: one faulty camera each, or several at once.

    Of two cameras neither can be named. Cameras that are wrong in the same way fit each other, and
    to correct one alone may be worse: those without unknowns are an alternative together.
    held: the views of the largest group.
    """
    if result.groups[0].uncertainty.wrong_focal.all():  # no camera is left to compare with
        return []
    views = screen_cameras(observed, result, held, config)[: config.diagnosis.candidates]
    found = [_compare(observed, view, result, config) for view in views]
    alternatives = [each for each in found if each is not None]
    exact = [each for each in alternatives if each.faults[0].word in _EXACT]
    if len(exact) > 1:
        faults = tuple(fault for each in exact for fault in each.faults)
        alternatives.append(Alternative(faults, min(each.evidence for each in exact)))
    return alternatives


def _compare(
    observed: Observed, view: int, result: CalibrationResult, config: Config
) -> Alternative | None:
    """Return the best hypothesis of a view, None where nothing need be wrong with its input."""
    others = leave_out(observed, view, config)
    if others is None:
        return None
    in_rig, rig, name = None, result.groups[0].rig, observed.recording.names[view]
    if {name, *others.rig.names} <= set(rig.names):
        in_rig = pose_beside(others.rig, rig, name)
    fitted, share = fit_hypotheses(observed, view, others, config, in_rig=in_rig, seed=result.seed)
    if not any(_evidence(each, share, config.diagnosis) > 0 for each in fitted):
        return None
    if any(each.hypothesis.free for each in fitted):
        bent = bent_points(others, config)
        fitted = [add_rig_uncertainty(each, bent, config.diagnosis) for each in fitted]
    evidence = [_evidence(each, share, config.diagnosis) for each in fitted]
    enough = [k for k, nats in enumerate(evidence) if nats > DECISIVE_NATS]
    if not enough:
        return None
    effective = min(fitted[k].effective for k in enough)  # one number: all see the same keypoints
    best = max(
        enough,
        key=lambda k: _upright(fitted[k], config.diagnosis) + _gained(fitted[k], effective),
    )
    # any camera beside a faulty one looks faulty itself, and of two halves of a rig whose sides
    # differ, the one whose bodies are lifted more alike is right
    nats = fitted[best].gain * len(fitted[best].source) * others.pair_score**2
    return Alternative((_name_fault(fitted[best], evidence[best], share, config.diagnosis),), nats)


def _evidence(fitted: FittedHypothesis, share: float, config: DiagnosisConfig) -> float:
    """Return the log evidence (nats) of a hypothesis against the input as given.

    share: of the detections that fit with exchanged sides alone.
    """
    name = fitted.hypothesis.name
    if name == "given":
        return 0.0
    if name == "sides" and share > config.exchanged_share:
        return share * fitted.effective  # a nat each, for those that fit exchanged alone
    # no more than chance would hardly make of keypoints that differ so much (Vuong 1989)
    certain = fitted.gain * abs(fitted.gain) / max(2 * fitted.spread**2, 1e-300)
    gained = _upright(fitted, config) + min(
        _gained(fitted, fitted.effective), certain * fitted.effective
    )
    if fitted.hypothesis.free:
        return min(evidence_of_unknowns(fitted.hypothesis, fitted.fit, config), gained)
    return gained


def _upright(fitted: FittedHypothesis, config: DiagnosisConfig) -> float:
    """Return the evidence (nats) of a camera on its side that its images are rotated."""
    return config.upright_nats if fitted.hypothesis.name.startswith("rotated") else 0.0


def _gained(fitted: FittedHypothesis, effective: float) -> float:
    """Return the gain (nats) of so many keypoints, others than those that were fitted.

    It is less by what unknowns gain of errors alone.
    """
    price = _price(POSE + len(fitted.hypothesis.free), effective) - _price(POSE, effective)
    return fitted.gain * effective - price


def _price(unknowns: int, keypoints: float) -> float:
    """Return by how many nats a fit is better than it would be on other keypoints.

    Akaike's criterion for small samples (Hurvich and Tsai 1989); a keypoint is two numbers.
    """
    spare = max(2 * keypoints - unknowns - 1, 1.0)
    return unknowns + unknowns * (unknowns + 1) / spare


def _name_fault(
    fitted: FittedHypothesis, nats: float, share: float, config: DiagnosisConfig
) -> Fault:
    """Return the fault of a hypothesis.

    Where the sides of some detections alone are exchanged, exchanging all of them corrects nothing.
    """
    mend = mend_of(fitted.hypothesis, fitted.fit)
    assert mend is not None
    evidence: dict[str, float | int | str] = {
        "nats": nats,
        "gain": fitted.gain,
        "keypoints": len(fitted.source),
        "error_px": float(np.median(fitted.fit.error)),
    }
    if mend.word == "sides":
        evidence["share"] = share
        if share < 1 - config.exchanged_share / 2:
            says = f"left and right exchanged in {share:.0%} of the detections"
            return Fault(mend.camera, mend.word, says, evidence)
    return Fault(mend.camera, mend.word, describe(mend), evidence, mend)


def find_exchanged_cameras(group: GroupResult) -> list[Alternative]:
    """Return the two cameras whose intrinsics are exchanged; nothing where none are.

    Each looks wrong by itself, and spoils the rig that it would be held against. The evidence is
    how much likelier the changes are that the adjustment asks of their focal lengths, where each
    has that of the other; nothing else gives them away.
    """
    change, sigma = group.uncertainty.focal_change, group.uncertainty.focal_sigma
    focal = np.log([camera.focal for camera in group.rig.cameras])
    if len(focal) < 3 or not np.isfinite(change).all():
        return []
    variance = sigma**2 + _SYSTEMATIC**2
    likelier = []
    for a, b in combinations(range(len(focal)), 2):
        ends, other = np.array([a, b]), focal[[b, a]] - focal[[a, b]]
        nats = (change[ends] ** 2 - (change[ends] - other) ** 2) / (2 * variance[ends])
        if abs(other[0]) > _LEAST_DIFFERENCE and (nats > 0).all():
            likelier.append((float(nats.sum()), a, b))
    nats, *views = max(likelier, default=(0.0, 0, 0))
    if nats < DECISIVE_NATS:
        return []
    first, second = (group.rig.names[view] for view in views)
    mend = Exchanged(first, second)
    faults = tuple(
        Fault(one, "exchanged", f"has the intrinsics of {other}", {"nats": nats}, mend)
        for one, other in ((first, second), (second, first))
    )
    return [Alternative(faults, nats)]
