"""How people walk: feet that stand on the floor while the body passes over them.

The phase counts gait cycles (two steps) and is driven by the travelled distance, so that nobody
walks on the spot. Each foot stands at one place for 62 % of its cycle (Winter 2009, ch. 1) and
swings to the next one.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from mocap_calib.synthetic.paths import Walk
from mocap_calib.synthetic.signals import direction, ease, interpolate, left_of
from mocap_calib.types import Floats

_STANCE = 0.62  # share of the cycle that a foot stands
_PASSING = 0.31  # phase at which the pelvis is above the foot
_BOTH_DOWN = 0.06  # a phase at which both feet stand, half-way through double support
_TURN_PER_CYCLE = 2.4  # radians: who turns on the spot steps as well, about 70 degrees a step
_STEP_WIDTH = 0.075  # metres from the middle to each foot
_TOES_OUT_DEG = 7.0

# pitch of the foot in degrees over its cycle, heel up positive: heel strike, flat, heel off, toe
# off, swing
_PITCH = PchipInterpolator(
    [0.0, 0.09, 0.36, 0.50, 0.62, 0.74, 0.90, 1.0],
    [-16.0, 0.0, 0.0, 14.0, 42.0, 30.0, -10.0, -16.0],
)


@dataclass(frozen=True)
class Foot:
    """A foot over time.

    ankle: `[time, 3]` metres.
    yaw: `[time]` radians.
    pitch: `[time]` radians; above 0 lifts the heel.
    """

    ankle: Floats
    yaw: Floats
    pitch: Floats


def gait_cycles(time: Floats, walk: Walk, stature: float) -> Floats:
    """Return the gait cycles `[time]` since the start.

    All pauses fall where both feet are on the floor. time: `[time]` seconds; stature: metres.
    """
    stride = (0.5 + 0.62 * np.maximum(walk.speed, 0.0)) * stature / 1.7  # longer when faster
    walking = (walk.speed / stride)[1:] * np.diff(time)
    turning = np.abs(np.diff(walk.heading)) / _TURN_PER_CYCLE
    cycles: Floats = np.concatenate([[0.0], np.cumsum(walking + turning)])
    if not walk.pauses:
        return cycles
    return _pause_on_both_feet(cycles, time, walk)


def _pause_on_both_feet(cycles: Floats, time: Floats, walk: Walk) -> Floats:
    """Return the cycles `[time]`, shifted a little so that both feet stand in every pause."""
    middle = np.array([(start + end) / 2 for start, end in walk.pauses])
    paused: Floats = np.interp(middle, time, cycles)
    paused = paused[np.concatenate([[True], np.diff(paused) > 0.3])]
    wanted = np.round(2 * (paused - _BOTH_DOWN)) / 2 + _BOTH_DOWN
    # between pauses the phase is stretched a little, outside of them only shifted
    outside = cycles[-1] + 1.0
    before = np.concatenate([[paused[0] - outside], paused, [paused[-1] + outside]])
    after = np.concatenate([[wanted[0] - outside], wanted, [wanted[-1] + outside]])
    return np.asarray(np.interp(cycles, before, after))


def vigour(walk: Walk) -> Floats:
    """Return how large the swings of legs and arms are `[time]`: 0 standing .. 1 brisk."""
    brisk = ease(0.15 + 0.7 * walk.speed / 1.1)
    moving = ease(walk.speed / 0.4)
    return np.asarray(brisk * moving)


def place_foot(walk: Walk, cycles: Floats, side: float, offsets: Floats) -> Foot:
    """Return the left (side = 1) or right (side = -1) foot over time.

    cycles: `[time]` of `gait_cycles`. offsets: `[3, 3]` heel, big toe and small toe from the ankle,
    in metres, of a flat foot in its own axes (x ahead, y left, z up).
    """
    own_cycles = cycles - (0.0 if side > 0 else 0.5)
    step = np.floor(own_cycles)
    within = own_cycles - step
    swing_phase = (within - _STANCE) / (1 - _STANCE)
    swing = ease(swing_phase)
    here, yaw_here = _foothold(walk, own_cycles, step, side)
    following, yaw_following = _foothold(walk, own_cycles, step + 1, side)
    strength = vigour(walk)
    yaw = yaw_here + swing * (yaw_following - yaw_here)
    pitch = strength * np.radians(_PITCH(within))
    rolled = _roll_over(within, swing, strength, offsets)
    moved = swing[:, None] * (following - here)
    level = here + moved + rolled[:, None] * direction(yaw)
    arch = np.sin(np.pi * np.clip(swing_phase, 0, 1)) ** 2
    clearance = (0.02 + 0.04 * strength) * arch
    # the lowest point of the turned foot is what stands on the floor; heel and toes are joints
    # inside of it
    sine, cosine = np.sin(pitch)[:, None], np.cos(pitch)[:, None]
    lowest = (-sine * offsets[:, 0] + cosine * offsets[:, 2]).min(1)
    height = clearance - lowest + float(-0.35 * offsets[0, 2])
    return Foot(np.concatenate([level, height[:, None]], axis=1), yaw, pitch)


def _roll_over(within: Floats, swing: Floats, strength: Floats, offsets: Floats) -> Floats:
    """Return how far `[time]` the ankle is ahead of its foothold as the foot rolls, in metres.

    within: `[time]` phase of the foot's own cycle; swing: `[time]` 0..1 of the way to the next
    foothold; strength: `[time]` of `vigour`.
    """
    standing = _ankle_shift(strength * np.radians(_PITCH(within)), offsets)
    lift = _ankle_shift(strength * np.radians(float(_PITCH(_STANCE))), offsets)
    land = _ankle_shift(strength * np.radians(float(_PITCH(0.0))), offsets)
    return np.where(within < _STANCE, standing, lift + swing * (land - lift))


def _ankle_shift(pitch: Floats, offsets: Floats) -> Floats:
    """Return how far `[time]` the ankle goes ahead when the foot is pitched, in metres.

    The foot rolls over its toe, or stands back on its heel.
    """
    pivot = np.where(np.asarray(pitch)[..., None] > 0, offsets[1], offsets[0])
    turned = np.cos(pitch) * pivot[..., 0] + np.sin(pitch) * pivot[..., 2]
    return np.asarray(pivot[..., 0] - turned)


def _foothold(walk: Walk, own_cycles: Floats, step: Floats, side: float) -> tuple[Floats, Floats]:
    """Return where the foot stands in its step number `[time]`, and its heading.

    Beside where the pelvis passes, `[time, 2]` metres, and `[time]` radians.
    """
    # a slight slope makes the phase strictly increasing, also while somebody stands
    index = np.arange(len(own_cycles), dtype=np.float64)
    passing = np.interp(step + _PASSING, own_cycles + 1e-9 * index, index)
    place = interpolate(passing, index, walk.position)
    heading = np.interp(passing, index, walk.heading)
    left = left_of(direction(heading))
    yaw = heading + side * np.radians(_TOES_OUT_DEG)
    return place + _STEP_WIDTH * side * left, yaw
