"""How sure points from rays are, and how much of the rays' errors they absorb.

All to first order, with J the derivatives of the rays' angles by the point: a ray that is seen at
the distance d along the unit vector u has J' J = (I - u u') / d^2.
"""

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import INTERSECT_LOSS_SCALE
from mocap_calib.geometry.view_blocks import ViewBlock, view_blocks
from mocap_calib.kernels import rays as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import CameraRig, Floats

# Where a point follows one ray almost wholly, what is left of that ray's error tells nothing
# certain of the error: this share of its variance at least is taken to be left.
_LEAST_SHARE = 0.05
# the median angle of a view that does not see the point, which then takes up nothing of its error:
# of two degrees of freedom, by the formula of `median_angles`
_UNTOUCHED = (2 * (1 - 1 / 9) ** 3) ** 0.5


def point_covariance(
    rig: CameraRig, points: Floats, world: Floats, *, precision: Floats, variance: Floats
) -> Floats:
    """Return the covariances `[6, N]` of points that `intersect` found: xx, xy, xz, yy, yz, zz.

    points: `[3, N]` in world coordinates. world: `[view, 3, N]` unit rays in the world's axes, zero
        where missing.
    precision: `[view, N]` what they were weighed by, 0 = not used.
    variance: `[view]` of one coordinate of the rays' angles, in radians squared.

    With the robust weights w and N = sum w J'J they are N^-1 (sum w^2 s^2 J'J) N^-1: N^-1 itself
    where the weights are the inverse variances. Huge where the rays used are all in one line.
    """
    found = np.empty((6, points.shape[1]))
    given = contiguous(rig.centres, points, world, precision, variance)
    kernels.covariances(*given, INTERSECT_LOSS_SCALE, found)
    return found


def median_angles(rig: CameraRig, points: Floats, weight: Floats) -> Floats:
    """Return the medians `[view, N]` of the angles between rays and the points made of them.

    In standard deviations of one coordinate of the rays' errors, whose variances are inverse to
    the weights (`[view, N]`). An angle without any point would have 1.18. The point takes up
    H = w J (sum w J'J)^-1 J' of a ray's error, so what is left has the covariance I - H: of three
    coordinates less in all, but more of a near camera than of a far one, and in one direction
    alone where two rays meet.

    The squared angle has the mean m = tr(I - H) and the variance 2 tr(I - H)^2. As chi-squared of
    k = m^2 / tr(I - H)^2 degrees of freedom it has the median m (1 - 2 / (9 k))^3 (Satterthwaite
    1946; Wilson and Hilferty 1931).
    """
    medians = np.full(weight.shape, _UNTOUCHED)

    def measure(block: ViewBlock) -> Floats:
        own, seen_by = rig.select(block.views), block.take(weight)
        return _median_angles_in_block(own, points[:, block.points], seen_by)

    blocks = view_blocks(np.asarray(weight > 0))
    for block, found in zip(blocks, map_in_threads(measure, blocks), strict=True):
        block.put(found, medians)
    return medians


def _median_angles_in_block(rig: CameraRig, points: Floats, weight: Floats) -> Floats:
    """Return what `median_angles` does of a block, where most views see most of the points."""
    medians = np.empty(weight.shape)
    given = contiguous(rig.centres, points, weight)
    kernels.median_angles(*given, _LEAST_SHARE, _UNTOUCHED, medians)
    return medians
