"""How well the detections of all views of a frame fit the epipolar geometry of a rig, compiled.

`affinity` defines what is computed. Frames lie side by side in rows, so that loops over them are
vectorised.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats

FRAMES = 20  # side by side; loops of a fixed length below 16 do not become vector instructions


@inlined
def _lay_out(rays: Floats, weight: Floats, first: int, found: Floats) -> bool:
    """Set `[keypoint, 4 * FRAMES]` the rays and weights of a detection in frames in a row.

    rays: `[frame, keypoint, 3]`, NaN = missing; weight: `[frame, keypoint]`. What is missing, or
    after the last frame, is 0. Returns whether any is there.
    """
    there = False
    found[:] = 0.0
    for f in range(min(FRAMES, len(rays) - first)):
        for k in range(len(found)):
            x, y, z = rays[first + f, k, 0], rays[first + f, k, 1], rays[first + f, k, 2]
            if weight[first + f, k] > 0 and not math.isnan(x):
                found[k, f], found[k, FRAMES + f], found[k, 2 * FRAMES + f] = x, y, z
                found[k, 3 * FRAMES + f] = weight[first + f, k]
                there = True
    return there


@inlined
def _turn_frames(matrix: Floats, rays: Floats, turned: Floats) -> None:
    """Set `[keypoint, 4 * FRAMES]` the products of a matrix with rays, and their squares.

    rays: of `_lay_out`.
    """
    xx, xy, xz = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    yx, yy, yz = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    zx, zy, zz = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    for k in range(len(rays)):
        for f in range(FRAMES):
            x, y, z = rays[k, f], rays[k, FRAMES + f], rays[k, 2 * FRAMES + f]
            by_x = xx * x + xy * y + xz * z
            by_y = yx * x + yy * y + yz * z
            by_z = zx * x + zy * y + zz * z
            turned[k, f], turned[k, FRAMES + f], turned[k, 2 * FRAMES + f] = by_x, by_y, by_z
            turned[k, 3 * FRAMES + f] = by_x * by_x + by_y * by_y + by_z * by_z


@inlined
def _sum_fits(
    from_a: Floats, from_b: Floats, a: Floats, b: Floats, narrow: Floats, sums: Floats
) -> None:
    """Set `[3 * FRAMES]` sums over the joints of two detections: of weights, fits, and joints.

    from_a, from_b: of `_turn_frames`. a, b: of `_lay_out`. narrow: `[FRAMES]` 1 / width^2.
    """
    sums[:] = 0.0
    for k in range(len(a)):
        for f in range(FRAMES):
            value = from_a[k, f] * b[k, f] + from_a[k, FRAMES + f] * b[k, FRAMES + f]
            value = value + from_a[k, 2 * FRAMES + f] * b[k, 2 * FRAMES + f]
            squared = value * value
            slope = from_a[k, 3 * FRAMES + f] + from_b[k, 3 * FRAMES + f] - 2 * squared
            denominator = squared * narrow[f] + slope
            denominator = 1e-18 if denominator < 1e-18 else denominator
            weight = a[k, 3 * FRAMES + f] * b[k, 3 * FRAMES + f]
            sums[f] += weight
            sums[FRAMES + f] += weight * slope / denominator
            sums[2 * FRAMES + f] += 1.0 if weight > 0 else 0.0


@inlined
def _compare_views(
    from_a: Floats,
    from_b: Floats,
    of_a: Floats,
    of_b: Floats,
    closeness_a: Floats,
    closeness_b: Floats,
    there_a: Bools,
    there_b: Bools,
    inlier: float,
    least_common: int,
    fits: Floats,
) -> None:
    """Set the fits `[instance, instance, FRAMES]` of two views, -1 = not comparable.

    from_a, from_b: `[instance]` of `_turn_frames`. of_a, of_b: of `_lay_out`. closeness_a,
    closeness_b: `[instance, FRAMES]` one over the squared distance. there_a, there_b: `[instance]`.
    """
    sums, narrow = np.empty(3 * FRAMES), np.empty(FRAMES)
    fits[:] = -1.0
    for i in range(len(fits)):
        for j in range(len(fits)):
            if not (there_a[i] and there_b[j]):
                continue
            for f in range(FRAMES):
                narrow[f] = 2 / (closeness_a[i, f] + closeness_b[j, f]) / inlier**2
            _sum_fits(from_a[i], from_b[j], of_a[i], of_b[j], narrow, sums)
            for f in range(FRAMES):
                if sums[2 * FRAMES + f] >= least_common:
                    fits[i, j, f] = sums[FRAMES + f] / max(sums[f], 1e-9)


@inlined
def _set_frame(fits: Floats, f: int, affinity: Floats, comparable: Floats) -> None:
    """Set `[view, instance, view, instance]` of one of the frames side by side.

    fits: `[view, view, instance, instance, FRAMES]` of views a < b.
    """
    views, instances = affinity.shape[:2]
    for a in range(views):
        for b in range(a + 1, views):
            for i in range(instances):
                for j in range(instances):
                    fit = fits[a, b, i, j, f]
                    if fit > -1:
                        affinity[a, i, b, j] = affinity[b, j, a, i] = fit
                        comparable[a, i, b, j] = comparable[b, j, a, i] = 1.0


@kernel(
    "f8[:,:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,::1], f8, i8, f8[:,:,:,:,::1], "
    "f8[:,:,:,:,::1]"
)
def fit_all_views(
    rays: Floats,
    weight: Floats,
    distance: Floats,
    matrices: Floats,
    inlier: float,
    least_common: int,
    affinity: Floats,
    comparable: Floats,
) -> None:
    """Set affinity and comparable `[frame, view, instance, view, instance]`, which are 0.

    rays: `[view, frame, instance, keypoint, 3]`, NaN = missing. weight: `[view, frame, instance,
    keypoint]`. distance: `[view, frame, instance]`. matrices: `[view, view, 3, 3]` the essential
    matrix of each pair a < b, and its transpose at (b, a). Frames are looked at side by side.
    """
    views, frames, instances, joints, _ = rays.shape
    shape = (instances, joints, 4 * FRAMES)
    seen, closeness = np.empty((views, *shape)), np.ones((views, instances, FRAMES))
    from_a, from_b = np.empty(shape), np.empty(shape)
    there = np.empty((views, instances), dtype=np.bool_)
    fits = np.empty((views, views, instances, instances, FRAMES))
    for first in range(0, frames, FRAMES):
        for view in range(views):
            for i in range(instances):
                own = rays[view, :, i], weight[view, :, i]
                there[view, i] = _lay_out(own[0], own[1], first, seen[view, i])
                for f in range(min(FRAMES, frames - first)):
                    closeness[view, i, f] = 1 / distance[view, first + f, i] ** 2
        for a in range(views):
            for b in range(a + 1, views):
                for i in range(instances):
                    _turn_frames(matrices[a, b], seen[a, i], from_a[i])
                    _turn_frames(matrices[b, a], seen[b, i], from_b[i])
                _compare_views(
                    from_a,
                    from_b,
                    seen[a],
                    seen[b],
                    closeness[a],
                    closeness[b],
                    there[a],
                    there[b],
                    inlier,
                    least_common,
                    fits[a, b],
                )
        for f in range(min(FRAMES, frames - first)):
            _set_frame(fits, f, affinity[first + f], comparable[first + f])
