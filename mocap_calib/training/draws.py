"""Random draws for training data: numbers, joints that are hidden together, cameras."""

import numpy as np
import torch
from torch import Tensor

from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.types import Floats, Skeleton


class Draws:
    """Random tensors; the same seed gives the same ones in the same order."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def uniform(self, *shape: int) -> Tensor:
        """Return uniform numbers `[shape]` in 0..1."""
        return torch.rand(*shape, generator=self.generator)

    def normal(self, *shape: int) -> Tensor:
        """Return normal numbers `[shape]` with variance 1."""
        return torch.randn(*shape, generator=self.generator)

    def log_uniform(self, bounds: tuple[float, float], *shape: int) -> Tensor:
        """Return numbers `[shape]` within the bounds whose logarithms are uniform."""
        low, high = np.log(bounds[0]), np.log(bounds[1])
        return torch.exp(self.uniform(*shape) * (high - low) + low)

    def index(self, count: int, size: int) -> Tensor:
        """Return `[size]` indices below `count`."""
        return torch.randint(count, (size,), generator=self.generator)

    def weighted_index(self, weight: Tensor, size: int) -> Tensor:
        """Return `[size]` indices, drawn with replacement by the weights `[count]`."""
        return torch.multinomial(weight, size, replacement=True, generator=self.generator)


def symmetry_classes(skeleton: Skeleton) -> list[tuple[int, ...]]:
    """Return the joints that a layout has together: pairs of left and right, and single joints."""
    paired = {joint for pair in skeleton.symmetries for joint in pair}
    single = [(joint,) for joint in range(len(skeleton.keypoints)) if joint not in paired]
    return [*skeleton.symmetries, *single]


def class_of_joint(classes: list[tuple[int, ...]]) -> Tensor:
    """Return the index `[J]` of each joint's class of `symmetry_classes`."""
    index = torch.empty(sum(map(len, classes)), dtype=torch.long)
    for k, joints in enumerate(classes):
        index[list(joints)] = k
    return index


def limbs(skeleton: Skeleton) -> Tensor:
    """Return the joints `[edge, J]` (bool) at and beyond the child of each edge."""
    beyond = torch.zeros(len(skeleton.edges), len(skeleton.keypoints), dtype=torch.bool)
    for row, (_, root) in enumerate(skeleton.edges):
        beyond[row, root] = True
        for parent, child in skeleton.edges:
            beyond[row, child] |= beyond[row, parent]
    return beyond


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
