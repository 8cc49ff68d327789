"""Fit hypotheses about the input of a camera to the points of its leave-one-out rig."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import (
    CameraFit,
    Seen,
    fit_camera,
    shift_of_unknowns,
)
from mocap_calib.adjust.resection import (
    Resection,
    Sightings,
    exchanged_share,
    resect,
    sightings_of,
)
from mocap_calib.config import Config, DiagnosisConfig
from mocap_calib.faults.hypotheses import Hypothesis, list_hypotheses
from mocap_calib.faults.leave_one_out import OtherCameras, nearest_quarter, rolls
from mocap_calib.geometry.lens import decompose_projection
from mocap_calib.recording.corrections import exchanged_sides
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig import MEDIAN_DISTANCE, Observed
from mocap_calib.types import Camera, Floats, Ints

_ROUGH_KEYPOINTS = 300  # of a first fit, and so many hypotheses are fitted to all keypoints
_FITTED = 6


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis fitted to the keypoints of a camera.

    source: `[N]` indices of their points among those of the other cameras.
    gain: by which it lowers the robust cost of a keypoint, against the input as given; spread: its
        standard deviation over keypoints.
    effective: number of keypoints with independent gains that would tell as much.
    """

    hypothesis: Hypothesis
    seen: Seen
    source: Ints
    fit: CameraFit
    gain: float
    spread: float
    effective: float


def fit_hypotheses(
    observed: Observed,
    view: int,
    others: OtherCameras,
    config: Config,
    *,
    in_rig: Floats | None,
    seed: int,
) -> tuple[list[FittedHypothesis], float]:
    """Return the hypotheses of a view fitted to what it saw of the others' points.

    None where too few detections match any body. And the share of its detections that fit with
    exchanged sides alone.

    in_rig: the pose of the camera beside the others in the rig of all, where it has one.
    """
    diagnosis, sample = config.diagnosis, observed.sample.select(frames=others.frames)
    sightings = _sightings(observed, view, others)
    resections = {
        sides: resection
        for sides, sighting in sightings.items()
        if (resection := resect(sighting, diagnosis.resection, seed=seed)) is not None
    }
    if not resections:
        return [], 0.0
    best = min(resections.values(), key=lambda each: each.cost)
    matched = sightings[False].select(np.flatnonzero(best.individual >= 0))
    if len(matched.frame) < diagnosis.least_matched * len(best.individual):
        return [], 0.0
    turn = _quarter_turn(others, best, sample.cameras[view], diagnosis)
    tried = [
        each
        for each in list_hypotheses(sample, view)
        if not each.name.startswith("rotated") or each.name == f"rotated {turn}"
    ]
    bodies = matched.frame, best.individual[best.individual >= 0]
    seen, source = _seen_by(tried, others, bodies, matched.instance, diagnosis)
    if len(source) < diagnosis.least_keypoints:
        return [], 0.0
    starts = {sides: resections.get(sides, best) for sides in (False, True)}
    share = exchanged_share(sightings[False], sightings[True], best.projection, best.tolerance)
    return _fit_all(tried, seen, source, (starts, best, in_rig), diagnosis), share


def _sightings(observed: Observed, view: int, others: OtherCameras) -> dict[bool, Sightings]:
    """Return what a camera saw of the others' points, by whether its sides are exchanged.

    Without the given lens distortion, which is nearly right for all hypotheses.
    """
    seen = sightings_of(observed.sample.rays[view, others.frames], others.points)
    order = exchanged_sides(observed.recording.keypoints)
    return {False: seen, True: replace(seen, image=seen.image[:, order])}


def _quarter_turn(
    others: OtherCameras, best: Resection, camera: Camera, config: DiagnosisConfig
) -> int:
    """Return the quarter turn (degrees) by which the camera's images are rotated, 0 = none."""
    rig, (_, rotation, translation) = others.rig, decompose_projection(best.projection)
    with_camera = replace(
        rig,
        cameras=(*rig.cameras, camera),
        rotation=np.concatenate([rig.rotation, rotation[None]]),
        translation=np.concatenate([rig.translation, translation[None]]),
    )
    return int(nearest_quarter(rolls(with_camera, config), config)[-1])


def _seen_by(
    tried: Sequence[Hypothesis],
    others: OtherCameras,
    bodies: tuple[Ints, Ints],
    instance: Ints,
    config: DiagnosisConfig,
) -> tuple[dict[str, Seen], Ints]:
    """Return what was seen, by hypothesis: the same keypoints in all, and whose points these are.

    bodies: frames and individuals `[match]` of the others' points; instance: `[match]` the
        detections of them. The second: `[N]` indices into the others' points, made flat.
    """
    frame, individual = bodies
    points = others.points[bodies]  # [match, keypoint, 3]
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
    return seen, np.ravel_multi_index(source, others.points.shape[:3])


def _fit_all(
    tried: Sequence[Hypothesis],
    seen: dict[str, Seen],
    source: Ints,
    found: tuple[dict[bool, Resection], Resection, Floats | None],
    config: DiagnosisConfig,
) -> list[FittedHypothesis]:
    """Return the hypothesis that nothing is wrong, and the others that fit some keypoints best.

    found: resections by whether sides are exchanged, the best one, and the pose in the rig of all.
    """
    by_sides, best, in_rig = found
    few = evenly_spaced(np.arange(len(source)), _ROUGH_KEYPOINTS)
    noise = config.focal_noise * tried[0].camera.focal
    quick = replace(config.fit, steps=10)
    rough: dict[str, CameraFit] = {}
    for each in tried:
        part = seen[each.name].select(few)
        resections = [best] if by_sides[each.sides] is best else [best, by_sides[each.sides]]
        starts = [pose for one in resections for pose in _starts(one, part.points)]
        starts += [] if in_rig is None else [in_rig]
        fits = [
            fit_camera(each.camera, part, start, quick, noise=noise, free=each.free)
            for start in starts
        ]
        rough[each.name] = min(fits, key=lambda fit: _costs(fit, noise).mean())
    order = sorted(tried[1:], key=lambda each: _costs(rough[each.name], noise).mean())
    kept = [tried[0], *order[:_FITTED]]
    fits = [
        fit_camera(
            each.camera,
            seen[each.name],
            rough[each.name].pose,
            config.fit,
            noise=noise,
            free=each.free,
        )
        for each in kept
    ]
    sharpest = min(float(np.median(fit.error)) for fit in fits) / MEDIAN_DISTANCE
    costs = [_costs(fit, sharpest) for fit in fits]
    fitted = []
    for each, fit, cost in zip(kept, fits, costs, strict=True):
        own, gain = seen[each.name], costs[0] - cost
        effective = effective_number(gain, (own.block, own.keypoint))
        mean, spread = float(gain.mean()), float(gain.std())
        fitted.append(FittedHypothesis(each, own, source, fit, mean, spread, effective))
    return fitted


def effective_number(values: Floats, clusters: tuple[Ints, Ints]) -> float:
    """Return how many independent values have a mean as certain as that of these `[N]`.

    clusters: two numberings `[N]`; values of one cluster of either have errors in common. N over
    the design effect (Kish 1965), of two-way clusters (Cameron, Gelbach and Miller 2011).
    """
    deviation = values - values.mean()
    alone = float(deviation @ deviation)
    together = [float((np.bincount(each, deviation) ** 2).sum()) for each in clusters]
    return len(values) * alone / max(sum(together) - alone, alone, 1e-300)


def add_rig_uncertainty(
    fitted: FittedHypothesis, bent: list[tuple[float, Floats]], config: DiagnosisConfig
) -> FittedHypothesis:
    """Return a hypothesis whose unknowns are as uncertain as the others' rig makes them.

    A rig that may bend takes its points with it, and so changes which intrinsics fit. Where cameras
    are far away, or subjects are flat, any corner of the image fits. bent: see `bent_points`.
    """
    hypothesis, given = fitted.hypothesis, fitted.seen.points
    if not hypothesis.free:
        return fitted

    def shift(points: Floats) -> Floats:
        """Return by how much `[unknown]` the unknowns change with other points `[N, 3]`."""
        return shift_of_unknowns(
            hypothesis.camera,
            replace(fitted.seen, points=np.where(np.isfinite(points), points, given)),
            fitted.fit,
            config.fit,
            noise=config.focal_noise * hypothesis.camera.focal,
            free=hypothesis.free,
        )

    rest = shift(given)  # of a fit that is not quite at its minimum
    by_rig = np.array(
        [times * (shift(points.reshape(-1, 3)[fitted.source]) - rest) for times, points in bent]
    )
    covariance = fitted.fit.covariance + by_rig.T @ by_rig
    return replace(fitted, fit=replace(fitted.fit, covariance=covariance))


def _starts(resection: Resection, points: Floats) -> tuple[Floats, Floats]:
    """Return the pose `[3, 4]` of a resection, and the one of which a distant camera sees the same.

    The second looks from the opposite side at what is mirrored: where perspective is weak, one
    passes for the other (the reversal of Necker's cube).
    """
    _, rotation, translation = decompose_projection(resection.projection)
    middle = np.median(points, axis=0)
    opposite = np.diag([-1.0, 1.0, -1.0]) @ rotation
    seen = (rotation @ middle + translation) * np.array([-1.0, 1.0, 1.0])
    found = np.column_stack([rotation, translation])
    return found, np.column_stack([opposite, seen - opposite @ middle])


def _costs(fit: CameraFit, noise: float) -> Floats:
    """Return the robust costs `[N]` of keypoints, -log of a Cauchy density (without constants)."""
    return np.asarray(np.log1p((fit.error / (2 * noise)) ** 2))
