"""Tell which of three cameras have left and right exchanged: one, or the two others.

Geometry tells only that one differs from two: with left and right exchanged in all cameras, all
points are where they were. But no body bends its knees backwards: the lifting network is less sure
of detections whose sides are exchanged.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.config import Config
from mocap_calib.faults.words import describe
from mocap_calib.recording.corrections import Sides
from mocap_calib.results import Fault
from mocap_calib.rig.observed import Observed

_HALVES = 3  # cameras: of more, most are right


def exchanged_instead(
    found: Sequence[Fault], observed: Observed, mended: Observed, config: Config
) -> tuple[Fault, ...]:
    """Return the faults of the two others where a camera had its sides right; else nothing.

    observed, mended: what was known with the sides of the camera as they are, and exchanged.
    """
    names = observed.recording.names
    if len(names) != _HALVES or len(found) != 1 or not isinstance(found[0].mend, Sides):
        return ()
    fault = found[0]
    rise = log_spread(mended, fault.camera) - log_spread(observed, fault.camera)
    if not rise > config.diagnosis.unnatural_sides:
        return ()
    mends = [Sides(name) for name in names if name != fault.camera]
    evidence = {**fault.evidence, "spread": rise}
    return tuple(
        replace(fault, camera=mend.camera, says=describe(mend), evidence=evidence, mend=mend)
        for mend in mends
    )


def log_spread(observed: Observed, camera: str) -> float:
    """Return the logarithm of how unsure the network is of a camera's bodies, typically."""
    spread = observed.lifted.spread[observed.recording.names.index(camera)]
    lifted = np.isfinite(spread).any(-1)
    if not lifted.any():
        return float("nan")
    return float(np.median(np.log(np.nanmean(spread[lifted] ** 2, axis=-1))) / 2)
