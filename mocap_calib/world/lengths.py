"""Check stated lengths, measure them in results, and estimate the scale that fits them best.

Each cue gives the length of a unit: the logarithms of known over measured lengths are averaged,
weighted by their inverse variances (a product of errors is a sum of logarithms).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import CueConfig, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError, argument, spell_as_option, suggest
from mocap_calib.geometry.rotation import body_size
from mocap_calib.kinematics import quantile_over_frames
from mocap_calib.recording.epochs import views_by_camera
from mocap_calib.recording.joints import normalise_name
from mocap_calib.results import Poses3D, RigCovariance
from mocap_calib.types import CameraRig, Floats, MeasuredCue, World
from mocap_calib.world.floor import (
    Floor,
    Joints,
    distance,
    find_floor,
    lengths_of_legs,
    sample_poses,
    stand_straight,
)

_OTHER_CUES = f"use {argument('length')} or {argument('camera_distance')}"
_METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}
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


def measurable(
    poses: Poses3D,
    joints: Joints,
    rig: CameraRig,
    covariance: RigCovariance,
    config: WorldConfig,
    *,
    verdict: str,
) -> Measurable:
    """Return results as lengths are measured in them, with the floor.

    verdict: on the rig, "" = none.
    """
    sample = sample_poses(poses)
    floor: Floor | str = "the rig is not determined"
    if verdict != "not determined":
        floor = find_floor(sample, joints, config.floor)
    if isinstance(floor, Floor):
        turn = float(np.median(covariance.rotation_sigma))
        floor = replace(floor, up_sigma=float(np.hypot(floor.up_sigma, turn)))
    return Measurable(sample, joints, rig, floor, covariance)


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
    weight = 1 / sigma**2
    mean = float(weight @ logs / weight.sum())
    left = np.maximum(sigma**2 - 1 / weight.sum(), 0.0)  # the mean follows each of them in part
    residual = (mean - logs) / np.sqrt(left) if len(cues) > 1 else np.array([np.nan])
    factor = float(np.exp(mean))
    measured = tuple(
        MeasuredCue(describe_cue(cue), cue.metres, float(factor * length), float(own), float(off))
        for cue, length, own, off in zip(cues, lengths, sigma, residual, strict=True)
    )
    if (np.abs(residual) > config.most_misfit).any():
        listed = ", ".join(
            f"{cue.text}={cue.metres:g} m ({cue.measured:.3g} m by all of them, "
            f"{abs(cue.residual):.1f} sigma off)"
            for cue in measured
        )
        raise MismatchError(
            "scale",
            "lengths that agree with each other",
            listed,
            "correct or leave out one of them",
        )
    return Scale(factor, float(np.sqrt(1 / weight.sum())), measured)


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
            argument("height"), "someone who stands", f"that {on.floor}", _OTHER_CUES
        )
    positions, floor = on.poses.positions, config.floor
    height = (positions - on.floor.point) @ on.floor.up
    ankle = np.fmin.reduce(height[:, :, on.joints.feet], axis=-1)  # of the lower foot
    sole = ankle - floor.ankle_height * lengths_of_legs(positions, on.joints)
    stands = stand_straight(positions, on.joints, floor.straight)
    stands &= np.abs(sole) < floor.near * body_size(positions)
    columns, shares = zip(*heads, strict=True)
    tall = height[:, :, list(columns)] / np.array(shares)
    tall = np.where(stands[..., None] & (tall > 0), tall, np.nan)
    return quantile_over_frames(quantile_over_frames(tall, 0.5).T, 0.5)


def _measure_height(cue: ScaleCue, on: Measurable, config: WorldConfig) -> tuple[float, float]:
    """Return the stature of an individual, or the median of all who stand."""
    found = statures(on, config)
    if cue.of:
        found = found[[find_individual(cue.of, len(found), on.individuals)]]
    who = f"individual {cue.of}" if cue.of else "someone"
    if not np.isfinite(found).any():
        raise MismatchError(argument("height"), f"{who} on a straight leg", "no one", _OTHER_CUES)
    middle, sigma = _median_of(found, config.measure.height_sigma)
    low = on.floor.sigma / middle if isinstance(on.floor, Floor) else 0.0
    return middle, float(np.hypot(sigma, low))


def _measure_length(cue: ScaleCue, on: Measurable, config: CueConfig) -> tuple[float, float]:
    """Return the median distance of two joints, of the median individual."""
    pair = joint_pair(cue.of, on.poses.keypoints, on.joints, "length")
    middles = quantile_over_frames(distance(on.poses.positions, *pair), 0.5)
    if not np.isfinite(middles).any():
        raise MismatchError(
            argument("length", cue.of),
            "both joints of a subject in one frame",
            "them in none",
            "use another pair",
        )
    return _median_of(middles, 2 * config.height_sigma)


def _measure_cameras(cue: ScaleCue, on: Measurable) -> tuple[float, float]:
    """Return the distance of two cameras."""
    a, b = camera_pair(cue.of, on.rig.names, "camera_distance")
    offset = on.rig.centres[b] - on.rig.centres[a]
    length = float(np.linalg.norm(offset))
    if length == 0:
        raise MismatchError(
            argument("camera_distance", cue.of),
            "cameras in different places",
            "them in one",
            "use another pair",
        )
    parts = on.covariance.matrix[[a, b], 3:][:, :, [a, b], 3:] * on.covariance.size**2
    signs, along = np.array([-1.0, 1.0]), offset / length
    variance = float(np.einsum("a,i,aibj,b,j->", signs, along, parts, signs, along))
    return length, float(np.hypot(np.sqrt(max(variance, 0.0)) / length, 1e-3))


def _median_of(values: Floats, sigma: float) -> tuple[float, float]:
    """Return the median over the individuals, and its relative standard deviation.

    It has their spread, as the cue may be of any of them. values: `[individual]`, NaN = not known,
    but for one at least. sigma: relative, of each.
    """
    values = values[np.isfinite(values)]
    middle = float(np.median(values))
    spread = 1.4826 * np.median(np.abs(values - middle)) / middle
    return middle, float(np.hypot(sigma, spread))


def check_unit(positions: Floats, joints: Joints, name: str, config: CueConfig) -> list[str]:
    """Return a remark where people are too small for a stated unit of length, none if they fit.

    positions: `[frame, individual, keypoint, 3]` in metres by the stated unit. name: of the
        argument that states it.

    Raises MismatchError where people are too tall.
    """
    ankles = joints.feet if joints.kind == "people" else []
    tall = [
        distance(positions, joints.columns[name], ankle) / share
        for name, share in config.head_height
        for ankle in ankles
        if name in joints.columns
    ]
    known = np.array(tall)[np.isfinite(tall)]
    if not len(known):
        return []
    metres = float(np.median(known))
    if metres > config.statures[1]:
        raise MismatchError(
            argument(name),
            "lengths in its unit",
            f"people {metres:.4g} m tall",
            likely_unit(metres, config),
        )
    too_small = metres < config.statures[0]
    option = spell_as_option(name, "")
    return [f"people are {metres:.2g} m tall: is the unit of {option} right?"] if too_small else []


# --- what is stated of lengths


def check_cues(
    cues: Sequence[ScaleCue],
    keypoints: tuple[str, ...],
    joints: Joints,
    views: Sequence[str],
    config: CueConfig,
    *,
    count: int | None = None,
    individuals: Sequence[str] = (),
) -> None:
    """Compare known lengths with the names of keypoints, cameras and individuals.

    views: names of the cameras' views. count: of individuals, None = not known, and individuals:
    names that they have besides numbers.

    Raises MismatchError for unknown names, impossible statures, and lengths that are given twice.
    """
    seen: set[tuple[str, frozenset[int]]] = set()
    for cue in cues:
        if cue.kind == "height":
            head_columns(joints, config)
            least, most = config.statures
            if not least <= cue.metres <= most:
                raise MismatchError(
                    argument("height"),
                    f"the stature of a person in metres, {least:g} to {most:g}",
                    f"{cue.metres:g}",
                    likely_unit(cue.metres, config),
                )
            own = [find_individual(cue.of, count, individuals)] if cue.of else []
            what = frozenset(own)
        elif cue.kind == "length":
            what = frozenset(joint_pair(cue.of, keypoints, joints, "length"))
        else:
            what = frozenset(camera_pair(cue.of, views, "camera_distance"))
        if (cue.kind, what) in seen:
            raise MismatchError(
                "scale", "each length once", f"{describe_cue(cue)} twice", "leave one of them out"
            )
        seen.add((cue.kind, what))


def describe_cue(cue: ScaleCue) -> str:
    """Return the name of a known length: `height of 0`, `length left_hip-left_knee`."""
    if cue.kind == "height":
        return f"height of {cue.of}" if cue.of else "height"
    return f"{cue.kind} {cue.of}"


def head_columns(joints: Joints, config: CueConfig) -> list[tuple[int, float]]:
    """Return the points of the head, and the height of each in statures.

    Raises MismatchError without such points, and without feet.
    """
    heads = [(joints.columns[name], share) for name, share in config.head_height
             if name in joints.columns]  # fmt: skip
    if joints.kind != "people" or not heads or not joints.have_feet:
        raise MismatchError(
            argument("height"),
            "people with ankles and points of the head (head_top, eyes, ears or nose)",
            "none",
            _OTHER_CUES,
        )
    return heads


def find_individual(text: str, count: int | None, individuals: Sequence[str] = ()) -> int:
    """Return the index of an individual, by its number, `individual_0` or its name.

    count: of individuals, None = not known. individuals: their names besides numbers.

    Raises MismatchError.
    """
    number = text.removeprefix("individual_")
    index = int(number) if number.isdecimal() else -1
    index = individuals.index(text) if text in individuals else index
    if index >= 0 and (count is None or index < count):
        return index
    known = ["0", "1", "..."] if count is None else [*map(str, range(count)), *individuals]
    raise MismatchError(
        argument("height", f"{text}=..."),
        f"an individual, one of {', '.join(known)}",
        f"{text!r}",
        suggest(text, known),
    )


def joint_pair(text: str, keypoints: tuple[str, ...], joints: Joints, name: str) -> tuple[int, int]:
    """Return the indices of two keypoints of `A-B`, by their own names or those of joints.

    name: of the argument that holds the text.

    Raises MismatchError.
    """
    known = joints.columns | {name: k for k, name in enumerate(keypoints)}
    return _find_pair(text, known, "joints", keypoints, name)


def camera_pair(text: str, views: Sequence[str], name: str) -> tuple[int, int]:
    """Return the indices of the views of two cameras of `A-B`. Raises MismatchError."""
    known = {name: own[0] for name, own in views_by_camera(views).items()}
    return _find_pair(text, known, "cameras", tuple(known), name)


def _find_pair(
    text: str, known: Mapping[str, int], what: str, offered: Sequence[str], name: str
) -> tuple[int, int]:
    """Return the indices of the two names of `A-B`, either of which may have a `-`.

    Raises MismatchError.
    """
    known = {normalise_name(name): k for name, k in known.items()} | dict(known)
    names = text.split("-")
    for cut in range(1, len(names)):
        ends = ("-".join(names[:cut]), "-".join(names[cut:]))
        first, second = (known.get(end, known.get(normalise_name(end))) for end in ends)
        if first is not None and second is not None and first != second:
            return first, second
    strangers = [name for name in names if name not in known and normalise_name(name) not in known]
    advice = suggest(strangers[0], offered) if strangers else "give two"
    raise MismatchError(
        argument(name, text),
        f"two {what}, as A-B, of {', '.join(offered)}",
        f"{(strangers or names)[0]!r}",
        advice,
    )


def likely_unit(stature: float, config: CueConfig) -> str:
    """Return what to do about a stature that is impossible in metres."""
    least, most = config.statures
    fits = {name: stature * unit for name, unit in _METRES.items()}
    fits = {name: metres for name, metres in fits.items() if least <= metres <= most}
    if not fits:
        return "correct it"
    name = max(fits, key=lambda each: fits[each])
    return f"were {name} meant? multiply by {_METRES[name]:g}: {fits[name]:g} m"
