"""Draw random numbers for training data from a generator of their own."""

import numpy as np
import torch
from torch import Tensor


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
