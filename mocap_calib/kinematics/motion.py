"""Velocities of points whose frames have numbers, and gaps."""

import numpy as np

from mocap_calib.types import Floats, Ints


def frame_velocity(frames: Ints, positions: Floats) -> Floats:
    """Return the velocities `[frame, ..., 3]` of positions `[frame, ..., 3]`, per frame.

    The mean of the velocities to the frame before and to the one behind (the central difference),
    the one that there is at the ends of a track, NaN where there is neither. Frames follow each
    other where their numbers differ by the step that most do: a track does not go on across a gap.

    frames: `[frame]` numbers that rise.
    """
    velocity = np.full(positions.shape, np.nan)
    steps = np.diff(frames)
    if not len(steps):
        return velocity
    shape = (-1, *[1] * (positions.ndim - 1))
    usual = float(np.median(steps))
    apart = steps.reshape(shape).astype(np.float64)
    between = np.where(apart <= usual, np.diff(positions, axis=0) / apart, np.nan)
    none = np.full((1, *positions.shape[1:]), np.nan)
    return mean_known(np.stack([np.concatenate([none, between]), np.concatenate([between, none])]))


def average_around(frames: Ints, values: Floats, reach: int) -> Floats:
    """Return the means of values `[frame, ...]` over the frames up to `reach` numbers away.

    NaN stays where a value itself is missing.
    """
    total, count = np.zeros(values.shape), np.zeros(values.shape)
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    for shift in range(-min(reach, len(frames) - 1), min(reach, len(frames) - 1) + 1):
        here = slice(max(0, -shift), len(frames) - max(0, shift))
        there = slice(max(0, shift), len(frames) - max(0, -shift))
        near = np.abs(frames[there] - frames[here]) <= reach
        total[here][near] += filled[there][near]
        count[here][near] += known[there][near]
    return np.where(known, total / np.maximum(count, 1), np.nan)


def mean_known(values: Floats, axis: int = 0) -> Floats:
    """Return the mean of the values that are not NaN along an axis, NaN where all are."""
    known = np.isfinite(values)
    count = known.sum(axis)
    total = np.where(known, values, 0.0).sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
