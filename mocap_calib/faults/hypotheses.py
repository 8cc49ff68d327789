"""What may be wrong with the images, the labels or the intrinsics of one camera, and its words.

Each hypothesis states under which intrinsics and with which detections the camera would see what
it saw, and which few unknowns are free under it. In words: what is wrong, what to do about it, and
the option that states it beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, Unknown
from mocap_calib.config import PLAIN_FACTORS, DiagnosisConfig
from mocap_calib.errors import count
from mocap_calib.recording.corrections import (
    Cropped,
    Flipped,
    Mirrored,
    Refocused,
    Resized,
    Rotated,
    Sides,
)
from mocap_calib.results import Clocks, Fault, FaultWord, Mend
from mocap_calib.types import Camera, CameraClock, EstimatedCamera, Floats, Recording

ADVICE: dict[FaultWord, str] = {
    "mirrored": "mirror the video and detect again",
    "flipped": "write keypoints with the y axis down, from the upper border of the image",
    "sides": "exchange left and right in the names of its keypoints",
    "rotated": "give the intrinsics of the images as they are",
    "resized": "give the intrinsics of images of this size",
    "cropped": "say where the part lies in the whole image",
    "focal": "check its intrinsics, its zoom and the size of its images",
    "exchanged": "exchange the names of the two keypoint files, or of the two cameras",
    "moved": "use the rig of each part of the recording",
}
_SAYS: dict[FaultWord, str] = {
    "mirrored": "images horizontally mirrored",
    "flipped": "the y axis goes up: images upside down and mirrored",
    "sides": "left and right exchanged",
    "rotated": "images turned clockwise by {0.degrees} deg against its intrinsics",
    "resized": "images resized by {0.text} against its intrinsics",
    "cropped": "images cut off by {0.x:.0f} px at the left and {0.y:.0f} px at the top",
    "focal": "focal length {0.focal:.0f} +- {0.sigma:.0f} px, other than its intrinsics say",
}
_OPTION: dict[FaultWord, str] = {
    "mirrored": "--mirrored {0.camera}",
    "flipped": "--flipped {0.camera}",
    "sides": "--sides {0.camera}",
    "rotated": "--rotated {0.camera}:{0.degrees}",
    "resized": "--resized {0.camera}:{0.text}",
    "cropped": "--crop-offset {0.camera}:{0.x:.0f},{0.y:.0f}",
    "focal": "--refine focal --focal-per-camera",  # all focal lengths are estimated then
    "exchanged": "--exchanged {0.camera},{0.other}",
    "moved": "--moved {0.camera}:{0.frame}",
}
_ADVICE_ON_CLOCKS = "number its frames by the clock of the others"


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis about the input of a camera.

    name: unique among those of a camera; "given" where nothing is wrong.
    camera: with the intrinsics that it would have. pixels: `[frame, instance, keypoint, 2]` the
        detections as they would be.
    free: the unknowns besides the pose. mend: the correction, where there are no unknowns.
    """

    name: str
    camera: Camera
    pixels: Floats
    free: tuple[Unknown, ...] = ()
    mend: Mend | None = None


def list_hypotheses(recording: Recording, view: int) -> tuple[Hypothesis, ...]:
    """Return all hypotheses of the camera of a view, first that nothing is wrong.

    recording: some frames of it. Images of unknown size are not rotated, and intrinsics that were
        estimated from the recording are no input that could be wrong.
    """
    alone = recording.select(views=[view])
    name = alone.names[0]
    mends: list[tuple[str, Mend]] = [
        ("sides", Sides(name)),
        ("mirrored", Mirrored(name, sides=False)),
        ("mirrored, sides", Mirrored(name, sides=True)),
        ("flipped", Flipped(name)),
    ]
    if alone.cameras[0].size != (0, 0):
        mends += [(f"rotated {degrees}", Rotated(name, degrees)) for degrees in (90, 180, 270)]
    if not isinstance(alone.cameras[0], EstimatedCamera):
        mends += [(f"resized {factor:.3g}", Resized(name, factor)) for factor in PLAIN_FACTORS]
    given = Hypothesis("given", alone.cameras[0], alone.positions[0].astype(np.float64))
    found = [given]
    for word, mend in mends:
        fixed = mend.apply(alone)
        pixels = fixed.positions[0].astype(np.float64)
        found.append(Hypothesis(word, fixed.cameras[0], pixels, mend=mend))
    if not isinstance(alone.cameras[0], EstimatedCamera):
        found += [
            replace(given, name="cropped", free=("x", "y")),
            replace(given, name="focal", free=("log_focal",)),
            replace(given, name="resized", free=("log_width", "log_height")),
        ]
    return tuple(found)


def mend_of(hypothesis: Hypothesis, fit: CameraFit) -> Mend | None:
    """Return the correction of a hypothesis with the unknowns that were found."""
    camera = hypothesis.camera
    if hypothesis.name == "cropped":
        x, y = (round(-shift) for shift in fit.unknowns.tolist())
        sigma = float(np.sqrt(np.diag(fit.covariance).max()))
        return Cropped(camera.name, x=x, y=y, sigma=sigma)
    if hypothesis.name == "focal":
        focal = camera.focal * float(np.exp(fit.unknowns[0]))
        return Refocused(camera.name, focal, focal * float(np.sqrt(fit.covariance[0, 0])))
    if hypothesis.name == "resized":
        x, y = np.exp(fit.unknowns).tolist()
        sigma = float(np.sqrt(np.diag(fit.covariance).max()))
        return _plain_size(camera.name, fit) or Resized(camera.name, x, y, sigma=sigma)
    return hypothesis.mend


def _plain_size(camera: str, fit: CameraFit) -> Resized | None:
    """Return plain factors of width and height, of one of them or unlike, where a fit has such."""
    sigma, plain = np.sqrt(np.diag(fit.covariance)), np.array((1.0, *PLAIN_FACTORS))
    beside = np.abs(fit.unknowns[:, None] - np.log(plain)) / sigma[:, None]
    near = beside.argmin(1)
    certain = (beside.min(1) < 2).all() and sigma.max() < DiagnosisConfig.sound_focal
    return Resized(camera, *plain[near].tolist()) if certain and near[0] != near[1] else None


def log_bayes_factor(unknowns: Floats, covariance: Floats, sound: Floats, faulty: Floats) -> float:
    """Return the log evidence of a fault beside sound intrinsics, by Laplace's approximation.

    Both have zero-mean normal priors of the unknowns, wide and narrow: the marginal densities of
    the estimate are N(0, covariance + prior) (Kass and Raftery 1995, eq. 5).

    unknowns: `[unknown]` estimates; covariance: of them. sound, faulty: `[unknown]` standard
        deviations of sound and of faulty intrinsics.
    """
    narrow, wide = (covariance + np.diag(sigma**2) for sigma in (sound, faulty))
    squares = [float(unknowns @ np.linalg.solve(each, unknowns)) for each in (narrow, wide)]
    volumes = [float(np.linalg.slogdet(each)[1]) for each in (narrow, wide)]
    return (squares[0] - squares[1] + volumes[0] - volumes[1]) / 2


def evidence_of_unknowns(hypothesis: Hypothesis, fit: CameraFit, config: DiagnosisConfig) -> float:
    """Return the log evidence (nats) for the unknowns of a hypothesis, not for sound ones."""
    if hypothesis.name != "cropped":
        tests: tuple[list[float], ...] = ([1.0],)
        if hypothesis.name == "resized":  # with equal factors the focal length may be wrong
            plain = _plain_size(hypothesis.camera.name, fit)
            tests = ([1.0, -1.0],) if plain else ([1.0, -1.0], [1.0, 0.0], [0.0, 1.0])
        sound, faulty = np.array([config.sound_focal]), np.array([config.faulty_focal])
        return min(
            log_bayes_factor(each @ fit.unknowns, each @ fit.covariance @ each.T, sound, faulty)
            for each in map(np.atleast_2d, tests)
        )
    size = np.array(hypothesis.camera.size, dtype=np.float64)
    if not size.all() or not _may_be_cropped(hypothesis, fit, size):
        return -np.inf
    sound, faulty = config.sound_centre * size, config.faulty_centre * size
    return log_bayes_factor(fit.unknowns, fit.covariance, sound, faulty)


def _may_be_cropped(hypothesis: Hypothesis, fit: CameraFit, size: Floats) -> bool:
    """Return whether the images may be a part of those that the intrinsics are for.

    Cropping moves what is seen to the left and up, and nothing is seen beyond what is left.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    if (fit.unknowns > 2 * sigma).any():
        return False
    seen = hypothesis.pixels[np.isfinite(hypothesis.pixels[..., 0])]
    part = size + np.minimum(fit.unknowns + 2 * sigma, 0.0)
    return bool((np.percentile(seen, 99.5, axis=0) <= part).all())


# --- faults in words


def describe(mend: Mend) -> str:
    """Return what is wrong with the files of a camera, for a person."""
    says = _SAYS[mend.word].format(mend)
    return f"{says}, {_SAYS['sides']}" if isinstance(mend, Mirrored) and mend.sides else says


def option_of(mend: Mend | CameraClock) -> str:
    """Return the command-line option that states a correction beforehand, "" if there is none."""
    if isinstance(mend, CameraClock):
        return f"--frame-offset {mend.camera}:{-mend.offset}" if mend.kind == "clock" else ""
    option = _OPTION[mend.word].format(mend)
    if isinstance(mend, Mirrored) and not mend.sides:
        option += f" --sides {mend.camera}"
    return option


def describe_corrected(recording: Recording, *, decided: bool = False) -> tuple[str, ...]:
    """Return a line for each camera whose intrinsics were corrected by the sizes of its images.

    decided: the direction of quarter turns, which sizes do not show, is known.
    """
    options: dict[str, list[str]] = {}
    for fault in recording.corrected:
        option = option_of(cast(Mend, fault.mend))
        if isinstance(fault.mend, Rotated) and not decided:
            option += f" or {fault.camera}:{360 - fault.mend.degrees}"
        if isinstance(fault.mend, Cropped):
            option += ", the middle"
        options.setdefault(f"{fault.camera}: {fault.says}", []).append(option)
    return tuple(
        f"{says}; intrinsics corrected, as by {' '.join(each)}" for says, each in options.items()
    )


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
        "advice": ADVICE.get(fault.word, _ADVICE_ON_CLOCKS) if mend else None,
        "option": (option_of(mend) or None) if mend else None,
        **fault.evidence,
    }


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
            mend=each if applied else None,
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
