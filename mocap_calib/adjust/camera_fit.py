"""Fit one camera to points that are known: its pose, and what its images or its lens may hide.

Images may be cropped against the intrinsics, and the focal length may be another. Robust nonlinear
least squares (Cauchy's loss, by the iteration of `solve`) on the pixels as they are, so that the
errors of all explanations compare. Errors of one joint go together, and those of one stretch of
time: the uncertainty of the unknowns is measured on these (sandwich covariance, Cameron, Gelbach
and Miller 2011), not assumed.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from mocap_calib.adjust.covariance import scatter_of
from mocap_calib.adjust.solve import System, levenberg_marquardt
from mocap_calib.config import CORNER_OFFSET, AdjustConfig, CameraFitConfig
from mocap_calib.geometry import lens
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import POSE, Camera, CameraRig, Floats, Ints

Unknown = Literal["x", "y", "log_focal", "log_width", "log_height"]
_MOST_LOG = 3.0  # no focal length is so many times another: beyond it a fit has run away
_FAR = 1e6  # pixels: the residual of what is behind the camera


@dataclass(frozen=True, eq=False, repr=False)
class Seen:
    """Points that are known, and where a camera saw them.

    points: `[N, 3]` in world coordinates. pixels: `[N, 2]`.
    block: `[N]` the stretch of time of each. keypoint: `[N]` its joint.
    """

    points: Floats
    pixels: Floats
    block: Ints
    keypoint: Ints

    def select(self, index: Ints) -> "Seen":
        """Return some of the points (`[n]` indices)."""
        return Seen(self.points[index], self.pixels[index], self.block[index], self.keypoint[index])


def pose_of(rig: CameraRig, view: int) -> Floats:
    """Return the pose `[3, 4]` of a camera, cam_from_world."""
    return np.column_stack([rig.rotation[view], rig.translation[view]])


@dataclass(frozen=True)
class CameraFit:
    """The pose and the unknowns under which a camera sees points where it does.

    pose: `[3, 4]` cam_from_world.
    unknowns: `[unknown]` in the order in which they were asked for.
    covariance: `[unknown, unknown]` of them, errors of one joint and of one stretch going together.
    error: `[N]` distances in pixels.
    """

    pose: Floats
    unknowns: Floats
    covariance: Floats
    error: Floats


def fit_camera(
    camera: Camera,
    seen: Seen,
    start: Floats,
    config: CameraFitConfig,
    *,
    noise: float,
    free: tuple[Unknown, ...] = (),
) -> CameraFit:
    """Return the pose and the free unknowns under which the points are seen where they are.

    noise: standard deviation in pixels; errors of several of it count less and less.
    """
    unknowns = Unknowns(start, np.zeros(len(free)))
    for width in config.loss_scales:
        unknowns = levenberg_marquardt(
            unknowns,
            partial(_system, camera=camera, seen=seen, free=free, scale=width * noise),
            Unknowns.moved,
            tolerance=AdjustConfig.tolerance,
            steps=config.steps,
        )
    residual, jacobian = linearise_camera(camera, seen, unknowns, free)
    scale = config.loss_scales[-1] * noise
    return CameraFit(
        pose=unknowns.pose,
        unknowns=unknowns.others,
        covariance=_covariance(residual, jacobian, seen, scale)[POSE:, POSE:],
        error=np.minimum(np.sqrt((residual**2).sum(0)), _FAR),
    )


@dataclass(frozen=True)
class Unknowns:
    """A pose `[3, 4]` and `[unknown]` others."""

    pose: Floats
    others: Floats

    def moved(self, step: Floats) -> "Unknowns":
        """Return the unknowns after a step `[parameter]`: turn, shift and others."""
        rotation = matrix_from_vector(step[:3]) @ self.pose[:, :3]
        pose = np.column_stack([rotation, self.pose[:, 3] + step[3:POSE]])
        return Unknowns(pose, self.others + step[POSE:])


def _system(
    unknowns: Unknowns, *, camera: Camera, seen: Seen, free: tuple[Unknown, ...], scale: float
) -> System[Unknowns]:
    """Return the equations about some unknowns, under the loss of a scale."""
    residual, jacobian = linearise_camera(camera, seen, unknowns, free)
    cost, weight = cauchy_loss(residual, scale)
    weighted = jacobian * weight
    matrix = np.einsum("pcn,qcn->pq", weighted, jacobian)
    return System(
        unknowns=unknowns,
        cost=cost,
        matrix=matrix,
        gradient=np.einsum("pcn,cn->p", weighted, residual),
        stiffness=np.diag(matrix),
    )


def cauchy_loss(residual: Floats, scale: float) -> tuple[float, Floats]:
    """Return Cauchy's loss of residuals `[2, N]`, and their weights `[N]`."""
    square = (residual**2).sum(0) / scale**2
    return float(np.log1p(square).sum() * scale**2), 1 / (1 + square)


def _covariance(residual: Floats, jacobian: Floats, seen: Seen, scale: float) -> Floats:
    """Return the sandwich covariance `[parameter, parameter]`."""
    weighted = jacobian * cauchy_loss(residual, scale)[1]
    bread = np.linalg.pinv(np.einsum("pcn,qcn->pq", weighted, jacobian))
    scores = np.einsum("pcn,cn->pn", weighted, residual)
    filling = scatter_of(scores, seen.block) + scatter_of(scores, seen.keypoint)
    return np.asarray(bread @ filling @ bread)


def linearise_camera(
    camera: Camera, seen: Seen, now: Unknowns, free: tuple[Unknown, ...]
) -> tuple[Floats, Floats]:
    """Return residuals `[2, N]` in pixels and their slopes `[parameter, 2, N]`.

    By a turn and a shift of the camera and the unknowns.

    What is behind the camera has a large residual and no slope.
    """
    value: dict[Unknown, float] = dict(zip(free, now.others.tolist(), strict=True))
    log_focal = float(np.clip(value.get("log_focal", 0.0), -_MOST_LOG, _MOST_LOG))
    camera = lens.change_intrinsics(camera, log_focal=log_focal, k1=0.0)
    turned = now.pose[:, :3] @ seen.points.T
    in_camera = turned + now.pose[:, 3:]
    front = in_camera[2] > 1e-9
    depth = np.where(front, in_camera[2], 1.0)
    image = np.where(front, in_camera[:2] / depth, 0.0)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        slopes = lens.image_slopes(camera, image)
    taken = slopes.log_focal + camera.matrix[:2, 2:]
    logs = np.array([[value.get("log_width", 0.0)], [value.get("log_height", 0.0)]])
    size = np.exp(np.clip(logs, -_MOST_LOG, _MOST_LOG))
    whole = size * (taken + CORNER_OFFSET)  # from the corner of the images, which are resized
    shift = np.array([[value.get("x", 0.0)], [value.get("y", 0.0)]])
    residual = whole - CORNER_OFFSET + shift - seen.pixels.T
    good = front & np.isfinite(residual).all(0)
    by_image = size[:, None] * slopes.image / depth
    by_shift = np.stack([by_image[:, 0], by_image[:, 1], -(by_image * image).sum(1)])
    by_unknown = {
        "x": np.stack([np.ones_like(depth), np.zeros_like(depth)]),
        "y": np.stack([np.zeros_like(depth), np.ones_like(depth)]),
        "log_focal": size * slopes.log_focal,
        "log_width": whole * [[1.0], [0.0]],
        "log_height": whole * [[0.0], [1.0]],
    }
    # a turn w of the camera's axes moves R X by w x R X
    by_turn = np.cross(turned[:, None], by_shift, axis=0)
    jacobian = np.concatenate([by_turn, by_shift, *(by_unknown[name][None] for name in free)])
    return np.where(good, residual, _FAR), np.where(good, jacobian, 0.0)
