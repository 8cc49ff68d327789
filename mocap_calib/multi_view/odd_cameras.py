"""Find the camera whose images, labels or intrinsics are not what they are said to be.

A camera that is suspicious is held against the rig of all others: what would its images, its
labels or its intrinsics have to be, for it to see what these know? The camera that another reading
explains best is the odd one. One is named at a time: the others are looked at again once it was
mended, since it spoils every rig that it is part of.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import Config, DiagnosisConfig
from mocap_calib.multi_view.camera_fit import CameraFit, CameraPose, Seen, fit_camera
from mocap_calib.multi_view.core_rig import CoreRig, find_core_rig, is_determined
from mocap_calib.multi_view.explanations import (
    Explanation,
    explanations,
    is_acceptable,
    mend_of,
)
from mocap_calib.multi_view.observed import Observed
from mocap_calib.multi_view.resection import Resection, Sighting, decompose, resect
from mocap_calib.multi_view.triangulation import MEDIAN_DISTANCE
from mocap_calib.multi_view.suspicion import Signs, find_signs, is_turned, rolls
from mocap_calib.recording.mending import exchanged_sides
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import CalibrationResult, CameraRig, Fault, Floats, Ints

_LEAST_CAMERAS = 3  # of two nobody can say which is odd


@dataclass(frozen=True)
class Finding:
    """How one explanation fits a camera.

    core: the rig of the others.
    gain: what it lowers the robust cost of a keypoint by, against the intrinsics and the labels as
        they are given. keypoints: how many tell.
    """

    core: CoreRig
    explanation: Explanation
    fit: CameraFit
    gain: float
    keypoints: int

    @property
    def evidence(self) -> float:
        """The gain of all keypoints together."""
        return self.gain * self.keypoints


def find_odd_cameras(
    observed: Observed, result: CalibrationResult, config: Config
) -> tuple[Fault, ...]:
    """Return the fault of the camera that is most certainly odd; nothing where none is.

    observed: what was known before the rigs were built. result: what was found.
    """
    if len(observed.recording.cameras) < _LEAST_CAMERAS:
        return ()
    signs = find_signs(observed, result, config)
    found = [
        diagnose(observed, view, config, seed=result.seed)
        for view in _most_suspicious(signs, config.diagnosis)
    ]
    certain = sorted((each for each in found if each is not None), key=lambda f: -f.evidence)
    for finding in certain:
        if is_determined(finding.core, config, seed=result.seed):
            return (_name_fault(finding, config.diagnosis),)
    return ()


def _most_suspicious(signs: Signs, config: DiagnosisConfig) -> list[int]:
    """Return the suspicious views, those of the worst pairs first; as many as are looked at."""
    suspicious = np.flatnonzero(signs.suspicious(config))
    order = np.argsort(signs.pairs[suspicious], kind="stable")
    return [int(view) for view in suspicious[order][: config.candidates]]


def diagnose(observed: Observed, view: int, config: Config, *, seed: int) -> Finding | None:
    """Return what explains what the camera of a view saw best; None where nothing need be."""
    findings = explain(observed, view, config, seed=seed)
    acceptable = [
        each for each in findings if _is_acceptable(each, config.diagnosis)
    ]
    return max(acceptable, key=lambda each: _preference(each, config.diagnosis), default=None)


def explain(
    observed: Observed, view: int, config: Config, *, seed: int
) -> tuple[Finding, ...]:
    """Return how all explanations fit that are worth a closer look; none without other cameras."""
    core = find_core_rig(observed, view, config)
    if core is None:
        return ()
    resections = _resect_both(observed, view, core, config.diagnosis, seed=seed)
    if not resections:
        return ()
    sample = observed.sample.select(frames=core.frames)
    best = min(resections.values(), key=lambda each: each.cost)
    frame, instance = np.nonzero(best.individual >= 0)
    points = core.points[frame, best.individual[frame, instance]]
    tried = explanations(sample, view)
    turned = _turn_of(core.rig, resections, sample.cameras[view], config.diagnosis)
    tried = tuple(e for e in tried if not e.name.startswith("rotated") or e.name == turned)
    seen = _seen_by(tried, points, frame, instance, config.diagnosis)
    if not seen or len(seen["given"].points) < config.diagnosis.least_keypoints:
        return ()
    return _fit_all(tried, seen, resections, core, config.diagnosis)


def _resect_both(
    observed: Observed, view: int, core: CoreRig, config: DiagnosisConfig, *, seed: int
) -> dict[bool, Resection]:
    """Return the resections of a camera with the labels as given and with sides exchanged."""
    camera = observed.recording.cameras[view]
    rays = observed.sample.rays[view, core.frames]
    forward = np.where(rays[..., 2:] > config.least_forward, rays[..., 2:], np.nan)
    image = rays[..., :2] / forward * camera.focal + camera.matrix[:2, 2]
    order = exchanged_sides(observed.recording.keypoints)
    found = {}
    for sides, seen in ((False, image), (True, image[:, :, order])):
        resection = resect(Sighting(core.points, seen), config.resection, seed=seed)
        if resection is not None:
            found[sides] = resection
    return found


def _turn_of(
    rig: CameraRig, resections: dict[bool, Resection], camera, config: DiagnosisConfig
) -> str:
    """Return which turn of its images would explain how the camera lies beside the others."""
    best = min(resections.values(), key=lambda each: each.cost)
    pose = decompose(best.projection)
    with_camera = replace(
        rig,
        cameras=(*rig.cameras, camera),
        rotation=np.concatenate([rig.rotation, pose.rotation[None]]),
        translation=np.concatenate([rig.translation, pose.translation[None]]),
    )
    roll = rolls(with_camera, config)[-1:]
    if not is_turned(roll, config)[0]:
        return ""
    return f"rotated {round(float(roll[0]) / 90) % 4 * 90}"


def _seen_by(
    tried: Sequence[Explanation],
    points: Floats,
    frame: Ints,
    instance: Ints,
    config: DiagnosisConfig,
) -> dict[str, Seen]:
    """Return what was seen, by explanation: the same keypoints in all.

    points: `[match, keypoint, 3]`; frame, instance: `[match]` the detections of them.
    """
    pixels = {each.name: each.pixels[frame, instance] for each in tried}
    both = np.isfinite(points[..., 0])
    for each in pixels.values():
        both &= np.isfinite(each[..., 0])
    match, keypoint = np.nonzero(both)
    chosen = evenly_spaced(np.arange(len(match)), config.keypoints)
    match, keypoint = match[chosen], keypoint[chosen]
    if not len(match):
        return {}
    span = int(frame.max()) + 1
    block = frame[match] * config.time_blocks // span
    return {
        name: Seen(points[match, keypoint], each[match, keypoint], block, keypoint)
        for name, each in pixels.items()
    }


def _fit_all(
    tried: Sequence[Explanation],
    seen: dict[str, Seen],
    resections: dict[bool, Resection],
    core: CoreRig,
    config: DiagnosisConfig,
) -> tuple[Finding, ...]:
    """Return the findings of the explanations that a part of the keypoints does not rule out."""
    best = min(resections.values(), key=lambda each: each.cost)
    few = evenly_spaced(np.arange(len(seen["given"].points)), config.rough_keypoints)
    noise = config.focal_noise * tried[0].camera.focal
    quick = replace(config.fit, steps=config.rough_steps)
    rough: dict[str, tuple[float, CameraPose]] = {}
    for each in tried:
        part = seen[each.name].select(few)
        starts = [
            pose
            for sides, resection in resections.items()
            if sides == each.sides or resection is best
            for pose in _starts(resection, part.points)
        ]
        for start in starts:
            fit = fit_camera(each.camera, part, start, quick, noise=noise, free=each.free)
            cost = _cost(fit, noise)
            if each.name not in rough or cost < rough[each.name][0]:
                rough[each.name] = (cost, fit.pose)
    limit = min(cost for cost, _ in rough.values()) + config.rough_margin
    fits = {
        each.name: fit_camera(
            each.camera, seen[each.name], rough[each.name][1], config.fit, noise=noise,
            free=each.free,
        )
        for each in tried
        if each.name == "given" or rough[each.name][0] <= limit
    }
    sharpest = min(float(np.median(fit.error)) for fit in fits.values()) / MEDIAN_DISTANCE
    given = _cost(fits["given"], sharpest)
    return tuple(
        Finding(
            core=core,
            explanation=each,
            fit=fits[each.name],
            gain=given - _cost(fits[each.name], sharpest),
            keypoints=len(fits[each.name].error),
        )
        for each in tried
        if each.name in fits
    )


def _starts(resection: Resection, points: Floats) -> tuple[CameraPose, CameraPose]:
    """Return the pose of a resection, and the one of which a distant camera sees the same.

    The second looks from the opposite side at what is mirrored: where perspective is weak, one
    passes for the other (the reversal of Necker's cube).
    """
    found = decompose(resection.projection)
    middle = np.median(points, axis=0)
    opposite = np.diag([-1.0, 1.0, -1.0]) @ found.rotation
    seen = found.rotation @ middle + found.translation
    translation = seen * np.array([-1.0, 1.0, 1.0]) - opposite @ middle
    return CameraPose(found.rotation, found.translation), CameraPose(opposite, translation)


def _cost(fit: CameraFit, noise: float) -> float:
    """Return the mean robust cost of a keypoint, -log of a Cauchy density (without constants)."""
    return float(np.log1p((fit.error / (2 * noise)) ** 2).mean())


def _is_acceptable(finding: Finding, config: DiagnosisConfig) -> bool:
    """Return whether an explanation is decisively better than that nothing is wrong."""
    explanation = finding.explanation
    if explanation.name == "given":
        return False
    if explanation.name.startswith("rotated"):
        return _effective(finding, config) > -config.rotation_prior
    least = {"cropped": 0.0, "focal": 0.0, "resized": config.resize_gain}
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


_SAYS = {
    "sides": "left and right exchanged",
    "mirrored": "images horizontally mirrored",
    "mirrored, sides": "images horizontally mirrored, left and right exchanged",
}


def _name_fault(finding: Finding, config: DiagnosisConfig) -> Fault:
    """Return the fault that an explanation means."""
    explanation, fit = finding.explanation, finding.fit
    mend = mend_of(explanation, fit, config)
    assert mend is not None
    evidence: dict[str, float | int | str] = {
        "gain": finding.gain,
        "keypoints": finding.keypoints,
        "error_px": float(np.median(fit.error)),
    }
    says = _SAYS.get(explanation.name, "")
    return Fault(explanation.camera.name, mend.word, says or str(mend.option), evidence, mend)
