"""Checks of a rig that are independent of its covariance: one table, and how each is measured.

A covariance knows what chance does to a rig under a model that is right. Whether the model is right
(one clock, these lenses, cameras that do not move, rigid bodies, right identities) shows in the
residuals. Each check stands for a rotation error: none up to the largest value of sound recordings,
1 degree at the limit, and more in proportion beyond.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_calib.config import Config
from mocap_calib.results import Check, GroupResult
from mocap_calib.types import Floats
from mocap_calib.verdict.explained import Leftover
from mocap_calib.verdict.measures import (
    Look,
    broken_loops,
    clocks,
    convergence,
    errors_of_body,
    few_frames,
    flatness,
    held_out,
    lack_of_score,
    over_time,
    radial_slopes,
    steadiest_bones,
    times_others,
    unmatched,
    weakest_bridge,
)

_MOST_DEG = 5.0  # one check alone makes a rig weak, not more


@dataclass(frozen=True)
class CheckKind:
    """What a check measures, and what its value means.

    text: what is measured. sound: smallest and largest value of sound recordings
        (docs/how-good.md). limit: the value that stands for an error of 1 degree; above it the
        check fails.
    meaning, remedy: of a check that fails; `{value}` and `{camera}` are filled in.
    measure: returns the value, or `[view]` values, of which the largest counts.
    """

    name: str
    text: str
    sound: tuple[float, float]
    limit: float
    meaning: str
    remedy: str
    measure: Callable[[Look], float | Floats]

    def check(self, look: Look) -> Check:
        """Return the check of a group: of the camera with the largest value."""
        values = np.atleast_1d(self.measure(look))
        if not np.isfinite(values).any():
            return Check(self.name, np.nan, self.limit)
        worst = int(np.nanargmax(values))
        camera = look.group.rig.names[worst] if len(values) > 1 else ""
        value = float(values[worst])
        return Check(self.name, value, self.limit, camera, self.error_of(value))

    def error_of(self, value: float) -> float:
        """Return the rotation error in degrees that a value stands for."""
        beyond = (value - self.sound[1]) / (self.limit - self.sound[1])
        return float(np.clip(beyond, 0.0, _MOST_DEG))


def describe_checks() -> dict[str, dict[str, object]]:
    """Return what each check measures and the values of sound recordings, as JSON has them."""
    return {kind.name: {"text": kind.text, "sound": list(kind.sound)} for kind in CHECKS}


def kind_of(check: Check) -> CheckKind:
    """Return the row of the table for a check."""
    return next(kind for kind in CHECKS if kind.name == check.name)


def check_rig(group: GroupResult, config: Config) -> tuple[Check, ...]:
    """Return all checks of the rig of a group."""
    look = Look(group, Leftover.of(group), config)
    return tuple(kind.check(look) for kind in CHECKS)


CHECKS = (
    CheckKind(
        "convergence",
        "whether adjusting and matching converged",
        sound=(0.0, 0.0),
        limit=0.5,
        meaning="adjusting and matching did not converge",
        remedy="look for a camera with large errors, and record longer",
        measure=convergence,
    ),
    CheckKind(
        "moments",
        "10 over the number of frames in which bodies are matched",
        sound=(0.01, 0.5),
        limit=1.25,
        meaning="bodies are matched in few frames: errors that all joints of a frame share do not "
        "show",
        remedy="record longer",
        measure=few_frames,
    ),
    CheckKind(
        "held-out frames",
        "median error of a fifth of the recording in a rig made without it, in errors of the same "
        "frames in the rig of all; of the worst fifth",
        sound=(1.0, 1.07),
        limit=1.18,
        meaning="errors are {value:.2f} times as large in a fifth of the recording that the rig "
        "was made without",
        remedy="check that the cameras were not moved, and record longer",
        measure=held_out,
    ),
    CheckKind(
        "flat",
        "median error of points in those that they would have if all lay in one plane, as several "
        "rigs fit these",
        sound=(0.01, 0.15),
        limit=0.45,
        meaning="all detections may lie in one plane: other rigs would fit as well",
        remedy="let the subject come closer, rise, jump or tilt",
        measure=flatness,
    ),
    CheckKind(
        "bones",
        "share by which the steadiest quarter of all distances on a body vary over time",
        sound=(0.01, 0.26),
        limit=0.3,
        meaning="distances on bodies vary by {value:.0%} at least",
        remedy="check the keypoints and the identities in the 3D poses",
        measure=steadiest_bones,
    ),
    CheckKind(
        "loops",
        "share of the pairs of cameras that contradict the rig",
        sound=(0.0, 0.53),
        limit=0.75,
        meaning="{value:.0%} of the pairs of cameras contradict the rig",
        remedy="check the keypoints, and that all files are of one time",
        measure=broken_loops,
    ),
    CheckKind(
        "bridge",
        "of the best pairs that connect all cameras: by how many times the worst score is below "
        "the median of the others",
        sound=(1.0, 1.2),
        limit=1.45,
        meaning="two groups of cameras agree less with each other than within themselves "
        "({value:.1f} x)",
        remedy="check that all files are of one recording; or let the subject cross where both "
        "groups look",
        measure=weakest_bridge,
    ),
    CheckKind(
        "pair score",
        "what the best pair of a camera lacks of a score of 0.55: agreement of lifted bodies",
        sound=(-0.4, -0.01),
        limit=0.02,
        meaning="{camera}: its bodies do not look like those of any other camera",
        remedy="check that its file belongs to this recording",
        measure=lack_of_score,
    ),
    CheckKind(
        "clock",
        "frames by which a clock is certainly off that was not corrected",
        sound=(0.0, 0.0),
        limit=0.5,
        meaning="{camera}: its clock seems to be off by {value:.2f} frames",
        remedy="trigger the cameras together, or record at a higher rate",
        measure=clocks,
    ),
    CheckKind(
        "lens",
        "slope of errors along the cube of the radius, in standard deviations",
        sound=(0.3, 2.1),
        limit=4.5,
        meaning="{camera}: errors grow towards the edge of the image ({value:.1f} standard "
        "deviations)",
        remedy="its lens may be another than given: calibrate it, or run again with --refine "
        "focal+k1",
        measure=radial_slopes,
    ),
    CheckKind(
        "over time",
        "largest error of a stretch of time, in median ones",
        sound=(1.1, 2.3),
        limit=3.0,
        meaning="{camera}: errors are {value:.1f} times as large for a part of the recording",
        remedy="check whether it was moved or out of step for a part of the recording",
        measure=over_time,
    ),
    CheckKind(
        "unmatched",
        "share of the detections of a camera that stay unassigned",
        sound=(0.0, 0.13),
        limit=0.3,
        meaning="{camera}: {value:.0%} of its detections stay unassigned",
        remedy="check its keypoints: false detections, or people whom no other camera sees",
        measure=unmatched,
    ),
    CheckKind(
        "errors",
        "median error of a keypoint in sizes of the body in the image",
        sound=(0.02, 0.06),
        limit=0.09,
        meaning="{camera}: errors are {value:.0%} of the size of a body",
        remedy="check its keypoints, its clock and its intrinsics",
        measure=errors_of_body,
    ),
    CheckKind(
        "inconsistent",
        "median error of a camera in those of the other cameras",
        sound=(1.0, 1.5),
        limit=2.5,
        meaning="{camera}: errors are {value:.1f} times those of the other cameras",
        remedy="check whether it is out of step (--frame-offset), was moved, or has other "
        "intrinsics",
        measure=times_others,
    ),
)
