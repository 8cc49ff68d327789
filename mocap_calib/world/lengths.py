"""Measure known lengths in results, and estimate the scale that fits them best.

Each cue gives the length of a unit: the logarithms of known over measured lengths are averaged,
weighted by their inverse variances (a product of errors is a sum of logarithms).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import CueConfig, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.alignment import body_size
from mocap_calib.kinematics import quantile_over_frames
from mocap_calib.results import Poses3D, RigCovariance
from mocap_calib.types import Bools, CameraRig, Floats, MeasuredCue, World
from mocap_calib.world.align import find_culprit
from mocap_calib.world.floor import Floor, Joints, distance, lengths_of_legs, stand_straight
from mocap_calib.world.requested import (
    OTHER_CUES,
    camera_pair,
    check_cues,
    describe_cue,
    find_individual,
    head_columns,
    joint_pair,
    likely_unit,
)

_RESCALED = "axes and origin are those of the file; lengths follow from known ones instead"


@dataclass(frozen=True)
class Measurable:
    """Results in which lengths are measured.

    poses: a sample of them, see `world.floor.sample_poses`. floor: or the reason why there is none.
    covariance: of the rig. individuals: `[individual]` names besides numbers.
    """

    poses: Poses3D
    joints: Joints
    rig: CameraRig
    floor: Floor | str
    covariance: RigCovariance
    individuals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scale:
    """The factor from lengths to metres, its relative standard deviation, and what it rests on."""

    factor: float
    sigma: float
    cues: tuple[MeasuredCue, ...]


def scaled_world(world: World, scale: Scale) -> World:
    """Return the world of results that were scaled already, with what the scale rests on."""
    remarks = world.remarks
    if world.kind == "file" and _RESCALED not in remarks:
        remarks = (*remarks, _RESCALED)
    return replace(world, scale_sigma=scale.sigma, cues=scale.cues, remarks=remarks, scale_unmet="")


def find_scale(cues: Sequence[ScaleCue], on: Measurable, config: WorldConfig) -> Scale | None:
    """Return the scale that fits the cues best, None without cues.

    Raises MismatchError for lengths that cannot be measured, and cues that contradict each other.
    """
    if not cues:
        return None
    count = on.poses.positions.shape[1]
    names = (on.poses.keypoints, on.joints, on.rig.names)
    check_cues(cues, *names, config.measure, count=count, individuals=on.individuals)
    lengths, sigmas = np.array([_measure(cue, on, config) for cue in cues]).T
    known = np.array([cue.metres for cue in cues])
    sigma = np.hypot(sigmas, [cue.sigma / cue.metres for cue in cues])
    logs = np.log(known / lengths)
    mean, residual = _combine(logs, sigma)
    factor = float(np.exp(mean))
    measured = tuple(
        MeasuredCue(describe_cue(cue), cue.metres, float(factor * length), float(own), float(off))
        for cue, length, own, off in zip(cues, lengths, sigma, residual, strict=True)
    )
    most = config.measure.most_residual
    if (np.abs(residual) > most).any():

        def agree(some: Bools) -> bool:
            """Return whether the cues that a mask leaves agree with each other."""
            return not (np.abs(_combine(logs[some], sigma[some])[1]) > most).any()

        culprit = find_culprit(agree, len(cues)) if len(cues) > 2 else None
        raise _contradiction(measured, culprit)
    return Scale(factor, float(np.sqrt(1 / (1 / sigma**2).sum())), measured)


def _combine(logs: Floats, sigma: Floats) -> tuple[float, Floats]:
    """Return the mean of `[cue]` logarithms, and how many sigma each is from it, NaN if alone."""
    weight = 1 / sigma**2
    mean = float(weight @ logs / weight.sum())
    left = np.maximum(sigma**2 - 1 / weight.sum(), 0.0)  # the mean follows each of them in part
    return mean, (mean - logs) / np.sqrt(left) if len(logs) > 1 else np.array([np.nan])


def _contradiction(cues: Sequence[MeasuredCue], culprit: int | None) -> MismatchError:
    """Return the refusal of cues that differ by more than their errors allow.

    culprit: index of the one without which the others agree.
    """
    listed = ", ".join(
        f"{cue.text}={cue.metres:g} m ({cue.measured:.3g} m by all of them, "
        f"{abs(cue.residual):.1f} sigma off)"
        for cue in cues
    )
    advice = "correct or leave out one of them"
    if culprit is not None:
        advice = f"correct or leave out {cues[culprit].text}, without which the others agree"
    return MismatchError(
        f"scale: expected lengths that agree with each other, found {listed}; {advice}"
    )


def _measure(cue: ScaleCue, on: Measurable, config: WorldConfig) -> tuple[float, float]:
    """Return a length in the unit of the poses, and its relative standard deviation.

    Raises MismatchError where nothing shows it.
    """
    if cue.kind == "height":
        return _measure_height(cue, on, config)
    if cue.kind == "length":
        return _measure_length(cue, on, config.measure)
    return _measure_cameras(cue, on)


def statures(on: Measurable, config: WorldConfig) -> Floats:
    """Return the stature `[individual]` of people who stand on the floor, NaN of all others.

    Raises MismatchError where the floor is not determined.
    """
    heads = head_columns(on.joints, config.measure)
    if isinstance(on.floor, str):
        raise MismatchError(
            f"--height: expected someone who stands, found that {on.floor}; {OTHER_CUES}"
        )
    positions, floor = on.poses.positions, config.floor
    height = (positions - on.floor.point) @ on.floor.up
    ankle = np.fmin.reduce(height[:, :, on.joints.feet], axis=-1)  # of the lower foot
    sole = ankle - floor.ankle_height * lengths_of_legs(positions, on.joints)
    stands = stand_straight(positions, on.joints, floor.straight)
    stands &= np.abs(sole) < floor.near * body_size(positions)
    found = np.full((len(heads), positions.shape[1]), np.nan)
    for k, (column, share) in enumerate(heads):
        above = height[:, :, column]
        own = np.where(stands & (above > 0), above / share, np.nan)
        found[k] = _quantile_of_enough(own, config.measure.tall_quantile, config.measure)
    return quantile_over_frames(found, 0.5)


def _quantile_of_enough(values: Floats, share: float, config: CueConfig) -> Floats:
    """Return a quantile `[individual]` of `[frame, individual]`, NaN where frames are too few."""
    enough = np.isfinite(values).sum(0) >= config.least_frames
    return np.where(enough, quantile_over_frames(values, share), np.nan)


def _measure_height(cue: ScaleCue, on: Measurable, config: WorldConfig) -> tuple[float, float]:
    """Return the stature of an individual, or the median of all who stand."""
    found = statures(on, config)
    if cue.of:
        found = found[[find_individual(cue.of, len(found), on.individuals)]]
    found = found[np.isfinite(found)]
    if not len(found):
        who = f"individual {cue.of}" if cue.of else "someone"
        raise MismatchError(
            f"--height: expected {who} on a straight leg in {config.measure.least_frames} frames, "
            f"found no one; {OTHER_CUES}"
        )
    middle = float(np.median(found))
    low = on.floor.sigma / middle if isinstance(on.floor, Floor) else 0.0
    return middle, float(np.hypot(np.hypot(config.measure.height_sigma, low), _spread(found)))


def _measure_length(cue: ScaleCue, on: Measurable, config: CueConfig) -> tuple[float, float]:
    """Return the median distance of two joints, of the median individual."""
    pair = joint_pair(cue.of, on.poses.keypoints, on.joints, "--length")
    lengths = distance(on.poses.positions, *pair)
    middles = _quantile_of_enough(lengths, 0.5, config)
    middles = middles[np.isfinite(middles)]
    if not len(middles):
        most = np.isfinite(lengths).sum(0).max(initial=0)
        raise MismatchError(
            f"--length {cue.of}: expected both joints of a subject in {config.least_frames} "
            f"frames, found them in {most}; use another pair"
        )
    return float(np.median(middles)), float(np.hypot(config.length_sigma, _spread(middles)))


def _measure_cameras(cue: ScaleCue, on: Measurable) -> tuple[float, float]:
    """Return the distance of two cameras."""
    a, b = camera_pair(cue.of, on.rig.names, "--camera-distance")
    offset = on.rig.centres[b] - on.rig.centres[a]
    length = float(np.linalg.norm(offset))
    if length == 0:
        raise MismatchError(
            f"--camera-distance {cue.of}: expected cameras in different places, found them in "
            "one; use another pair"
        )
    parts = on.covariance.matrix[[a, b], 3:][:, :, [a, b], 3:] * on.covariance.size**2
    signs, along = np.array([-1.0, 1.0]), offset / length
    variance = float(np.einsum("a,i,aibj,b,j->", signs, along, parts, signs, along))
    return length, float(np.hypot(np.sqrt(max(variance, 0.0)) / length, 1e-3))


def _spread(values: Floats) -> float:
    """Return the relative standard deviation of individuals: the cue may be of any of them."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))) / np.median(values))


def check_unit(positions: Floats, joints: Joints, option: str, config: CueConfig) -> list[str]:
    """Return a remark where people are too small for a stated unit of length, none if they fit.

    positions: `[frame, individual, keypoint, 3]` in metres by the stated unit. option: states it.

    Raises MismatchError where people are too tall.
    """
    ankles = joints.feet if joints.kind == "people" else []
    tall = [
        _quantile_of_enough(distance(positions, head, ankle) / share, config.tall_quantile, config)
        for head, share in ((joints.columns.get(name), share) for name, share in config.head_height)
        for ankle in ankles
        if head is not None
    ]
    known = quantile_over_frames(np.array(tall), 0.5) if tall else np.zeros(0)
    known = known[np.isfinite(known)]
    if not len(known):
        return []
    metres = float(np.median(known))
    if metres > config.statures[1]:
        raise MismatchError(
            f"{option}: expected lengths in its unit, found people {metres:.4g} m tall; "
            f"{likely_unit(metres, config)}"
        )
    too_small = metres < config.statures[0]
    return [f"people are {metres:.2g} m tall: is the unit of {option} right?"] if too_small else []
