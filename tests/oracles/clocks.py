"""Definitions in plain numpy of what kernels of the clocks compute."""

import numpy as np


def follow(table: np.ndarray, price: float) -> np.ndarray:
    """Return the path `[frame]` of most agreement through a table `[frame, offset]` (Viterbi)."""
    frames, offsets = table.shape
    stay = np.arange(offsets)
    steps = np.array([0, 1, -1])  # from where an offset is reached
    sources = (stay + steps[:, None]).clip(0, offsets - 1)
    prices = price * (steps != 0)[:, None]
    origin = np.zeros((frames, offsets), dtype=np.int64)
    total = table[0].copy()
    for frame in range(1, frames):
        value = total[sources] - prices
        best = value.argmax(0)
        origin[frame] = sources[best, stay]
        total = value[best, stay] + table[frame]
    path = [int(total.argmax())]
    for frame in range(frames - 1, 0, -1):
        path.append(int(origin[frame, path[-1]]))
    return np.array(path[::-1])


def sum_on_diagonals(values, rate: float, rows, blocks: int, window: int):
    """Return sums `[hypothesis, stretch, block, offset]` of known values, and their numbers."""
    each = len(rows) // blocks
    table = diagonals(values, window, rate, rows)[:, :, : blocks * each]
    table = table.reshape(*values.shape[:2], blocks, each, 2 * window + 1)
    seen = np.isfinite(table)
    return np.where(seen, table, np.float32(0.0)).sum(3), seen.sum(3)


def diagonals(values, window: int, rate: float, rows):
    """Return `[..., row, offset]` of frames t and round(rate t) + offset, NaN = none."""
    column = np.round(rows * rate).astype(np.int64)[:, None] + np.arange(-window, window + 1)
    inside = (column >= 0) & (column < values.shape[-1])
    index = np.broadcast_to(np.where(inside, column, 0), (*values.shape[:-2], *column.shape))
    return np.where(inside, np.take_along_axis(values, index, -1), np.float32(np.nan))
