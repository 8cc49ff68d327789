"""Measure lengths that somebody knows, and find the scale that fits them best.

Each cue says what a length of 1 is: the logarithms of what is known over what was measured are
averaged, weighted by their variances (a product of errors is a sum of logarithms).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mocap_calib.config import CueConfig, FloorConfig, ScaleCue
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.geometry.alignment import body_size, rig_size
from mocap_calib.recording.epochs import own_name
from mocap_calib.results import Poses3D, RigCovariance
from mocap_calib.types import Bools, CameraRig, Floats, MeasuredCue, World
from mocap_calib.world.asked import (
    camera_pair,
    check_cues,
    describe_cue,
    head_columns,
    individual_index,
    joint_pair,
)
from mocap_calib.world.body import (
    Joints,
    distance,
    leg_lengths,
    median_over_frames,
    quantile_over_frames,
    stand_straight,
)
from mocap_calib.world.floor import FEET, Floor

_RESCALED = "axes and origin are those of the file, lengths are not: known ones set them"


@dataclass(frozen=True)
class Measurable:
    """What lengths are measured on: poses, and the cameras where those are at hand.

    covariance: of the rig; None = not known. centre_sigma_percent: then, by the names of cameras,
    how far their centres may be off, in percent of the size of the rig.
    individuals: `[individual]` names besides numbers.
    floor: or why there is none.
    """

    poses: Poses3D
    joints: Joints
    rig: CameraRig
    floor: Floor | str
    covariance: RigCovariance | None = None
    centre_sigma_percent: Mapping[str, float] = field(default_factory=dict)
    individuals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scale:
    """What a length of 1 is in metres, its relative standard deviation, and what says so."""

    factor: float
    sigma: float
    cues: tuple[MeasuredCue, ...]


def scaled_world(world: World, scale: Scale) -> World:
    """Return a world, whose lengths are scaled already, that says by what."""
    remarks = world.remarks
    if world.kind == "file" and _RESCALED not in remarks:
        remarks = (*remarks, _RESCALED)
    return replace(world, scale_sigma=scale.sigma, cues=scale.cues, remarks=remarks, scale_unmet="")


def find_scale(
    cues: Sequence[ScaleCue], on: Measurable, config: CueConfig, floor: FloorConfig
) -> Scale | None:
    """Return the scale that fits the cues best, None where there are none.

    Raises MismatchError for what cannot be measured, and where cues contradict each other.
    """
    if not cues:
        return None
    names = (on.poses.keypoints, on.joints, on.rig.names)
    check_cues(cues, *names, config, individuals=on.individuals)
    lengths, sigmas = np.array([_measure(cue, on, config, floor) for cue in cues]).T
    known = np.array([cue.metres for cue in cues])
    sigma = np.hypot(sigmas, [cue.sigma / cue.metres for cue in cues])
    logs = np.log(known / lengths)
    mean, residual = _combine(logs, sigma)
    factor = float(np.exp(mean))
    measured = tuple(
        MeasuredCue(describe_cue(cue), cue.metres, float(factor * length), float(own), float(off))
        for cue, length, own, off in zip(cues, lengths, sigma, residual, strict=True)
    )
    if (np.abs(residual) > config.most_residual).any():
        raise _contradiction(measured, logs, sigma, config)
    return Scale(factor, float(np.sqrt(1 / (1 / sigma**2).sum())), measured)


def _combine(logs: Floats, sigma: Floats) -> tuple[float, Floats]:
    """Return the mean of `[cue]` logarithms, and how many sigma each is from it, NaN if alone."""
    weight = 1 / sigma**2
    mean = float(weight @ logs / weight.sum())
    left = np.maximum(sigma**2 - 1 / weight.sum(), 0.0)  # the mean follows each of them in part
    return mean, (mean - logs) / np.sqrt(left) if len(logs) > 1 else np.array([np.nan])


def _contradiction(
    cues: Sequence[MeasuredCue], logs: Floats, sigma: Floats, config: CueConfig
) -> MismatchError:
    """Return the refusal of cues that are further apart than chance allows.

    It names the one without which the others agree, if there is exactly one.
    """
    said = ", ".join(
        f"{cue.text}={cue.metres:g} m ({cue.measured:.3g} m by all of them, "
        f"{abs(cue.residual):.1f} sigma off)"
        for cue in cues
    )
    odd = [k for k in range(len(cues)) if _agree_without(k, logs, sigma, config)]
    advice = "correct or leave out one of them"
    if len(cues) > 2 and len(odd) == 1:
        advice = f"correct or leave out {cues[odd[0]].text}, without which the others agree"
    return MismatchError(
        f"scale: expected lengths that agree with each other, found {said}; {advice}"
    )


def _agree_without(cue: int, logs: Floats, sigma: Floats, config: CueConfig) -> bool:
    """Return whether all cues but that of an index agree with each other."""
    _, residual = _combine(np.delete(logs, cue), np.delete(sigma, cue))
    return not (np.abs(residual) > config.most_residual).any()


def _measure(
    cue: ScaleCue, on: Measurable, config: CueConfig, floor: FloorConfig
) -> tuple[float, float]:
    """Return a length in the unit of the poses, and its relative standard deviation.

    Raises MismatchError where nothing shows it.
    """
    if cue.kind == "height":
        return _measure_height(cue, on, config, floor)
    if cue.kind == "length":
        return _measure_length(cue, on, config)
    return _measure_cameras(cue, on)


# --- heights


def statures(on: Measurable, config: CueConfig, floor: FloorConfig) -> Floats:
    """Return the stature `[individual]` of people who stand on the floor, NaN of all others.

    Raises MismatchError where it is not known where the floor is.
    """
    heads = head_columns(on.joints, config)
    if isinstance(on.floor, str):
        raise MismatchError(
            f"--height: expected somebody who stands, found that {on.floor}; "
            "say a --length or --camera-distance"
        )
    straight = stand_straight(on.poses, on.joints, floor.straight) & _stand_on(on, on.floor, floor)
    found = np.full((len(heads), straight.shape[1]), np.nan)
    for k, (column, share) in enumerate(heads):
        height = (on.poses.positions[:, :, column] - on.floor.point) @ on.floor.up / share
        height = np.where(straight & (height > 0), height, np.nan)
        enough = np.isfinite(height).sum(0) >= config.least_frames
        found[k] = np.where(enough, quantile_over_frames(height, config.standing_quantile), np.nan)
    return median_over_frames(found)


def _stand_on(on: Measurable, under: Floor, config: FloorConfig) -> Bools:
    """Return of which individuals `[individual]` the lower foot mostly is on the floor."""
    feet = on.poses.positions[:, :, on.joints.present(FEET["people"])]
    height = (feet - under.point) @ under.up
    lower = np.where(np.isfinite(height), height, np.inf).min(-1)
    lower = np.where(np.isfinite(lower), lower, np.nan)
    leg = leg_lengths(on.poses, on.joints)
    above = median_over_frames(lower) - config.ankle_height * leg
    near = config.reach * body_size(on.poses.positions)
    return np.asarray(np.abs(above) < near)


def _measure_height(
    cue: ScaleCue, on: Measurable, config: CueConfig, floor: FloorConfig
) -> tuple[float, float]:
    """Return the stature of an individual, or the median of all who stand."""
    found = statures(on, config, floor)
    if cue.of:
        found = found[[_find_individual(cue.of, on)]]
    found = found[np.isfinite(found)]
    if not len(found):
        who = f"that individual {cue.of} stands" if cue.of else "somebody who stands"
        raise MismatchError(
            f"--height: expected {who} on a straight leg in {config.least_frames} frames, found "
            "nobody; say a --length or --camera-distance"
        )
    middle = float(np.median(found))
    low = on.floor.sigma / middle if isinstance(on.floor, Floor) else 0.0
    return middle, float(np.hypot(np.hypot(config.height_sigma, low), _spread(found)))


def _find_individual(text: str, on: Measurable) -> int:
    """Return the index of an individual. Raises MismatchError."""
    count = on.poses.positions.shape[1]
    index = individual_index(text, on.individuals)
    if index is None or index >= count:
        known = [*map(str, range(count)), *on.individuals]
        raise MismatchError(
            f"--height {text}=...: expected an individual, one of {', '.join(known)}, "
            f"found {text!r}; {suggest(text, known)}"
        )
    return index


# --- lengths between joints, distances of cameras


def _measure_length(cue: ScaleCue, on: Measurable, config: CueConfig) -> tuple[float, float]:
    """Return the median distance of two joints, of the median individual."""
    pair = joint_pair(cue.of, on.poses.keypoints, on.joints, "--length")
    lengths = distance(on.poses.positions, *pair)
    seen = np.isfinite(lengths).sum(0)
    enough = seen >= config.least_frames
    if not enough.any():
        raise MismatchError(
            f"--length {cue.of}: expected both joints of somebody in {config.least_frames} frames, "
            f"found them in {seen.max(initial=0)}; say another"
        )
    middles = median_over_frames(lengths)[enough]
    middle = float(np.median(middles))
    away = median_over_frames(np.abs(lengths - np.median(middles)))[enough]
    noise = 1.4826 * np.median(away) / middle / np.sqrt(min(seen.max(), config.blocks))
    return middle, float(np.hypot(np.hypot(config.length_sigma, noise), _spread(middles)))


def _measure_cameras(cue: ScaleCue, on: Measurable) -> tuple[float, float]:
    """Return the distance of two cameras."""
    a, b = camera_pair(cue.of, on.rig.names, "--camera-distance")
    offset = on.rig.centres[b] - on.rig.centres[a]
    length = float(np.linalg.norm(offset))
    if length == 0:
        raise MismatchError(
            f"--camera-distance {cue.of}: expected cameras in two places, found them in one; "
            "say another pair"
        )
    if on.covariance is None:
        sigma = _distance_sigma(on.rig, on.centre_sigma_percent, a, b)
        return length, float(np.hypot(sigma / length, 1e-3))
    parts = on.covariance.matrix[[a, b], 3:][:, :, [a, b], 3:] * on.covariance.size**2
    signs, along = np.array([-1.0, 1.0]), offset / length
    variance = float(np.einsum("a,i,aibj,b,j->", signs, along, parts, signs, along))
    return length, float(np.hypot(np.sqrt(max(variance, 0.0)) / length, 1e-3))


def _distance_sigma(rig: CameraRig, percent: Mapping[str, float], a: int, b: int) -> float:
    """Return the standard deviation of the distance of two views.

    percent: of the size of the rig, by which centres may be off in all directions together.
    """
    names = [own_name(rig.names[view], rig.names) for view in (a, b)]
    own = [float(percent.get(name, 0.0)) for name in names]
    return float(np.hypot(own[0], own[1]) / 100 * rig_size(rig) / np.sqrt(3))


def _spread(values: Floats) -> float:
    """Return by how much individuals differ: nobody said which of them is meant."""
    if len(values) < 2:
        return 0.0
    return float(1.4826 * np.median(np.abs(values - np.median(values))) / np.median(values))
