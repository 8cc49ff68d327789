"""Rays of pixels, and pixels of points, compiled.

`lens`, `brown_conrady` and `reprojection` define what is computed.

`LANES` of them at once, with all of Newton's steps.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats, Ints

LANES = 64
_FLATTEST = 1e-9  # as of `brown_conrady._newton_step`


@inlined
def _polynomial(square: float, first: float, second: float, third: float) -> float:
    """Return 1 + a r^2 + b r^4 + c r^6 of a squared radius."""
    return 1 + square * (first + square * (second + square * third))


@inlined
def _distort(k: Floats, x: float, y: float, square: float, radial: float) -> tuple[float, float]:
    """Return where the lens puts a point of the plane z = 1, with its squared radius."""
    twist = 2 * x * y
    return (
        x * radial + k[2] * twist + k[3] * (square + 2 * x * x),
        y * radial + k[3] * twist + k[2] * (square + 2 * y * y),
    )


@inlined
def _step(k: Floats, x: Floats, y: Floats, to_x: Floats, to_y: Floats, step: Floats) -> None:
    """Take Newton's step `[2, LANES]` towards the points that the lens puts at (to_x, to_y)."""
    for n in range(LANES):
        of_x, of_y = x[n], y[n]
        square = of_x * of_x + of_y * of_y
        below = _polynomial(square, k[5], k[6], k[7])
        radial = _polynomial(square, k[0], k[1], k[4]) / below
        above_slope = k[0] + square * (2 * k[1] + 3 * square * k[4])
        below_slope = k[5] + square * (2 * k[6] + 3 * square * k[7])
        slope = (above_slope - radial * below_slope) / below
        xx = radial + 2 * of_x * of_x * slope + 2 * k[2] * of_y + 6 * k[3] * of_x
        yy = radial + 2 * of_y * of_y * slope + 2 * k[3] * of_x + 6 * k[2] * of_y
        xy = 2 * of_x * of_y * slope + 2 * k[2] * of_x + 2 * k[3] * of_y
        determinant = xx * yy - xy * xy
        inverse = 1 / (determinant if abs(determinant) > _FLATTEST else _FLATTEST)
        lens_x, lens_y = _distort(k, of_x, of_y, square, radial)
        off_x, off_y = to_x[n] - lens_x, to_y[n] - lens_y
        step[0, n] = (yy * off_x - xy * off_y) * inverse
        step[1, n] = (xx * off_y - xy * off_x) * inverse
        x[n] = of_x + step[0, n]
        y[n] = of_y + step[1, n]


@inlined
def _still_moving(step: Floats, settled: float) -> bool:
    """Return whether any of the steps `[2, LANES]` is longer than that."""
    moving = 0
    for n in range(LANES):
        moving += int(abs(step[0, n]) > settled or abs(step[1, n]) > settled)
    return moving > 0


@inlined
def _miss(k: Floats, x: Floats, y: Floats, to_x: Floats, to_y: Floats, step: Floats) -> None:
    """Set by how much the lens misses (to_x, to_y), and the squared radii: `[2, LANES]`."""
    for n in range(LANES):
        of_x, of_y = x[n], y[n]
        square = of_x * of_x + of_y * of_y
        below = _polynomial(square, k[5], k[6], k[7])
        radial = _polynomial(square, k[0], k[1], k[4]) / below
        lens_x, lens_y = _distort(k, of_x, of_y, square, radial)
        step[0, n] = max(abs(to_x[n] - lens_x), abs(to_y[n] - lens_y))
        step[1, n] = square


@inlined
def _make_rays(x: Floats, y: Floats, length: Floats) -> None:
    """Make points of the plane z = 1 the unit rays (x, y, length), `[LANES]` each."""
    for n in range(LANES):
        length[n] = 1 / math.sqrt(1 + x[n] * x[n] + y[n] * y[n])
        x[n] *= length[n]
        y[n] *= length[n]


@inlined
def _find_points(k: Floats, steps: int, limits: Floats, work: Floats) -> None:
    """Set the points of the plane z = 1 that the lens puts at others, by Newton's method.

    work: `[7, LANES]`: points that are found; one row that is free; the others, in focal lengths;
    and by how much the lens misses these and the squared radii, 0 where it has no distortion.
    """
    x, y, to_x, to_y, step = work[0], work[1], work[3], work[4], work[5:]
    x[:], y[:] = to_x, to_y
    step[:] = 0.0
    for _ in range(steps):
        _step(k, x, y, to_x, to_y, step)
        if not _still_moving(step, limits[0]):
            break
    if steps > 0:
        _miss(k, x, y, to_x, to_y, step)


@kernel("f8[::1], f8[:,::1], f8[:,::1], i8[::1], f8[:,::1], i8[::1], f8[::1], b1[:,::1]")
def unproject(
    pixels: Floats,
    intrinsics: Floats,
    k: Floats,
    steps: Ints,
    limits: Floats,
    strides: Ints,
    rays: Floats,
    doubtful: Bools,
) -> None:
    """Set the rays of N pixels of each view, and where none was found, `[view, N]`.

    pixels, rays: `[view * N * 2]` and `[view * N * 3]`. strides: (4,) between points and between
    coordinates of these, and then of those. intrinsics: `[view, 4]` focal lengths, then the
    principal point. k: `[view, 8]` `Coefficients`. steps: `[view]` Newton's, 0 where the lens has
    no distortion, below 0 = all are doubtful. limits: `[view, 3]` `Limits`.
    """
    views, count = doubtful.shape
    work = np.zeros((7, LANES))
    x, y, length, to_x, to_y, step = work[0], work[1], work[2], work[3], work[4], work[5:]
    for view in range(views):
        if steps[view] < 0:
            doubtful[view] = True
            continue
        focal_x, focal_y, middle_x, middle_y = intrinsics[view]
        for start in range(0, count, LANES):
            here = min(LANES, count - start)
            at = 2 * view * count + start * strides[0]
            to_x[here:], to_y[here:] = middle_x, middle_y
            for n in range(here):
                to_x[n] = pixels[at + n * strides[0]]
                to_y[n] = pixels[at + n * strides[0] + strides[1]]
            for n in range(LANES):
                to_x[n] = (to_x[n] - middle_x) / focal_x
                to_y[n] = (to_y[n] - middle_y) / focal_y
            _find_points(k[view], steps[view], limits[view], work)
            for n in range(here):
                found = step[0, n] <= limits[view, 1] and step[1, n] < limits[view, 2]
                doubtful[view, start + n] = not found and math.isfinite(to_x[n] + to_y[n])
            _make_rays(x, y, length)
            at = 3 * view * count + start * strides[2]
            for n in range(here):
                for row in range(3):
                    rays[at + n * strides[2] + row * strides[3]] = work[row, n]


@inlined
def _add_misses(
    pose: Floats,
    intrinsics: Floats,
    k: Floats,
    point: Floats,
    pixel: Floats,
    used: Floats,
    total: Floats,
) -> None:
    """Add the squared distances in pixels of points `[3, LANES]` from what a view saw of them.

    pose: `[3, 4]` cam_from_world. pixel: `[2, LANES]`. used: `[LANES]`, 0 or 1. total: sums of
    squares and of numbers, `[2, LANES]`. A point behind the camera adds no square.
    """
    focal_x, focal_y, middle_x, middle_y = intrinsics
    for n in range(LANES):
        x, y, z = point[0, n], point[1, n], point[2, n]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        closeness = 1 / depth
        of_x = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * closeness
        of_y = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * closeness
        square = of_x * of_x + of_y * of_y
        radial = _polynomial(square, k[0], k[1], k[4]) / _polynomial(square, k[5], k[6], k[7])
        lens_x, lens_y = _distort(k, of_x, of_y, square, radial)
        off_x = focal_x * lens_x + middle_x - pixel[0, n]
        off_y = focal_y * lens_y + middle_y - pixel[1, n]
        miss = off_x * off_x + off_y * off_y
        known = (depth > 1e-9) & (used[n] > 0) & (miss < np.inf)
        total[0, n] += miss if known else 0.0
        total[1, n] += used[n]


@kernel("f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], b1[:,::1], f8[::1]")
def reprojection_errors(
    pose: Floats,
    intrinsics: Floats,
    k: Floats,
    points: Floats,
    pixels: Floats,
    used: Bools,
    error: Floats,
) -> None:
    """Set the RMS distances `[N]` in pixels of points `[3, N]` from detections; NaN = none is used.

    pose: `[view, 3, 4]` cam_from_world. intrinsics: `[view, 4]` focal lengths, then the principal
    point. k: `[view, 8]`. pixels: `[view, 2, N]`. used: `[view, N]`.
    """
    point, pixel, own = np.zeros((3, LANES)), np.zeros((2, LANES)), np.zeros(LANES)
    total = np.empty((2, LANES))
    for start in range(0, points.shape[1], LANES):
        here = min(LANES, points.shape[1] - start)
        for row in range(3):
            point[row, :here] = points[row, start : start + here]
        total[:] = 0.0
        for view in range(len(pose)):
            for row in range(2):
                pixel[row, :here] = pixels[view, row, start : start + here]
            for n in range(here):
                own[n] = 1.0 if used[view, start + n] else 0.0
            _add_misses(pose[view], intrinsics[view], k[view], point, pixel, own, total)
        for n in range(here):
            count = total[1, n]
            error[start + n] = math.sqrt(total[0, n] / count) if count > 0 else np.nan
