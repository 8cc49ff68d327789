"""Smooth signals of time, from which everything that moves is made."""

import numpy as np

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
