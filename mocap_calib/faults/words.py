"""Faults in words: what is wrong, what to do about it, and the option that states it beforehand."""

from collections.abc import Sequence
from typing import Any, cast

from mocap_calib.clocks.estimate import Retimed
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
from mocap_calib.results import CalibrationResult, Clocks, Fault, FaultWord, Mend
from mocap_calib.types import CameraClock
from mocap_calib.wording import count

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


# --- clocks


def clock_faults(clocks: Clocks, *, applied: bool) -> tuple[Fault, ...]:
    """Return the faults of the cameras whose clocks differ.

    applied: the recording was put on one clock.
    """
    return tuple(
        Fault(
            camera=each.camera,
            word=cast(FaultWord, each.kind),
            says=describe_clock_fault(each),
            evidence=dict(each.evidence),
            mend=Retimed(each) if applied else None,
        )
        for each in clocks.cameras
        if each.differs and each.evidence  # what somebody said is no finding
    )


def describe_clock_fault(clock: CameraClock) -> str:
    """Return how a clock differs, for a person, without the name of the camera."""
    if clock.kind == "clock":
        late = "late" if clock.offset > 0 else "early"
        return f"its clock is {count(abs(clock.offset), 'frame')} {late}"
    if clock.kind == "rate" and clock.rate != 1.0:
        return f"it has {clock.rate:g} frames for each of the other cameras"
    last = clock.table[-1][1] - clock.table[0][1]
    drift = f"its clock changes by {count(abs(last), 'frame')} over the recording"
    if clock.kind == "rate":
        return f"{drift}, evenly: its frame rate is another"
    return f"it lost frames and numbered the others without gaps: {drift}"


def describe_clock(clock: CameraClock, clocks: Clocks) -> dict[str, Any]:
    """Return how the clock of a camera differs from that of the others, as run.json has it."""
    return {
        "camera": clock.camera,
        "kind": clock.kind,
        "offset_frames": clock.offset,
        "rate": float(clock.rate),
        "table": [{"frame": frame, "offset": offset} for frame, offset in clock.table],
        "applied": clock.differs and clocks.changed,
        "evidence": dict(clock.evidence),
    }


def describe_unknown_clocks(result: CalibrationResult) -> list[str]:
    """Say that the clocks of the cameras could not be compared, where that is so."""
    looked = result.config.sync.mode != "off"
    if looked and all(clock.kind == "not known" for clock in result.clocks.cameras):
        return [
            "the clocks of the cameras are taken as they are: too little moves, or too few frames "
            "are shared, to compare them"
        ]
    return []
