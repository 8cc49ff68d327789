"""How people hold themselves: trunk, head and arms while they walk, gesture, bend and crouch."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.synthetic.signals import pulse, spells, wander
from mocap_calib.synthetic.walking import Walk, vigour
from mocap_calib.types import Floats

# What arms do, in degrees as low, high: flexion (ahead), abduction (to the side), inward turn of
# the upper arm, elbow.
_GESTURES = np.array(
    [
        [[15, 55], [5, 25], [20, 50], [60, 110]],  # explaining, in front of the belly
        [[55, 100], [0, 35], [0, 20], [5, 30]],  # pointing, reaching out
        [[5, 40], [55, 85], [-80, -50], [60, 100]],  # waving, the hand beside the head
        [[125, 165], [5, 25], [-10, 15], [5, 45]],  # overhead
        [[-8, 5], [30, 45], [55, 75], [80, 105]],  # hand on the hip
        [[0, 20], [50, 85], [-10, 10], [0, 30]],  # out to the side
        [[45, 80], [5, 25], [10, 40], [105, 130]],  # at the face
    ],
    dtype=np.float64,
)
_GESTURE_SHARES = np.array([0.32, 0.16, 0.12, 0.1, 0.1, 0.08, 0.12])
_BEAT = np.array([4.0, 3.0, 12.0, 10.0])  # degrees by which gesturing arms beat the air


@dataclass(frozen=True)
class Posture:
    """Angles in radians over time, `[time]` unless another shape is given.

    lean: of the trunk, ahead.
    side: of the trunk, to the right.
    twist: of the chest, to the left.
    pelvis_twist: to the left.
    pelvis_tilt: right side up.
    head: `[time, 3]` turn to the left, nod, tilt.
    arms: `[time, 2, 4]` left and right; flexion, abduction, inward turn, elbow.
    crouch: 0 upright .. 1 deep, no angle.
    """

    lean: Floats
    side: Floats
    twist: Floats
    pelvis_twist: Floats
    pelvis_tilt: Floats
    head: Floats
    arms: Floats
    crouch: Floats


def hold_posture(rng: np.random.Generator, time: Floats, walk: Walk, cycles: Floats) -> Posture:
    """Return one person's posture on a walk; arms and shoulders swing against the legs.

    time: `[time]` seconds; cycles: `[time]` gait cycles.
    """
    strength = vigour(walk)
    phase = 2 * np.pi * cycles
    swing = strength * np.cos(phase)
    crouch = _crouch(rng, time, walk)
    bend = _bend(rng, time)
    bending = 28 * bend * (1 - crouch)
    lean = 1 + 2 * wander(rng, time, 3.0) + 2 * strength + bending + 33 * crouch
    side = 2.0 * wander(rng, time, 3.0) + 1.5 * strength * np.sin(phase)
    twist = 5 * strength * np.cos(phase) + 8 * wander(rng, time, 4.0)
    head = _head(rng, time, lean)
    arms = _arms(rng, time, np.stack([-swing, swing], axis=1), crouch + bend)
    return Posture(
        lean=np.radians(lean),
        side=np.radians(side),
        twist=np.radians(twist),
        # the left hip goes ahead with the left leg
        pelvis_twist=np.radians(-5 * strength * np.cos(phase)),
        pelvis_tilt=np.radians(3 * strength * np.sin(phase)),
        head=np.radians(head),
        arms=np.radians(arms),
        crouch=crouch,
    )


def _crouch(rng: np.random.Generator, time: Floats, walk: Walk) -> Floats:
    """Return how deep somebody crouches `[time]`: only where they stand, and seldom."""
    crouch = np.zeros_like(time)
    for start, end in walk.pauses:
        depth = rng.uniform(0.3, 1.0)
        if rng.random() < 0.3 and end - start > 1.3:
            ramp = min(0.9, (end - start - 0.2) / 2)
            crouch += depth * pulse(time, start + 0.1, end - 0.1, ramp)
    return crouch


def _bend(rng: np.random.Generator, time: Floats) -> Floats:
    """Return how far somebody bends down `[time]`, now and then: 0 upright .. 1 deep."""
    bend = np.zeros_like(time)
    for start, end in spells(rng, time, 12.0, (1.6, 4.0)):
        bend = bend + rng.uniform(0.4, 1.0) * pulse(time, start, end, 0.7)
    return bend


def _head(rng: np.random.Generator, time: Floats, lean: Floats) -> Floats:
    """Return turn, nod and tilt of the head `[time, 3]` in degrees; lean: `[time]` degrees."""
    turn = 22 * wander(rng, time, 3.0)
    # most look where they go, also when they bend
    nod = 6 * wander(rng, time, 2.0) + 4 - 0.5 * lean
    tilt = 4 * wander(rng, time, 3.0)
    turn = np.clip(turn, -60, 60)
    nod = np.clip(nod, -25, 30)
    return np.stack([turn, nod, tilt], axis=-1)


def _arms(rng: np.random.Generator, time: Floats, swing: Floats, stoop: Floats) -> Floats:
    """Return the angles of the arms `[time, 2, 4]` in degrees.

    swing: `[time, 2]` -1 arm behind .. 1 arm ahead; stoop: `[time]` 0 upright .. 1 deep.
    """
    arms = _hanging_arms(rng, swing, stoop)
    gestures_of_both = spells(rng, time, 5.0, (1.8, 4.5))
    usual_gap = rng.uniform(1.5, 5.0)
    for start, end in gestures_of_both:
        goal, beat = _gesture(rng, time)
        _blend(arms[:, 0], pulse(time, start, end, 0.8), goal, beat)
        goal = goal + rng.normal(0, 5, 4)
        _blend(arms[:, 1], pulse(time, start + 0.1, end + 0.1, 0.8), goal, beat)
    for arm in (0, 1):
        for start, end in spells(rng, time, usual_gap, (1.6, 4.5)):
            goal, beat = _gesture(rng, time)
            _blend(arms[:, arm], pulse(time, start, end, rng.uniform(0.6, 0.8)), goal, beat)
    restless = [2 * wander(rng, time, 1.5) for _ in range(8)]
    arms += np.stack(restless, axis=-1).reshape(-1, 2, 4)
    arms[..., 3] = np.clip(arms[..., 3], 2, 140)  # elbows bend ahead only
    return arms


def _hanging_arms(rng: np.random.Generator, swing: Floats, stoop: Floats) -> Floats:
    """Return the angles `[time, 2, 4]` in degrees of arms that swing and gesture nothing."""
    arms = np.zeros((len(swing), 2, 4))
    arms[..., 0] = 2 + 18 * swing + 25 * stoop[:, None]  # arms hang down when the trunk leans
    arms[..., 1] = rng.uniform(5, 10)
    arms[..., 2] = rng.uniform(15, 30)
    bent_by_swing = 10 * (1 + swing) / 2 * np.abs(swing)
    arms[..., 3] = rng.uniform(10, 22) + bent_by_swing + 20 * stoop[:, None]
    return arms


def _gesture(rng: np.random.Generator, time: Floats) -> tuple[Floats, Floats]:
    """Return the degrees `[4]` that a gesture goes to, and how it beats the air `[time, 4]`."""
    low, high = _GESTURES[rng.choice(len(_GESTURES), p=_GESTURE_SHARES)].T
    strength = rng.uniform(0, 1)
    frequency = rng.uniform(0.7, 1.6)
    beat = _BEAT * strength * np.sin(2 * np.pi * frequency * time)[:, None]
    return rng.uniform(low, high), beat


def _blend(arm: Floats, weight: Floats, goal: Floats, beat: Floats) -> None:
    """Move the angles `arm` `[time, 4]` towards a gesture, in place.

    weight: `[time]` 0..1; goal: `[4]` and beat: `[time, 4]` of `_gesture`.
    """
    arm += weight[:, None] * (goal + beat - arm)
