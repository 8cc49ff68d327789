"""Quantiles of Fisher's distribution.

Without scipy.special, which takes longer to import than a short recording takes to be read.

Source: Press et al., Numerical Recipes, third edition (2007), 6.4 and 6.14.
"""

from math import exp, lgamma, log, log1p

_TERMS = 500  # of the continued fraction; some dozens are enough below a million degrees
_TINY = 1e-300
_EXACT = 1e-16


def fisher_quantile(share: float, above: float, below: float) -> float:
    """Return the value that Fisher's F stays under with a probability of `share`.

    above, below: degrees of freedom of the numerator and the denominator, more than 0. The
    result is exact to 1e-10 of itself up to 10,000 of them.
    """
    low, high = 0.0, 1.0
    while fisher_share(high, above, below) < share:
        low, high = high, 2.0 * high
    while high - low > 4e-16 * high:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if fisher_share(middle, above, below) < share:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def fisher_share(value: float, above: float, below: float) -> float:
    """Return how probably Fisher's F is under a positive value."""
    part, rest = above * value, below
    return _incomplete_beta(part / (part + rest), rest / (part + rest), above / 2.0, below / 2.0)


def _incomplete_beta(x: float, other: float, a: float, b: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b); other: 1 - x without its error."""
    if x > (a + 1.0) / (a + b + 2.0):  # where the fraction of the other side converges quickly
        return 1.0 - _incomplete_beta(other, x, b, a)
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * _log_rest(x, other))
    return front * _beta_fraction(x, a, b) / a


def _log_rest(x: float, other: float) -> float:
    """Return log(1 - x), from whichever of x and 1 - x says it more exactly."""
    return log1p(-x) if x < 0.5 else log(other)


def _beta_fraction(x: float, a: float, b: float) -> float:
    """Return the continued fraction of the incomplete beta function, by Lentz' method."""
    upper, lower = 1.0, 1.0 / _not_zero(1.0 - (a + b) * x / (a + 1.0))
    found = lower
    for term in range(1, _TERMS):
        twice = a + 2 * term
        for factor in (
            term * (b - term) * x / ((twice - 1.0) * twice),
            -(a + term) * (a + b + term) * x / (twice * (twice + 1.0)),
        ):
            lower = 1.0 / _not_zero(1.0 + factor * lower)
            upper = _not_zero(1.0 + factor / upper)
            found *= lower * upper
        if abs(lower * upper - 1.0) < _EXACT:
            break
    return found


def _not_zero(value: float) -> float:
    return value if abs(value) > _TINY else _TINY
