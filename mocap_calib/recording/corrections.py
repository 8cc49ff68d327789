"""Correct what is wrong with the files of one camera.

Each correction is a frozen record that turns a recording into another one: of detections
(`Mirrored`, `Flipped`, `Sides`, `Moved`) or of intrinsics, so that they fit the images as they are.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mocap_calib.config import EPOCH_MARK, UncertaintyConfig
from mocap_calib.errors import MismatchError, argument
from mocap_calib.geometry.lens import centre_sigma
from mocap_calib.recording.epochs import start_of, views_by_camera
from mocap_calib.recording.joints import side_pairs
from mocap_calib.results import FaultWord, Mend
from mocap_calib.types import Camera, EstimatedCamera, Floats, Ints, Recording


def apply_mends(recording: Recording, mends: tuple[Mend, ...]) -> Recording:
    """Return the recording with all mends applied, one after the other.

    Raises MismatchError where a mend is of a camera that the recording does not have, or does not
    know enough of.
    """
    for mend in mends:
        recording = mend.apply(recording)
    return recording


@dataclass(frozen=True)
class Mirrored:
    """The images of a camera are mirrored, left for right.

    sides: the detector took the left limbs for the right ones as well, as it does where it sees
        nothing but the mirrored image.
    """

    camera: str
    sides: bool = True
    word: ClassVar[FaultWord] = "mirrored"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the detections as the camera would have seen them."""
        mirrored = _reverse_axis(recording, self.camera, 0)
        return Sides(self.camera).apply(mirrored) if self.sides else mirrored


@dataclass(frozen=True)
class Flipped:
    """The y axis of the keypoints of a camera goes up, from the lower border of its images."""

    camera: str
    word: ClassVar[FaultWord] = "flipped"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the y axis of the camera down."""
        return _reverse_axis(recording, self.camera, 1)


@dataclass(frozen=True)
class Sides:
    """The keypoints of a camera's left and right limbs are exchanged."""

    camera: str
    word: ClassVar[FaultWord] = "sides"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with left and right of the camera exchanged."""
        view = find_view(recording, self.camera)
        order = exchanged_sides(recording.keypoints)
        positions, confidence = recording.positions.copy(), recording.confidence.copy()
        positions[view] = positions[view][:, :, order]
        confidence[view] = confidence[view][:, :, order]
        return replace(recording, positions=positions, confidence=confidence)


@dataclass(frozen=True)
class Moved:
    """A camera stands, or looks, elsewhere from a frame (number) on."""

    camera: str
    frame: int
    word: ClassVar[FaultWord] = "moved"

    @property
    def later_name(self) -> str:
        """Name of the camera from the frame on."""
        return f"{self.camera}{EPOCH_MARK}{self.frame}"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with two cameras: up to the frame, and from it on."""
        view = self._last_before(recording)
        later = np.asarray(recording.frames >= self.frame)
        both = [*range(view + 1), *range(view, len(recording.cameras))]
        cameras = [recording.cameras[each] for each in both]
        cameras[view + 1] = replace(cameras[view + 1], name=self.later_name)
        split = replace(
            recording,
            cameras=tuple(cameras),
            positions=recording.positions[both],
            confidence=recording.confidence[both],
            tracked=recording.tracked[both],
        )
        for part, hidden in ((view, later), (view + 1, ~later)):
            split.positions[part, hidden] = np.nan
            split.confidence[part, hidden] = 0.0
        return split

    def _last_before(self, recording: Recording) -> int:
        """Return the view of the camera before the frame; it may have moved earlier.

        Raises MismatchError where the recording does not have the camera.
        """
        find_view(recording, self.camera)
        names = recording.names
        return max(
            view
            for view in views_by_camera(names)[self.camera]
            if start_of(names[view], names) < self.frame
        )


@dataclass(frozen=True)
class Rotated:
    """The images of a camera are turned clockwise against its intrinsics, by quarters.

    degrees: 90, 180 or 270.
    """

    camera: str
    degrees: int
    word: ClassVar[FaultWord] = "rotated"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics that are turned like the images."""
        camera = recording.cameras[find_view(recording, self.camera)]
        _check_size(camera)
        for _ in range(self.degrees // 90):
            camera = _turn_clockwise(camera)
        return _with_camera(recording, camera)


@dataclass(frozen=True)
class Resized:
    """The images of a camera are larger or smaller than its intrinsics say.

    x, y: width and height of the images, as multiples of what the intrinsics are for; y is None
        where the two are the same. sigma: standard deviation of the logarithms where they are an
        estimate, 0 where they are known.
    """

    camera: str
    x: float
    y: float | None = None
    sigma: float = 0.0
    word: ClassVar[FaultWord] = "resized"

    @property
    def factors(self) -> Floats:
        """Of width and height."""
        return np.array([self.x, self.x if self.y is None else self.y])

    @property
    def text(self) -> str:
        """The factors as options have them: one, or that of the width and that of the height."""
        return ",".join(f"{factor:.4g}" for factor in dict.fromkeys(self.factors.tolist()))

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics of images of this size."""
        camera, factors = recording.cameras[find_view(recording, self.camera)], self.factors
        matrix = camera.matrix.copy()
        matrix[:2] *= factors[:, None]
        matrix[:2, 2] += (factors - 1) / 2  # pixel centres are integers
        width, height = np.rint(factors * camera.size).astype(int).tolist()
        largest = float(factors.max())
        resized = replace(
            camera,
            size=(width, height),
            matrix=matrix,
            centre_sigma=camera.centre_sigma and largest * camera.centre_sigma,
            focal_sigma=camera.focal_sigma and largest * camera.focal_sigma,
        )
        if self.sigma:
            sigma = np.hypot(centre_sigma(resized, UncertaintyConfig()), self.sigma * matrix[:2, 2])
            resized = EstimatedCamera.of(
                replace(resized, centre_sigma=float(sigma.max())),
                focal_sigma=self.sigma * resized.focal,
                k1_sigma=0.0,
            )
        return _with_camera(recording, resized)


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

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with intrinsics of the part that the images show."""
        camera = recording.cameras[find_view(recording, self.camera)]
        matrix = camera.matrix.copy()
        matrix[:2, 2] -= (self.x, self.y)
        known = centre_sigma(camera, UncertaintyConfig())  # as of the whole image
        for fault in recording.corrected:  # a corner that was guessed is replaced by an estimate
            if isinstance(fault.mend, Cropped) and fault.camera == self.camera:
                known = float(np.sqrt(max(known**2 - fault.mend.sigma**2, 0.0)))
        sigma = float(np.hypot(known, self.sigma))
        return _with_camera(recording, replace(camera, matrix=matrix, centre_sigma=sigma))


@dataclass(frozen=True)
class Exchanged:
    """The files of two cameras are exchanged: each has the intrinsics of the other."""

    camera: str
    other: str
    word: ClassVar[FaultWord] = "exchanged"

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

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the estimated focal length."""
        camera = recording.cameras[find_view(recording, self.camera)]
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= self.focal / camera.focal
        refocused = EstimatedCamera.of(camera, focal_sigma=self.sigma, k1_sigma=0.0)
        return _with_camera(recording, replace(refocused, matrix=matrix))


def find_view(recording: Recording, camera: str) -> int:
    """Return the index of a camera. Raises MismatchError where the recording does not have it."""
    if camera not in recording.names:
        raise MismatchError(
            "",
            f"one of the cameras {', '.join(recording.names)}",
            camera,
            "name a camera of this recording",
        )
    return recording.names.index(camera)


def exchanged_sides(keypoints: tuple[str, ...]) -> Ints:
    """Return the order `[keypoint]` in which left and right keypoints have changed places."""
    order = np.arange(len(keypoints))
    for left, right in side_pairs(keypoints):
        order[[left, right]] = right, left
    return order


def _reverse_axis(recording: Recording, name: str, axis: int) -> Recording:
    """Return the recording with the x (0) or the y axis (1) of a camera's keypoints reversed."""
    view = find_view(recording, name)
    camera, positions = recording.cameras[view], recording.positions.copy()
    last = camera.size[axis] - 1 if camera.size[axis] else 2 * camera.matrix[axis, 2]
    positions[view, ..., axis] = last - positions[view, ..., axis]
    return replace(recording, positions=positions)


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


def _check_size(camera: Camera) -> None:
    """Raise MismatchError where the size of a camera's images is not known."""
    if camera.size == (0, 0):
        raise MismatchError(
            camera.name,
            "the size of its images, by which they are rotated",
            "none",
            f"give it, as in {argument('image_size', f'{camera.name}:WIDTHxHEIGHT')}",
        )
