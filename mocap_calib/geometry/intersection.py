"""Points from the rays of many views, robustly, many at once.

All points start in closed form (weighted least squares on lines) and take Gauss-Newton steps on
angles. Those whose rays do not all meet there start again under a loss that tightens, and where
too few rays agree even then, every pair of rays gives a candidate. Arrays are kept by component,
`[view, 3, N]`, in blocks that stay in the cache.
"""

from itertools import combinations

import numpy as np

from mocap_calib.config import (
    INTERSECT_AGREEING_RAYS,
    INTERSECT_AGREEING_SHARE,
    INTERSECT_ALL_PAIRS_VIEWS,
    INTERSECT_DOUBTFUL,
    INTERSECT_LOSS_SCALE,
    INTERSECT_OUTLIER,
    INTERSECT_POLISH_STEPS,
    INTERSECT_STEPS,
    INTERSECT_TIGHTENING_SCALES,
)
from mocap_calib.kernels.intersection import intersect_rays
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import CameraRig, Floats


def intersect(rig: CameraRig, world: Floats, precision: Floats) -> Floats:
    """Return the points `[3, N]` nearest to rays, in angles; NaN where fewer than two are seen.

    world: `[view, 3, N]` unit rays in the world's axes, zero where missing.
    precision: `[view, N]` inverse variance of the angle in radians, 0 = not seen.
    """
    middle = rig.centres.mean(0)
    points = np.empty(world.shape[1:])
    first, others = _candidate_pairs(len(rig))
    intersect_rays(
        *contiguous(rig.centres - middle, world, precision),
        np.array(first + others, dtype=np.int64).reshape(-1, 2),
        len(first),
        np.full(INTERSECT_STEPS, INTERSECT_LOSS_SCALE),
        np.array(INTERSECT_TIGHTENING_SCALES),
        np.full(INTERSECT_POLISH_STEPS, INTERSECT_LOSS_SCALE),
        np.array(
            [
                INTERSECT_DOUBTFUL,
                INTERSECT_OUTLIER,
                INTERSECT_AGREEING_RAYS,
                INTERSECT_AGREEING_SHARE,
            ]
        ),
        points,
    )
    return points + middle[:, None]


def _candidate_pairs(views: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the pairs of views that try every point they see, and those that fill what these miss.

    All pairs are of the first kind in a small rig. In a large one they are those of a view with
    the next one, and with the one a third of the rig away.
    """
    pairs = list(combinations(range(views), 2))
    if views <= INTERSECT_ALL_PAIRS_VIEWS:
        return pairs, []
    neighbours = {
        (min(view, other), max(view, other))
        for view in range(views)
        for other in ((view + 1) % views, (view + views // 3) % views)
    }
    return sorted(neighbours), [pair for pair in pairs if pair not in neighbours]
