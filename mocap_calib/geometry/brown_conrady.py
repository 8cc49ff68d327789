"""The lens model of Brown and Conrady, with OpenCV's rational terms, on the plane z = 1."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_calib.types import Camera, Floats

NEWTON_STEPS = 5
_SETTLED = 1e-7  # of a step: the next would be its square
_CAREFUL_STEPS = 60
_CAREFUL_STEP = 0.1  # longest step of those


class Coefficients(NamedTuple):
    """OpenCV's coefficients, in its order."""

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float
    k5: float
    k6: float


class Limits(NamedTuple):
    """When Newton's method has found the point that a lens distorts.

    settled: a step shorter than that needs no other after it. error: by how much the lens may miss
    the distorted point, at most. squared_fold_radius: past the first fold of the lens lie further
    solutions, which mean nothing.
    """

    settled: float
    error: float
    squared_fold_radius: float


def coefficients(camera: Camera) -> Coefficients:
    """Return the camera's coefficients, 0 where it has fewer than eight."""
    given = camera.distortion[:8].tolist()
    return Coefficients(*given, *[0.0] * (8 - len(given)))


def distort(k: Coefficients, image: Floats) -> Floats:
    """Return where the lens puts points of the plane z = 1, `[2, N]` both."""
    x, y = image
    square = x * x + y * y
    xy = x * y
    radial = _polynomial(square, k.k1, k.k2, k.k3)
    if k.k4 or k.k5 or k.k6:
        radial = radial / _polynomial(square, k.k4, k.k5, k.k6)
    distorted = image * radial
    if k.p1 or k.p2:
        distorted[0] += 2 * k.p1 * xy + k.p2 * (square + 2 * x * x)
        distorted[1] += 2 * k.p2 * xy + k.p1 * (square + 2 * y * y)
    return distorted


def jacobian(k: Coefficients, image: Floats) -> Floats:
    """Return the derivatives `[2, 2, N]` of `distort` by the points of the plane z = 1."""
    xx, xy, yy = _slopes(k, image)
    return np.stack([np.stack([xx, xy]), np.stack([xy, yy])])


def slope_by_k1(k: Coefficients, image: Floats) -> Floats:
    """Return the derivatives `[2, N]` of `distort` by k1."""
    square = (image**2).sum(0)
    return image * square / _polynomial(square, k.k4, k.k5, k.k6)


def undistort(k: Coefficients, distorted: Floats, *, miss: float) -> Floats:
    """Return the points of the plane z = 1 that the lens puts at `distorted`, `[2, N]` both.

    By Newton's method. NaN where there is no such point within `miss` (in focal lengths).
    """
    limits = limits_of_newton(k, miss=miss)
    image = distorted
    for _ in range(NEWTON_STEPS):
        step = _newton_step(k, image, distorted)
        image = image + step
        if not (np.abs(step) > limits.settled).any():
            break
    error = np.abs(distorted - distort(k, image)).max(0)
    before_fold = (image**2).sum(0) < limits.squared_fold_radius
    doubtful = ~((error <= limits.error) & before_fold) & np.isfinite(distorted).all(0)
    if doubtful.any():
        image[:, doubtful] = _undistort_carefully(k, distorted[:, doubtful], miss=miss)
    return image


def limits_of_newton(k: Coefficients, *, miss: float) -> Limits:
    """Return when Newton's method has found a point for this lens; miss: as of `undistort`."""
    return Limits(_SETTLED, 1e-12 + 1e-9 * miss, _squared_fold_radius(k))


def _undistort_carefully(k: Coefficients, distorted: Floats, *, miss: float) -> Floats:
    """Return the same `[2, N]`, from the middle of the image outwards in small steps."""
    image = np.zeros_like(distorted)
    for _ in range(_CAREFUL_STEPS):
        step = _newton_step(k, image, distorted)
        length = np.maximum(np.hypot(*step), 1e-12)
        image = image + step * np.minimum(1.0, _CAREFUL_STEP / length)
    error = np.abs(distorted - distort(k, image)).max(0)
    return np.where(error <= miss, image, np.nan)


def _newton_step(k: Coefficients, image: Floats, distorted: Floats) -> Floats:
    """Return Newton's step `[2, N]` from `image` towards the points that the lens distorts so."""
    xx, xy, yy = _slopes(k, image)
    determinant = xx * yy - xy * xy
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, 1e-9)
    error = distorted - distort(k, image)
    step_x = yy * error[0] - xy * error[1]
    step_y = xx * error[1] - xy * error[0]
    return np.stack([step_x, step_y]) / determinant


def _slopes(k: Coefficients, image: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the entries xx, xy and yy `[N]` of the Jacobian of `distort`, which is symmetric."""
    x, y = image
    square = x * x + y * y
    above = _polynomial(square, k.k1, k.k2, k.k3)
    below = _polynomial(square, k.k4, k.k5, k.k6)
    radial = above / below
    above_slope = k.k1 + square * (2 * k.k2 + 3 * square * k.k3)
    below_slope = k.k4 + square * (2 * k.k5 + 3 * square * k.k6)
    slope = (above_slope - radial * below_slope) / below  # d radial / d r^2
    xx = radial + 2 * x * x * slope + 2 * k.p1 * y + 6 * k.p2 * x
    yy = radial + 2 * y * y * slope + 2 * k.p2 * x + 6 * k.p1 * y
    xy = 2 * x * y * slope + 2 * k.p1 * x + 2 * k.p2 * y
    return xx, xy, yy


@lru_cache
def _squared_fold_radius(k: Coefficients) -> float:
    """Return the squared radius up to which the distorted radius grows with the radius."""
    radius = np.linspace(0, 10, 4001)
    square = radius**2
    above = _polynomial(square, k.k1, k.k2, k.k3)
    below = _polynomial(square, k.k4, k.k5, k.k6)
    distorted = radius * above / np.where(below > 0, below, np.nan)
    grows = np.diff(distorted) > 0
    return np.inf if grows.all() else float(square[np.argmin(grows)])


def _polynomial(square: Floats, first: float, second: float, third: float) -> Floats:
    """Return 1 + a r^2 + b r^4 + c r^6 of squared radii `[N]`."""
    return 1 + square * (first + square * (second + square * third))
