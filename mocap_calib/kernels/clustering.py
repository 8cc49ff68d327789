"""Groups of the detections of a frame, compiled: `clustering` defines what is computed.

Each cluster remembers the one that is closest to it. A merge changes one row and one column of the
linkage, so that the next closest two are found without looking at all of it again.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints

_BITS = 62  # views of a word


@inlined
def _look_for_closest(linkage: Floats, best: Floats, closest: Ints, row: int) -> None:
    """Find the first cluster that is closest to one."""
    value, index = linkage[row, 0], 0
    for column in range(1, linkage.shape[1]):
        if linkage[row, column] > value:
            value, index = linkage[row, column], column
    best[row], closest[row] = value, index


@inlined
def _share_a_view(holds: Ints, first: int, second: int) -> bool:
    """Return whether two clusters have detections of one view."""
    shared = 0
    for word in range(holds.shape[1]):
        shared |= holds[first, word] & holds[second, word]
    return shared != 0


@inlined
def _start(
    affinity: Floats,
    comparable: Floats,
    view: Ints,
    total: Floats,
    pairs: Floats,
    linkage: Floats,
    holds: Ints,
) -> None:
    """Set the clusters of one detection each."""
    holds[:] = 0
    for i in range(len(view)):
        holds[i, view[i] // _BITS] |= 1 << (view[i] % _BITS)
        for j in range(len(view)):
            total[i, j] = affinity[i, j] * comparable[i, j]
            pairs[i, j] = comparable[i, j]
            linkage[i, j] = 0.0
            if view[i] != view[j]:
                linkage[i, j] = total[i, j] / max(comparable[i, j], 1.0)


@inlined
def _merge(
    total: Floats,
    pairs: Floats,
    linkage: Floats,
    holds: Ints,
    best: Floats,
    closest: Ints,
    kept: int,
    merged: int,
) -> None:
    """Put the cluster `merged` into `kept`; no cluster is close to what is no longer used."""
    count, words = len(best), holds.shape[1]
    for i in range(count):
        total[kept, i] += total[merged, i]
        pairs[kept, i] += pairs[merged, i]
    for word in range(words):
        holds[kept, word] |= holds[merged, word]
        holds[merged, word] = -1
    for i in range(count):
        total[i, kept] = total[kept, i]
        pairs[i, kept] = pairs[kept, i]
        close = 0.0
        if not _share_a_view(holds, kept, i):
            close = total[kept, i] / max(pairs[kept, i], 1.0)
        linkage[kept, i] = linkage[i, kept] = close
    for i in range(count):
        linkage[merged, i] = linkage[i, merged] = 0.0
    best[merged] = 0.0
    _look_for_closest(linkage, best, closest, kept)
    for i in range(count):
        close = linkage[i, kept]
        if i in (kept, merged):
            continue
        if close > best[i] or (close == best[i] and kept < closest[i]):
            best[i], closest[i] = close, kept
        elif closest[i] in (kept, merged) and close < best[i]:
            _look_for_closest(linkage, best, closest, i)


@inlined
def _number(cluster: Ints, number: Ints) -> None:
    """Give clusters numbers from 0 in place, by their first detection.

    number: `[N]`, to be written over.
    """
    count = 0
    for i in range(len(cluster)):
        if cluster[i] == i:
            number[i] = count
            count += 1
    for i in range(len(cluster)):
        if cluster[i] >= 0:
            cluster[i] = number[cluster[i]]


@kernel("f8[:,:,::1], f8[:,:,::1], i8[::1], f8, i8[:,::1]")
def cluster_frames(
    affinity: Floats, comparable: Floats, view: Ints, least: float, cluster: Ints
) -> None:
    """Set the group `[frame, N]` of each detection, -1 for one that stays alone.

    affinity, comparable: `[frame, N, N]`, 0 or more, symmetric to the last digit: only then is what
    is closest to a cluster known without looking. view: `[N]` of each detection. least: the mean
    affinity down to which clusters are merged, above 0.
    """
    frames, count = affinity.shape[0], len(view)
    total = np.empty((count, count))
    pairs = np.empty((count, count))
    linkage = np.empty((count, count))
    holds = np.empty((count, view.max() // _BITS + 1), dtype=np.int64)
    best, closest = np.empty(count), np.empty(count, dtype=np.int64)
    for frame in range(frames):
        _start(affinity[frame], comparable[frame], view, total, pairs, linkage, holds)
        own = cluster[frame]
        for i in range(count):
            own[i] = -1
            _look_for_closest(linkage, best, closest, i)
        while True:
            kept = int(best.argmax())
            if not best[kept] >= least:
                break
            merged = int(closest[kept])
            _merge(total, pairs, linkage, holds, best, closest, kept, merged)
            for i in range(count):
                if own[i] == merged:
                    own[i] = kept
            own[kept] = own[merged] = kept
        _number(own, closest)
