"""The energy of poses in dense numpy: the oracle of the kernels that fit poses.

body, seen and strengths are the records `Body`, `Detections` and `Strengths` of `poses.fit`.
"""

import numpy as np

from mocap_calib.config import PosesConfig

ENTRIES = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # xx xy xz yy yz zz
ROUNDS = 5  # of Weiszfeld's iteration


def accelerations(points: np.ndarray, body) -> np.ndarray:
    """Return the accelerations `[keypoint, frame - 2, 3]` by the first of their frames."""
    ends = points.shape[1] - 2
    return sum(body.steps[k, :ends, None] * points[:, k : k + ends] for k in range(3))


def rows_of_rays(points: np.ndarray, seen, loss: float):
    """Yield the place, the Jacobian `[3, 3]`, the residual `[3]` and the weight of each ray."""
    for view, keypoint, frame in np.argwhere(seen.precision > 0):
        ray = seen.rays[:, view, keypoint, frame]
        offset = points[keypoint, frame] - seen.centres[view]
        depth = max(ray @ offset, 1e-3 * np.abs(offset).sum())
        off = (offset - (ray @ offset) * ray) / depth
        precision = seen.precision[view, keypoint, frame]
        jacobian = (np.eye(3) - np.outer(ray, ray) - np.outer(off, ray)) / depth
        yield (keypoint, frame), jacobian, off, precision / (1 + off @ off * precision / loss**2)


def rows_of_bones(points: np.ndarray, body, strengths, config: PosesConfig):
    """Yield both places, the direction `[3]`, the error and the weight of each bone and frame."""
    edges = body.edges if np.isfinite(strengths.bones) else []
    for edge, (a, b) in enumerate(edges):
        for frame in range(points.shape[1] if np.isfinite(body.lengths[edge]) else 0):
            along = points[a, frame] - points[b, frame]
            length = np.linalg.norm(along)
            sigma = np.hypot(strengths.bones * body.size, body.varies[edge])
            error = length - body.lengths[edge]
            weight = 1 / sigma**2 / (1 + (error / sigma / config.prior_loss) ** 2)
            yield (a, frame), (b, frame), along / length, error, weight


def shared_accelerations(acceleration: np.ndarray, config: PosesConfig) -> np.ndarray:
    """Return what joints share `[frame, 3]` of their accelerations `[keypoint, frame, 3]`.

    A part of their geometric median, some steps from the mean towards it (Weiszfeld 1937).
    """
    joints, middle = len(acceleration), acceleration.mean(0)
    for _ in range(ROUNDS):
        weight = 1 / (np.linalg.norm(acceleration - middle, axis=-1) + 1e-100)
        middle = (acceleration * weight[..., None]).sum(0) / weight.sum(0)[:, None]
    known = joints * config.shared_acceleration
    return middle * known / (1 + known)


def add_motion(points, body, strengths, config, hessian, gradient) -> None:
    """Add the accelerations beyond those that joints share."""
    if not np.isfinite(strengths.acceleration) or points.shape[1] < 3:
        return
    own = accelerations(points, body)
    own = own - shared_accelerations(own, config)
    for joint, frame in np.argwhere(np.broadcast_to(body.steps[0, :-2] != 0, own.shape[:2])):
        sigma = strengths.acceleration * body.size
        square = own[joint, frame] @ own[joint, frame] / sigma**2
        weight = 1 / sigma**2 / (1 + square / config.prior_loss**2)
        steps = body.steps[:, frame]
        for i in range(3):
            gradient[joint, frame + i] += weight * steps[i] * own[joint, frame]
            for k in range(3):
                block = hessian[joint, frame + i, :, joint, frame + k]
                block += weight * steps[i] * steps[k] * np.eye(3)


def normal_equations(points, seen, body, strengths, config) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Newton system `[K, frame, 3, K, frame, 3]` and the gradient."""
    gradient = np.zeros(points.shape)
    hessian = np.zeros(points.shape * 2)
    for place, jacobian, off, weight in rows_of_rays(points, seen, strengths.loss):
        hessian[(*place, slice(None), *place)] += weight * jacobian.T @ jacobian
        gradient[place] += weight * jacobian.T @ off
    for a, b, direction, error, weight in rows_of_bones(points, body, strengths, config):
        for place, sign in ((a, 1), (b, -1)):
            gradient[place] += sign * weight * error * direction
            for other, other_sign in ((a, 1), (b, -1)):
                block = weight * sign * other_sign * np.outer(direction, direction)
                hessian[(*place, slice(None), *other)] += block
    add_motion(points, body, strengths, config, hessian, gradient)
    ridge = np.full(points.shape, config.ridge / body.size**2)
    size = points.size
    return hessian.reshape(size, size) + np.diag(ridge.ravel()), gradient


def covariances(points, seen, body, strengths, config) -> np.ndarray:
    """Return the covariances `[keypoint, frame, 6]`; bones count to first order."""
    known = np.zeros((*points.shape, 3))
    ridge = config.ridge / body.size**2 * np.eye(3)
    for place, jacobian, _, weight in rows_of_rays(points, seen, strengths.loss):
        known[place] += weight * jacobian.T @ jacobian
    alone = np.linalg.inv(known + ridge)
    for a, b, direction, _, weight in rows_of_bones(points, body, strengths, config):
        for place, other in ((a, b), (b, a)):
            variance = 1 / weight + direction @ alone[other] @ direction
            known[place] += np.outer(direction, direction) / variance
    hessian = np.zeros(points.shape * 2)
    add_motion(points, body, strengths, config, hessian, np.zeros(points.shape))
    found = np.empty((*points.shape[:2], 6))
    for joint, own in enumerate(known):
        system = hessian[joint, :, :, joint]
        for frame, block in enumerate(own):
            system[frame, :, frame] += block + ridge
        frames = points.shape[1]
        inverse = np.linalg.inv(system.reshape(3 * frames, -1)).reshape(system.shape)
        found[joint] = [inverse[frame, :, frame][ENTRIES] for frame in range(frames)]
    return found
