"""Rotations, batched over leading axes."""

import numpy as np

from mocap_calib.types import Floats


def matrix_from_vector(vector: Floats) -> Floats:
    """Rodrigues' formula: `[..., 3]` rotation vectors in radians -> `[..., 3, 3]` matrices."""
    vector = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle > 0, angle, 1.0)
    # sin(a)/a and (1-cos(a))/a^2 by np.sinc, which is exact near zero
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(safe / (2 * np.pi)) ** 2
    k = skew(vector)
    return np.eye(3) + first * k + second * (k @ k)


def vector_from_matrix(matrix: Floats) -> Floats:
    """`[..., 3, 3]` rotation matrices -> `[..., 3]` rotation vectors of length 0..pi, through unit quaternions."""
    q = quaternion_from_matrix(matrix)
    w, v = q[..., 0], q[..., 1:]
    sine = np.linalg.norm(v, axis=-1)
    angle = 2 * np.arctan2(sine, w)
    factor = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return factor[..., None] * v


def quaternion_from_matrix(matrix: Floats) -> Floats:
    """`[..., 3, 3]` -> `[..., 4]` unit quaternions (w, x, y, z) with w >= 0.

    Each column below is 4 q_k q; the one with the largest q_k is the best conditioned (Shepperd 1978).
    """
    m = np.asarray(matrix, dtype=np.float64)
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = np.stack(
        [
            np.stack([1 + d0 + d1 + d2, a, b, c], -1),
            np.stack([a, 1 + d0 - d1 - d2, d, e], -1),
            np.stack([b, d, 1 - d0 + d1 - d2, f], -1),
            np.stack([c, e, f, 1 - d0 - d1 + d2], -1),
        ],
        -2,
    )
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def skew(vector: Floats) -> Floats:
    """The cross product as a matrix, `[..., 3]` -> `[..., 3, 3]`: [a]x b = a x b."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2
    )


def angle_between(first: Floats, second: Floats) -> Floats:
    """Geodesic distance in radians between `[..., 3, 3]` rotations; exact also for tiny angles."""
    relative = np.swapaxes(first, -1, -2) @ second
    chord = np.linalg.norm(relative - np.eye(3), axis=(-2, -1)) / np.sqrt(8.0)
    return 2 * np.arcsin(np.clip(chord, 0.0, 1.0))


def direction_angle(first: Floats, second: Floats) -> Floats:
    """Angle in radians between `[..., 3]` vectors of any length; pi where one of them has none."""
    cross = np.linalg.norm(np.cross(first, second), axis=-1)
    dot = (first * second).sum(-1)
    return np.where((cross == 0) & (dot == 0), np.pi, np.arctan2(cross, dot))


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotation that maximises tr(R' M), for `[..., 3, 3]` matrices (Kabsch 1976, with Umeyama's sign)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.linalg.det(u) * np.linalg.det(vt)
    u = np.concatenate([u[..., :2], u[..., 2:] * sign[..., None, None]], axis=-1)
    return u @ vt


def looking_along(direction: Floats, down: Floats) -> Floats:
    """`[..., 3, 3]` rotation into axes with z along `direction` `[..., 3]` and y as near to `down` `[3]` as it can be.

    Where direction is along `down`, the horizontal axis is the camera's own x.
    """
    z = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    x = np.cross(down, z)
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(length > 1e-6, x / np.maximum(length, 1e-6), np.array([1.0, 0.0, 0.0]))
    y = np.cross(z, x)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-2)
