"""Join the detections of a frame to groups, most alike first, in all frames at once.

Agglomerative clustering with average linkage (Sokal and Michener 1958). A group never holds two
detections of one view.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.types import Bools, Floats, Ints

_LEAST_AFFINITY = 1e-12  # 0 stands for clusters that must not be merged


@dataclass(frozen=True)
class _Clusters:
    """The clusters of each frame, changed in place as they are merged.

    A cluster goes by the index of one of its N detections; the rows and columns of the others
    are no longer used.

    affinity: `[frame, N, N]` sum of the affinities between the detections of two clusters.
    pairs: `[frame, N, N]` number of the comparable pairs of detections between two clusters.
    linkage: `[frame, N, N]` mean affinity, 0 between clusters that must not be merged.
    holds: `[frame, N, view]` whether a cluster has a detection of the view.
    cluster: `[frame, N]` the cluster of each detection.
    """

    affinity: Floats
    pairs: Floats
    linkage: Floats
    holds: Bools
    cluster: Ints


def cluster_detections(
    affinity: Floats, comparable: Floats, *, views: int, least_affinity: float
) -> Ints:
    """Return the group of each detection in its frame, `[frame, N]`; -1 for one that stays alone.

    Groups are numbered from 0 in each frame, by their first detection.

    affinity, comparable: `[frame, N, N]` of the N = views x instances detections: how alike two
        of them are, 0..1, and 1 where they can be compared; symmetric.
    least_affinity: the mean affinity down to which groups are merged; what is not alike at all
        never is.
    """
    least_affinity = max(least_affinity, _LEAST_AFFINITY)
    kernels = compiled("mocap_calib.kernels.clustering")
    if kernels is None:
        return merge_clusters(affinity, comparable, views=views, least_affinity=least_affinity)
    cluster = np.empty(affinity.shape[:2], dtype=np.int64)
    detections = affinity.shape[1]
    view = np.arange(detections) // max(detections // views, 1)
    kernels.cluster_frames(*contiguous(affinity, comparable), view, least_affinity, cluster)
    return cluster


def merge_clusters(
    affinity: Floats, comparable: Floats, *, views: int, least_affinity: float
) -> Ints:
    """Return what `cluster_detections` does, in numpy. least_affinity: above 0."""
    clusters = _single_detections(affinity, comparable, views)
    frames = np.arange(len(affinity))
    while len(frames):
        frames, kept, merged = _closest_clusters(clusters, frames, least_affinity)
        _merge(clusters, frames, kept, merged)
    together = clusters.cluster[:, :, None] == clusters.cluster[:, None]
    alone = together.sum(-1) == 1
    # a cluster goes by its first detection
    begins = (clusters.cluster == np.arange(affinity.shape[1])) & ~alone
    number = np.take_along_axis(begins.cumsum(1) - 1, clusters.cluster, axis=1)
    return np.where(alone, -1, number)


def _single_detections(affinity: Floats, comparable: Floats, views: int) -> _Clusters:
    """Return clusters of one detection each."""
    frames, detections = affinity.shape[:2]
    of_view = np.repeat(np.eye(views, dtype=bool), detections // views, axis=0)
    same_view = of_view @ of_view.T
    total = affinity * comparable
    return _Clusters(
        affinity=total,
        pairs=comparable.copy(),
        linkage=np.where(same_view, 0.0, total / np.maximum(comparable, 1.0)),
        holds=np.broadcast_to(of_view, (frames, detections, views)).copy(),
        cluster=np.broadcast_to(np.arange(detections), (frames, detections)).copy(),
    )


def _closest_clusters(
    clusters: _Clusters, frames: Ints, least_affinity: float
) -> tuple[Ints, Ints, Ints]:
    """Return the frames in which clusters are still to be merged, and the two closest of each."""
    detections = clusters.cluster.shape[1]
    linkage = clusters.linkage.reshape(len(clusters.linkage), -1)[frames]
    best = linkage.argmax(1)
    alike = linkage[np.arange(len(best)), best] >= least_affinity
    kept, merged = np.divmod(best[alike], detections)
    return frames[alike], kept, merged


def _merge(clusters: _Clusters, frames: Ints, kept: Ints, merged: Ints) -> None:
    """Merge the cluster `merged` into `kept`, in each of the frames."""
    for sums in (clusters.affinity, clusters.pairs):
        joined = sums[frames, kept] + sums[frames, merged]
        sums[frames, kept] = joined
        sums[frames, :, kept] = joined

    holds = clusters.holds
    holds[frames, kept] |= holds[frames, merged]
    holds[frames, merged] = True  # no cluster may be merged with it again

    pairs = np.maximum(clusters.pairs[frames, kept], 1.0)
    mean = clusters.affinity[frames, kept] / pairs
    share_a_view = (holds[frames] & holds[frames, kept][:, None]).any(-1)
    linkage = np.where(share_a_view, 0.0, mean)
    clusters.linkage[frames, kept] = linkage
    clusters.linkage[frames, :, kept] = linkage
    clusters.linkage[frames, merged] = 0.0
    clusters.linkage[frames, :, merged] = 0.0

    cluster = clusters.cluster[frames]
    clusters.cluster[frames] = np.where(cluster == merged[:, None], kept[:, None], cluster)
