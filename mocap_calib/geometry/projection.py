"""Camera models; cv2 is used here and in epipolar.py alone.

Pixels have their centres at integers. Rays are unit vectors in the camera's axes: x right, y down, z forward.
"""

import cv2
import numpy as np

from mocap_calib.types import Camera, Floats

_UNDISTORT_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
_MISS = 0.5  # pixels between a pixel and its ray's: beyond, the lens model has no ray for it


def rays_from_pixels(camera: Camera, pixels: Floats) -> Floats:
    """`[..., 2]` pixels -> `[..., 3]` unit rays with the distortion taken out; NaN stays NaN, and what no ray projects to is NaN."""
    flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    known = np.isfinite(flat).all(1)
    rays = np.full((len(flat), 3), np.nan)
    if known.any():
        rays[known] = _fisheye_rays(camera, flat[known]) if camera.fisheye else _pinhole_rays(camera, flat[known])
    return rays.reshape(*pixels.shape[:-1], 3)


def pixels_from_points(camera: Camera, points: Floats) -> Floats:
    """`[..., 3]` points in the camera's axes -> `[..., 2]` pixels; NaN stays NaN, and behind the camera is NaN."""
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    ahead = np.isfinite(flat).all(1) & (np.nan_to_num(flat[:, 2], nan=-1.0) > 1e-9)
    pixels = np.full((len(flat), 2), np.nan)
    if ahead.any():
        project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
        image, _ = project(flat[ahead][:, None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
        pixels[ahead] = image.reshape(-1, 2)
    return pixels.reshape(*points.shape[:-1], 2)


def _pinhole_rays(camera: Camera, pixels: Floats) -> Floats:
    """`[N, 2]` pixels -> `[N, 3]` unit rays. Past the fold of a polynomial cv2's iteration ends anywhere: NaN there."""
    found = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion, criteria=_UNDISTORT_STEPS)
    image = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    missed = ~(_miss(camera, image, pixels) <= _MISS)
    if missed.any():  # its fixed-point iteration also diverges short of the fold, where Newton's method does not
        image[missed] = _newton(camera, pixels[missed])
        missed[missed] = ~(_miss(camera, image[missed], pixels[missed]) <= _MISS)
    rays = np.concatenate([image, np.ones((len(image), 1))], axis=1)
    return np.where(missed[:, None], np.nan, rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _project(camera: Camera, image: Floats) -> Floats:
    return pixels_from_points(camera, np.concatenate([image, np.ones((len(image), 1))], axis=1))


def _miss(camera: Camera, image: Floats, pixels: Floats) -> Floats:
    """`[N]` distance in pixels between pixels and where points `[N, 2]` of the plane z = 1 are seen."""
    return np.abs(_project(camera, image) - pixels).max(axis=1)


def _newton(camera: Camera, pixels: Floats) -> Floats:
    """`[N, 2]` points of the plane z = 1 that are seen at the pixels, from the middle of the image outwards in small steps."""
    image = np.zeros_like(pixels)
    nudge = 1e-6
    for _ in range(60):
        here = _project(camera, image)
        slope = np.stack([(_project(camera, image + nudge * axis) - here) / nudge for axis in np.eye(2)], axis=-1)  # (N, 2, 2)
        step = np.linalg.solve(slope + 1e-9 * np.eye(2), (pixels - here)[..., None])[..., 0]
        image = image + step * np.minimum(1.0, 0.1 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
    return image


def _fisheye_rays(camera: Camera, pixels: Floats) -> Floats:
    """`[N, 2]` pixels -> `[N, 3]` unit rays, NaN where no angle up to 180 degrees has the pixel.

    Kannala-Brandt (2006) by Newton's method on theta; cv2's inverse returns tan(theta), which breaks near 90 degrees, and
    its projection ends there.
    """
    k = np.concatenate([camera.distortion, np.zeros(4)])[:4]
    x = (pixels[:, 0] - camera.matrix[0, 2]) / camera.matrix[0, 0]
    y = (pixels[:, 1] - camera.matrix[1, 2]) / camera.matrix[1, 1]
    distorted = np.hypot(x, y)
    theta = np.minimum(distorted, np.pi / 2)
    for _ in range(20):
        value, slope = _kannala_brandt(k, theta)
        theta = np.clip(theta - (value - distorted) / np.where(np.abs(slope) > 1e-9, slope, 1e-9), 0.0, np.pi)
    missed = np.abs(_kannala_brandt(k, theta)[0] - distorted) * max(camera.matrix[0, 0], camera.matrix[1, 1])
    theta = np.where(missed <= _MISS, theta, np.nan)
    scale = np.where(distorted > 1e-12, np.sin(theta) / np.maximum(distorted, 1e-12), 1.0)
    return np.stack([x * scale, y * scale, np.cos(theta)], axis=1)


def _kannala_brandt(k: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """`[N]` distances from the centre in focal lengths at the `[N]` angles, and `[N]` slopes of them; k: `[4]`."""
    square = theta**2
    value = theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3])))
    return value, slope
