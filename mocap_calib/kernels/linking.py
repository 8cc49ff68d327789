"""Carry groups through time where each goes to an individual of its own, compiled.

`linking.link_through_time` defines what is computed.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints


@inlined
def _distance(first: Floats, second: Floats) -> float:
    """Return the distance of two points."""
    x, y, z = first[0] - second[0], first[1] - second[1], first[2] - second[2]
    return float(np.sqrt(x * x + y * y + z * z))


@inlined
def _nearest(
    last_place: Floats, limit: Floats, here: Floats, count: int, groups: int, wanted: Ints
) -> int:
    """Set what each of the fewer wants; return 0 where groups do, 1 individuals, -1 two the same.

    What is beyond twice the limit of an individual costs the same however far it is.
    """
    by_individual = count <= groups
    for attempt in range(2):
        rows = count if by_individual else groups
        columns = groups if by_individual else count
        unique = rows <= columns
        for row in range(rows):
            least = np.inf
            for column in range(columns):
                k, g = (row, column) if by_individual else (column, row)
                cost = min(_distance(last_place[k], here[g]), 2 * limit[k])
                if cost < least:
                    least = cost
                    wanted[row] = column
            for earlier in range(row):
                unique = unique and wanted[earlier] != wanted[row]
        if unique:
            return 1 if by_individual else 0
        if attempt or count != groups:
            break
        by_individual = False
    return -1


@kernel("f8[:,:,::1], i8[::1], i8, i8, i8, f8, i8, f8[:,::1], i8[::1], i8[:,::1], i8[::1]")
def link_frames(
    places: Floats,
    frames: Ints,
    start: int,
    stop: int,
    count: int,
    largest_step: float,
    memory: int,
    last_place: Floats,
    last_frame: Ints,
    names: Ints,
    reached: Ints,
) -> None:
    """Name the groups of the frames from `start` on, as far as no two want the same individual.

    places: `[frame, group, 3]`; frames: `[frame]` numbers. count: of individuals so far, of which
    last_place `[individual, 3]` and last_frame have room for more. names: `[frame, group]`.
    reached: set to the frame that was not named, which is `stop` where all were, and the count.
    """
    groups = places.shape[1]
    limit = np.empty(len(last_frame))
    here = np.empty((groups, 3))
    group, individual = np.empty(groups, dtype=np.int64), np.empty(groups, dtype=np.int64)
    wanted = np.empty(max(groups, len(last_frame)), dtype=np.int64)
    for index in range(start, stop):
        reached[0], reached[1] = index, count
        present = 0
        for g in range(groups):
            if np.isfinite(places[index, g, 0]):
                group[present] = g
                here[present] = places[index, g]
                individual[present] = -1
                present += 1
        if count + present > len(last_frame):
            return
        for k in range(count):
            limit[k] = largest_step * min(frames[index] - last_frame[k], memory)
        if count and present:
            side = _nearest(last_place, limit, here, count, present, wanted)
            if side < 0:
                return
            for row in range(count if side else present):
                k, g = (row, wanted[row]) if side else (wanted[row], row)
                if _distance(last_place[k], here[g]) <= limit[k]:
                    individual[g] = k
        for g in range(present):
            if individual[g] < 0:
                individual[g] = count
                count += 1
        for g in range(present):
            last_place[individual[g]] = here[g]
            last_frame[individual[g]] = frames[index]
            names[index, group[g]] = individual[g]
    reached[0], reached[1] = stop, count
