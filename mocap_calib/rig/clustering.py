"""Join the detections of a frame to groups, most alike first, in all frames at once.

Agglomerative clustering with average linkage (Sokal and Michener 1958). A group never holds two
detections of one view.
"""

import numpy as np

from mocap_calib.kernels.clustering import cluster_frames
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Floats, Ints

_LEAST_AFFINITY = 1e-12  # 0 stands for clusters that must not be merged


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
    cluster = np.empty(affinity.shape[:2], dtype=np.int64)
    detections = affinity.shape[1]
    view = np.arange(detections) // max(detections // views, 1)
    cluster_frames(*contiguous(affinity, comparable), view, least_affinity, cluster)
    return cluster
