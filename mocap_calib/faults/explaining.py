"""Hold one camera against the rig of the others: how well each explanation fits what it saw."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import (
    CameraFit,
    CameraPose,
    Seen,
    fit_camera,
    shift_of_unknowns,
)
from mocap_calib.adjust.projection_search import (
    Resection,
    Sighting,
    decompose,
    exchanged_share,
    resect,
)
from mocap_calib.config import Config, DiagnosisConfig
from mocap_calib.faults.core_rig import (
    CoreRig,
    bent_points,
    find_core_rig,
)
from mocap_calib.faults.explanations import Explanation, explanations
from mocap_calib.faults.suspicion import is_turned, rolls
from mocap_calib.recording.corrections import exchanged_sides
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import RigCovariance
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.tracks import MEDIAN_DISTANCE
from mocap_calib.types import Camera, CameraRig, Floats, Ints

# explanations that are fitted to all keypoints even where others explain more
_ALWAYS = ("given", "sides")


@dataclass(frozen=True)
class Finding:
    """How one explanation fits a camera.

    core: the rig of the others. seen: what the explanation was fitted to; source: `[N]` indices of
        its points among all of the rig of the others. noise: of the fit, in pixels.
    gain: what it lowers the robust cost of a keypoint by, against the intrinsics and the labels as
        they are given. keypoints: how many tell.
    exchanged: share of the detections that fit with exchanged sides alone.
    """

    core: CoreRig
    explanation: Explanation
    seen: Seen
    source: Ints
    noise: float
    fit: CameraFit
    gain: float
    keypoints: int
    exchanged: float

    @property
    def evidence(self) -> float:
        """The gain of all keypoints together."""
        return self.gain * self.keypoints


def explain(observed: Observed, view: int, config: Config, *, seed: int) -> tuple[Finding, ...]:
    """Return how all explanations fit that are worth a closer look; none without other cameras."""
    core = find_core_rig(observed, view, config)
    if core is None:
        return ()
    sightings = _sightings(observed, view, core, config.diagnosis)
    resections = {}
    for sides, sighting in sightings.items():
        resection = resect(sighting, config.diagnosis.resection, seed=seed)
        if resection is not None:
            resections[sides] = resection
    if not resections:
        return ()
    sample = observed.sample.select(frames=core.frames)
    best = min(resections.values(), key=lambda each: each.cost)
    frame, instance = np.nonzero(best.individual >= 0)
    if len(frame) < config.diagnosis.least_matched * _count_comparable(sightings[False]):
        return ()
    bodies = frame, best.individual[frame, instance]
    tried = explanations(sample, view)
    turned = _turn_of(core.rig, resections, sample.cameras[view], config.diagnosis)
    tried = tuple(e for e in tried if not e.name.startswith("rotated") or e.name == turned)
    seen, source = _seen_by(tried, core, bodies, instance, config.diagnosis)
    if len(source) < config.diagnosis.least_keypoints:
        return ()
    findings = _fit_all(tried, seen, resections, core, config.diagnosis, source=source)
    share = exchanged_share(sightings[False], sightings[True], best)
    return tuple(replace(each, exchanged=share) for each in findings)


def _count_comparable(sighting: Sighting) -> int:
    """Return the number of detections in frames of which the others know anybody."""
    known = np.isfinite(sighting.points[..., 0]).any((1, 2))
    return int(np.isfinite(sighting.image[known][..., 0]).any(-1).sum())


def _sightings(
    observed: Observed, view: int, core: CoreRig, config: DiagnosisConfig
) -> dict[bool, Sighting]:
    """Return what a camera saw of the points of the others, and the same with sides exchanged.

    Without the distortion that is given, which is nearly right for all explanations.
    """
    camera = observed.recording.cameras[view]
    rays = observed.sample.rays[view, core.frames]
    forward = np.where(rays[..., 2:] > config.least_forward, rays[..., 2:], np.nan)
    image = rays[..., :2] / forward * camera.focal + camera.matrix[:2, 2]
    order = exchanged_sides(observed.recording.keypoints)
    return {
        False: Sighting(core.points, image),
        True: Sighting(core.points, image[:, :, order]),
    }


def _turn_of(
    rig: CameraRig, resections: dict[bool, Resection], camera: Camera, config: DiagnosisConfig
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
    core: CoreRig,
    bodies: tuple[Ints, Ints],
    instance: Ints,
    config: DiagnosisConfig,
) -> tuple[dict[str, Seen], Ints]:
    """Return what was seen, by explanation: the same keypoints in all, and whose points these are.

    bodies: frames and individuals `[match]` of the points of the core; instance: `[match]` the
        detections of them. The second: `[N]` indices into the points of the core, made flat.
    """
    frame, individual = bodies
    points = core.points[bodies]  # [match, keypoint, 3]
    pixels = {each.name: each.pixels[frame, instance] for each in tried}
    both = np.isfinite(points[..., 0])
    for each in pixels.values():
        both &= np.isfinite(each[..., 0])
    match, keypoint = np.nonzero(both)
    chosen = evenly_spaced(np.arange(len(match)), config.keypoints)
    match, keypoint = match[chosen], keypoint[chosen]
    source = (frame[match], individual[match], keypoint)
    block = frame[match] * config.time_blocks // (int(frame.max(initial=0)) + 1)
    seen = {
        name: Seen(points[match, keypoint], each[match, keypoint], block, keypoint)
        for name, each in pixels.items()
    }
    return seen, np.ravel_multi_index(source, core.points.shape[:3])


def _fit_all(
    tried: Sequence[Explanation],
    seen: dict[str, Seen],
    resections: dict[bool, Resection],
    core: CoreRig,
    config: DiagnosisConfig,
    *,
    source: Ints,
) -> tuple[Finding, ...]:
    """Return the findings of the explanations that a part of the keypoints does not rule out."""
    best = min(resections.values(), key=lambda each: each.cost)
    few = evenly_spaced(np.arange(len(source)), config.rough_keypoints)
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
            each.camera,
            seen[each.name],
            rough[each.name][1],
            config.fit,
            noise=noise,
            free=each.free,
        )
        for each in tried
        if each.name in _ALWAYS or rough[each.name][0] <= limit
    }
    sharpest = min(float(np.median(fit.error)) for fit in fits.values()) / MEDIAN_DISTANCE
    given = _cost(fits["given"], sharpest)
    return tuple(
        Finding(
            core=core,
            explanation=each,
            seen=seen[each.name],
            source=source,
            noise=noise,
            fit=fits[each.name],
            gain=given - _cost(fits[each.name], sharpest),
            keypoints=len(fits[each.name].error),
            exchanged=0.0,
        )
        for each in tried
        if each.name in fits
    )


def with_uncertain_core(finding: Finding, covariance: RigCovariance, config: Config) -> Finding:
    """Return a finding whose unknowns are as uncertain as the rig of the others makes them.

    A rig that may bend takes its points with it, and so changes which intrinsics explain what a
    camera saw. Where cameras are far away, or subjects are flat, any corner of the image explains
    it. covariance: of the rig of the others (`core_rig.core_covariance`).
    """
    core, given = finding.core, finding.seen.points
    rest = _shift(finding, given, config.diagnosis)  # of a fit that is not quite at its minimum
    shifts = []
    for times, points in bent_points(core, covariance, config):
        bent = points.reshape(-1, 3)[finding.source]
        bent = np.where(np.isfinite(bent), bent, given)
        shifts.append(times * (_shift(finding, bent, config.diagnosis) - rest))
    by_core = np.array(shifts)
    return replace(finding, fit=finding.fit.with_covariance(by_core.T @ by_core))


def _shift(finding: Finding, points: Floats, config: DiagnosisConfig) -> Floats:
    """Return by how much `[unknown]` those of a finding change with other points `[N, 3]`."""
    return shift_of_unknowns(
        finding.explanation.camera,
        replace(finding.seen, points=points),
        finding.fit,
        config.fit,
        noise=finding.noise,
        free=finding.explanation.free,
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
