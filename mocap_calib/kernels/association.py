"""What belongs together: detections of two views, those of a frame, and detections and bodies.

Joints lie in rows, so that loops over them are vectorised. Groups are agglomerated by average
linkage.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats, Ints


@inlined
def _turn(matrix: Floats, rays: Floats, turned: Floats) -> None:
    """Set `[4, keypoint]` the products of a matrix with rays `[3, keypoint]`, and their squares."""
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
def _mean_fit(
    from_a: Floats, from_b: Floats, rays_b: Floats, weight: Floats, narrow: float, terms: Floats
) -> float:
    """Return the mean of 1 / (1 + (Sampson's error / width)^2) by weights `[keypoint]`.

    narrow: 1 / width^2, of the angle. terms: `[keypoint]` to write to.
    """
    for k in range(len(weight)):
        value = (
            from_a[0, k] * rays_b[0, k] + from_a[1, k] * rays_b[1, k] + from_a[2, k] * rays_b[2, k]
        )
        square = value * value
        slope = max(from_a[3, k] + from_b[3, k] - 2 * square, 1e-18)
        terms[k] = weight[k] * slope / (slope + square * narrow)
    total = fit = 0.0
    for k in range(len(weight)):
        total += weight[k]
        fit += terms[k]
    return fit / max(total, 1e-9)


@kernel(
    "i8[:,::1], f8[:,:,::1], f8[:,:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8, i8, f8[:,:,:,::1]"
)
def fit_hypotheses(
    views: Ints,
    matrices: Floats,
    rays: Floats,
    weight: Floats,
    distance: Floats,
    inlier: float,
    least_common: int,
    fit: Floats,
) -> None:
    """Set the fit `[M, frame, instance, instance]` of detections with enough joints in common.

    See `pairs.affinity.epipolar_fit`.

    views: `[M, 2]` the two views a and b that each essential matrix `[M, 3, 3]` is of. rays:
    `[view, frame, instance, 3, keypoint]`, and weight: `[view, frame, instance, keypoint]`, 0 =
    missing. distance: `[view, frame, instance]`.
    """
    _, frames, instances, _, joints = rays.shape
    from_a, from_b = np.empty((instances, 4, joints)), np.empty((instances, 4, joints))
    common, terms = np.empty(joints), np.empty(joints)
    for frame in range(frames):
        for m in range(len(matrices)):
            a, b = views[m, 0], views[m, 1]
            for i in range(instances):
                _turn(matrices[m], rays[a, frame, i], from_a[i])
                _turn(matrices[m].T, rays[b, frame, i], from_b[i])
            for i in range(instances):
                for j in range(instances):
                    if _weigh(weight[a, frame, i], weight[b, frame, j], common) < least_common:
                        continue
                    closeness = 1 / distance[a, frame, i] ** 2 + 1 / distance[b, frame, j] ** 2
                    narrow = 2 / (closeness * inlier * inlier)
                    ray = rays[b, frame, j]
                    fit[m, frame, i, j] = _mean_fit(
                        from_a[i], from_b[j], ray, common, narrow, terms
                    )


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
    "f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1], "
    "b1[:,:,:,::1], f8[::1]"
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


# --- groups of the detections of a frame


@inlined
def _start(
    affinity: Floats, comparable: Floats, view: Ints, total: Floats, pairs: Floats, linkage: Floats
) -> None:
    """Set the clusters of one detection each: those of one view never join."""
    for i in range(len(view)):
        for j in range(len(view)):
            total[i, j], pairs[i, j] = affinity[i, j] * comparable[i, j], comparable[i, j]
            if view[i] == view[j]:
                total[i, j] = -np.inf
            linkage[i, j] = total[i, j] / max(pairs[i, j], 1.0)


@inlined
def _find_closest(linkage: Floats) -> tuple[float, int, int]:
    """Return the largest linkage of two clusters, and the first two that have it."""
    largest, first, second = 0.0, 0, 0
    for i in range(len(linkage)):
        for j in range(i + 1, len(linkage)):
            if linkage[i, j] > largest:
                largest, first, second = linkage[i, j], i, j
    return largest, first, second


@inlined
def _merge(total: Floats, pairs: Floats, linkage: Floats, kept: int, merged: int) -> None:
    """Put the cluster `merged` into `kept`; nothing joins what is no longer used."""
    for i in range(len(total)):
        total[kept, i] += total[merged, i]
        pairs[kept, i] += pairs[merged, i]
        total[i, kept], pairs[i, kept] = total[kept, i], pairs[kept, i]
        linkage[kept, i] = linkage[i, kept] = total[kept, i] / max(pairs[kept, i], 1.0)
    for i in range(len(total)):
        total[merged, i] = total[i, merged] = linkage[merged, i] = linkage[i, merged] = -np.inf


@inlined
def _number(cluster: Ints, number: Ints) -> None:
    """Give clusters numbers from 0 in place, by their first detection.

    number: `[N]`, to be written over.
    """
    count = 0
    for i in range(len(cluster)):
        if cluster[i] == i:
            number[i] = count
            count += 1
    for i in range(len(cluster)):
        if cluster[i] >= 0:
            cluster[i] = number[cluster[i]]


@kernel("f8[:,:,::1], f8[:,:,::1], i8[::1], f8, i8[:,::1]")
def cluster_frames(
    affinity: Floats, comparable: Floats, view: Ints, least: float, cluster: Ints
) -> None:
    """Set the group `[frame, N]` of each detection, -1 for one that stays alone.

    affinity, comparable: `[frame, N, N]`, 0 or more, symmetric. view: `[N]` of each detection.
    least: the mean affinity down to which clusters are merged, above 0.
    """
    frames, count = affinity.shape[0], len(view)
    total, pairs = np.empty((count, count)), np.empty((count, count))
    linkage, number = np.empty((count, count)), np.empty(count, dtype=np.int64)
    for frame in range(frames):
        _start(affinity[frame], comparable[frame], view, total, pairs, linkage)
        own = cluster[frame]
        for i in range(count):
            own[i] = -1
        while True:
            largest, kept, merged = _find_closest(linkage)
            if not largest >= least:
                break
            _merge(total, pairs, linkage, kept, merged)
            for i in range(count):
                if own[i] == merged:
                    own[i] = kept
            own[kept] = own[merged] = kept
        _number(own, number)


# --- detections of a camera and the bodies of a frame


@inlined
def _cost(projection: Floats, joints: Floats, count: int, precision: float) -> float:
    """Return the sum of the costs of joints: rows x y z of a body, and u v of a detection."""
    total = 0.0
    for j in range(count):
        x, y, z = joints[0, j], joints[1, j], joints[2, j]
        row = projection[2]
        depth = row[0] * x + row[1] * y + row[2] * z + row[3]
        if depth <= 1e-12:
            total += 1.0
            continue
        row = projection[0]
        across = (row[0] * x + row[1] * y + row[2] * z + row[3]) / depth - joints[3, j]
        row = projection[1]
        down = (row[0] * x + row[1] * y + row[2] * z + row[3]) / depth - joints[4, j]
        square = (across * across + down * down) * precision
        total += square / (1 + square)
    return total


@kernel("f8[:,:,::1], i8[::1], f8[:,:,::1], f8[:,:,:,::1], f8[::1], i8, f8[:,::1], i8[:,::1]")
def compare_bodies(
    projection: Floats,
    frame: Ints,
    image: Floats,
    bodies: Floats,
    tolerance: Floats,
    least_joints: int,
    cost: Floats,
    body: Ints,
) -> None:
    """Set the least cost of each detection under each projection, and its body.

    Both `[projection, detection]`. projection: `[projection, 3, 4]`; image: `[detection, 2, joint]`
    and bodies: `[frame, body, 3, joint]`, NaN = missing.
    """
    joints = np.empty((5, image.shape[2]))
    cost[:] = np.inf
    body[:] = 0
    for n in range(len(frame)):
        precision = 1 / tolerance[n] ** 2
        for one in range(bodies.shape[1]):
            there, count = bodies[frame[n], one], 0
            for j in range(image.shape[2]):
                if np.isnan(there[0, j]) or np.isnan(image[n, 0, j]):
                    continue
                for k in range(3):
                    joints[k, count] = there[k, j]
                joints[3, count], joints[4, count] = image[n, 0, j], image[n, 1, j]
                count += 1
            if count < least_joints:
                continue
            for p in range(len(projection)):
                mean = _cost(projection[p], joints, count, precision) / count
                if mean < cost[p, n]:
                    cost[p, n] = mean
                    body[p, n] = one
        for p in range(len(projection)):
            if cost[p, n] == np.inf:
                cost[p, n] = np.nan
