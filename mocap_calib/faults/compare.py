"""Compare hypotheses about the input of one camera against the rig of the others.

What would its images, its labels or its intrinsics have to be, for the camera to see what the
others place? The evidence of each hypothesis is in nats. One camera is named at a time: the others
are compared again once its input was corrected, as it spoils every rig that it is part of.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, Seen, fit_camera
from mocap_calib.adjust.resection import Resection, exchanged_share, resect, sightings_of
from mocap_calib.config import DECISIVE_NATS, CameraFitConfig, Config, DiagnosisConfig
from mocap_calib.faults.hypotheses import (
    Hypothesis,
    describe,
    evidence_of_unknowns,
    list_hypotheses,
    mend_of,
)
from mocap_calib.faults.leave_one_out import (
    Held,
    OtherCameras,
    leave_out,
    pose_beside,
    screen_cameras,
)
from mocap_calib.geometry.lens import decompose_projection
from mocap_calib.geometry.rotation import quarter_turn
from mocap_calib.recording.corrections import exchanged_sides
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import CalibrationResult, Fault
from mocap_calib.rig import MEDIAN_DISTANCE, Observed, labelled_frames
from mocap_calib.rig.triangulate import place_bodies
from mocap_calib.types import Floats, Ints

_ROUGH_KEYPOINTS = 300  # of a first fit


@dataclass(frozen=True)
class Alternative:
    """Faults that may explain the errors of a rig, and their evidence in nats."""

    faults: tuple[Fault, ...]
    evidence: float


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis fitted to the keypoints of a camera.

    seen: the keypoints. gain: by which it lowers the robust cost of one, against the input as
        given; spread: its standard deviation over keypoints.
    effective: number of keypoints with independent gains that would tell as much.
    """

    hypothesis: Hypothesis
    seen: Seen
    fit: CameraFit
    gain: float
    spread: float
    effective: float


def find_faulty_cameras(
    observed: Observed, result: CalibrationResult, held: list[Held], config: Config
) -> list[Alternative]:
    """Return alternatives, of one faulty camera each. held: the views of the largest group.

    Of two cameras neither can be named.
    """
    if result.groups[0].uncertainty.wrong_focal.all():  # no camera is left to compare with
        return []
    views = screen_cameras(observed, result, held, config)[: config.diagnosis.candidates]
    found = [_compare(observed, view, result, config) for view in views]
    return [each for each in found if each is not None]


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
    nats = fitted[best].gain * len(fitted[best].seen.points) * others.pair_score**2
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
    # at most the evidence that the mean gain is not chance, given its spread (Vuong 1989)
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

    It is less by what unknowns gain of errors alone (Akaike's criterion).
    """
    return fitted.gain * effective - len(fitted.hypothesis.free)


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
        "keypoints": len(fitted.seen.points),
        "error_px": float(np.median(fitted.fit.error)),
    }
    if mend.word == "sides":
        evidence["share"] = share
        if share < 1 - config.exchanged_share / 2:
            says = f"left and right exchanged in {share:.0%} of the detections"
            return Fault(mend.camera, mend.word, says, evidence)
    return Fault(mend.camera, mend.word, describe(mend), evidence, mend)


# --- hypotheses fitted to what a camera saw


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
    diagnosis, placed = config.diagnosis, others.placed
    frames = evenly_spaced(labelled_frames(placed.matches), diagnosis.frames)
    sample = observed.sample.select(frames=frames)
    # without the given lens distortion, which is nearly right for all hypotheses
    bodies = place_bodies(others.sample, placed, frames, config)
    seen = sightings_of(sample.rays[view], bodies)
    exchanged = replace(seen, image=seen.image[:, exchanged_sides(sample.keypoints)])
    both = (resect(each, diagnosis.resection, seed=seed) for each in (seen, exchanged))
    resections = [each for each in both if each is not None]
    if not resections:
        return [], 0.0
    best = min(resections, key=lambda each: each.cost)
    matched = best.individual >= 0
    rotation = decompose_projection(best.projection)[1]
    turn = quarter_turn(rotation, others.rig.rotation, diagnosis.upright_deg)
    # a camera on its head that sees the mirror image sees what one with a reversed y axis does
    others_of_turn = {"flipped": turn == 180, "mirrored": turn != 180, f"rotated {turn}": True}
    tried = [
        each
        for each in list_hypotheses(sample, view)
        if others_of_turn.get(each.name, not each.name.startswith("rotated"))
    ]
    pixels = np.stack([each.pixels[seen.frame, seen.instance] for each in tried])
    pixels[:, np.isnan(pixels).any((0, 3))] = np.nan  # all have the same keypoints
    known = [
        seen.known_points(best.individual, matched, each, blocks=config.uncertainty.time_blocks)
        for each in pixels
    ]
    chosen = evenly_spaced(np.arange(len(known[0].points)), diagnosis.keypoints)
    if matched.mean() < diagnosis.least_matched or len(chosen) < diagnosis.least_keypoints:
        return [], 0.0
    known = [each.select(chosen) for each in known]
    starts = [pose for each in resections for pose in _starts(each, known[0].points)]
    starts += [] if in_rig is None else [in_rig]
    share = exchanged_share(seen, exchanged, best.projection, best.tolerance)
    return _fit_all(tried, known, starts, diagnosis), share


def _fit_all(
    tried: Sequence[Hypothesis],
    seen: Sequence[Seen],
    starts: Sequence[Floats],
    config: DiagnosisConfig,
) -> list[FittedHypothesis]:
    """Return the hypothesis that nothing is wrong, and the others that fit some keypoints better.

    seen: what was seen under each. starts: poses `[3, 4]`.
    """
    noise = config.focal_noise * tried[0].camera.focal

    def fit(k: int, part: Seen, start: Floats, settings: CameraFitConfig) -> CameraFit:
        """Return the fit of one hypothesis."""
        free = tried[k].free
        return fit_camera(tried[k].camera, part, start, settings, noise=noise, free=free)

    def cost(one: CameraFit) -> float:
        """Return the mean robust cost of a keypoint."""
        return float(_costs(one, noise).mean())

    few = evenly_spaced(np.arange(len(seen[0].points)), _ROUGH_KEYPOINTS)
    quick = replace(config.fit, steps=10)
    rough = [
        min((fit(k, part.select(few), start, quick) for start in starts), key=cost)
        for k, part in enumerate(seen)
    ]
    # what changes the images as a whole gains at once; other labels, of a part of the keypoints
    kept = [
        k
        for k, each in enumerate(tried)
        if cost(rough[k]) < cost(rough[0]) or not (each.free or each.name.startswith("resized"))
    ]
    fits = [fit(k, seen[k], rough[k].pose, config.fit) for k in kept]
    sharpest = min(float(np.median(one.error)) for one in fits) / MEDIAN_DISTANCE
    gains = [_costs(fits[0], sharpest) - _costs(one, sharpest) for one in fits]
    return [
        FittedHypothesis(
            hypothesis=tried[k],
            seen=seen[k],
            fit=one,
            gain=float(gain.mean()),
            spread=float(gain.std()),
            effective=effective_number(gain, (seen[k].block, seen[k].keypoint)),
        )
        for k, one, gain in zip(kept, fits, gains, strict=True)
    ]


def effective_number(values: Floats, clusters: tuple[Ints, Ints]) -> float:
    """Return how many independent values have a mean as certain as that of these `[N]`.

    clusters: two numberings `[N]`; values of one cluster of either have errors in common. N over
    the design effect (Kish 1965), of two-way clusters (Cameron, Gelbach and Miller 2011).
    """
    deviation = values - values.mean()
    alone = float(deviation @ deviation)
    together = [float((np.bincount(each, deviation) ** 2).sum()) for each in clusters]
    return len(values) * alone / max(sum(together) - alone, alone, 1e-300)


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
