"""How well all detections of a frame fit the epipolar geometry, compiled.

`affinity` defines what is computed. Joints lie in rows, so that loops over them are vectorised.
"""

import numpy as np

from mocap_calib.compute.jit import FLOAT, INT, changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats


@inlined
def _turn(matrix: Floats, rays: Floats, turned: Floats) -> None:
    """Set `[4, keypoint]` the products of a matrix with rays, and the sum of two squares.

    The squares are those of all three components.
    """
    x, y, z = rays[0], rays[1], rays[2]
    for row in range(3):
        first, second, third = matrix[row, 0], matrix[row, 1], matrix[row, 2]
        for k in range(rays.shape[1]):
            turned[row, k] = first * x[k] + second * y[k] + third * z[k]
    for k in range(rays.shape[1]):
        turned[3, k] = turned[0, k] ** 2 + turned[1, k] ** 2 + turned[2, k] ** 2


@inlined
def _fit(
    from_a: Floats,
    from_b: Floats,
    rays_b: Floats,
    inverse_width_squared: float,
    weight: Floats,
    terms: Floats,
) -> float:
    """Return the mean fit of the joints of two detections, by weights `[keypoint]`."""
    count = len(weight)
    for k in range(count):
        value = (
            from_a[0, k] * rays_b[0, k] + from_a[1, k] * rays_b[1, k] + from_a[2, k] * rays_b[2, k]
        )
        squared = value * value
        slope = from_a[3, k] + from_b[3, k] - 2 * squared
        denominator = max(squared * inverse_width_squared + slope, 1e-18)
        terms[k] = weight[k] * slope / denominator
    total = fit = 0.0
    for k in range(count):
        total += weight[k]
        fit += terms[k]
    return fit / max(total, 1e-9)


@inlined
def _weigh(weight_a: Floats, weight_b: Floats, weight: Floats) -> int:
    """Set the weights `[keypoint]` of the joints of two detections; return how many both show."""
    common = 0
    for k in range(len(weight)):
        weight[k] = weight_a[k] * weight_b[k]
        common += weight[k] > 0
    return common


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
    closeness: Floats,
    matrices: Floats,
    inlier: float,
    least_common: int,
    affinity: Floats,
    comparable: Floats,
) -> None:
    """Set affinity and comparable `[frame, view, instance, view, instance]`, which are 0.

    rays: `[frame, view, instance, 3, keypoint]`, 0 = missing. weight: `[frame, view, instance,
    keypoint]`. closeness: `[frame, view, instance]`, one over the squared distance. matrices:
    `[view, view, 3, 3]` the essential matrix of each pair a < b, and its transpose at (b, a).
    """
    frames, views, instances, _, joints = rays.shape
    from_a, from_b = np.empty((instances, 4, joints)), np.empty((instances, 4, joints))
    of_match, terms = np.empty(joints), np.empty(joints)
    seen = np.empty((views, instances), dtype=np.bool_)
    for frame in range(frames):
        for view in range(views):
            for i in range(instances):
                seen[view, i] = weight[frame, view, i].max() > 0
        for a in range(views):
            for b in range(a + 1, views):
                for i in range(instances):
                    if seen[a, i]:
                        _turn(matrices[a, b], rays[frame, a, i], from_a[i])
                    if seen[b, i]:
                        _turn(matrices[b, a], rays[frame, b, i], from_b[i])
                for i in range(instances):
                    for j in range(instances):
                        if not (seen[a, i] and seen[b, j]):
                            continue
                        common = _weigh(weight[frame, a, i], weight[frame, b, j], of_match)
                        if common < least_common:
                            continue
                        both = closeness[frame, a, i] + closeness[frame, b, j]
                        fit = _fit(
                            from_a[i],
                            from_b[j],
                            rays[frame, b, j],
                            2 / both / inlier**2,
                            of_match,
                            terms,
                        )
                        affinity[frame, a, i, b, j] = affinity[frame, b, j, a, i] = fit
                        comparable[frame, a, i, b, j] = comparable[frame, b, j, a, i] = 1.0
