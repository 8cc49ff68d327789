"""Lenses: rays of pixels, pixels of points, and their derivatives.

A lens is a row of 14 numbers, see `geometry.lens.rows`: its kind (1 Brown and Conrady's with
OpenCV's rational terms, 2 Kannala and Brandt's fisheye), the factor of pixels, focal lengths,
principal point, and up to eight coefficients in OpenCV's order.
"""

import math
from typing import TypeVar

import numpy as np

from mocap_calib.kernels.jit import copied, inlined, kernel
from mocap_calib.types import Bools, Floats

LANES = 64  # points side by side: loops of a fixed length over arrays in the cache are vectorised
FISHEYE = 2.0
_SETTLED, _FLATTEST = 1e-7, 1e-9  # of a step, after which the next is its square; of a determinant
_STEPS, _CAREFUL_STEPS, _FISHEYE_STEPS = 5, 60, 20
_CAREFUL_STEP = 0.1  # longest one
_LEAST_RADIUS = 1e-5  # of a fisheye: nearer to the axis derivatives are those at this distance
Number = TypeVar("Number", float, Floats)
_Six = tuple[Number, Number, Number, Number, Number, Number]


@inlined
def brown(lens: Floats, x: Number, y: Number) -> _Six[Number]:
    """Return what `distort` does, for the model of Brown and Conrady."""
    k1, k2, p1, p2 = lens[6], lens[7], lens[8], lens[9]
    k3, k4, k5, k6 = lens[10], lens[11], lens[12], lens[13]
    square = x * x + y * y
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 / (1 + square * (k4 + square * (k5 + square * k6)))
    radial = above * below
    above_slope = k1 + square * (2 * k2 + 3 * square * k3)
    below_slope = k4 + square * (2 * k5 + 3 * square * k6)
    slope = (above_slope - radial * below_slope) * below  # d radial / d r^2
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y),
        radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
        2 * x * y * slope + 2 * p1 * x + 2 * p2 * y,
        radial + 2 * y * y * slope + 2 * p2 * x + 6 * p1 * y,
        square * below,
    )


@inlined
def _fisheye_radius(lens: Floats, theta: Number) -> tuple[Number, Number]:
    """Return the distorted radius at an angle to the axis, and its slope.

    r = theta (1 + k1 theta^2 + ... + k4 theta^8), and dr / dtheta.
    """
    k1, k2, k3, k4 = lens[6], lens[7], lens[8], lens[9]
    square = theta * theta
    series = k1 + square * (k2 + square * (k3 + square * k4))
    slopes = 3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4))
    return theta * (1 + square * series), 1 + square * slopes


@inlined
def _fisheye(lens: Floats, x: Number, y: Number) -> _Six[Number]:
    """Return what `distort` does, for a fisheye lens."""
    radius = np.maximum(np.hypot(x, y), _LEAST_RADIUS)
    theta = np.arctan(radius)
    distorted, slope = _fisheye_radius(lens, theta)
    radial = distorted / radius
    by_radius = (slope / (1 + radius * radius) - radial) / (radius * radius)
    return (
        x * radial,
        y * radial,
        radial + x * x * by_radius,
        x * y * by_radius,
        radial + y * y * by_radius,
        theta * theta * theta / radius,
    )


@copied
def distort(lens: Floats, x: Number, y: Number) -> _Six[Number]:
    """Return where a lens puts a point of the plane z = 1, and its derivatives.

    x and y; the symmetric Jacobian xx, xy, yy; and d x / d k1 over x, which is d y / d k1 over y.
    Kernels call it for numbers, `geometry.lens` for arrays.
    """
    if lens[0] == FISHEYE:
        return _fisheye(lens, x, y)
    return brown(lens, x, y)


@inlined
def _step(lens: Floats, x: float, y: float, to_x: float, to_y: float) -> tuple[float, float]:
    """Return Newton's step towards the point that a lens of Brown and Conrady puts at `to`."""
    lens_x, lens_y, xx, xy, yy, _ = brown(lens, x, y)
    determinant = xx * yy - xy * xy
    inverse = 1 / (determinant if abs(determinant) > _FLATTEST else _FLATTEST)
    off_x, off_y = to_x - lens_x, to_y - lens_y
    return (yy * off_x - xy * off_y) * inverse, (xx * off_y - xy * off_x) * inverse


@inlined
def _find_points(lens: Floats, limits: Floats, work: Floats, found: Bools) -> None:
    """Set the points of the plane z = 1 that a lens puts at others, and which were found.

    By Newton's method. work: `[5, LANES]` the points, the others, in focal lengths, and the length
    of the last step. limits: see `unproject`. Past the first fold of a lens lie further solutions,
    which mean nothing.
    """
    x, y, to_x, to_y, length = work[0], work[1], work[2], work[3], work[4]
    x[:], y[:] = to_x, to_y
    for _ in range(_STEPS):
        for n in range(LANES):
            step_x, step_y = _step(lens, x[n], y[n], to_x[n], to_y[n])
            x[n] += step_x
            y[n] += step_y
            length[n] = max(abs(step_x), abs(step_y))
        moving = 0
        for n in range(LANES):
            moving += int(length[n] > _SETTLED)
        if moving == 0:
            break
    for n in range(LANES):
        lens_x, lens_y, _, _, _, _ = brown(lens, x[n], y[n])
        miss = max(abs(to_x[n] - lens_x), abs(to_y[n] - lens_y))
        found[n] = (miss <= limits[0]) & (x[n] * x[n] + y[n] * y[n] < limits[1])


@inlined
def _find_carefully(lens: Floats, limits: Floats, to_x: float, to_y: float) -> tuple[float, float]:
    """Return the point that a lens puts at another, from the middle outwards in small steps."""
    x = y = 0.0
    for _ in range(_CAREFUL_STEPS):
        step_x, step_y = _step(lens, x, y, to_x, to_y)
        share = min(1.0, _CAREFUL_STEP / max(math.hypot(step_x, step_y), 1e-12))
        x, y = x + share * step_x, y + share * step_y
    lens_x, lens_y, _, _, _, _ = brown(lens, x, y)
    if max(abs(to_x - lens_x), abs(to_y - lens_y)) <= limits[2]:
        return x, y
    return np.nan, np.nan


@inlined
def _find_fisheye_ray(
    lens: Floats, limits: Floats, x: float, y: float
) -> tuple[float, float, float]:
    """Return the unit ray that a fisheye lens puts at a point, by Newton's method on the angle."""
    radius = math.hypot(x, y)
    theta = min(radius, math.pi / 2)
    for _ in range(_FISHEYE_STEPS):
        value, slope = _fisheye_radius(lens, theta)
        step = (value - radius) / (slope if abs(slope) > _FLATTEST else _FLATTEST)
        theta = min(max(theta - step, 0.0), math.pi)
        if abs(step) <= 1e-15:
            break
    value, _ = _fisheye_radius(lens, theta)
    if not abs(value - radius) <= limits[2]:
        return np.nan, np.nan, np.nan
    scale = 1.0 if radius <= 1e-12 else math.sin(theta) / radius
    return x * scale, y * scale, math.cos(theta)


@kernel("f8[::1], f8[:,::1], f8[:,::1], i8[::1], i8, f8[::1]")
def unproject(
    pixels: Floats, lenses: Floats, limits: Floats, strides: Floats, count: int, rays: Floats
) -> None:
    """Set the unit rays of so many pixels of each view; NaN where no ray has the pixel.

    pixels, rays: `[view * N * 2]` and `[view * N * 3]`. strides: (4,) between points and between
    coordinates of these, and then of those. limits: `[view, 3]` by how much the lens may miss the
    pixel in focal lengths, the squared radius of its first fold, and by how much at most.
    """
    work, found = np.zeros((5, LANES)), np.zeros(LANES, dtype=np.bool_)
    ray = np.zeros((3, LANES))
    x, y, to_x, to_y = work[0], work[1], work[2], work[3]
    for view in range(len(lenses)):
        lens, limit = lenses[view], limits[view]
        for start in range(0, count, LANES):
            here = min(LANES, count - start)
            at = 2 * view * count + start * strides[0]
            to_x[here:], to_y[here:] = 0.0, 0.0
            for n in range(here):
                to_x[n] = (pixels[at + n * strides[0]] - lens[4]) / lens[2]
                to_y[n] = (pixels[at + n * strides[0] + strides[1]] - lens[5]) / lens[3]
            if lens[0] == FISHEYE:
                for n in range(here):
                    ray[0, n], ray[1, n], ray[2, n] = _find_fisheye_ray(
                        lens, limit, to_x[n], to_y[n]
                    )
            else:
                _find_points(lens, limit, work, found)
                for n in range(here):
                    if not found[n] and math.isfinite(to_x[n] + to_y[n]):
                        x[n], y[n] = _find_carefully(lens, limit, to_x[n], to_y[n])
                for n in range(LANES):
                    length = 1 / math.sqrt(1 + x[n] * x[n] + y[n] * y[n])
                    ray[0, n], ray[1, n], ray[2, n] = x[n] * length, y[n] * length, length
            at = 3 * view * count + start * strides[2]
            for n in range(here):
                for row in range(3):
                    rays[at + n * strides[2] + row * strides[3]] = ray[row, n]
