"""Bone lengths, joint angles, speeds and contacts of 3D poses."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import KinematicsConfig
from mocap_calib.geometry.rotation import direction_angle
from mocap_calib.kinematics.contacts import find_contacts, leg_lengths
from mocap_calib.kinematics.definitions import Definitions, define
from mocap_calib.kinematics.motion import average_around, frame_velocity, mean_known
from mocap_calib.recording.joints import choose_skeleton
from mocap_calib.records import Record
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_CONFIG = KinematicsConfig()
BODY = "body"  # whose speed is that of the trunk


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
    config: KinematicsConfig = _CONFIG,
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
    contacts, reason = _contacts(poses, velocity, definitions, fps, config)
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
        notes=(f"contacts: not determined: {reason}",) if reason else (),
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
    mean = mean_known(lengths)
    square = mean_known((lengths - mean) ** 2)
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
    body = np.linalg.norm(mean_known(velocity[:, :, own], axis=2), axis=-1)
    each = np.linalg.norm(velocity, axis=-1)
    return {BODY: body} | {name: each[:, :, k] for k, name in enumerate(names) if name != BODY}


def _contacts(
    poses: Poses3D,
    velocity: Floats,
    definitions: Definitions,
    fps: float | None,
    config: KinematicsConfig,
) -> tuple[dict[str, Floats], str]:
    """Return the contacts of each foot, or why there are none.

    velocity: `[frame, individual, keypoint, 3]` per second.
    """
    world = poses.world
    if not (np.isfinite(world.up).all() and np.isfinite(world.floor).all()):
        return {}, "the poses do not say where the floor is"
    if fps is None:
        return {}, "nobody says how many frames a second has; say it with --fps"
    if not definitions.feet:
        return {}, "the keypoints have no feet"
    if not definitions.legs:
        return (
            {},
            "the keypoints have no whole leg (hip, knee, foot), which heights are measured by",
        )
    leg = leg_lengths(poses.positions, definitions.legs)
    reach = round(config.window * fps)
    found = {}
    for name, points in definitions.feet.items():
        own = list(points)
        above = (poses.positions[:, :, own] - world.floor) @ world.up
        height = average_around(poses.frames, above, reach)
        mean_velocity = average_around(poses.frames, velocity[:, :, own], reach)
        speed = np.linalg.norm(mean_velocity, axis=-1)
        contacts = find_contacts(height, speed, leg, config)
        known = np.isfinite(contacts)
        any_ = np.where(known, contacts, 0.0).max(-1)
        found[name] = np.where(known.any(-1), any_, np.nan)
    return found, ""
