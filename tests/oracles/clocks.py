"""Definitions in plain numpy of what kernels of the clocks compute."""

import numpy as np


def follow(table: np.ndarray, price: float) -> np.ndarray:
    """Return the path `[frame]` of most agreement, never up, through a table `[frame, offset]`.

    Of equal ways to stay is the first, and to come from farther above.
    """
    offsets = table.shape[1]
    down = np.triu(np.ones((offsets, offsets), dtype=bool))  # [offset, from where]
    origin, total = [], table[0]
    for row in table[1:]:
        value = np.where(down, total - price, -np.inf)
        np.fill_diagonal(value, total)
        first = offsets - 1 - value[:, ::-1].argmax(1)
        stays = value.diagonal() >= value.max(1)
        origin.append(np.where(stays, np.arange(offsets), first))
        total = value.max(1) + row
    path = [int(total.argmax())]
    for source in origin[::-1]:
        path.append(int(source[path[-1]]))
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
