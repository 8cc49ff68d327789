"""Smooth signals of time, from which everything that moves is made, and directions in the plane."""

import numpy as np

from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Floats

_WAVES = 6  # that a random signal is the sum of


def ease(x: Floats) -> Floats:
    """Return 6x^5 - 15x^4 + 10x^3 `[...]`, 0 below x = 0 and 1 above x = 1.

    It starts and ends without a jerk. x: `[...]`.
    """
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (x * (6 * x - 15) + 10)


def wander(rng: np.random.Generator, time: Floats, period: float) -> Floats:
    """Return a smooth random signal `[time]` of unit variance.

    It turns about every `period` seconds. time: `[time]` seconds.
    """
    frequency = rng.uniform(0.3, 1.2, _WAVES) / period
    phase = rng.uniform(0.0, 2 * np.pi, _WAVES)
    waves: Floats = np.sin(2 * np.pi * frequency[:, None] * time + phase[:, None])
    return np.asarray(waves.sum(0) * np.sqrt(2.0 / _WAVES))


def pulse(time: Floats, start: float, end: float, ramp: float) -> Floats:
    """Return a signal `[time]` that is 0 outside `start`..`end` and 1 inside.

    Its smooth ramps last `ramp` seconds and lie inside. time: `[time]` seconds.
    """
    return ease((time - start) / ramp) * ease((end - time) / ramp)


def spells(
    rng: np.random.Generator, time: Floats, gap: float, hold: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return the (start, end) of random spells that do not overlap, in seconds.

    time: `[time]` seconds; gap: mean of the exponential gaps between spells; hold: bounds of their
    lengths.
    """
    found = []
    start = time[0] - rng.uniform(0.0, hold[1])
    while start < time[-1]:
        start += rng.exponential(gap)
        end = start + rng.uniform(*hold)
        found.append((float(start), float(end)))
        start = end
    return found


def interpolate(x: Floats, known: Floats, values: Floats) -> Floats:
    """Return the points `[..., 2]` at x `[...]` of a curve in the plane.

    known: `[point]` ascending, where its points `values` `[point, 2]` are.
    """
    first, second = (np.interp(x, known, values[:, column]) for column in (0, 1))
    return np.stack([first, second], axis=-1)


def direction(angle: Floats) -> Floats:
    """Return the unit vectors `[..., 2]` of angles `[...]` in radians, counter-clockwise from x."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def left_of(ahead: Floats) -> Floats:
    """Return vectors `[..., 2]` turned by a quarter to the left."""
    return np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)


def turn_about(angle: Floats, axis: int = 2) -> Floats:
    """Return rotations `[..., 3, 3]` by angles `[...]` in radians about a coordinate axis."""
    return matrix_from_vector(np.asarray(angle)[..., None] * np.eye(3)[axis])
