"""Animals with truth: bodies made from a skeleton's file that go or fly through a room.

A body holds one posture on the move and another at rest, and goes from one to the other. The legs
follow the way that the body goes, a wing beats with the time. Feet may slide on the floor.
"""

from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap_calib.recording.joints import load_section, load_skeleton
from mocap_calib.synthetic.body_plan import (
    AXES,
    BodyPlan,
    assemble,
    parse_body,
    posture_angles,
    sample_bones,
)
from mocap_calib.synthetic.config import ANIMAL_MOTION, AnimalMotion
from mocap_calib.synthetic.signals import wander
from mocap_calib.synthetic.walking import Walk
from mocap_calib.types import Floats

_AT_REST = 0.15  # metres a second, below which a body rests
_CHANGE = 0.15  # seconds, of the smoothing from one posture to the other
_SWAY = 3.0  # seconds between turns of what moves at random


def move_animal(
    rng: np.random.Generator, kind: str, time: Floats, walk: Walk, *, scale: float
) -> Floats:
    """Return the joints `[time, joint, 3]` of one random animal on a walk, floor at z = 0.

    kind: one of `config.ANIMAL_MOTION`. scale: metres of a length of 1 of the walk and of the
        joints that are returned.
    """
    motion = ANIMAL_MOTION[kind]
    body = parse_body(load_section(kind, "body"), load_skeleton(kind))
    unit = motion.unit / scale
    interval = float(time[1] - time[0])
    turn, facing = _turn_bones(rng, body, motion, time, walk, stride=motion.stride * unit)
    facing[:, AXES.index("yaw")] += walk.heading
    bones = np.repeat(sample_bones(rng, body, 1), len(time), axis=0)
    joints = unit * assemble(body, bones, turn, facing)
    height = motion.height + 0.3 * motion.height * wander(rng, time, _SWAY)
    if not motion.height:
        height = -gaussian_filter1d(joints[..., 2].min(1), _CHANGE / interval, mode="nearest")
    return joints + np.concatenate([walk.position, height[:, None]], axis=1)[:, None]


def _turn_bones(
    rng: np.random.Generator,
    body: BodyPlan,
    motion: AnimalMotion,
    time: Floats,
    walk: Walk,
    *,
    stride: float,
) -> tuple[Floats, Floats]:
    """Return the angles `[time, joint, 3]` of each bone, and `[time, 3]` of the whole body.

    Roll, pitch, yaw in radians, as `procedural.assemble` takes them. stride: the way of one cycle.
    """
    interval = float(time[1] - time[0])
    distance = np.cumsum(np.maximum(walk.speed, 0.0)) * interval
    cycle = 360 * (distance / stride + motion.beats * time)
    moves = (walk.speed > _AT_REST).astype(np.float64)
    share = gaussian_filter1d(moves, _CHANGE / interval, mode="nearest")[:, None]
    on_the_move, at_rest = (
        _hold_one_of(rng, body, names, time, cycle) for names in (motion.moving, motion.resting)
    )
    turn = share[..., None] * on_the_move[0] + (1 - share[..., None]) * at_rest[0]
    facing = share * on_the_move[1] + (1 - share) * at_rest[1]
    return np.deg2rad(turn), np.deg2rad(facing)


def _hold_one_of(
    rng: np.random.Generator, body: BodyPlan, names: tuple[str, ...], time: Floats, cycle: Floats
) -> tuple[Floats, Floats]:
    """Return the angles `[time, joint, 3]` and `[time, 3]`, in degrees, of one of these postures.

    cycle: `[time]` degrees of the stride, or of the beat of the wings.
    """
    known = {posture.name: posture for posture in body.postures}
    posture = known[names[rng.integers(len(names))]]
    opposed = rng.uniform(*posture.opposed)
    return posture_angles(body, posture, cycle, opposed, partial(_angle, rng, time))


def _angle(
    rng: np.random.Generator, time: Floats, numbers: tuple[float, ...], cycle: Floats
) -> Floats:
    """Return an angle `[time]` in degrees: at a place in the cycle, or at random within a range.

    numbers: (least, most), or (middle, amplitude, phase); cycle: `[time]` degrees.
    """
    if len(numbers) == 3:
        middle, amplitude, phase = numbers
        return middle + amplitude * np.cos(np.deg2rad(cycle + phase))
    least, most = numbers
    share = 0.5 + 0.25 * wander(rng, time, _SWAY)
    return least + (most - least) * np.clip(share, 0.0, 1.0)
