"""People with truth: bodies that walk through a room and gesture, as the 29 joints of the skeleton `people`.

Forward kinematics from the pelvis up and out to head and hands; the legs hang between the pelvis and feet that stand
on the floor. Body axes: x ahead, y to the body's left, z up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.synthetic.gait import Foot, foot, phase
from mocap_calib.synthetic.paths import Walk, walks
from mocap_calib.synthetic.postures import Posture, posture
from mocap_calib.types import Floats

JOINTS = load_skeleton("people").keypoints

_SIDES = {"left": 1.0, "right": -1.0}
_STRAIGHT = 0.99  # share of a leg's length that is used at most: nobody walks with locked knees
_RATE = 60.0  # inner frames a second: steps must not depend on how often somebody looks

# Places in the axes of head and foot, in shares of stature: ahead, to the left, up; from the neck and from the ankle.
_HEAD = {
    "nose": (0.088, 0, 0.110),
    "eye": (0.074, 0.019, 0.133),
    "ear": (0.026, 0.045, 0.118),
    "head_top": (0.012, 0, 0.187),
}
_FOOT = {
    "heel": (-0.031, -0.003, -0.031),
    "big_toe": (0.113, -0.006, -0.031),
    "small_toe": (0.084, 0.033, -0.031),
}


@dataclass(frozen=True)
class Body:
    """Lengths of one person in metres, left and right alike; head and foot by `_HEAD` and `_FOOT` times their size."""

    stature: float
    trunk: float
    hip: float
    thigh: float
    shin: float
    shoulder: float
    upper_arm: float
    forearm: float
    hand: float
    head: float
    foot: float


def people(
    rng: np.random.Generator,
    *,
    individuals: int,
    frames: int,
    fps: float,
    room: tuple[float, float],
) -> Floats:
    """`[frame, individual, joint, 3]` metres, +z up, floor at z = 0: people who walk about a room and gesture.

    room: (width, depth) in metres about the origin. The joints are `JOINTS`. Raises MismatchError where a number is
    not positive.
    """
    if min(individuals, frames, fps, *room) <= 0:
        raise MismatchError(
            f"people: expected positive numbers, got {individuals} individuals, {frames} frames, {fps} fps, room {room}"
        )
    finer = int(np.ceil(_RATE / fps))
    margin = 4 * int(np.ceil(fps))  # the steps at both ends need where people come from and go to
    time = np.arange((frames + 2 * margin) * finer) / (fps * finer)
    found = [_person(rng, time, walk) for walk in walks(rng, time, individuals, room)]
    return np.stack(found, axis=1)[margin * finer : (margin + frames) * finer : finer]


def random_body(rng: np.random.Generator) -> Body:
    """An adult, now and then a child. Shares of stature after Drillis and Contini (Winter 2009, fig. 4.1), joint to joint."""
    stature = float(
        rng.uniform(1.25, 1.5)
        if rng.random() < 0.15
        else np.clip(rng.normal(1.71, 0.09), 1.5, 1.95)
    )
    shares = np.array([0.288, 0.054, 0.248, 0.248, 0.106, 0.183, 0.150, 0.055, 1.0, 1.0]) * np.exp(
        rng.normal(0, 0.03, 10)
    )
    # heads of small people are large for them
    shares[8] *= np.sqrt(1.7 / stature)
    return Body(stature, *(float(share) * stature for share in shares))


def _person(rng: np.random.Generator, time: Floats, walk: Walk) -> Floats:
    """`[time, joint, 3]` one person on a walk."""
    body = random_body(rng)
    cycles = phase(time, walk, body.stature)
    how = posture(rng, time, walk, cycles)
    offsets = np.array(list(_FOOT.values())) * body.foot
    feet = {side: foot(walk, cycles, sign, offsets * [1, sign, 1]) for side, sign in _SIDES.items()}
    facing = _turn(walk.heading, 2)
    pelvis_axes = (
        facing @ _turn(how.pelvis_twist, 2) @ _turn(0.35 * how.lean, 1) @ _turn(how.pelvis_tilt, 0)
    )
    sway = 0.018 * np.sin(
        2 * np.pi * (cycles - 0.06)
    )  # over the standing foot: to the left in the first half
    pelvis = _pelvis(
        walk, how, body, axes=pelvis_axes, feet=feet, sway=sway, interval=float(time[1] - time[0])
    )
    places = {"mid_hip": pelvis}
    for side, sign in _SIDES.items():
        places |= _leg(
            side,
            body,
            hip=pelvis + pelvis_axes @ [0, sign * body.hip, 0],
            facing=facing,
            where=feet[side],
        )
    lower = facing @ _turn(0.4 * how.twist, 2) @ _turn(0.7 * how.lean, 1) @ _turn(0.5 * how.side, 0)
    chest = facing @ _turn(how.twist, 2) @ _turn(how.lean, 1) @ _turn(how.side, 0)
    places["spine"] = pelvis + lower @ [0, 0, body.trunk / 2]
    places["neck"] = places["spine"] + chest @ [0, 0, body.trunk / 2]
    places |= _head(places["neck"], chest, how, body)
    for k, (side, sign) in enumerate(_SIDES.items()):
        places |= _arm(
            side,
            body,
            shoulder=places["neck"] + chest @ [0, sign * body.shoulder, 0],
            chest=chest,
            angles=how.arms[:, k],
        )
    return np.stack([places[joint] for joint in JOINTS], axis=1)


def _turn(angle: Floats, axis: int) -> Floats:
    """`[..., 3, 3]` rotations by `angle` `[...]` about a coordinate axis."""
    return matrix_from_vector(np.asarray(angle)[..., None] * np.eye(3)[axis])


def _pelvis(
    walk: Walk,
    how: Posture,
    body: Body,
    *,
    axes: Floats,
    feet: dict[str, Foot],
    sway: Floats,
    interval: float,
) -> Floats:
    """`[time, 3]` as high as both legs allow, smoothly; that makes it bob twice a cycle."""
    ahead = np.stack([np.cos(walk.heading), np.sin(walk.heading)], axis=-1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    back = -0.2 * how.crouch - 0.15 * np.maximum(
        how.lean - 0.1, 0
    )  # hips go back when the trunk leans, to stay in balance
    level = walk.position + back[:, None] * ahead + sway[:, None] * left
    reach, allowed = _STRAIGHT * (body.thigh + body.shin), []
    for side, sign in _SIDES.items():
        hip = axes @ [0, sign * body.hip, 0]
        across = np.linalg.norm(level + hip[:, :2] - feet[side].ankle[:, :2], axis=1)
        allowed.append(
            feet[side].ankle[:, 2]
            + np.sqrt(np.maximum(reach**2 - across**2, (0.4 * reach) ** 2))
            - hip[:, 2]
        )
    width = round(0.12 / interval)
    height = gaussian_filter1d(
        minimum_filter1d(np.min(allowed, axis=0), 2 * width + 1), width / 2, mode="nearest"
    )
    height -= 0.32 * how.crouch * (body.thigh + body.shin)
    return np.concatenate([level, height[:, None]], axis=1)


def _leg(side: str, body: Body, *, hip: Floats, facing: Floats, where: Foot) -> dict[str, Floats]:
    """Hip, knee, ankle and foot: the knee by the law of cosines, ahead of the line from hip to ankle."""
    line = where.ankle - hip
    length = np.linalg.norm(line, axis=1, keepdims=True)
    reach = np.minimum(length, 0.998 * (body.thigh + body.shin))
    down = line / length
    # between where the body faces and where the foot points
    toes = _turn(where.yaw, 2)[..., 0]
    pole = facing[..., 0] + toes
    ahead = pole - (pole * down).sum(1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    along = (body.thigh**2 - body.shin**2 + reach**2) / (2 * reach)
    knee = hip + along * down + np.sqrt(np.maximum(body.thigh**2 - along**2, 0)) * ahead
    ankle = hip + reach * down
    axes = _turn(where.yaw, 2) @ _turn(where.pitch, 1)
    sign = np.array([1, _SIDES[side], 1]) * body.foot
    places = {"hip": hip, "knee": knee, "ankle": ankle} | {
        name: ankle + axes @ (sign * place) for name, place in _FOOT.items()
    }
    return {f"{side}_{name}": place for name, place in places.items()}


def _head(neck: Floats, chest: Floats, how: Posture, body: Body) -> dict[str, Floats]:
    """The joints of the head, which is rigid."""
    axes = chest @ _turn(how.head[:, 0], 2) @ _turn(how.head[:, 1], 1) @ _turn(how.head[:, 2], 0)
    places = {
        name: neck + axes @ (body.head * np.array(_HEAD[name])) for name in ("nose", "head_top")
    }
    for side, sign in _SIDES.items():
        places |= {
            f"{side}_{name}": neck + axes @ (body.head * np.array([1, sign, 1]) * _HEAD[name])
            for name in ("eye", "ear")
        }
    return places


def _arm(
    side: str, body: Body, *, shoulder: Floats, chest: Floats, angles: Floats
) -> dict[str, Floats]:
    """Shoulder, elbow, wrist and hand. angles: `[time, 4]` flexion, abduction, inward turn, elbow."""
    flexion, abduction, inward, elbow = angles.T
    sign = _SIDES[side]
    upper = chest @ _turn(sign * abduction, 0) @ _turn(-flexion, 1) @ _turn(-sign * inward, 2)
    fore = upper @ _turn(-elbow, 1)
    down = np.array([0.0, 0.0, -1.0])
    at = {"shoulder": shoulder, "elbow": shoulder + body.upper_arm * (upper @ down)}
    at["wrist"] = at["elbow"] + body.forearm * (fore @ down)
    at["hand"] = at["wrist"] + body.hand * (
        fore @ _turn(np.radians(-12.0), 1) @ down
    )  # hands at ease bend in a little
    return {f"{side}_{name}": place for name, place in at.items()}
