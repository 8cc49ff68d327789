"""Covariances of the points of a fit: the blocks of the inverse of its normal equations.

Over time exactly: the factored bands of a joint give the blocks of the diagonal of the inverse from
the last frame to the first (Takahashi 1973). Along bones to first order: a bone adds to what is
known of a joint by what is known of its other end without it.
"""

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels.pose_energy import LANES, sum_known
from mocap_calib.kernels.pose_step import invert_bands
from mocap_calib.poses.energy import Strengths
from mocap_calib.poses.lanes import from_lanes
from mocap_calib.poses.packing import pack
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats


def covariances(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> Floats:
    """Return the covariance `[keypoint, frame, 6]` of each point, xx xy xz yy yz zz.

    points: `[keypoint, frame, 3]` of a fit. A point without information has the variance 1 / ridge.
    """
    packed = pack(points, seen, body, strengths, config)
    packed.share_accelerations()
    sum_known(
        packed.rays,
        packed.centres,
        packed.points,
        packed.edges,
        packed.bones,
        packed.expected,
        strengths.loss,
        config.prior_loss,
        packed.factor,
    )
    packed.factor_bands(np.zeros_like(packed.points))
    found = np.zeros((*packed.factor.shape[:2], 6 * LANES))
    invert_bands(packed.factor, found)
    return from_lanes(found, LANES, packed.joints, points.shape[1])
