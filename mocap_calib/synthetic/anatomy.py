"""The lengths of people's bodies."""

from dataclasses import dataclass

import numpy as np

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
    stature = _random_stature(rng)
    shares = np.array(_SHARES) * np.exp(rng.normal(0, 0.03, len(_SHARES)))
    # heads of small people are large for them
    shares[_HEAD] *= np.sqrt(1.7 / stature)
    return Body(stature, *(float(share) * stature for share in shares))


def _random_stature(rng: np.random.Generator) -> float:
    """Return the height of an adult or a child in metres."""
    if rng.random() < _CHILDREN:
        return float(rng.uniform(1.25, 1.5))
    return float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.95))


def mirror(side: str) -> Floats:
    """Return the factors `[3]` that turn places on the left into places on this side."""
    return np.array([1, SIDES[side], 1])
