"""Likelihood ratios that are measured on the recording itself, by logistic regression."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.types import Floats

_NEWTON_STEPS = 8


@dataclass(frozen=True)
class LogRatio:
    """The log-likelihood ratio of two classes, linear in some features.

    slope: `[feature]`. low, high: `[feature]` range of the examples, beyond which it is constant.
    unknown: the ratio where features are unknown, by how often they are in either class.
    """

    slope: Floats
    offset: float
    low: Floats
    high: Floats
    unknown: float

    def __call__(self, features: Floats) -> Floats:
        """Return the log-likelihood ratios `[...]` of features `[..., feature]`, NaN = unknown."""
        found = np.clip(features, self.low, self.high) @ self.slope + self.offset
        return np.where(np.isfinite(found), found, self.unknown)


def measure_log_ratio(features: Floats, one: Floats, two: Floats) -> LogRatio | None:
    """Return the log-likelihood ratio of class one against class two; None without examples.

    Logistic regression with a normal prior of variance 1 on the slopes: few examples determine
    little. Both classes weigh alike, so that log-odds are log-likelihood ratios.

    features: `[example, feature]`, NaN = unknown. one, two: `[example]` how certainly an example
    is of either class, 0..1.
    """
    known = np.isfinite(features).all(-1)
    totals = one.sum(), two.sum()
    features, one, two = features[known], one[known], two[known]
    least = min(one.sum(), two.sum())
    if least <= 0:
        return None
    missing = (total - seen.sum() + 1 for total, seen in zip(totals, (one, two), strict=True))
    shares = [each / (total + 1) for each, total in zip(missing, totals, strict=True)]
    one, two = one * (least / one.sum()), two * (least / two.sum())
    middle = features.mean(0)
    rows = np.column_stack([features - middle, np.ones(len(features))])
    prior = np.diag([*np.ones(len(middle)), 1e-9])
    found = np.zeros(len(prior))
    for _ in range(_NEWTON_STEPS):
        chance = 1 / (1 + np.exp(-rows @ found))
        gradient = rows.T @ (one * (1 - chance) - two * chance) - prior @ found
        curvature = (rows.T * ((one + two) * chance * (1 - chance))) @ rows + prior
        found = found + np.linalg.solve(curvature, gradient)
    slope = found[:-1]
    return LogRatio(
        slope,
        float(found[-1] - middle @ slope),
        low=features.min(0),
        high=features.max(0),
        unknown=float(np.log(shares[0] / shares[1])),
    )
