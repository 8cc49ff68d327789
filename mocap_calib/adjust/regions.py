"""How wide 95 % regions of three numbers are; scipy has the same and takes long to import."""

import math

import numpy as np

_CHI_SQUARE = 7.814727903251179  # 95 % quantile, of three degrees of freedom
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(100)


def widening(degrees: float) -> float:
    """Return by how much an estimated covariance must grow for its 95 % regions to hold 95 %.

    Regions of three numbers, as of a normal distribution. degrees: of freedom of the covariance,
    3.5 to 1e8. Its own error makes the squared distances those of Hotelling's T^2.
    """
    left = degrees - 2
    return 3 * degrees / left * _f_quantile(left) / _CHI_SQUARE


def _f_quantile(degrees: float) -> float:
    """Return the 95 % quantile of the F distribution of 3 and so many degrees of freedom.

    By halving: of f = d s^2 / (3 (1 - s^2)), the density of s in 0..1 is s^2 (1 - s^2)^(d/2 - 1).
    """
    half = degrees / 2
    log_scale = math.lgamma(half + 1.5) - math.lgamma(1.5) - math.lgamma(half)
    # of many degrees all lies next to 0, between two nodes of a wide region
    low, high = 0.0, min(1.0, math.sqrt(30 / degrees))
    while (middle := (low + high) / 2) not in (low, high):
        s = middle / 2 * (1 + _NODES)
        density = 2 * s**2 * np.exp(log_scale + (half - 1) * np.log1p(-(s**2)))
        if middle / 2 * float(_WEIGHTS @ density) < 0.95:
            low = middle
        else:
            high = middle
    return degrees * low**2 / (3 * (1 - low**2))
