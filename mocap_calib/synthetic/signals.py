"""Smooth signals of time, from which everything that moves is made."""

import numpy as np

from mocap_calib.types import Floats


def ease(x: Floats) -> Floats:
    """0 below 0, 1 above 1, between them 6x^5 - 15x^4 + 10x^3: starts and ends without a jerk."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (x * (6 * x - 15) + 10)


def wander(rng: np.random.Generator, time: Floats, period: float) -> Floats:
    """`[time]` a smooth random signal of unit variance that turns about every `period` seconds."""
    terms = 6
    frequency = rng.uniform(0.3, 1.2, terms) / period
    phase = rng.uniform(0.0, 2 * np.pi, terms)
    waves: Floats = np.sin(2 * np.pi * frequency[:, None] * time + phase[:, None])
    return np.asarray(waves.sum(0) * np.sqrt(2.0 / terms))


def pulse(time: Floats, start: float, end: float, ramp: float) -> Floats:
    """`[time]` 0 outside `start`..`end`, 1 inside, with smooth ramps of `ramp` seconds within it."""
    return ease((time - start) / ramp) * ease((end - time) / ramp)


def spells(
    rng: np.random.Generator, time: Floats, gap: float, hold: tuple[float, float]
) -> list[tuple[float, float]]:
    """(start, end) of spells that do not overlap: lengths in `hold`, exponential gaps of mean `gap`, all in seconds."""
    found = []
    start = time[0] - rng.uniform(0.0, hold[1])
    while start < time[-1]:
        start += rng.exponential(gap)
        end = start + rng.uniform(*hold)
        found.append((float(start), float(end)))
        start = end
    return found
