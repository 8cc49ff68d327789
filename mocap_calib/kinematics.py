"""Bone lengths, joint angles, speeds and foot contacts of 3D poses.

What is measured of a kind of body is the section `kinematics` of its skeleton's file. Joints stand
there without their sides. A list in place of a joint is a choice: the first that the recording has
counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mocap_calib.config import KinematicsConfig
from mocap_calib.geometry.rotation import direction_angle, mean_of_known
from mocap_calib.recording.joints import (
    choose_skeleton,
    edges_of_keypoints,
    load_section,
    match_names,
)
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints, Record, Skeleton

_CONFIG = KinematicsConfig()
BODY = "body"  # whose speed is that of the trunk
SIDES = ("left_", "right_")


@dataclass(frozen=True)
class Definitions:
    """What can be measured of a recording; numbers are indices of its keypoints.

    edges: pairs that a bone joins.
    angles: name -> (end, vertex, end).
    trunk: keypoints that move as the body does.
    legs: chains of keypoints from the hip down.
    feet: name -> keypoints of which one touches the floor where the foot does.
    """

    edges: tuple[tuple[int, int], ...]
    angles: Mapping[str, tuple[int, int, int]]
    trunk: tuple[int, ...]
    legs: tuple[tuple[int, ...], ...]
    feet: Mapping[str, tuple[int, ...]]


def define(
    keypoints: Sequence[str], skeleton: Skeleton, aliases: Mapping[str, str] | None = None
) -> Definitions:
    """Return what can be measured of these keypoints by the section of a shipped skeleton.

    aliases: a user's names, own name -> joint.
    """
    section = load_section(skeleton.name, "kinematics")
    names = tuple((aliases or {}).get(name, name) for name in keypoints)
    vocabulary = match_names(names, skeleton)
    known = {skeleton.keypoints[joint]: k for k, joint in enumerate(vocabulary) if joint >= 0}
    spelt = [side + joint for joint in section.get("trunk", ()) for side in ("", *SIDES)]
    return Definitions(
        edges=edges_of_keypoints(skeleton, vocabulary),
        angles={
            side + name: (a, vertex, b)
            for name, joints in section.get("angles", {}).items()
            for side, (a, vertex, b) in _chains(joints, known).items()
        },
        trunk=tuple(known[name] for name in spelt if name in known),
        legs=tuple(_chains(section.get("leg", ()), known).values()),
        feet=_define_feet(section.get("feet", {}), known),
    )


def _define_feet(feet: Mapping[str, Any], known: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Return the feet; of several groups of joints the first of which the recording has any."""
    found = {}
    for (name, groups), side in product(feet.items(), SIDES):
        own = ([known[side + each] for each in group if side + each in known] for group in groups)
        if first := next(filter(None, own), None):
            found[side + name] = tuple(first)
    return found


def _chains(joints: Sequence[Any], known: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Return the keypoints of a chain of joints, by side; "" = a chain in the body's middle."""
    found = {side: [_find(joint, side, known) for joint in joints] for side in ("", *SIDES)}
    whole = {side: tuple(own) for side, own in found.items() if own and -1 not in own}
    return {"": whole[""]} if "" in whole else whole


def _find(joint: Any, side: str, known: Mapping[str, int]) -> int:
    """Return the keypoint of a joint of a side, or of the middle; -1 where there is none."""
    for name in joint if isinstance(joint, list) else [joint]:
        for spelt in (f"{side}{name}", name):
            if spelt in known:
                return known[spelt]
    return -1


@dataclass(frozen=True, eq=False, repr=False)
class Kinematics(Record):
    """What follows from poses; missing is NaN. Lengths are in the unit of the poses.

    bones: `[bone]` names, from joint to joint. bone_mean, bone_sd: `[individual, bone]` mean and
        standard deviation of the lengths, over bone_frames: `[individual, bone]` frames.
    angles: name -> `[frame, individual]` included angle in degrees: 180 = straight.
    speeds: name -> `[frame, individual]` per second, per frame where the rate is not known.
    contacts: name -> `[frame, individual]` 1 = the foot stands on the floor, 0 = it does not.
    frames: `[frame]` numbers. rate: frames per second, NaN = not known.
    notes: what could not be measured and why, a line each.
    """

    frames: Ints
    rate: float
    unit: str
    bones: tuple[str, ...]
    bone_mean: Floats
    bone_sd: Floats
    bone_frames: Ints
    angles: dict[str, Floats]
    speeds: dict[str, Floats]
    contacts: dict[str, Floats]
    notes: tuple[str, ...] = ()


def measure(
    poses: Poses3D,
    fps: float | None = None,
    definitions: Definitions | None = None,
) -> Kinematics:
    """Measure poses.

    fps: frames per second, None = not known: speeds are per frame then, and contacts are not
        looked for. definitions: what is measured; None: what the shipped skeleton says that knows
        most of the keypoints.
    """
    if definitions is None:
        definitions = define(poses.keypoints, choose_skeleton(poses.keypoints))
    mean, deviation, frames = bone_lengths(poses.positions, definitions.edges)
    velocity = frame_velocity(poses.frames, poses.positions) * (1.0 if fps is None else fps)
    contacts, reason = _contacts(poses, velocity, definitions, fps)
    names = poses.keypoints
    return Kinematics(
        frames=poses.frames,
        rate=np.nan if fps is None else fps,
        unit=poses.unit,
        bones=tuple(f"{names[a]}-{names[b]}" for a, b in definitions.edges),
        bone_mean=mean,
        bone_sd=deviation,
        bone_frames=frames,
        angles={
            name: joint_angle(*(poses.positions[:, :, k] for k in joints))
            for name, joints in definitions.angles.items()
        },
        speeds=_speeds(names, velocity, definitions.trunk),
        contacts=contacts,
        notes=(f"foot contacts skipped: {reason}",) if reason else (),
    )


def bone_lengths(
    positions: Floats, edges: tuple[tuple[int, int], ...]
) -> tuple[Floats, Floats, Ints]:
    """Return mean and standard deviation of the lengths `[individual, bone]`, and their frames.

    positions: `[frame, individual, keypoint, 3]`. The deviation is NaN where there is one frame.
    """
    pairs = np.array(edges, dtype=np.int64).reshape(-1, 2)
    lengths = np.linalg.norm(positions[:, :, pairs[:, 0]] - positions[:, :, pairs[:, 1]], axis=-1)
    frames = np.isfinite(lengths).sum(0)
    mean = mean_of_known(lengths, 0)
    square = mean_of_known((lengths - mean) ** 2, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.where(frames > 1, square * frames / (frames - 1), np.nan))
    return mean, deviation, frames


def joint_angle(first: Floats, vertex: Floats, last: Floats) -> Floats:
    """Return the included angles `[...]` in degrees at vertices `[..., 3]`: 180 = straight.

    NaN where a point is missing, or lies on the vertex.
    """
    a, b = first - vertex, last - vertex
    there = (a * a).sum(-1) * (b * b).sum(-1) > 0
    return np.where(there, np.degrees(direction_angle(a, b)), np.nan)


def _speeds(names: tuple[str, ...], velocity: Floats, trunk: tuple[int, ...]) -> dict[str, Floats]:
    """Return the speeds of the body and of each keypoint.

    The body's is the length of the mean velocity of the trunk's joints that are there: the mean of
    velocities does not jump where a joint comes or goes, as the mean of positions does.
    """
    own = list(trunk) or list(range(len(names)))
    body = np.linalg.norm(mean_of_known(velocity[:, :, own], 2), axis=-1)
    each = np.linalg.norm(velocity, axis=-1)
    return {BODY: body} | {name: each[:, :, k] for k, name in enumerate(names) if name != BODY}


def _contacts(
    poses: Poses3D,
    velocity: Floats,
    definitions: Definitions,
    fps: float | None,
) -> tuple[dict[str, Floats], str]:
    """Return the contacts of each foot, or why there are none.

    velocity: `[frame, individual, keypoint, 3]` per second.
    """
    world = poses.world
    if not np.isfinite([world.up, world.floor]).all():
        return {}, "the poses do not say where the floor is"
    if fps is None:
        return {}, "the frame rate is unknown (use --fps)"
    if not definitions.feet:
        return {}, "the keypoints have no feet"
    if not definitions.legs:
        why = "the keypoints have no whole leg (hip, knee, foot), which heights are measured by"
        return {}, why
    leg = leg_lengths(poses.positions, definitions.legs)
    reach = round(_CONFIG.window * fps)
    found = {}
    for name, points in definitions.feet.items():
        own = list(points)
        above = (poses.positions[:, :, own] - world.floor) @ world.up
        height = average_around(poses.frames, above, reach)
        speed = np.linalg.norm(average_around(poses.frames, velocity[:, :, own], reach), axis=-1)
        contacts = find_contacts(height, speed, leg)
        known = np.isfinite(contacts)
        any_ = np.where(known, contacts, 0.0).max(-1)
        found[name] = np.where(known.any(-1), any_, np.nan)
    return found, ""


def leg_lengths(positions: Floats, legs: Sequence[Sequence[int]]) -> Floats:
    """Return the length `[individual]` of legs, the mean of both; NaN = not known.

    positions: `[frame, individual, keypoint, 3]`. legs: chains of keypoints from the hip down.
    """
    lengths = np.full((len(legs), positions.shape[1]), np.nan)
    for k, chain in enumerate(legs):
        bones = np.linalg.norm(np.diff(positions[:, :, list(chain)], axis=2), axis=-1)
        lengths[k] = quantile_over_frames(bones, 0.5).sum(-1)
    return mean_of_known(lengths, 0)


def find_contacts(height: Floats, speed: Floats, leg: Floats) -> Floats:
    """Return 1 where a point stands on the floor, 0 where it does not, NaN = not known.

    A joint lies above the sole, so heights count from the lowest that it usually has, as far as
    that is near the floor.

    height: `[frame, individual, point]` above the floor. speed: the same, per second. leg:
        `[individual]` length of a leg.
    """
    length = leg[:, None]
    rest = quantile_over_frames(height, _CONFIG.rest_quantile)
    most = 2 * _CONFIG.contact_height * length  # an ankle's is 0.1; more: it never stands
    rest = np.clip(rest, -most, most)
    with np.errstate(invalid="ignore"):
        low = height - rest < _CONFIG.contact_height * length
        slow = speed < _CONFIG.contact_speed * length
    known = np.isfinite(height) & np.isfinite(speed) & np.isfinite(length)
    return np.where(known, low & slow, np.nan)


def frame_velocity(frames: Ints, positions: Floats) -> Floats:
    """Return the velocities `[frame, ..., 3]` of positions `[frame, ..., 3]`, per frame.

    The mean of the velocities to the frame before and to the one behind (the central difference),
    the one that there is at the ends of a track, NaN where there is neither. Frames follow each
    other where their numbers differ by the step that most do: a track does not go on across a gap.

    frames: `[frame]` numbers that rise.
    """
    velocity = np.full(positions.shape, np.nan)
    steps = np.diff(frames)
    if not len(steps):
        return velocity
    shape = (-1, *[1] * (positions.ndim - 1))
    usual = float(np.median(steps))
    apart = steps.reshape(shape).astype(np.float64)
    between = np.where(apart <= usual, np.diff(positions, axis=0) / apart, np.nan)
    none = np.full((1, *positions.shape[1:]), np.nan)
    both = np.stack([np.concatenate([none, between]), np.concatenate([between, none])])
    return mean_of_known(both, 0)


def average_around(frames: Ints, values: Floats, reach: int) -> Floats:
    """Return the means of values `[frame, ...]` over the frames up to `reach` numbers away.

    NaN stays where a value itself is missing.
    """
    low = np.searchsorted(frames, frames - reach)
    high = np.searchsorted(frames, frames + reach, side="right")
    known = np.isfinite(values)
    sums = np.zeros((2, len(frames) + 1, *values.shape[1:]))
    np.cumsum([np.where(known, values, 0.0), known], axis=1, out=sums[:, 1:])
    total, count = sums[:, high] - sums[:, low]
    return np.where(known, total / np.maximum(count, 1), np.nan)


def quantile_over_frames(values: Floats, share: float) -> Floats:
    """Return a quantile `[...]` of the values `[frame, ...]` that are not NaN; NaN without any."""
    ordered = np.sort(np.concatenate([values, np.full((1, *values.shape[1:]), np.nan)]), axis=0)
    last = np.maximum(np.isfinite(values).sum(0) - 1, 0)  # NaN comes last
    rows = np.rint(share * last).astype(np.int64)
    return np.take_along_axis(ordered, rows[None], axis=0)[0]
