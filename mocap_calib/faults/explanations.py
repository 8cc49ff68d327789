"""What may be wrong with the images, the labels or the intrinsics of one camera, as hypotheses.

Each says under which intrinsics and with which detections the camera would see what it saw, and
which few unknowns go with it.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, Unknown
from mocap_calib.config import PLAIN_FACTORS, DiagnosisConfig
from mocap_calib.recording.corrections import Cropped, Mirrored, Refocused, Resized, Rotated, Sides
from mocap_calib.results import Mend
from mocap_calib.types import Camera, Floats, Recording

QUARTERS = (90, 180, 270)


@dataclass(frozen=True)
class Explanation:
    """One hypothesis of a camera.

    name: unique among those of a camera; "given" where nothing is wrong.
    camera: with the intrinsics that it would have. pixels: `[frame, instance, keypoint, 2]` the
        detections as they would be. sides: left and right of them are exchanged.
    mirrored: the images are. free: what goes with it.
    mend: of an explanation without unknowns.
    """

    name: str
    camera: Camera
    pixels: Floats
    sides: bool = False
    mirrored: bool = False
    free: tuple[Unknown, ...] = ()
    mend: Mend | None = None


def explanations(recording: Recording, view: int) -> tuple[Explanation, ...]:
    """Return all hypotheses of the camera of a view, the one that nothing is wrong first.

    recording: some frames of it. Images of unknown size are not turned.
    """
    alone = recording.select(views=[view])
    name = alone.names[0]
    mends: list[tuple[str, Mend]] = [
        ("sides", Sides(name)),
        ("mirrored", Mirrored(name, sides=False)),
        ("mirrored, sides", Mirrored(name, sides=True)),
    ]
    if alone.cameras[0].size != (0, 0):
        mends += [(f"rotated {degrees}", Rotated(name, degrees)) for degrees in QUARTERS]
    given = Explanation("given", alone.cameras[0], alone.positions[0].astype(np.float64))
    found = [given, *(_mended(alone, word, mend) for word, mend in mends)]
    found += [
        replace(given, name="resized", free=("log_scale",)),
        replace(given, name="cropped", free=("x", "y")),
        replace(given, name="focal", free=("log_focal",)),
    ]
    return tuple(found)


def _mended(alone: Recording, name: str, mend: Mend) -> Explanation:
    """Return the hypothesis that a mend without unknowns is right."""
    mended = mend.apply(alone)
    return Explanation(
        name=name,
        camera=mended.cameras[0],
        pixels=mended.positions[0].astype(np.float64),
        sides=name.endswith("sides"),
        mirrored=name.startswith("mirrored"),
        mend=mend,
    )


def mend_of(explanation: Explanation, fit: CameraFit, config: DiagnosisConfig) -> Mend | None:
    """Return the mend of an explanation with the unknowns that were found."""
    camera = explanation.camera
    if explanation.name == "resized":
        return Resized(camera.name, plain_factor(float(np.exp(fit.unknowns[0])), config))
    if explanation.name == "cropped":
        x, y = (round(-shift) for shift in fit.unknowns.tolist())
        sigma = float(np.sqrt(np.diag(fit.covariance).max()))
        return Cropped(camera.name, x=x, y=y, sigma=sigma)
    if explanation.name == "focal":
        focal = camera.focal * float(np.exp(fit.unknowns[0]))
        return Refocused(camera.name, focal, focal * float(np.sqrt(fit.covariance[0, 0])))
    return explanation.mend


def plain_factor(factor: float, config: DiagnosisConfig) -> float:
    """Return the plain factor (2, 1/2, 2/3, ...) that is meant by an estimated one, or itself.

    Videos are resized by plain factors, and a focal length that is estimated with it is good to
    some per cent alone.
    """
    nearest = min(PLAIN_FACTORS, key=lambda plain: abs(np.log(factor / plain)))
    return nearest if abs(np.log(factor / nearest)) <= config.plain_factor else factor


def is_acceptable(explanation: Explanation, fit: CameraFit, config: DiagnosisConfig) -> bool:
    """Return whether the unknowns of an explanation are what it says, and are significant."""
    if explanation.free and len(fit.error) < config.telling_keypoints:
        return False
    if explanation.name == "resized":
        change = abs(float(fit.unknowns[0]))
        likely = config.least_resize < change < config.most_resize
        return likely and fit.significance > config.resize_significance
    if explanation.name == "focal":
        change = abs(float(fit.unknowns[0]))
        likely = config.least_focal_change < change < config.most_focal_change
        return likely and fit.significance > config.focal_significance
    if explanation.name == "cropped":
        return fit.significance > config.crop_significance and _may_be_cropped(
            explanation, fit, config
        )
    return True


def _may_be_cropped(explanation: Explanation, fit: CameraFit, config: DiagnosisConfig) -> bool:
    """Return whether the images may be a part of those that the intrinsics are for.

    Cutting moves what is seen to the left and up, and nothing is seen beyond what was left.
    """
    size = np.array(explanation.camera.size, dtype=np.float64)
    shift, sigma = fit.unknowns, np.sqrt(np.diag(fit.covariance))
    if not size.all() or (shift > 2 * sigma).any():
        return False
    if not (-shift > config.least_crop * size).any():
        return False
    beyond = explanation.pixels > size + np.minimum(shift + 2 * sigma, 0.0)
    seen = max(int(np.isfinite(explanation.pixels[..., 0]).sum()), 1)
    return float(beyond.any(-1).sum()) / seen <= config.crop_outside
