"""Lens models as in OpenCV, by component: `[2, N]` pixels, `[3, N]` points and rays. NaN stays NaN.

Brown-Conrady with OpenCV's rational terms, and Kannala-Brandt (2006) for fisheyes. Written out, because whole recordings go
through: ten times faster than cv2, and without its failures (its fixed-point iteration diverges at strong lenses; its fisheye inverse
returns tan(theta), which breaks near 90 degrees).
"""

from functools import lru_cache

import numpy as np

from mocap_calib.types import Bools, Camera, Floats

_NEWTON_STEPS = 5
_SETTLED = 1e-7  # of a step: the next would be its square
_CAREFUL_STEPS = 60
_MISS = 0.5  # pixels between a pixel and its ray's: beyond, the lens model has no ray for it


def pixels(camera: Camera, points: Floats) -> Floats:
    """Points in the camera's axes `[3, N]` -> pixels `[2, N]`; behind the camera is NaN."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        image = points[:2] / np.where(points[2] > 1e-9, points[2], np.nan)
        if camera.fisheye:
            radius = np.hypot(image[0], image[1])
            value = _kannala_brandt(_fisheye(camera), np.arctan(radius))[0]
            image = image * np.where(radius > 1e-12, value / np.maximum(radius, 1e-12), 1.0)
        elif camera.distortion.any():
            image = _brown(_coefficients(camera), image)
        focal, middle = _scale(camera)
        return focal[:, None] * image + middle[:, None]


def rays(camera: Camera, seen: Floats) -> Floats:
    """Pixels `[2, N]` -> unit rays `[3, N]` with the distortion taken out; NaN where no ray has the pixel."""
    focal, middle = _scale(camera)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        image = (seen - middle[:, None]) / focal[:, None]
        if camera.fisheye:
            return _fisheye_rays(_fisheye(camera), image, _MISS / focal.max())
        if camera.distortion.any():
            image = _undistorted(_coefficients(camera), image, _MISS / focal.max())
        length = 1 / np.sqrt(1 + image[0] ** 2 + image[1] ** 2)
        return np.concatenate([image * length, length[None]])


def _scale(camera: Camera) -> tuple[Floats, Floats]:
    """Focal lengths `[2]` and principal point `[2]`."""
    return camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2]


def _coefficients(camera: Camera) -> tuple[float, ...]:
    """k1 k2 p1 p2 k3 k4 k5 k6."""
    return (*camera.distortion[:8].tolist(), *[0.0] * 8)[:8]


def _brown(k: tuple[float, ...], image: Floats) -> Floats:
    """`[2, N]` points of the plane z = 1 -> where the lens puts them."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    x, y = image
    square, xy = x * x + y * y, x * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    if k4 or k5 or k6:
        radial = radial / (1 + square * (k4 + square * (k5 + square * k6)))
    out = image * radial
    if p1 or p2:
        out[0] += 2 * p1 * xy + p2 * (square + 2 * x * x)
        out[1] += 2 * p2 * xy + p1 * (square + 2 * y * y)
    return out


def _correction(k: tuple[float, ...], image: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Newton's step towards the points that the lens puts at `target`, and how far off `image` is."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    x, y = image
    square = x * x + y * y
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    radial = above / below
    slope = (
        k1
        + square * (2 * k2 + 3 * square * k3)
        - radial * (k4 + square * (2 * k5 + 3 * square * k6))
    ) / below  # d radial / d r^2
    short = target - _brown(k, image)
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + 2 * y * y * slope + 2 * p2 * x + 6 * p1 * y
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    determinant = xx * yy - xy * xy
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, 1e-9)
    return np.stack(
        [yy * short[0] - xy * short[1], xx * short[1] - xy * short[0]]
    ) / determinant, short


def _undistorted(k: tuple[float, ...], seen: Floats, miss: float) -> Floats:
    """`[2, N]` points of the plane z = 1 that the lens puts at `seen`; NaN where there is none within `miss`."""
    image = seen
    for _ in range(_NEWTON_STEPS):
        step = _correction(k, image, seen)[0]
        image = image + step
        if not (np.abs(step) > _SETTLED).any():
            break
    short = np.abs(seen - _brown(k, image)).max(0)
    # past the first fold lie further solutions, which mean nothing
    doubtful: Bools = ~(
        (short <= 1e-12 + 1e-9 * miss) & ((image**2).sum(0) < _fold(k))
    ) & np.isfinite(seen).all(0)
    if doubtful.any():
        image[:, doubtful] = _careful(k, seen[:, doubtful], miss)
    return image


def _careful(k: tuple[float, ...], seen: Floats, miss: float) -> Floats:
    """The same from the middle of the image outwards, in small steps."""
    image = np.zeros_like(seen)
    for _ in range(_CAREFUL_STEPS):
        step = _correction(k, image, seen)[0]
        image = image + step * np.minimum(1.0, 0.1 / np.maximum(np.hypot(*step), 1e-12))
    return np.where(np.abs(seen - _brown(k, image)).max(0) <= miss, image, np.nan)


@lru_cache
def _fold(k: tuple[float, ...]) -> float:
    """The squared radius up to which the distorted radius grows with the radius."""
    radius = np.linspace(0, 10, 4001)
    k1, k2, _, _, k3, k4, k5, k6 = k
    square = radius**2
    below = 1 + square * (k4 + square * (k5 + square * k6))
    grows = (
        np.diff(
            radius
            * (1 + square * (k1 + square * (k2 + square * k3)))
            / np.where(below > 0, below, np.nan)
        )
        > 0
    )
    return np.inf if grows.all() else float(square[np.argmin(grows)])


def _fisheye(camera: Camera) -> Floats:
    return np.concatenate([camera.distortion, np.zeros(4)])[:4]


def _fisheye_rays(k: Floats, image: Floats, miss: float) -> Floats:
    """By Newton's method on theta; NaN where no angle up to 180 degrees has the pixel."""
    distorted = np.hypot(image[0], image[1])
    theta = np.minimum(distorted, np.pi / 2)
    for _ in range(20):
        value, slope = _kannala_brandt(k, theta)
        change = (value - distorted) / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
        theta = np.clip(theta - change, 0.0, np.pi)
        if not (np.abs(change) > 1e-15).any():
            break
    theta = np.where(np.abs(_kannala_brandt(k, theta)[0] - distorted) <= miss, theta, np.nan)
    scale = np.where(distorted <= 1e-12, 1.0, np.sin(theta) / np.maximum(distorted, 1e-12))
    return np.stack([image[0] * scale, image[1] * scale, np.cos(theta)])


def _kannala_brandt(k: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """`[N]` distances from the centre in focal lengths at the `[N]` angles, and `[N]` slopes of them; k: `[4]`."""
    square = theta**2
    value = theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3])))
    return value, slope
