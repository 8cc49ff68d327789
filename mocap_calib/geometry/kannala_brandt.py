"""The fisheye model of Kannala and Brandt (2006), as in cv2.fisheye, on the plane z = 1."""

import numpy as np

from mocap_calib.types import Camera, Floats

_NEWTON_STEPS = 20
_SETTLED = 1e-15  # of a step, in radians
_LEAST_RADIUS = 1e-5  # nearer to the axis than this, derivatives are those at this distance


def coefficients(camera: Camera) -> Floats:
    """Return the camera's coefficients k1 k2 k3 k4 `[4]`, 0 where it has fewer."""
    return np.concatenate([camera.distortion, np.zeros(4)])[:4]


def distort(k: Floats, image: Floats) -> Floats:
    """Return where the lens puts points of the plane z = 1, `[2, N]` both."""
    radius = np.hypot(image[0], image[1])
    distorted, _ = _distorted_radius(k, np.arctan(radius))
    return image * np.where(radius > 1e-12, distorted / np.maximum(radius, 1e-12), 1.0)


def jacobian(k: Floats, image: Floats) -> Floats:
    """Return the derivatives `[2, 2, N]` of `distort` by the points of the plane z = 1."""
    radius = np.maximum(np.hypot(image[0], image[1]), _LEAST_RADIUS)
    distorted, slope = _distorted_radius(k, np.arctan(radius))
    radial = distorted / radius
    by_radius = (slope / (1 + radius**2) - radial) / radius**2  # d radial / d r, over r
    outer = image[:, None] * image[None]
    return np.eye(2)[..., None] * radial + outer * by_radius


def slope_by_k1(image: Floats) -> Floats:
    """Return the derivatives `[2, N]` of `distort` by k1."""
    radius = np.maximum(np.hypot(image[0], image[1]), _LEAST_RADIUS)
    return image * (np.arctan(radius) ** 3 / radius)


def rays(k: Floats, distorted: Floats, *, miss: float) -> Floats:
    """Return the unit rays `[3, N]` that the lens puts at `distorted` `[2, N]`.

    By Newton's method on the angle theta to the optical axis. NaN where no angle up to 180
    degrees comes within `miss` (in focal lengths).
    """
    radius = np.hypot(distorted[0], distorted[1])
    theta = np.minimum(radius, np.pi / 2)
    for _ in range(_NEWTON_STEPS):
        value, slope = _distorted_radius(k, theta)
        step = (value - radius) / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
        theta = np.clip(theta - step, 0.0, np.pi)
        if not (np.abs(step) > _SETTLED).any():
            break
    error = np.abs(_distorted_radius(k, theta)[0] - radius)
    theta = np.where(error <= miss, theta, np.nan)
    scale = np.where(radius <= 1e-12, 1.0, np.sin(theta) / np.maximum(radius, 1e-12))
    return np.stack([distorted[0] * scale, distorted[1] * scale, np.cos(theta)])


def _distorted_radius(k: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """Return the distances from the centre `[N]` in focal lengths at angles `[N]`, and the slopes.

    r = theta (1 + k1 theta^2 + ... + k4 theta^8), and dr / dtheta.
    """
    square = theta**2
    series = k[0] + square * (k[1] + square * (k[2] + square * k[3]))
    radius = theta * (1 + square * series)
    slopes = 3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3]))
    slope = 1 + square * slopes
    return radius, slope
