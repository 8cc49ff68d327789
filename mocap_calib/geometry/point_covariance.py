"""How sure points from rays are, and how much of the rays' errors they absorb.

All to first order, with J the derivatives of the rays' angles by the point: a ray that is seen at
the distance d along the unit vector u has J' J = (I - u u') / d^2.
"""

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import INTERSECT_LOSS_SCALE
from mocap_calib.geometry import symmetric
from mocap_calib.geometry.intersection import normal_matrix
from mocap_calib.geometry.symmetric import Entries
from mocap_calib.geometry.view_blocks import ViewBlock, view_blocks
from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.types import CameraRig, Floats

# Where a point follows one ray almost wholly, what is left of that ray's error tells nothing
# certain of the error: this share of its variance at least is taken to be left.
_LEAST_SHARE = 0.05
# the median angle of a view that does not see the point, which then takes up nothing of its error:
# of two degrees of freedom, by the formula of `median_angles`
_UNTOUCHED = (2 * (1 - 1 / 9) ** 3) ** 0.5


def point_covariance(
    rig: CameraRig, points: Floats, world: Floats, *, precision: Floats, variance: Floats
) -> Entries:
    """Return the covariances of points that `intersect` found.

    points: `[3, N]` in world coordinates. world: `[view, 3, N]` unit rays in the world's axes, zero
        where missing.
    precision: `[view, N]` what they were weighed by, 0 = not used.
    variance: `[view]` of one coordinate of the rays' angles, in radians squared.

    With the robust weights w and N = sum w J'J they are N^-1 (sum w^2 s^2 J'J) N^-1: N^-1 itself
    where the weights are the inverse variances. Huge where the rays used are all in one line.
    """
    if kernels := compiled("mocap_calib.kernels.point_covariance"):
        found = np.empty((6, points.shape[1]))
        given = contiguous(rig.centres, points, world, precision, variance)
        kernels.covariances(*given, INTERSECT_LOSS_SCALE, found)
        return tuple(found)
    return _point_covariance(rig, points, world, precision=precision, variance=variance)


def _point_covariance(
    rig: CameraRig, points: Floats, world: Floats, *, precision: Floats, variance: Floats
) -> Entries:
    """Return what `point_covariance` does."""
    direction, inverse_square = _from_centres(rig, points)
    along = np.einsum("vin,vin->vn", direction, world)
    error = np.maximum(1 - along * along, 0.0) * precision
    weight = precision / (1 + error / INTERSECT_LOSS_SCALE**2) ** 2
    by_weight = normal_matrix(direction, weight * inverse_square)
    by_error = normal_matrix(direction, weight**2 * variance[:, None] * inverse_square)
    return symmetric.sandwich(symmetric.invert(by_weight), by_error)


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
    kernels = compiled("mocap_calib.kernels.rays")
    if not kernels:
        return _median_angles(rig, points, weight)
    medians = np.empty(weight.shape)
    given = contiguous(rig.centres, points, weight)
    kernels.median_angles(*given, _LEAST_SHARE, _UNTOUCHED, medians)
    return medians


def _median_angles(rig: CameraRig, points: Floats, weight: Floats) -> Floats:
    """Return what `_median_angles_in_block` does."""
    direction, inverse_square = _from_centres(rig, points)
    weight = weight * inverse_square
    covariance = symmetric.invert(normal_matrix(direction, weight))
    medians = np.empty(weight.shape)
    for view, (u, share) in enumerate(zip(direction, weight, strict=True)):
        along = symmetric.multiply(covariance, u)
        straight = (u * along).sum(0)
        taken = share * (symmetric.trace(covariance) - straight)
        square = symmetric.sum_of_squares(covariance) - 2 * (along**2).sum(0) + straight**2
        mean = np.maximum(2 - taken, 2 * _LEAST_SHARE)
        squared = np.maximum(2 - 2 * taken + share**2 * square, 0.5 * mean**2)
        freedom = np.clip(mean**2 / squared, 1.0, 2.0)
        medians[view] = np.sqrt(mean * (1 - 2 / (9 * freedom)) ** 3)
    return medians


def _from_centres(rig: CameraRig, points: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors `[view, 3, N]` from the cameras, and inverse squared distances."""
    offset = points - rig.centres[:, :, None]
    inverse_square = 1 / np.maximum(np.einsum("vin,vin->vn", offset, offset), 1e-300)
    return offset * np.sqrt(inverse_square)[:, None], inverse_square
