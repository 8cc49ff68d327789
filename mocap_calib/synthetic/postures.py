"""How people hold themselves: the angles of trunk, head and arms while they walk, gesture, bend and crouch."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.synthetic.gait import vigour
from mocap_calib.synthetic.paths import Walk
from mocap_calib.synthetic.signals import pulse, spells, wander
from mocap_calib.types import Floats

# What arms do, in degrees as low, high: flexion (ahead), abduction (to the side), inward turn of the upper arm, elbow.
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
_FREQUENT = np.array([0.32, 0.16, 0.12, 0.1, 0.1, 0.08, 0.12])


@dataclass(frozen=True)
class Posture:
    """Angles in radians over time.

    lean (ahead), side (to the right), twist (to the left), pelvis_twist, pelvis_tilt (right side up): `[time]`; head: `[time, 3]`
    turn to the left, nod, tilt; arms: `[time, 2, 4]` left and right flexion, abduction, inward turn, elbow;
    crouch: `[time]` 0 upright .. 1 deep.
    """

    lean: Floats
    side: Floats
    twist: Floats
    pelvis_twist: Floats
    pelvis_tilt: Floats
    head: Floats
    arms: Floats
    crouch: Floats


def posture(rng: np.random.Generator, time: Floats, walk: Walk, cycles: Floats) -> Posture:
    """One person's posture; arms and shoulders swing against the legs."""
    strength, cycle = vigour(walk), 2 * np.pi * cycles
    crouch = _crouching(rng, time, walk)
    bend = sum(
        (
            rng.uniform(0.4, 1.0) * pulse(time, *spell, 0.7)
            for spell in spells(rng, time, 12.0, (1.6, 4.0))
        ),
        np.zeros_like(time),
    )
    lean = 1 + 2 * wander(rng, time, 3.0) + 2 * strength + 28 * bend * (1 - crouch) + 33 * crouch
    side = 2.0 * wander(rng, time, 3.0) + 1.5 * strength * np.sin(cycle)
    pelvis_twist = -5 * strength * np.cos(cycle)  # the left hip goes ahead with the left leg
    twist = 5 * strength * np.cos(cycle) + 8 * wander(rng, time, 4.0)
    turn = 22 * wander(rng, time, 3.0)
    nod = (
        6 * wander(rng, time, 2.0) + 4 - 0.5 * lean
    )  # most look where they go, also when they bend
    head = np.stack(
        [np.clip(turn, -60, 60), np.clip(nod, -25, 30), 4 * wander(rng, time, 3.0)], axis=-1
    )
    swing = strength * np.cos(cycle)
    pelvis_tilt = 3 * strength * np.sin(cycle)
    arms = _arms(rng, time, np.stack([-swing, swing], axis=1), crouch + bend)
    rad = np.radians
    return Posture(
        rad(lean),
        rad(side),
        rad(twist),
        rad(pelvis_twist),
        rad(pelvis_tilt),
        rad(head),
        rad(arms),
        crouch,
    )


def _crouching(rng: np.random.Generator, time: Floats, walk: Walk) -> Floats:
    """People crouch only where they stand, and seldom."""
    crouch = np.zeros_like(time)
    for start, end in walk.pauses:
        depth = rng.uniform(0.3, 1.0)
        if rng.random() < 0.3 and end - start > 1.3:
            crouch += depth * pulse(time, start + 0.1, end - 0.1, min(0.9, (end - start - 0.2) / 2))
    return crouch


def _arms(rng: np.random.Generator, time: Floats, swing: Floats, stoop: Floats) -> Floats:
    """`[time, 2, 4]` degrees; swing: `[time, 2]` -1 arm behind .. 1 arm ahead."""
    arms = np.zeros((len(time), 2, 4))
    arms[..., 0] = 2 + 18 * swing + 25 * stoop[:, None]  # arms hang down when the trunk leans
    arms[..., 1] = rng.uniform(5, 10)
    arms[..., 2] = rng.uniform(15, 30)
    arms[..., 3] = rng.uniform(10, 22) + 10 * (1 + swing) / 2 * np.abs(swing) + 20 * stoop[:, None]
    both, liveliness = spells(rng, time, 5.0, (1.8, 4.5)), rng.uniform(1.5, 5.0)
    for start, end in both:
        goal, beat = _gesture(rng, time)
        _blend(arms[:, 0], pulse(time, start, end, 0.8), goal, beat)
        _blend(
            arms[:, 1], pulse(time, start + 0.1, end + 0.1, 0.8), goal + rng.normal(0, 5, 4), beat
        )
    for arm in (0, 1):
        for start, end in spells(rng, time, liveliness, (1.6, 4.5)):
            goal, beat = _gesture(rng, time)
            _blend(arms[:, arm], pulse(time, start, end, rng.uniform(0.6, 0.8)), goal, beat)
    arms += np.stack([2 * wander(rng, time, 1.5) for _ in range(8)], axis=-1).reshape(-1, 2, 4)
    arms[..., 3] = np.clip(arms[..., 3], 2, 140)  # elbows bend ahead only
    return arms


def _gesture(rng: np.random.Generator, time: Floats) -> tuple[Floats, Floats]:
    """`[4]` degrees that a gesture goes to, and `[time, 4]` how it beats the air."""
    low, high = _GESTURES[rng.choice(len(_GESTURES), p=_FREQUENT)].T
    beat = (
        np.array([4.0, 3.0, 12.0, 10.0])
        * rng.uniform(0, 1)
        * np.sin(2 * np.pi * rng.uniform(0.7, 1.6) * time)[:, None]
    )
    return rng.uniform(low, high), beat


def _blend(arm: Floats, weight: Floats, goal: Floats, beat: Floats) -> None:
    """Moves `arm` `[time, 4]` towards the goal, in place."""
    arm += weight[:, None] * (goal + beat - arm)
