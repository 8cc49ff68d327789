"""Find the camera whose images, labels or intrinsics are not what they are said to be.

A camera that is suspicious is held against the rig of all others: what would its images, its
labels or its intrinsics have to be, for it to see what these know? The camera that another reading
explains best is the odd one. One is named at a time: the others are looked at again once it was
mended, since it spoils every rig that it is part of. Two that are odd in the same way go together,
and to mend one of them may make it worse: those that need no estimate are also named together.
"""

import numpy as np

from mocap_calib.config import Config, DiagnosisConfig
from mocap_calib.faults.core_rig import core_covariance, is_determined
from mocap_calib.faults.explaining import Finding, explain, with_uncertain_core
from mocap_calib.faults.explanations import is_acceptable, mend_of
from mocap_calib.faults.suspicion import Signs, find_signs
from mocap_calib.faults.words import describe
from mocap_calib.results import CalibrationResult, Fault
from mocap_calib.rig.observed import Observed

_LEAST_CAMERAS = 3  # of two nobody can say which is odd


def find_odd_cameras(
    observed: Observed, result: CalibrationResult, config: Config
) -> tuple[tuple[Fault, ...], ...]:
    """Return the fault of the camera that is most certainly odd; nothing where none is.

    And, as a rival of that, the faults of all cameras that certainly are odd in a way that has no
    unknowns, where there are several.

    observed: what was known before the rigs were built. result: what was found.
    """
    if len(observed.recording.cameras) < _LEAST_CAMERAS or _all_focal_lengths_wrong(result):
        return ()
    signs = find_signs(observed, result, config)
    found = [
        diagnose(observed, view, config, seed=result.seed)
        for view in _most_suspicious(signs, config.diagnosis)
    ]
    certain = sorted((each for each in found if each is not None), key=_certainty, reverse=True)
    if _is_ambiguous(certain, config.diagnosis):
        return ()
    for finding in certain:
        covariance = core_covariance(finding.core, config)
        if is_determined(covariance, config, unknowns=bool(finding.explanation.free)):
            exact = [each for each in certain if each.explanation.mend is not None]
            rivals = [[finding], exact] if len(exact) > 1 else [[finding]]
            return tuple(
                tuple(_name_fault(each, config.diagnosis) for each in faults) for faults in rivals
            )
    return ()


def _all_focal_lengths_wrong(result: CalibrationResult) -> bool:
    """Return whether the rig has no camera left that another could be held against."""
    return bool(result.groups[0].uncertainty.wrong_focal.all())


def _most_suspicious(signs: Signs, config: DiagnosisConfig) -> list[int]:
    """Return the suspicious views, those of the worst pairs first; as many as are looked at."""
    suspicious = np.flatnonzero(signs.suspicious(config))
    order = np.argsort(signs.pairs[suspicious], kind="stable")
    return [int(view) for view in suspicious[order][: config.candidates]]


def _is_ambiguous(certain: list[Finding], config: DiagnosisConfig) -> bool:
    """Return whether a weak explanation of one camera has a rival that explains another.

    One camera with a wrong focal length makes a rig of three in which each looks odd.
    """
    if len(certain) < 2 or certain[0].gain >= config.least_gain:
        return False
    return _certainty(certain[1]) > config.rival * _certainty(certain[0])


def _certainty(finding: Finding) -> float:
    """Return what the camera has most of that is odd, of several that may be.

    Any camera beside an odd one looks odd itself, but not beside others that agree. Of two halves
    of a rig that see left and right differently, the one whose bodies are lifted more alike is
    right: its pairs have the better scores.
    """
    return finding.evidence * finding.core.pair_score**2


def diagnose(observed: Observed, view: int, config: Config, *, seed: int) -> Finding | None:
    """Return what explains what the camera of a view saw best; None where nothing need be."""
    findings = explain(observed, view, config, seed=seed)
    acceptable = [each for each in findings if _is_acceptable(each, config.diagnosis)]
    sure = [each for each in acceptable if not each.explanation.free]
    estimated = [each for each in acceptable if each.explanation.free]
    if estimated:  # all of them rest on the same rig
        covariance = core_covariance(estimated[0].core, config)
        doubted = (with_uncertain_core(each, covariance, config) for each in estimated)
        least = config.diagnosis.core_significance
        sure += [each for each in doubted if each.fit.significance > least]
    return max(sure, key=lambda each: _preference(each, config.diagnosis), default=None)


def _is_acceptable(finding: Finding, config: DiagnosisConfig) -> bool:
    """Return whether an explanation is decisively better than that nothing is wrong."""
    explanation = finding.explanation
    if explanation.name == "given":
        return False
    if explanation.name.startswith("rotated"):
        return _effective(finding, config) > -config.rotation_prior
    # of few keypoints a third of the detections may fit better by chance
    enough = finding.keypoints >= config.telling_keypoints
    if explanation.name == "sides" and enough and finding.exchanged > config.least_exchanged:
        return True
    least = {"cropped": 0.0, "focal": config.focal_gain, "resized": config.resize_gain}
    return finding.gain > least.get(explanation.name, config.least_gain) and is_acceptable(
        explanation, finding.fit, config
    )


def _preference(finding: Finding, config: DiagnosisConfig) -> float:
    """Return what the best explanation of a camera has most of."""
    turned = finding.explanation.name.startswith("rotated")
    return _effective(finding, config) + (config.rotation_prior if turned else 0.0)


def _effective(finding: Finding, config: DiagnosisConfig) -> float:
    """Return the gain of as many keypoints as have independent errors."""
    return finding.gain * min(finding.keypoints, config.effective_keypoints)


def _name_fault(finding: Finding, config: DiagnosisConfig) -> Fault:
    """Return the fault that an explanation means.

    Where the sides of some detections alone are exchanged, exchanging all of them is no mend.
    """
    explanation, fit = finding.explanation, finding.fit
    mend = mend_of(explanation, fit, config)
    assert mend is not None
    evidence: dict[str, float | int | str] = {
        "gain": finding.gain,
        "keypoints": finding.keypoints,
        "error_px": float(np.median(fit.error)),
    }
    if mend.word == "sides":
        evidence["share"] = finding.exchanged
        if finding.exchanged < config.all_exchanged:
            says = f"left and right exchanged in {finding.exchanged:.0%} of the detections"
            return Fault(mend.camera, mend.word, says, evidence)
    return Fault(mend.camera, mend.word, describe(mend), evidence, mend)
