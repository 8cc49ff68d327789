"""Which focal lengths that were given are wrong, by what they would change to if they were free.

Three signs: a change that is certain by itself; one that is likely and would give a camera the
focal length of its equals; and changes of all cameras alike, which are less uncertain together.
"""

import numpy as np

from mocap_calib.adjust.intrinsics import shared_intrinsics
from mocap_calib.config import IntrinsicsConfig, UncertaintyConfig
from mocap_calib.types import Bools, Camera, Floats


def find_wrong_focal(
    cameras: tuple[Camera, ...], change: Floats, sigma: Floats, config: UncertaintyConfig
) -> Bools:
    """Return the cameras `[view]` whose focal lengths are certainly other than was given.

    change, sigma: `[view]` of their logarithms, as of `FreeFocal`; NaN = not known.
    """
    large = (np.abs(change) > config.least_focal_change) & (sigma > config.least_focal_sigma)
    certain = np.abs(change) > config.focal_significance * sigma
    unlike = _favours_equals(cameras, change, sigma, config)
    return np.asarray(large & (certain | unlike | _all_change_alike(change, sigma, config)))


def _favours_equals(
    cameras: tuple[Camera, ...], change: Floats, sigma: Floats, config: UncertaintyConfig
) -> Bools:
    """Return where a camera `[view]` has rather the focal length of the others than its own.

    The others: at least two of the same image size, whose focal lengths are alike. The ratio of the
    likelihoods of the two focal lengths must be large.
    """
    focal = np.log([camera.focal for camera in cameras])
    kind = shared_intrinsics(cameras, IntrinsicsConfig())
    found = np.zeros(len(cameras), dtype=bool)
    for view in range(len(cameras)):
        others = np.flatnonzero((kind == kind[view]) & (np.arange(len(cameras)) != view))
        if len(others) < 2 or np.ptp(focal[others]) > config.equal_focal:
            continue
        to_others = float(np.median(focal[others])) - focal[view]
        variance = sigma[view] ** 2 + config.focal_systematic**2
        nats = (change[view] ** 2 - (change[view] - to_others) ** 2) / (2 * variance)
        found[view] = abs(to_others) > config.equal_focal and nats > config.equal_focal_nats
    return found


def _all_change_alike(change: Floats, sigma: Floats, config: UncertaintyConfig) -> Bools:
    """Return where a camera `[view]` has a wrong focal length as all others have, or none.

    The mean of the changes weighed by their certainty is that of one focal length that the cameras
    share, and nearly as certain.
    """
    nobody = np.zeros(len(change), dtype=bool)
    if len(change) < 3 or not np.isfinite(change).all():
        return nobody
    weight = 1 / sigma**2
    mean = float((change * weight).sum() / weight.sum())
    uncertain = float(np.hypot(np.sqrt(1 / weight.sum()), config.focal_systematic / 2))
    apart = np.abs(change - mean) > 2 * np.hypot(sigma, config.focal_systematic)
    if apart.any() or abs(mean) < config.common_focal_significance * uncertain:
        return nobody
    return np.asarray(np.sign(mean) * change > sigma)
