"""Agreement at the offsets of a clock, and the best path through these, compiled.

`clock_paths` says the same in numpy.
"""

import numpy as np
from numpy.typing import NDArray

from mocap_calib.kernels.jit import kernel
from mocap_calib.types import Floats, Ints


@kernel("f8[:,::1], f8, i8, i8[::1]")
def follow(table: Floats, price: float, largest_step: int, path: Ints) -> None:
    """Set the path `[frame]` through a table `[frame, offset]`: see `clock_paths._follow`.

    largest_step: by which a camera is ahead at once.
    """
    frames, offsets = table.shape
    origin = np.empty((frames, offsets), dtype=np.int32)
    total, before = table[0].copy(), np.empty(offsets)
    for frame in range(1, frames):
        before[:] = total
        for k in range(offsets):
            best, value = k, before[k]
            # in the order in which equal ones are preferred: one on, then one back, two back ...
            for step in range(largest_step + 1):
                source = min(k + 1, offsets - 1) if step == 0 else max(k - step, 0)
                reached = before[source] - price
                if reached > value:
                    best, value = source, reached
            origin[frame, k] = best
            total[k] = value + table[frame, k]
    path[-1] = np.argmax(total)
    for frame in range(frames - 1, 0, -1):
        path[frame - 1] = origin[frame, path[frame]]


@kernel("f4[:,:,::1], i8[:,::1], i8[::1], f8[:,:,::1]")
def add_windows(values: NDArray[np.float32], row: Ints, first: Ints, table: Floats) -> None:
    """Add windows of rows of agreement to a table: see `clock_paths._add_windows`."""
    stretches, frames, offsets = table.shape
    own_frames = values.shape[2]
    for stretch in range(stretches):
        for frame in range(frames):
            if row[stretch, frame] < 0:
                continue
            start = max(0, -first[frame])
            end = min(offsets, own_frames - first[frame])
            for offset in range(start, end):
                agreement = values[stretch, row[stretch, frame], first[frame] + offset]
                table[stretch, frame, offset] += agreement
