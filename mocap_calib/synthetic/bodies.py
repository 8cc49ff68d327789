"""People with truth: bodies that walk about and gesture, as joints of the skeleton `people`.

Forward kinematics from the pelvis up and out to head and hands; the legs hang between the pelvis
and feet that stand on the floor. Body axes: x ahead, y to the body's left, z up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from mocap_calib.recording.joints import load_skeleton
from mocap_calib.synthetic.config import MOTION_RATE
from mocap_calib.synthetic.postures import Posture, hold_posture
from mocap_calib.synthetic.signals import direction, left_of, turn_about
from mocap_calib.synthetic.walking import Foot, Walk, gait_cycles, place_foot
from mocap_calib.types import Floats

SIDES = {"left": 1.0, "right": -1.0}

# Places in the axes of head and foot, in shares of stature: ahead, to the left, up; from the neck
# and from the ankle.
MIDDLE_OF_HEAD = {"nose": (0.088, 0, 0.110), "head_top": (0.012, 0, 0.187)}
SIDE_OF_HEAD = {"eye": (0.074, 0.019, 0.133), "ear": (0.026, 0.045, 0.118)}
FOOT = {
    "heel": (-0.031, -0.003, -0.031),
    "big_toe": (0.113, -0.006, -0.031),
    "small_toe": (0.084, 0.033, -0.031),
}

# Lengths in shares of stature, joint to joint, after Drillis and Contini (Winter 2009, fig. 4.1):
# trunk, hip, thigh, shin, shoulder, upper arm, forearm, hand; head and foot as their tables above.
_SHARES = [0.288, 0.054, 0.248, 0.248, 0.106, 0.183, 0.150, 0.055, 1.0, 1.0]
_HEAD = 8  # column of the head
_CHILDREN = 0.15  # share of the people

JOINTS = load_skeleton("people").keypoints

_STRAIGHT = 0.99  # share of a leg's length that is used at most: nobody walks with locked knees
_HAND_BEND_DEG = -12.0  # hands at ease bend in a little
_ALONG_LIMB = np.array([0.0, 0.0, -1.0])  # the direction of a hanging arm in its own axes


@dataclass(frozen=True)
class Body:
    """Lengths of one person in metres, left and right alike.

    head and foot: what the places in the tables above are multiplied by.
    """

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

    @property
    def leg(self) -> float:
        """Length of a straight leg in metres."""
        return self.thigh + self.shin


def random_body(rng: np.random.Generator) -> Body:
    """Return the lengths of an adult, now and then of a child."""
    if rng.random() < _CHILDREN:
        stature = float(rng.uniform(1.25, 1.5))
    else:
        stature = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.95))
    shares = np.array(_SHARES) * np.exp(rng.normal(0, 0.03, len(_SHARES)))
    # heads of small people are large for them
    shares[_HEAD] *= np.sqrt(1.7 / stature)
    return Body(stature, *(float(share) * stature for share in shares))


def mirror(side: str) -> Floats:
    """Return the factors `[3]` that turn places on the left into places on this side."""
    return np.array([1, SIDES[side], 1])


# --- their motion


def motion_times(frames: int, fps: float) -> tuple[Floats, slice]:
    """Return the times `[time]` in seconds of finer frames, and which of them are the frames."""
    finer = int(np.ceil(MOTION_RATE / fps))
    margin = 4 * int(np.ceil(fps))  # the steps at both ends need where people come from and go to
    time = np.arange((frames + 2 * margin) * finer) / (fps * finer)
    return time, slice(margin * finer, (margin + frames) * finer, finer)


def move_person(rng: np.random.Generator, time: Floats, walk: Walk) -> Floats:
    """Return the joints `[time, joint, 3]` of one random person on a walk."""
    body = random_body(rng)
    cycles = gait_cycles(time, walk, body.stature)
    posture = hold_posture(rng, time, walk, cycles)
    offsets = np.array(list(FOOT.values())) * body.foot
    feet = {
        side: place_foot(walk, cycles, sign, offsets * [1, sign, 1]) for side, sign in SIDES.items()
    }
    facing = turn_about(walk.heading)
    places = _lower_body(time, walk, cycles, posture=posture, body=body, facing=facing, feet=feet)
    places |= _upper_body(places["mid_hip"], posture=posture, body=body, facing=facing)
    return np.stack([places[joint] for joint in JOINTS], axis=1)


def _turn_axes(axes: Floats, *, yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """Return axes `[time, 3, 3]` turned about their own z, then y, then x, by angles `[time]`."""
    return axes @ turn_about(yaw) @ turn_about(pitch, 1) @ turn_about(roll, 0)


def _lower_body(
    time: Floats,
    walk: Walk,
    cycles: Floats,
    *,
    posture: Posture,
    body: Body,
    facing: Floats,
    feet: dict[str, Foot],
) -> dict[str, Floats]:
    """Return the joints `[time, 3]` from the pelvis down; facing: `[time, 3, 3]` axes."""
    axes = _turn_axes(
        facing,
        yaw=posture.pelvis_twist,
        pitch=0.35 * posture.lean,
        roll=posture.pelvis_tilt,
    )
    hips = {side: axes @ [0, sign * body.hip, 0] for side, sign in SIDES.items()}
    level = _level_of_pelvis(walk, cycles, posture)
    reachable = _reachable_height(level, hips, feet, body)
    height = _smooth_below(reachable, interval=float(time[1] - time[0]))
    height -= 0.32 * posture.crouch * body.leg
    pelvis = np.concatenate([level, height[:, None]], axis=1)
    places = {"mid_hip": pelvis}
    for side, hip in hips.items():
        places |= _leg(side, body, hip=pelvis + hip, facing=facing, foot=feet[side])
    return places


def _level_of_pelvis(walk: Walk, cycles: Floats, posture: Posture) -> Floats:
    """Return where the pelvis is on the floor plan, `[time, 2]` metres."""
    ahead = direction(walk.heading)
    # hips go back when the trunk leans, to stay in balance
    back = -0.2 * posture.crouch - 0.15 * np.maximum(posture.lean - 0.1, 0)
    # over the standing foot: to the left in the first half of the cycle
    sway = 0.018 * np.sin(2 * np.pi * (cycles - 0.06))
    return walk.position + back[:, None] * ahead + sway[:, None] * left_of(ahead)


def _reachable_height(
    level: Floats, hips: dict[str, Floats], feet: dict[str, Foot], body: Body
) -> Floats:
    """Return the height `[time]` up to which the pelvis can rise with both feet where they are.

    level: `[time, 2]` of the pelvis; hips: `[time, 3]` from the pelvis.
    """
    reach = _STRAIGHT * body.leg
    heights = []
    for side, hip in hips.items():
        ankle = feet[side].ankle
        across = np.linalg.norm(level + hip[:, :2] - ankle[:, :2], axis=1)
        rise = np.sqrt(np.maximum(reach**2 - across**2, (0.4 * reach) ** 2))
        heights.append(ankle[:, 2] + rise - hip[:, 2])
    return np.min(heights, axis=0)


def _smooth_below(height: Floats, *, interval: float) -> Floats:
    """Return a smooth signal `[time]` along the lowest values of a height `[time]`.

    interval: seconds between the values. It makes the pelvis bob twice a cycle.
    """
    width = round(0.12 / interval)
    lowest = minimum_filter1d(height, 2 * width + 1)
    return gaussian_filter1d(lowest, width / 2, mode="nearest")


def _leg(side: str, body: Body, *, hip: Floats, facing: Floats, foot: Foot) -> dict[str, Floats]:
    """Return hip, knee, ankle and foot `[time, 3]`.

    The knee by the law of cosines, ahead of the line from hip to ankle.
    """
    line = foot.ankle - hip
    length = np.linalg.norm(line, axis=1, keepdims=True)
    reach = np.minimum(length, 0.998 * body.leg)
    down = line / length
    ahead = _knee_direction(down, facing, foot)
    along = (body.thigh**2 - body.shin**2 + reach**2) / (2 * reach)
    across = np.sqrt(np.maximum(body.thigh**2 - along**2, 0))
    knee = hip + along * down + across * ahead
    ankle = hip + reach * down
    axes = turn_about(foot.yaw) @ turn_about(foot.pitch, 1)
    size = mirror(side) * body.foot
    places = {"hip": hip, "knee": knee, "ankle": ankle}
    places |= {name: ankle + axes @ (size * place) for name, place in FOOT.items()}
    return {f"{side}_{name}": place for name, place in places.items()}


def _knee_direction(down: Floats, facing: Floats, foot: Foot) -> Floats:
    """Return the unit vector `[time, 3]`, across the line of the leg, that the knee bends to.

    Between where the body faces and where the foot points. down: `[time, 3]` from hip to ankle.
    """
    toes = turn_about(foot.yaw)[..., 0]
    pole = facing[..., 0] + toes
    ahead = pole - (pole * down).sum(1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return ahead


def _upper_body(
    pelvis: Floats, *, posture: Posture, body: Body, facing: Floats
) -> dict[str, Floats]:
    """Return the joints `[time, 3]` above the pelvis; facing: `[time, 3, 3]` axes."""
    loin = _turn_axes(
        facing, yaw=0.4 * posture.twist, pitch=0.7 * posture.lean, roll=0.5 * posture.side
    )
    chest = _turn_axes(facing, yaw=posture.twist, pitch=posture.lean, roll=posture.side)
    spine = pelvis + loin @ [0, 0, body.trunk / 2]
    neck = spine + chest @ [0, 0, body.trunk / 2]
    places = {"spine": spine, "neck": neck} | _head(neck, chest, posture, body)
    for k, (side, sign) in enumerate(SIDES.items()):
        shoulder = neck + chest @ [0, sign * body.shoulder, 0]
        places |= _arm(side, body, shoulder=shoulder, chest=chest, angles=posture.arms[:, k])
    return places


def _head(neck: Floats, chest: Floats, posture: Posture, body: Body) -> dict[str, Floats]:
    """Return the joints `[time, 3]` of the head, which is rigid."""
    turn, nod, tilt = posture.head.T
    axes = _turn_axes(chest, yaw=turn, pitch=nod, roll=tilt)
    places = {
        name: neck + axes @ (body.head * np.array(place)) for name, place in MIDDLE_OF_HEAD.items()
    }
    for side in SIDES:
        for name, place in SIDE_OF_HEAD.items():
            places[f"{side}_{name}"] = neck + axes @ (body.head * mirror(side) * place)
    return places


def _arm(
    side: str, body: Body, *, shoulder: Floats, chest: Floats, angles: Floats
) -> dict[str, Floats]:
    """Return shoulder, elbow, wrist and hand `[time, 3]`.

    angles: `[time, 4]` flexion, abduction, inward turn, elbow.
    """
    flexion, abduction, inward, bend = angles.T
    sign = SIDES[side]
    upper = (
        chest
        @ turn_about(sign * abduction, 0)
        @ turn_about(-flexion, 1)
        @ turn_about(-sign * inward, 2)
    )
    fore = upper @ turn_about(-bend, 1)
    hand_axes = fore @ turn_about(np.radians(_HAND_BEND_DEG), 1)
    elbow = shoulder + body.upper_arm * (upper @ _ALONG_LIMB)
    wrist = elbow + body.forearm * (fore @ _ALONG_LIMB)
    hand = wrist + body.hand * (hand_axes @ _ALONG_LIMB)
    places = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist, "hand": hand}
    return {f"{side}_{name}": place for name, place in places.items()}
