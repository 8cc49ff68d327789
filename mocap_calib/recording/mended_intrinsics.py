"""Put right intrinsics that are not those of a camera's images.

The images are turned, resized or cropped, or the intrinsics are those of another camera or zoom.
The intrinsics are changed, so that they fit the images as they are.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.recording.mending import find_view
from mocap_calib.types import Camera, EstimatedCamera, FaultWord, Recording


@dataclass(frozen=True)
class Rotated:
    """The images of a camera are turned clockwise against its intrinsics, by quarters.

    degrees: 90, 180 or 270.
    """

    camera: str
    degrees: int
    word: ClassVar[FaultWord] = "rotated"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        return f"--rotated {self.camera}:{self.degrees}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "give the intrinsics of the images as they are"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics that are turned like the images."""
        camera = recording.cameras[find_view(recording, self.camera)]
        _check_size(camera, self.option)
        for _ in range(self.degrees // 90):
            camera = _turn_clockwise(camera)
        return _with_camera(recording, camera)


@dataclass(frozen=True)
class Resized:
    """The images of a camera are larger or smaller than its intrinsics say.

    factor: size of the images, as a multiple of what the intrinsics are for.
    """

    camera: str
    factor: float
    word: ClassVar[FaultWord] = "resized"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        return f"--resized {self.camera}:{self.factor:.4g}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "give the intrinsics of images of this size"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics of images of this size."""
        camera = recording.cameras[find_view(recording, self.camera)]
        matrix = camera.matrix.copy()
        matrix[:2] *= self.factor
        matrix[:2, 2] += (self.factor - 1) / 2  # pixel centres are integers
        width, height = (round(self.factor * length) for length in camera.size)
        return _with_camera(recording, replace(camera, size=(width, height), matrix=matrix))


@dataclass(frozen=True)
class Cropped:
    """The images of a camera are a part of those that its intrinsics are for.

    x, y: corner of the part, in pixels. sigma: standard deviation of both where they are an
        estimate, 0 where they are known.
    """

    camera: str
    x: float
    y: float
    sigma: float = 0.0
    word: ClassVar[FaultWord] = "cropped"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        return f"--crop-offset {self.camera}:{self.x:.0f},{self.y:.0f}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "say where the part lies in the whole image"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics of the part that the images show."""
        camera = recording.cameras[find_view(recording, self.camera)]
        matrix = camera.matrix.copy()
        matrix[:2, 2] -= (self.x, self.y)
        return _with_camera(recording, replace(camera, matrix=matrix))


@dataclass(frozen=True)
class Exchanged:
    """The files of two cameras are exchanged: each has the intrinsics of the other."""

    camera: str
    other: str
    word: ClassVar[FaultWord] = "exchanged"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        return f"--exchanged {self.camera},{self.other}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "exchange the names of the two keypoint files, or of the two cameras"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording in which each of the two has the intrinsics of the other."""
        a, b = (find_view(recording, name) for name in (self.camera, self.other))
        cameras = list(recording.cameras)
        cameras[a] = replace(recording.cameras[b], name=self.camera)
        cameras[b] = replace(recording.cameras[a], name=self.other)
        return replace(recording, cameras=tuple(cameras))


@dataclass(frozen=True)
class Refocused:
    """A camera has another focal length than its intrinsics say.

    focal: in pixels, as estimated from the recording; sigma: its standard deviation.
    """

    camera: str
    focal: float
    sigma: float
    word: ClassVar[FaultWord] = "focal"

    @property
    def option(self) -> str:
        """How a user states it beforehand: all focal lengths are estimated then."""
        return "--refine focal --focal-per-camera"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "check its intrinsics, its zoom and the size of its images"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the estimated focal length."""
        camera = recording.cameras[find_view(recording, self.camera)]
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= self.focal / camera.focal
        refocused = EstimatedCamera.of(camera, focal_sigma=self.sigma, k1_sigma=0.0)
        return _with_camera(recording, replace(refocused, matrix=matrix))


def _turn_clockwise(camera: Camera) -> Camera:
    """Return the intrinsics for images turned clockwise by a quarter.

    What was at (x, y) is at (height - 1 - y, x); with normalised x' = -y and y' = x OpenCV's
    tangential coefficients become p1' = p2 and p2' = -p1.
    """
    width, height = camera.size
    (fx, _, cx), (_, fy, cy), _ = camera.matrix
    distortion = camera.distortion.copy()
    if not camera.fisheye and len(distortion) >= 4:
        distortion[[2, 3]] = distortion[3], -distortion[2]
    matrix = np.array([[fy, 0.0, height - 1 - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]])
    return replace(camera, size=(height, width), matrix=matrix, distortion=distortion)


def _with_camera(recording: Recording, camera: Camera) -> Recording:
    """Return the recording with other intrinsics of the camera of that name."""
    cameras = [camera if each.name == camera.name else each for each in recording.cameras]
    return replace(recording, cameras=tuple(cameras))


def _check_size(camera: Camera, option: str) -> None:
    """Raise MismatchError where the size of a camera's images is not known."""
    if camera.size == (0, 0):
        raise MismatchError(
            f"{option}: expected the size of the images of camera {camera.name}, found none; "
            f"say --image-size {camera.name}:WIDTHxHEIGHT"
        )
