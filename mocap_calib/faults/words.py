"""Faults in words: what is wrong, what to do about it, and the option that states it beforehand."""

from collections.abc import Sequence
from typing import Any

from mocap_calib.faults.clock_faults import Retimed
from mocap_calib.recording.corrections import (
    Cropped,
    Exchanged,
    Mirrored,
    Moved,
    Refocused,
    Resized,
    Rotated,
    Sides,
)
from mocap_calib.results import Fault, FaultWord, Mend

ADVICE: dict[FaultWord, str] = {
    "mirrored": "mirror the video and detect again",
    "sides": "exchange left and right in the names of its keypoints",
    "rotated": "give the intrinsics of the images as they are",
    "resized": "give the intrinsics of images of this size",
    "cropped": "say where the part lies in the whole image",
    "focal": "check its intrinsics, its zoom and the size of its images",
    "exchanged": "exchange the names of the two keypoint files, or of the two cameras",
    "moved": "use the rig of each part of the recording",
}
_ADVICE_ON_CLOCKS = "number its frames by the clock of the others"


def describe(mend: Mend) -> str:
    """Return what is wrong with the files of a camera, for a person."""
    says: str = mend.word
    match mend:
        case Mirrored(sides=sides):
            says = "images horizontally mirrored"
            says += ", left and right exchanged" if sides else ""
        case Sides():
            says = "left and right exchanged"
        case Rotated(degrees=degrees):
            says = f"images turned clockwise by {degrees} deg against its intrinsics"
        case Resized(factor=factor):
            says = f"images resized by {factor:.3g} against its intrinsics"
        case Cropped(x=x, y=y):
            says = f"images cut off by {x:.0f} px at the left and {y:.0f} px at the top"
        case Refocused(focal=focal, sigma=sigma):
            says = f"focal length {focal:.0f} +- {sigma:.0f} px, other than its intrinsics say"
    return says


def option_of(mend: Mend) -> str:
    """Return the command-line option that states a correction beforehand, "" if there is none."""
    option = ""
    match mend:
        case Mirrored(camera, sides=sides):
            option = f"--mirrored {camera}" if sides else f"--mirrored {camera} --sides {camera}"
        case Sides(camera):
            option = f"--sides {camera}"
        case Rotated(camera, degrees):
            option = f"--rotated {camera}:{degrees}"
        case Resized(camera, factor):
            option = f"--resized {camera}:{factor:.4g}"
        case Cropped(camera, x, y):
            option = f"--crop-offset {camera}:{x:.0f},{y:.0f}"
        case Exchanged(camera, other):
            option = f"--exchanged {camera},{other}"
        case Refocused():  # all focal lengths are estimated then
            option = "--refine focal --focal-per-camera"
        case Moved(camera, frame):
            option = f"--moved {camera}:{frame}"
        case Retimed(clock) if clock.kind == "clock":
            option = f"--frame-offset {clock.camera}:{-clock.offset}"
    return option


def describe_faults(faults: Sequence[Fault]) -> dict[str, Any]:
    """Return the faults of a camera by word; further ones of a word under `further`."""
    described: dict[str, Any] = {}
    for fault in faults:
        if fault.word in described:
            described[fault.word].setdefault("further", []).append(_describe_fault(fault))
        else:
            described[fault.word] = _describe_fault(fault)
    return described


def _describe_fault(fault: Fault) -> dict[str, Any]:
    """Return a fault with the numbers it rests on, and how it was corrected."""
    mend = fault.mend
    return {
        "says": fault.says,
        "mended": mend is not None,
        "advice": ADVICE.get(mend.word, _ADVICE_ON_CLOCKS) if mend else None,
        "option": (option_of(mend) or None) if mend else None,
        **fault.evidence,
    }
