"""Checks of a rig that are independent of its covariance: how each is measured, and one table.

A covariance knows what chance does to a rig under a model that is right. Whether the model is right
(one clock, these lenses, cameras that do not move, right identities) shows in the residuals. Each
check is the rotation error in degrees that a discrepancy means: an angle where the discrepancy is
one, else `OPEN_DEG` times the share of the evidence that contradicts the rig. So no check needs a
limit of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import REPORT_FRAMES, SOUND_DEG, Config
from mocap_calib.errors import argument
from mocap_calib.geometry.lens import project_views
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Cause, GroupResult, Matches
from mocap_calib.rig import gather_tracks, matched_share
from mocap_calib.types import CameraRig, Floats, Ints, Recording

# of what the recording leaves open, where a rig may be wrong by any angle. Measured: two cameras
# with estimated intrinsics are off by 2 to 5 deg in five of eight recordings, by 21 to 40 in three
OPEN_DEG = 5.0


@dataclass(frozen=True)
class Residuals:
    """Detections, and how far from them the points of their bodies are projected, in pixels.

    Of an even sample of the frames, so that a long recording need not cost its length in memory.

    pixels, gap: `[view, 2, frame, individual, keypoint]` the detections, and the way from them to
        the projections; NaN = missing.
    """

    pixels: Floats
    gap: Floats

    @property
    def distance(self) -> Floats:
        """Length of the gaps, `[view, frame, individual, keypoint]`."""
        return np.asarray(np.linalg.norm(self.gap, axis=1))


def residuals_of(group: GroupResult) -> Residuals:
    """Return the residuals of the matched keypoints and the triangulated points of a group."""
    frames = report_frames(group.recording)
    return find_residuals(group.recording, group.matches, group.rig, group.poses.raw, frames)


def find_residuals(
    recording: Recording, matches: Matches, rig: CameraRig, points: Floats, frames: Ints
) -> Residuals:
    """Return the residuals of points `[frame, individual, keypoint, 3]` in some frames (indices).

    rig: of the cameras of the recording.
    """
    seen = gather_tracks(recording, matches, frames)
    shown = mapped.take(points, frames)  # [frame, individual, keypoint, 3]
    shape = (len(rig), 2, *shown.shape[:-1])
    pixels = np.where(seen.weight[:, None] > 0, seen.pixels, np.nan)
    gap = project_views(rig, shown.reshape(-1, 3).T) - pixels
    return Residuals(pixels.reshape(shape), gap.reshape(shape))


def report_frames(recording: Recording) -> Ints:
    """Return the frames (indices) that are looked at: evenly spread, and not too many."""
    return evenly_spaced(np.arange(len(recording.frames)), REPORT_FRAMES)


@dataclass(frozen=True)
class Look:
    """A group of cameras, and the residuals of its points.

    gap: `[view, 2, frame, individual, keypoint]` in degrees. Image sizes may be (0, 0), unknown.
    """

    group: GroupResult
    gap: Floats
    config: Config


# Of the whole rig


def convergence(look: Look) -> float:
    """Return by how much a camera would turn in as many rounds again, each like the last one."""
    return look.group.adjusted.rounds * look.group.adjusted.turn_deg


# Of each camera


def over_time(look: Look) -> Floats:
    """Return by how much `[view]` detections are beside the points, all to one side, for a while.

    As of a camera that was moved: what a tenth of all stretches of time exceed. A shorter time is
    that of false detections.
    """
    stretches = np.array_split(look.gap, look.config.uncertainty.time_blocks, axis=2)
    counts = np.stack([np.isfinite(part[:, 0]).sum((1, 2, 3)) for part in stretches])
    # a stretch in which a camera matches little does not show where it is
    enough = counts >= np.maximum(1, np.median(counts, axis=0) / 2)
    sides = np.array([[_medians(part[:, axis]) for axis in range(2)] for part in stretches])
    shift = np.where(enough, np.linalg.norm(sides, axis=1), np.nan)  # [stretch, view]
    some = enough.any(0)
    return np.where(some, np.nanquantile(np.where(some, shift, 0.0), 0.9, axis=0), np.nan)


def errors(look: Look) -> Floats:
    """Return the median error `[view]` of the detections."""
    return _medians(np.linalg.norm(look.gap, axis=1))


def _medians(values: Floats) -> Floats:
    """Return the medians `[view]` of values `[view, ...]`, NaN where there are none."""
    flat = values.reshape(len(values), -1)
    found = np.full(len(flat), np.nan)
    some = np.isfinite(flat).any(1)
    found[some] = np.nanmedian(flat[some], axis=1)
    return found


def unmatched(look: Look) -> Floats:
    """Return the error `[view]` of cameras whose detections stay unassigned, by their share."""
    return OPEN_DEG * (1 - matched_share(look.group.recording, look.group.matches)) ** 2


@dataclass(frozen=True)
class CheckKind:
    """What a check measures, and what it means.

    text: what is measured, in degrees. meaning, remedy: of a check that is a reason for the
        verdict; `{value}`, in degrees, and `{camera}` of the meaning are filled in.
    measure: returns the error in degrees, or `[view]` errors, of which the largest counts.
    """

    name: str
    text: str
    meaning: str
    remedy: str
    measure: Callable[[Look], float | Floats]

    def check(self, look: Look) -> Cause:
        """Return the check of a group: of the camera with the largest value.

        A camera without one, where others have it, may be wrong by any angle.
        """
        values = np.atleast_1d(self.measure(look))
        unknown = np.isnan(values)
        if unknown.all():  # of no camera: the check cannot be made
            return Cause(self.name, "", 0.0, self.meaning, self.remedy, measured=False)
        values = np.where(unknown, OPEN_DEG, values)
        worst = int(values.argmax())
        camera = look.group.rig.names[worst] if len(values) > 1 else ""
        meaning, remedy = self.meaning.format(value=values[worst], camera=camera), self.remedy
        if unknown[worst]:
            meaning = f"{camera}: the check of its {self.name} had nothing to measure"
            remedy = "record subjects that it sees together with other cameras"
        measured = not unknown[worst]
        return Cause(self.name, camera, float(values[worst]), meaning, remedy, measured)


def describe_checks() -> dict[str, dict[str, object]]:
    """Return what each check measures and the values of sound recordings, as JSON has them."""
    sound = [0.0, round(SOUND_DEG / 2, 2)]  # more is a reason for the verdict
    return {kind.name: {"text": kind.text, "sound": sound} for kind in CHECKS}


def look_at(group: GroupResult, config: Config) -> Look:
    """Return a group with the residuals of its points."""
    focal = np.array([camera.focal for camera in group.rig.cameras])[:, None, None, None, None]
    return Look(group, np.rad2deg(residuals_of(group).gap / focal), config)


def check_rig(group: GroupResult, config: Config) -> tuple[Cause, ...]:
    """Return all checks of the rig of a group."""
    look = look_at(group, config)
    return tuple(kind.check(look) for kind in CHECKS)


CHECKS = (
    CheckKind(
        "convergence",
        "turn of a camera in the last round of adjusting and matching, times the rounds",
        "adjusting and matching did not converge: a camera may still turn by {value:.1f} deg",
        "look for a camera with large errors, and record longer",
        convergence,
    ),
    CheckKind(
        "over time",
        "bias of the detections to one side in a tenth of all stretches of time",
        "{camera}: detections are {value:.1f} deg to one side for a part of the recording",
        "check whether it was moved or out of step for a part of the recording",
        over_time,
    ),
    CheckKind(
        "unmatched",
        f"{OPEN_DEG:.0f} times the square of the share of unassigned detections",
        "{camera}: many of its detections stay unassigned",
        "check its keypoints: false detections, or people that only this camera sees",
        unmatched,
    ),
    CheckKind(
        "errors",
        "median error of a keypoint of a camera",
        "{camera}: the median error of its keypoints is {value:.1f} deg",
        "check its keypoints, its intrinsics, its clock "
        f"({argument('frame_offset')}), and that it was not moved",
        errors,
    ),
)
