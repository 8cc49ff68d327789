"""Agreement at the offsets of a clock, and the best path through these."""

import math

import numpy as np
from numpy.typing import NDArray

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints


@kernel("f8[:,::1], f8, i8[::1]")
def follow(table: Floats, price: float, path: Ints) -> None:
    """Set the path `[frame]` through a table `[frame, offset]`, as of `clocks.maps`: never up."""
    frames, offsets = table.shape
    origin = np.empty((frames, offsets), dtype=np.int32)
    total, before = np.empty(offsets), np.empty(offsets)
    total[:] = table[0]
    for frame in range(1, frames):
        before[:] = total
        above = offsets - 1
        for k in range(offsets - 1, -1, -1):
            best, value = k, before[k]
            if before[above] - price > value:
                best, value = above, before[above] - price
            if before[k] > before[above]:
                above = k
            origin[frame, k] = best
            total[k] = value + table[frame, k]
    best = 0
    for k in range(1, offsets):
        best = k if total[k] > total[best] else best
    path[-1] = best
    for frame in range(frames - 1, 0, -1):
        path[frame - 1] = origin[frame, path[frame]]


@kernel("f8[:,:,::1], i8[::1], f8[::1], f8[:,::1]")
def sum_on_lines(table: Floats, start: Ints, slope: Floats, total: Floats) -> None:
    """Add up a table `[stretch, frame, offset]` along lines, to totals `[line, offset]`.

    start: `[stretch]` frames before each. slope: `[line]` offsets by frame. The offsets of the
    totals are those in the middle of the table, at frame 0. Lines may leave the table.
    """
    stretches, frames, offsets = table.shape
    middle = (offsets - total.shape[1]) // 2
    for line in range(len(slope)):
        for stretch in range(stretches):
            for frame in range(frames):
                shift = middle + round(slope[line] * (start[stretch] + frame))
                for offset in range(total.shape[1]):
                    if 0 <= offset + shift < offsets:
                        total[line, offset] += table[stretch, frame, offset + shift]


@kernel("f4[:,:,::1], i8[:,::1], i8[:,::1], f8[:,:,::1]")
def add_windows(values: NDArray[np.float32], row: Ints, first: Ints, table: Floats) -> None:
    """Add windows of rows of agreement `[stretch, row, frame]` to a table of a clock.

    row: `[stretch, frame]`, -1 = none. first: the same, of the window. table: `[stretch, frame,
    offset]`.
    """
    stretches, frames, offsets = table.shape
    own_frames = values.shape[2]
    for stretch in range(stretches):
        for frame in range(frames):
            if row[stretch, frame] < 0:
                continue
            begin = first[stretch, frame]
            for offset in range(max(0, -begin), min(offsets, own_frames - begin)):
                agreement = values[stretch, row[stretch, frame], begin + offset]
                table[stretch, frame, offset] += agreement


@inlined
def _add_row(
    values: NDArray[np.float32], first: int, total: NDArray[np.float32], known: Ints
) -> None:
    """Add the frames of a row `[frame]` from the first on to the offsets `[offset]`.

    NaN and frames that are not there are left out.
    """
    start, end = max(0, -first), min(len(total), len(values) - first)
    for offset in range(start, end):
        value = values[first + offset]
        here = not math.isnan(value)
        total[offset] += value if here else np.float32(0.0)
        known[offset] += here


@kernel("f4[:,:,:,::1], i8[::1], i8, f4[:,:,:,::1], i8[:,:,:,::1]")
def sum_on_diagonals(
    values: NDArray[np.float32],
    first: Ints,
    each: int,
    total: NDArray[np.float32],
    known: Ints,
) -> None:
    """Set the sums over the rows of a block and how many they are, which are 0.

    values: `[hypothesis, stretch, row, frame]`. first: `[row]` the frame at the first offset.
    each: rows of a block. total, known: `[hypothesis, stretch, block, offset]`.
    """
    for hypothesis in range(values.shape[0]):
        for stretch in range(values.shape[1]):
            for row in range(total.shape[2] * each):
                block = row // each
                _add_row(
                    values[hypothesis, stretch, row],
                    first[row],
                    total[hypothesis, stretch, block],
                    known[hypothesis, stretch, block],
                )


@kernel("f8[:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1], f8, f8[:,:,::1]")
def mean_epipolar_likelihood(
    normal: Floats, ray: Floats, square_a: Floats, square_b: Floats, scale: float, table: Floats
) -> None:
    """Set the mean log likelihood `[stretch, frame of a, offset of b]` of epipolar angles.

    NaN where two views share no point. normal: `[stretch, frame, point, 3]` of the epipolar planes
    of the rays of a; ray: of b. square_a, square_b: `[stretch, frame, point]` NaN where unknown.
    scale: angle at which the loss turns.
    """
    stretches, frames, offsets = table.shape
    for stretch in range(stretches):
        for frame in range(frames):
            for k in range(offsets):
                other = frame + k - offsets // 2
                total, count = 0.0, 0
                if 0 <= other < frames:
                    for point in range(normal.shape[2]):
                        square = square_a[stretch, frame, point] + square_b[stretch, other, point]
                        if math.isnan(square):
                            continue
                        n, r = normal[stretch, frame, point], ray[stretch, other, point]
                        gap = n[0] * r[0] + n[1] * r[1] + n[2] * r[2]
                        total -= math.log1p(gap * gap / (square * scale * scale))
                        count += 1
                table[stretch, frame, k] = total / count if count else math.nan
