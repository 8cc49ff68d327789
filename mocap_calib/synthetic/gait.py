"""How people walk: feet that stand on the floor while the body passes over them.

The phase counts gait cycles (two steps) and is driven by the travelled distance, so that nobody walks on the spot.
Each foot stands at one place for 62 % of its cycle (Winter 2009, ch. 1) and swings to the next one.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from mocap_calib.synthetic.paths import Walk
from mocap_calib.synthetic.signals import ease
from mocap_calib.types import Floats

_STANCE = 0.62
_PASSING = 0.31  # phase at which the pelvis is above the foot
_BOTH_DOWN = 0.06  # a phase at which both feet stand, half-way through double support
# pitch of the foot in degrees over its cycle, heel up positive: heel strike, flat, heel off, toe off, swing
_PITCH = PchipInterpolator(
    [0.0, 0.09, 0.36, 0.50, 0.62, 0.74, 0.90, 1.0],
    [-16.0, 0.0, 0.0, 14.0, 42.0, 30.0, -10.0, -16.0],
)


@dataclass(frozen=True)
class Foot:
    """A foot over time. ankle: `[time, 3]` metres; yaw and pitch: `[time]` radians, pitch > 0 lifts the heel."""

    ankle: Floats
    yaw: Floats
    pitch: Floats


def phase(time: Floats, walk: Walk, stature: float) -> Floats:
    """`[time]` gait cycles since the start; all pauses fall where both feet are on the floor."""
    stride = (0.5 + 0.62 * np.maximum(walk.speed, 0.0)) * stature / 1.7  # longer when faster
    # who turns on the spot steps as well, about 70 degrees a step
    raw: Floats = np.concatenate(
        [
            [0.0],
            np.cumsum(
                (walk.speed / stride)[1:] * np.diff(time) + np.abs(np.diff(walk.heading)) / 2.4
            ),
        ]
    )
    if not walk.pauses:
        return raw
    at: Floats = np.interp(np.array([(a + b) / 2 for a, b in walk.pauses]), time, raw)
    at = at[np.concatenate([[True], np.diff(at) > 0.3])]
    wanted = np.round(2 * (at - _BOTH_DOWN)) / 2 + _BOTH_DOWN
    # between pauses the phase is stretched a little, outside of them only shifted
    far = raw[-1] + 1.0
    knots = np.concatenate([[at[0] - far], at, [at[-1] + far]])
    return np.asarray(
        np.interp(raw, knots, np.concatenate([[wanted[0] - far], wanted, [wanted[-1] + far]]))
    )


def vigour(walk: Walk) -> Floats:
    """`[time]` 0 standing .. 1 walking briskly: how large the swings of legs and arms are."""
    return np.asarray(ease(0.15 + 0.7 * walk.speed / 1.1) * ease(walk.speed / 0.4))


def foot(walk: Walk, cycles: Floats, side: float, offsets: Floats) -> Foot:
    """The left (side = 1) or right (side = -1) foot.

    cycles: `[time]` phase. offsets: `[3, 3]` heel, big toe and small toe from the ankle, in metres, of a flat foot in
    its own axes (x ahead, y left, z up).
    """
    own = cycles - (0.0 if side > 0 else 0.5)
    number = np.floor(own)
    within = own - number
    swing = ease((within - _STANCE) / (1 - _STANCE))
    now, following = (_foothold(walk, own, number + k, side) for k in (0, 1))
    yaw = now[1] + swing * (following[1] - now[1])
    strength = vigour(walk)
    pitch = strength * np.radians(_PITCH(within))
    lift, land = (_roll(strength * np.radians(float(_PITCH(p))), offsets) for p in (_STANCE, 0.0))
    roll = np.where(within < _STANCE, _roll(pitch, offsets), lift + swing * (land - lift))
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    level = now[0] + swing[:, None] * (following[0] - now[0]) + roll[:, None] * ahead
    clearance = (0.02 + 0.04 * strength) * np.sin(
        np.pi * np.clip((within - _STANCE) / (1 - _STANCE), 0, 1)
    ) ** 2
    # the lowest point of the turned foot is what stands on the floor
    lowest = (-np.sin(pitch)[:, None] * offsets[:, 0] + np.cos(pitch)[:, None] * offsets[:, 2]).min(
        1
    )
    height = clearance - lowest + _skin(offsets)
    return Foot(np.concatenate([level, height[:, None]], axis=1), yaw, pitch)


def _skin(offsets: Floats) -> float:
    """Height of heel and toes, which are joints inside the foot, over the sole; metres."""
    return float(-0.35 * offsets[0, 2])


def _roll(pitch: Floats, offsets: Floats) -> Floats:
    """`[time]` metres that the ankle goes ahead when the foot rolls over its toe, or stands back on its heel."""
    pivot = np.where(np.asarray(pitch)[..., None] > 0, offsets[1], offsets[0])
    return np.asarray(
        pivot[..., 0] - (np.cos(pitch) * pivot[..., 0] + np.sin(pitch) * pivot[..., 2])
    )


def _foothold(walk: Walk, own: Floats, number: Floats, side: float) -> tuple[Floats, Floats]:
    """Place `[time, 2]` and yaw `[time]` of the foot's stance `number`: beside where the pelvis passes over it."""
    # a slight slope makes the phase strictly increasing, also while somebody stands
    index = np.arange(len(own), dtype=np.float64)
    passing = np.interp(number + _PASSING, own + 1e-9 * index, index)
    place = np.stack([np.interp(passing, index, walk.position[:, k]) for k in (0, 1)], axis=-1)
    heading = np.interp(passing, index, walk.heading)
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    return place + 0.075 * side * left, heading + side * np.radians(7.0)
