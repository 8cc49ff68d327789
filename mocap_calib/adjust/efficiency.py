"""How wide the loss of an adjustment is best: as the errors of the recording themselves say.

A narrow loss leaves out what is wrong, and some of what is right: of normal errors a seventh. What
a robust estimate errs by has the variance E |psi|^2 / (E psi')^2, by the influence psi of an error
and its slope (Huber 1981: "Robust Statistics", section 3.2), and that can be measured. Points bend
to what was seen, with a narrow loss more than with a wide one: rigs of normal errors gain twice as
much by a wide one as errors alone tell.
"""

import numpy as np

from mocap_calib.config import Config
from mocap_calib.geometry.point_covariance import median_angles
from mocap_calib.rig.noise import MEDIAN_DISTANCE, MeasuredSample, least_noise
from mocap_calib.types import CameraRig, Floats


def choose_loss_scale(rig: CameraRig, measured: MeasuredSample, config: Config) -> float:
    """Return how wide Cauchy's loss is in the end, in standard deviations.

    The last of the scales or the narrow one, whichever has the smaller variance; the narrow one
    where nothing was measured.
    """
    wide, narrow = config.adjust.loss_scales[-1], config.adjust.narrow_loss_scale
    errors = _errors(rig, measured, least_noise(rig, config.triangulate))
    if not len(errors):
        return narrow
    return wide if _variance(errors, wide) < _variance(errors, narrow) else narrow


def _errors(rig: CameraRig, measured: MeasuredSample, least: Floats) -> Floats:
    """Return the sizes `[N]` of the errors that count, in standard deviations of each view's own.

    What points took up of each is made up for. least: `[view]` below which no deviation is.
    """
    angle = measured.angle / median_angles(rig, measured.points, measured.seen.confidence)
    errors = [np.zeros(0)]
    for view in np.flatnonzero(measured.counted.any(1)):
        own = angle[view, measured.counted[view]]
        deviation = max(float(np.median(own)) / MEDIAN_DISTANCE, float(least[view]))
        errors.append(own / deviation)
    return np.concatenate(errors)


def _variance(errors: Floats, scale: float) -> float:
    """Return the variance of an estimate from vectors in the plane of these lengths `[N]`.

    Cauchy's loss has the influence w r, where w = 1 / (1 + r^2 / s^2), and over all directions of
    the vector r its mean slope is w^2.
    """
    weight = 1 / (1 + (errors / scale) ** 2)
    slope = float(np.mean(weight**2))
    return float(np.mean((weight * errors) ** 2)) / max(slope**2, 1e-300)
