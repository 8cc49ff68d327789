"""How well all detections of a frame fit the epipolar geometry, compiled.

`affinity` and `scoring` define what is computed. Joints lie in rows, so that loops over them are
vectorised.
"""

import math

import numpy as np

from mocap_calib.compute.jit import FLOAT, INT, bools, changed_floats, floats, inlined, kernel
from mocap_calib.types import Bools, Floats

FRAMES = 20  # side by side; loops of a fixed length below 16 do not become vector instructions


@inlined
def _turn(matrix: Floats, rays: Floats, turned: Floats) -> None:
    """Set `[4, N]` the products of a matrix with rays `[3 or more, N]`, and sums of squares."""
    x, y, z = rays[0], rays[1], rays[2]
    for row in range(3):
        first, second, third = matrix[row, 0], matrix[row, 1], matrix[row, 2]
        for k in range(rays.shape[1]):
            turned[row, k] = first * x[k] + second * y[k] + third * z[k]
    for k in range(rays.shape[1]):
        turned[3, k] = turned[0, k] ** 2 + turned[1, k] ** 2 + turned[2, k] ** 2


@inlined
def _weigh(weight_a: Floats, weight_b: Floats, weight: Floats) -> int:
    """Set the weights `[keypoint]` of the joints of two detections; return how many both show."""
    common = 0
    for k in range(len(weight)):
        weight[k] = weight_a[k] * weight_b[k]
        common += weight[k] > 0
    return common


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
    """Set `[keypoint, 4 * FRAMES]` what `_turn` sets, of rays as `_lay_out` has them."""
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
def _add_fits(
    from_a: Floats, from_b: Floats, a: Floats, b: Floats, inverse: Floats, sums: Floats
) -> None:
    """Set `[3 * FRAMES]` sums over the joints of two detections: of weights, fits, and joints.

    from_a, from_b: `[keypoint]` of `_turn_frames`. a, b: of `_lay_out`. inverse: `[FRAMES]` of
    the squared width.
    """
    sums[:] = 0.0
    for k in range(len(a)):
        for f in range(FRAMES):
            value = from_a[k, f] * b[k, f] + from_a[k, FRAMES + f] * b[k, FRAMES + f]
            value = value + from_a[k, 2 * FRAMES + f] * b[k, 2 * FRAMES + f]
            squared = value * value
            slope = from_a[k, 3 * FRAMES + f] + from_b[k, 3 * FRAMES + f] - 2 * squared
            denominator = squared * inverse[f] + slope
            denominator = denominator if denominator > 1e-18 else 1e-18
            weight = a[k, 3 * FRAMES + f] * b[k, 3 * FRAMES + f]
            sums[f] += weight
            sums[FRAMES + f] += weight * slope / denominator
            sums[2 * FRAMES + f] += 1.0 if weight > 0 else 0.0


@inlined
def _set_frame(fits: Floats, f: int, affinity: Floats, comparable: Floats) -> None:
    """Set `[view, instance, view, instance]` of one of the frames side by side.

    fits: `[view, instance, view, instance, FRAMES]` of views a < b, -1 = not comparable.
    """
    views, instances = affinity.shape[:2]
    for a in range(views):
        for i in range(instances):
            for b in range(a + 1, views):
                for j in range(instances):
                    fit = fits[a, i, b, j, f]
                    if fit >= 0:
                        affinity[a, i, b, j] = affinity[b, j, a, i] = fit
                        comparable[a, i, b, j] = comparable[b, j, a, i] = 1.0


@kernel(
    floats(5),
    floats(4),
    floats(3),
    floats(4),
    FLOAT,
    INT,
    changed_floats(5),
    changed_floats(5),
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
    seen, there = np.empty((views, *shape)), np.empty((views, instances), dtype=np.bool_)
    closeness = np.ones((views, instances, FRAMES))
    from_a, from_b = np.empty(shape), np.empty(shape)
    fits = np.empty((views, instances, views, instances, FRAMES))
    sums, inverse = np.empty(3 * FRAMES), np.empty(FRAMES)
    for first in range(0, frames, FRAMES):
        for a in range(views):
            for i in range(instances):
                there[a, i] = _lay_out(rays[a, :, i], weight[a, :, i], first, seen[a, i])
                for f in range(min(FRAMES, frames - first)):
                    closeness[a, i, f] = 1 / distance[a, first + f, i] ** 2
        for a in range(views):
            for b in range(a + 1, views):
                for i in range(instances):
                    _turn_frames(matrices[a, b], seen[a, i], from_a[i])
                    _turn_frames(matrices[b, a], seen[b, i], from_b[i])
                for i in range(instances):
                    for j in range(instances):
                        if not (there[a, i] and there[b, j]):
                            fits[a, i, b, j] = -1.0
                            continue
                        for f in range(FRAMES):
                            both = closeness[a, i, f] + closeness[b, j, f]
                            inverse[f] = 2 / both / inlier**2
                        _add_fits(from_a[i], from_b[j], seen[a, i], seen[b, j], inverse, sums)
                        for f in range(FRAMES):
                            fit = sums[FRAMES + f] / max(sums[f], 1e-9)
                            enough = sums[2 * FRAMES + f] >= least_common
                            fits[a, i, b, j, f] = fit if enough else -1.0
        for f in range(min(FRAMES, frames - first)):
            _set_frame(fits, f, affinity[first + f], comparable[first + f])


@inlined
def _sampson(
    from_a: Floats, from_b: Floats, rays_b: Floats, body_sizes_per_radian: float, error: Floats
) -> None:
    """Set Sampson's errors `[keypoint]` of the joints of two detections, in body sizes."""
    for k in range(len(error)):
        value = (
            from_a[0, k] * rays_b[0, k] + from_a[1, k] * rays_b[1, k] + from_a[2, k] * rays_b[2, k]
        )
        slope = from_a[3, k] + from_b[3, k] - 2 * value**2
        error[k] = abs(value) / math.sqrt(max(slope, 1e-18)) * body_sizes_per_radian


@inlined
def _mean_fit(error: Floats, weight: Floats, inlier: float, terms: Floats) -> float:
    """Return the mean fit of joints of these errors, by weights `[keypoint]`."""
    for k in range(len(weight)):
        terms[k] = weight[k] / (1 + (error[k] / inlier) ** 2)
    total = fit = 0.0
    for k in range(len(weight)):
        total += weight[k]
        fit += terms[k]
    return fit / max(total, 1e-9)


@kernel(
    floats(3),
    floats(4),
    floats(4),
    floats(3),
    floats(3),
    floats(3),
    FLOAT,
    INT,
    changed_floats(5),
    changed_floats(4),
)
def fit_hypotheses(
    matrices: Floats,
    rays_a: Floats,
    rays_b: Floats,
    weight_a: Floats,
    weight_b: Floats,
    body_sizes_per_radian: Floats,
    inlier: float,
    least_common: int,
    error: Floats,
    fit: Floats,
) -> None:
    """Set error `[M, frame, I, J, keypoint]` and fit `[M, frame, I, J]`, which are 0.

    The errors of joints without weight have no meaning. matrices: `[M, 3, 3]` essential.
    rays_a, rays_b: `[frame, instance, 3, keypoint]`, 0 = missing. weight_a, weight_b: `[frame,
    instance, keypoint]`. body_sizes_per_radian: `[frame, I, J]`.
    """
    frames, count_a, _, joints = rays_a.shape
    count_b = rays_b.shape[1]
    from_a, from_b = np.empty((count_a, 4, joints)), np.empty((count_b, 4, joints))
    weight, terms = np.empty((count_a, count_b, joints)), np.empty(joints)
    enough = np.empty((count_a, count_b), dtype=np.bool_)
    for frame in range(frames):
        for i in range(count_a):
            for j in range(count_b):
                common = _weigh(weight_a[frame, i], weight_b[frame, j], weight[i, j])
                enough[i, j] = common >= least_common
        for m in range(len(matrices)):
            for i in range(count_a):
                _turn(matrices[m], rays_a[frame, i], from_a[i])
            for j in range(count_b):
                _turn(matrices[m].T, rays_b[frame, j], from_b[j])
            for i in range(count_a):
                for j in range(count_b):
                    if enough[i, j]:
                        errors = error[m, frame, i, j]
                        scale = body_sizes_per_radian[frame, i, j]
                        _sampson(from_a[i], from_b[j], rays_b[frame, j], scale, errors)
                        fit[m, frame, i, j] = _mean_fit(errors, weight[i, j], inlier, terms)


@inlined
def _is_in_front(rotation: Floats, translation: Floats, ray_a: Floats, ray_b: Floats) -> bool:
    """Return whether two rays `[3]` meet in front of both cameras: signs of `epipolar.depths`."""
    cosine = along_a = along_b = 0.0
    for row in range(3):
        turned = (
            rotation[row, 0] * ray_a[0] + rotation[row, 1] * ray_a[1] + rotation[row, 2] * ray_a[2]
        )
        cosine += turned * ray_b[row]
        along_a += turned * translation[row]
        along_b += ray_b[row] * translation[row]
    return cosine * along_b > along_a and along_b > cosine * along_a


@kernel(
    floats(3),
    floats(2),
    floats(4),
    floats(4),
    floats(3),
    floats(3),
    bools(4),
    changed_floats(1),
)
def share_in_front(
    rotation: Floats,
    translation: Floats,
    rays_a: Floats,
    rays_b: Floats,
    weight_a: Floats,
    weight_b: Floats,
    matched: Bools,
    share: Floats,
) -> None:
    """Set the share `[M]` of the joints of the matches that are in front of both cameras.

    rotation: `[M, 3, 3]` and translation: `[M, 3]` of b_from_a. rays_a, rays_b: `[frame, instance,
    keypoint, 3]`. weight_a, weight_b: `[frame, instance, keypoint]`. matched: `[M, frame, I, J]`.
    """
    hypotheses, frames, count_a, count_b = matched.shape
    for m in range(hypotheses):
        joints = in_front = 0
        for frame in range(frames):
            for i in range(count_a):
                for j in range(count_b):
                    if not matched[m, frame, i, j]:
                        continue
                    for k in range(weight_a.shape[2]):
                        if weight_a[frame, i, k] * weight_b[frame, j, k] > 0:
                            joints += 1
                            in_front += _is_in_front(
                                rotation[m],
                                translation[m],
                                rays_a[frame, i, k],
                                rays_b[frame, j, k],
                            )
        share[m] = in_front / max(joints, 1)
