"""How a camera's images may have been changed, and the pose under which a change explains them.

The images as they are come from those that the camera took by a similarity of the plane: turned,
mirrored, resized, cropped. Beside that the focal length may be another, and so may all intrinsics.
The pose and the few unknowns of a change are found by robust nonlinear least squares (Levenberg
1944, Marquardt 1963; weights of Geman and McClure) on the pixels as they are, so that the errors
of all changes can be compared.
"""

from dataclasses import dataclass, field

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Camera, Floats

_STEPS = 40
_SETTLED = 1e-7  # of the cost: smaller changes end the iteration


@dataclass(frozen=True)
class ImageModel:
    """From points in a camera's frame to pixels as they are: x = scale A x_taken + offset.

    camera: the intrinsics of the images that were taken.
    axes: `[2, 2]` A, which turns or mirrors. offset: `[2]` pixels.
    free: which unknowns are estimated, of "log_scale", "x", "y", "log_focal".
    """

    camera: Camera
    axes: Floats = field(default_factory=lambda: np.eye(2))
    offset: Floats = field(default_factory=lambda: np.zeros(2))
    free: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pose:
    """rotation: `[3, 3]` and translation: `[3]` of cam_from_world."""

    rotation: Floats
    translation: Floats


@dataclass(frozen=True)
class FittedModel:
    """A pose, and the unknowns of a model (0 where they are not free).

    error: `[N]` distances in pixels, infinite behind the camera.
    sigma: `[unknown]` standard deviations of the free unknowns, of independent errors.
    """

    pose: Pose
    unknowns: dict[str, float]
    error: Floats
    sigma: dict[str, float]


def fit(
    model: ImageModel, points: Floats, pixels: Floats, start: Pose, *, noise: float
) -> FittedModel:
    """Return the pose and the unknowns under which points `[N, 3]` are seen at pixels `[N, 2]`.

    noise: in pixels; errors beyond it count less and less.
    """
    unknowns = np.zeros(len(model.free))
    pose, damping = start, 1e-3
    widths = (8.0, 4.0, 2.0)
    information = np.eye(6 + len(unknowns))
    for width in widths:
        scale = width * noise
        residual, jacobian = _linearise(model, points, pixels, pose, unknowns)
        cost = _cost(residual, scale)
        for _ in range(_STEPS):
            weight = 1 / (1 + (residual**2).sum(0) / scale**2) ** 2
            weighted = jacobian * weight
            information = np.einsum("pcn,qcn->pq", weighted, jacobian)
            gradient = np.einsum("pcn,cn->p", weighted, residual)
            damped = information + damping * np.diag(np.diag(information) + 1e-12)
            step = -np.linalg.solve(damped, gradient)
            new_pose, new_unknowns = _move(pose, unknowns, step)
            found = _linearise(model, points, pixels, new_pose, new_unknowns)
            new_cost = _cost(found[0], scale)
            if not new_cost < cost:
                damping *= 10
                if damping > 1e6:
                    damping = 1e-3
                    break
                continue
            damping = max(damping / 10, 1e-9)
            pose, unknowns, (residual, jacobian) = new_pose, new_unknowns, found
            gain, cost = cost - new_cost, new_cost
            if gain < _SETTLED * cost:
                break
    error = np.sqrt((residual**2).sum(0))
    covariance = np.linalg.pinv(information) * noise**2
    deviations = np.sqrt(np.diag(covariance)[6:])
    return FittedModel(
        pose=pose,
        unknowns=dict(zip(model.free, map(float, unknowns), strict=True)),
        error=np.where(np.isfinite(error) & (error < 1e5), error, np.inf),
        sigma=dict(zip(model.free, map(float, deviations), strict=True)),
    )


def _linearise(
    model: ImageModel, points: Floats, pixels: Floats, pose: Pose, unknowns: Floats
) -> tuple[Floats, Floats]:
    """Return residuals `[2, N]` in pixels and their Jacobian `[parameter, 2, N]`.

    Parameters are a turn of the camera's axes, a shift along them, and the free unknowns. What is
    behind the camera has a large residual and no slope.
    """
    value = dict.fromkeys(("log_scale", "x", "y", "log_focal"), 0.0)
    value |= dict(zip(model.free, unknowns, strict=True))
    camera = model.camera
    if "log_focal" in model.free:
        camera = lens.change_intrinsics(camera, log_focal=value["log_focal"], k1=0.0)
    turned = pose.rotation @ points.T
    seen = turned + pose.translation[:, None]
    depth = seen[2]
    front = depth > 1e-6
    safe = np.where(front, depth, 1.0)
    image = np.where(front, seen[:2] / safe, 0.0)
    middle = camera.matrix[:2, 2]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        slopes = lens.image_slopes(camera, image)
        taken = slopes.log_focal + middle[:, None]
    axes = np.exp(value["log_scale"]) * model.axes
    shift = model.offset + np.array([value["x"], value["y"]])
    residual = axes @ taken + shift[:, None] - pixels.T
    good = front & np.isfinite(residual).all(0)
    by_image = np.einsum("ij,jkn->ikn", axes, slopes.image) / safe
    # d image / d point = [I, -image] / depth; a turn of the axes moves the point by w x (R X)
    by_point = np.stack(
        [by_image[:, 0], by_image[:, 1], -(by_image * image[None]).sum(1)]
    )  # [3, 2, N]
    x, y, z = turned
    by_turn = np.stack(
        [
            by_point[2] * y - by_point[1] * z,
            by_point[0] * z - by_point[2] * x,
            by_point[1] * x - by_point[0] * y,
        ]
    )
    by_unknown = {
        "log_scale": axes @ taken,
        "x": np.broadcast_to(np.array([[1.0], [0.0]]), residual.shape),
        "y": np.broadcast_to(np.array([[0.0], [1.0]]), residual.shape),
        "log_focal": axes @ slopes.log_focal,
    }
    free = [by_unknown[name] for name in model.free]
    jacobian = np.concatenate([by_turn, by_point, np.array(free).reshape(len(free), *residual.shape)])
    return np.where(good, residual, 1e6), np.where(good, jacobian, 0.0)


def _move(pose: Pose, unknowns: Floats, step: Floats) -> tuple[Pose, Floats]:
    """Return the pose and the unknowns after a step."""
    turned = matrix_from_vector(step[:3]) @ pose.rotation
    return Pose(turned, pose.translation + step[3:6]), unknowns + step[6:]


def _cost(residual: Floats, scale: float) -> float:
    """Return the sum of Geman and McClure's loss of residuals `[2, N]`."""
    square = (residual**2).sum(0) / scale**2
    return float((square / (1 + square)).sum())
