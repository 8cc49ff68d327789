"""The verdict on a calibration that was given, and what is said of its cameras."""

import numpy as np

from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.results import VerdictWord, VerifiedCamera, word_of_error
from mocap_calib.types import Floats
from mocap_calib.verdict.rig_changes import RigChange

_CALIBRATE = "calibrate anew: `mocap-calib run`"
_RECORD = "verify again with another recording"
_OPEN_DEG = 5.0  # what stands for errors of unknown size
_TELLING = 2.0  # standard deviations from which on a turn or a shift is worth a word


def judge_calibration(
    cameras: tuple[VerifiedCamera, ...],
    change: RigChange,
    sigma: Floats,
    names: tuple[str, ...],
    config: Config,
) -> tuple[VerdictWord, list[str]]:
    """Return the verdict on a calibration, and why it is no better.

    It is that on the camera that is worst off: how far it is from where the keypoints have it, and
    how uncertain that is; the cameras that moved being where they are now. sigma: `[view]`
    radians; names: of these views.
    """
    uncertain = np.rad2deg(sigma)
    refitted = change.moved & (len(names) > 2)  # of two nobody knows where they are now
    apart = np.where(refitted, 0.0, np.rad2deg(change.difference))
    expected = np.hypot(uncertain, apart)
    worst = int(expected.argmax())
    unexplained = change.disagreement > config.verify.pair_disagreement
    unsaid = unexplained and apart.max() > VERDICT_LIMITS_DEG[0]
    unplaced = any(camera.word == "inconsistent" for camera in cameras)
    reasons = []
    if uncertain.max() > VERDICT_LIMITS_DEG[1]:
        reasons.append(
            f"the keypoints leave {names[int(uncertain.argmax())]} uncertain by "
            f"{uncertain.max():.1f} deg: record longer, with subjects that move through the room"
        )
    if unsaid:
        # keypoints that determine nothing give no better calibration
        remedy = _CALIBRATE if uncertain.max() <= VERDICT_LIMITS_DEG[1] else _RECORD
        reasons.append(
            f"the cameras stand up to {apart.max():.1f} deg ({names[int(apart.argmax())]}) from "
            f"where these keypoints have them, and no single one explains it: {remedy}"
        )
    elif expected[worst] > VERDICT_LIMITS_DEG[1]:
        reasons.append(
            f"{names[worst]} may be off by {expected[worst]:.1f} deg, by these keypoints"
        )
    if unsaid or unplaced:  # the calibration may be wrong by any angle
        expected = np.hypot(expected, _OPEN_DEG)
    return word_of_error(float(expected.max())), reasons


def explain_cameras(cameras: tuple[VerifiedCamera, ...]) -> list[str]:
    """Return a line for each camera with which something is wrong, and what to do about it."""
    lines = []
    if len(cameras) == 2 and all(camera.word == "moved" for camera in cameras):
        first, second = cameras
        turn = f"{_deg(first.turn)} +- {_deg(first.turn_sigma)} deg"
        return [
            f"{first.name} or {second.name} moved, by {turn} against the other; with two cameras "
            f"nobody can say which: {_CALIBRATE}"
        ]
    for camera in cameras:
        if camera.word == "moved":
            lines.append(f"{camera.name} {describe_move(camera)}: put it back, or {_CALIBRATE}")
        if camera.word == "focal":
            change = float(np.expm1(camera.focal_change))
            lines.append(
                f"{camera.name}: its focal length is {abs(change):.1%} "
                f"{'longer' if change > 0 else 'shorter'} than given (zoom, or images of another "
                f"size): mend its intrinsics, or {_CALIBRATE}"
            )
        if camera.word == "inconsistent":
            lines.append(
                f"{camera.name}: nothing that it sees goes with the other cameras, wherever it "
                "stands: check its files and its clock"
            )
        if camera.word == "not checked":
            lines.append(f"{camera.name}: sees too little with the others to be checked")
    return lines


def describe_move(camera: VerifiedCamera) -> str:
    """Return by how much a camera moved, for a person: `is turned by 2.1 +- 0.2 deg`."""
    parts = []
    if camera.turn > _TELLING * camera.turn_sigma:
        parts.append(f"turned by {_deg(camera.turn)} +- {_deg(camera.turn_sigma)} deg")
    if camera.shift > _TELLING * camera.shift_sigma:
        sigma = camera.relative_shift * camera.shift_sigma / camera.shift
        parts.append(f"shifted by {camera.relative_shift:.1%} +- {sigma:.1%} of the rig's size")
    return f"is {' and '.join(parts)}" if parts else "stands elsewhere"


def describe_refits(cameras: tuple[VerifiedCamera, ...]) -> list[str]:
    """Return a line for each camera that is elsewhere in the mended rig, for its file."""
    return [
        f"{camera.name}: refitted by keypoints; as given before it {describe_move(camera)}"
        for camera in cameras
        if camera.word in ("moved", "focal")
    ]


def _deg(angle: float) -> str:
    """Return an angle of radians as a number of degrees."""
    return f"{np.rad2deg(angle):.2f}"
