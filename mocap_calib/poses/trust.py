"""How much a detection's confidence tells of its error: measured, since detectors differ in it."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.poses.track import Detections
from mocap_calib.types import Floats


@dataclass(frozen=True)
class Trust:
    """The inverse variance of a detection is that of its view times (confidence / usual)^power.

    usual: the geometric mean of the confidences.
    """

    power: float = 1.0
    usual: float = 1.0

    def weigh(self, seen: Detections, noise: Floats) -> Detections:
        """Return detections whose inverse variances are so, from those that go with confidence.

        noise: `[view]` in radians.
        """
        even = noise[:, None, None] ** -2.0
        there = seen.precision > 0
        confidence = np.where(there, seen.precision / even, self.usual)
        precision = np.where(there, even * (confidence / self.usual) ** self.power, 0.0)
        return replace(seen, precision=precision)


def measure_trust(square: Floats, confidence: Floats, usual: float) -> Trust:
    """Return the trust that the errors of hidden detections show.

    The logarithm of squared errors falls as that of the confidences rises: the power is the slope,
    to which a wrong detection matters little however far off it is. At most 1, as if confidences
    were inverse variances: on Shelf it would be 3.3, with errors smaller by 1 % and fewer limbs
    that are right, since single views decide where each is.

    square: `[N]` squared errors. confidence: `[N]`, not all alike. usual: see `Trust`.
    """
    told = np.log(confidence) - np.log(confidence).mean()
    error = np.log(np.maximum(square, np.finfo(float).tiny))
    power = -float(told @ error) / float(told @ told)
    return Trust(float(np.clip(power, 0.0, 1.0)), usual)
