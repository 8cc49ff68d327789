"""Groups of the detections of a frame: agglomerative clustering with average linkage."""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints


@inlined
def _start(
    affinity: Floats, comparable: Floats, view: Ints, total: Floats, pairs: Floats, linkage: Floats
) -> None:
    """Set the clusters of one detection each: those of one view never join."""
    for i in range(len(view)):
        for j in range(len(view)):
            total[i, j], pairs[i, j] = affinity[i, j] * comparable[i, j], comparable[i, j]
            if view[i] == view[j]:
                total[i, j] = -np.inf
            linkage[i, j] = total[i, j] / max(pairs[i, j], 1.0)


@inlined
def _find_closest(linkage: Floats) -> tuple[float, int, int]:
    """Return the largest linkage of two clusters, and the first two that have it."""
    largest, first, second = 0.0, 0, 0
    for i in range(len(linkage)):
        for j in range(i + 1, len(linkage)):
            if linkage[i, j] > largest:
                largest, first, second = linkage[i, j], i, j
    return largest, first, second


@inlined
def _merge(total: Floats, pairs: Floats, linkage: Floats, kept: int, merged: int) -> None:
    """Put the cluster `merged` into `kept`; nothing joins what is no longer used."""
    for i in range(len(total)):
        total[kept, i] += total[merged, i]
        pairs[kept, i] += pairs[merged, i]
        total[i, kept], pairs[i, kept] = total[kept, i], pairs[kept, i]
        linkage[kept, i] = linkage[i, kept] = total[kept, i] / max(pairs[kept, i], 1.0)
    for i in range(len(total)):
        total[merged, i] = total[i, merged] = linkage[merged, i] = linkage[i, merged] = -np.inf


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

    affinity, comparable: `[frame, N, N]`, 0 or more, symmetric. view: `[N]` of each detection.
    least: the mean affinity down to which clusters are merged, above 0.
    """
    frames, count = affinity.shape[0], len(view)
    total, pairs = np.empty((count, count)), np.empty((count, count))
    linkage, number = np.empty((count, count)), np.empty(count, dtype=np.int64)
    for frame in range(frames):
        _start(affinity[frame], comparable[frame], view, total, pairs, linkage)
        own = cluster[frame]
        for i in range(count):
            own[i] = -1
        while True:
            largest, kept, merged = _find_closest(linkage)
            if not largest >= least:
                break
            _merge(total, pairs, linkage, kept, merged)
            for i in range(count):
                if own[i] == merged:
                    own[i] = kept
            own[kept] = own[merged] = kept
        _number(own, number)
