"""Cameras that look at the bodies of training data."""

import numpy as np
import torch
from torch import Tensor

from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.types import Floats

_DOWN = np.array([0.0, 0.0, -1.0])


def fibonacci_hemisphere(count: int) -> Floats:
    """Return unit vectors `[count, 3]` with z > 0, each with the same area of the hemisphere.

    The heights are evenly spaced (Archimedes: equal bands have equal areas), the azimuths advance
    by the golden angle (Gonzalez 2010).
    """
    k = np.arange(count)
    height = (k + 0.5) / count
    azimuth = np.pi * (3 - np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=-1)


def hemisphere_views(cameras: int, rolls: int) -> Floats:
    """Return cam_from_world `[cameras * rolls, 3, 3]` of cameras on the hemisphere (appendix C).

    All look at the origin and are rolled evenly about their axes.
    """
    upright = looking_along(-fibonacci_hemisphere(cameras), _DOWN)
    roll = 2 * np.pi * np.arange(rolls) / rolls
    turn = matrix_from_vector(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    return (turn[None] @ upright[:, None]).reshape(-1, 3, 3)


def upright_views(azimuth: Tensor, elevation: Tensor) -> Tensor:
    """Return cam_from_world `[B, 3, 3]` of upright cameras that look at the origin.

    azimuth and elevation: `[B]` radians of the cameras' places, seen from the origin, +z up.
    """
    across = -elevation.cos()
    forward = torch.stack(
        [across * azimuth.cos(), across * azimuth.sin(), -elevation.sin()], 1
    )  # (B, 3)
    up = torch.tensor([0.0, 0.0, 1.0]).expand_as(forward)
    right = torch.nn.functional.normalize(torch.cross(forward, up, dim=1), dim=1)
    down = torch.cross(forward, right, dim=1)
    return torch.stack([right, down, forward], 1)


def rotation_about_z(angle: Tensor) -> Tensor:
    """Return the rotations `[B, 3, 3]` by angles `[B]` in radians about the z axis."""
    cosine, sine = angle.cos(), angle.sin()
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    rows = [cosine, -sine, zero, sine, cosine, zero, zero, zero, one]
    return torch.stack(rows, 1).view(-1, 3, 3)
