"""The nouns of the program: frozen records, checked when they are made.

Axis names, always in this order: view, frame, instance, individual, keypoint, coordinate.
An *instance* is a detection in one view; an *individual* is the same body in all views.
*Pose* means the pose of a body; cameras have *extrinsics*. Transforms are named
`target_from_source`: x_cam = R x_world + t. Missing is NaN in floats and -1 in labels.
docs/conventions.md has the rest.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
# float32 where whole recordings are kept: that is a ten-thousandth of a pixel
Reals = NDArray[np.floating[Any]]

T = TypeVar("T")
R = TypeVar("R")


def check_shape(owner: str, array: NDArray[np.generic], *shape: int | None) -> None:
    """Hold an array to its documented shape `[*shape]`; None stands for any length.

    Raises ValueError, which names the owner and both shapes.
    """
    fits = array.ndim == len(shape) and all(
        expected in (None, found) for expected, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = tuple("any" if length is None else length for length in shape)
        raise ValueError(f"{owner}: expected shape {expected}, got {array.shape}")


class Progress(Protocol):
    """How the library tells of its progress; it never prints."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Tell that `done` of `total` steps of `stage` are finished."""


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress: the default where nobody listens."""


class Mapper(Protocol):
    """Where the library has independent work done: threads, processes or other machines."""

    def __call__(self, function: Callable[[T], R], items: Iterable[T], /) -> Iterable[R]:
        """Return `function` of every item, in any order.

        The function and the items can be pickled. Items may be taken long before their results
        come.
        """


@dataclass(frozen=True)
class Skeleton:
    """The vocabulary of one kind of body.

    keypoints: `[keypoint]` names.
    edges: pairs (parent, child) of indices into the names.
    symmetries: pairs (left, right) of indices.
    aliases: other spellings, normalised name -> keypoint name.
    layouts: what names mean where all names of a layout occur together (a dog's `shoulder` beside
        its `arm`), normalised name -> keypoint name.
    """

    name: str
    keypoints: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    symmetries: tuple[tuple[int, int], ...]
    aliases: dict[str, str]
    layouts: tuple[dict[str, str], ...] = ()


@dataclass(frozen=True)
class Camera:
    """The intrinsics of one camera.

    size: (width, height) in pixels.
    matrix: `[3, 3]`; pixel centres are integers (OpenCV).
    distortion: `[4 | 5 | 8]` OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, or `[4]` of cv2.fisheye when
        `fisheye` is set.
    """

    name: str
    size: tuple[int, int]
    matrix: Floats
    distortion: Floats
    fisheye: bool

    def __post_init__(self) -> None:
        check_shape(f"camera {self.name}: matrix", self.matrix, 3, 3)
        check_shape(f"camera {self.name}: distortion", self.distortion, None)

    @property
    def focal(self) -> float:
        """Mean focal length in pixels."""
        return float((self.matrix[0, 0] + self.matrix[1, 1]) / 2)


@dataclass(frozen=True)
class EstimatedCamera(Camera):
    """A camera whose intrinsics follow from the recording itself.

    Its principal point is the given one, or the middle of the image.

    focal_sigma: standard deviation of its focal length, in pixels.
    k1_sigma: standard deviation of the first coefficient of the lens, 0 where that was not
        estimated.
    """

    focal_sigma: float
    k1_sigma: float


@dataclass(frozen=True)
class CameraRig:
    """Cameras and where they stand.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world.
    unit: what a length of 1 is ("m", "mm", ... or "arbitrary").
    """

    cameras: tuple[Camera, ...]
    rotation: Floats
    translation: Floats
    unit: str

    def __post_init__(self) -> None:
        check_shape("rig: rotation", self.rotation, len(self.cameras), 3, 3)
        check_shape("rig: translation", self.translation, len(self.cameras), 3)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def centres(self) -> Floats:
        """`[view, 3]` camera centres in world coordinates, C = -R' t."""
        return -np.einsum("vji,vj->vi", self.rotation, self.translation)

    def relative(self, a: int, b: int) -> tuple[Floats, Floats]:
        """Return R `[3, 3]` and t `[3]` of b_from_a, for the views a and b: x_b = R x_a + t."""
        rotation = self.rotation[b] @ self.rotation[a].T
        return rotation, self.translation[b] - rotation @ self.translation[a]

    def select(self, views: Ints) -> "CameraRig":
        """Return the rig of these views (`[view]` indices) alone, in this order."""
        return CameraRig(
            cameras=tuple(self.cameras[view] for view in views),
            rotation=self.rotation[views],
            translation=self.translation[views],
            unit=self.unit,
        )


@dataclass(frozen=True)
class Keypoints2D:
    """What one keypoint file holds: the detections of one camera.

    frames: `[frame]` numbers as the file has them, ascending, each once.
    positions: `[frame, instance, keypoint, 2]` pixels, NaN = missing. The instance index is the
        detection's position within its frame in file order (for files with one column per
        individual: the column's position).
    confidence: `[frame, instance, keypoint]`, as the file has it, 0 = missing.
    tracked: the instance index names the same individual in all frames of this file.
    image_size: (width, height), (0, 0) where the file does not say.
    missing: how many points each custom of the file ("(0, 0)", "empty or NaN", ...) marks as
        missing; remarks: what a person should know of the file, a line each. Both are for
        `inspect`; no stage looks at them.
    """

    camera: str
    keypoints: tuple[str, ...]
    frames: Ints
    positions: Reals
    confidence: Reals
    tracked: bool
    image_size: tuple[int, int]
    source: str
    missing: dict[str, int] = field(default_factory=dict, compare=False)
    remarks: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        frames, instances, keypoints = self.positions.shape[:3]
        names = len(self.keypoints)
        check_shape(f"{self.source}: frames", self.frames, frames)
        check_shape(f"{self.source}: positions", self.positions, None, None, names, 2)
        check_shape(f"{self.source}: confidence", self.confidence, frames, instances, keypoints)


@dataclass(frozen=True)
class Recording:
    """All views on one clock.

    frames: `[frame]` numbers that at least two views have.
    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]` in 0..1 of each view's own scale, 0 = missing.
    tracked: `[view]` the instance index names the same individual in all frames.
    vocabulary: `[keypoint]` index of each keypoint in the model's skeleton, -1 = the model has no
        such joint.
    """

    cameras: tuple[Camera, ...]
    keypoints: tuple[str, ...]
    frames: Ints
    positions: Reals
    confidence: Reals
    tracked: Bools
    vocabulary: Ints

    def __post_init__(self) -> None:
        views, keypoints = len(self.cameras), len(self.keypoints)
        frames, instances = self.positions.shape[1:3]
        detections = (views, frames, instances, keypoints)
        check_shape("recording: positions", self.positions, *detections, 2)
        check_shape("recording: frames", self.frames, frames)
        check_shape("recording: confidence", self.confidence, *detections)
        check_shape("recording: tracked", self.tracked, views)
        check_shape("recording: vocabulary", self.vocabulary, keypoints)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def seen(self) -> Bools:
        """`[view, frame, instance, keypoint]` where there is a detection."""
        return np.isfinite(self.positions[..., 0])

    def select(
        self, *, views: Ints | None = None, frames: Ints | Bools | slice | None = None
    ) -> Self:
        """Return the recording with these views and these frames alone, in this order.

        views: `[view]` indices. frames: `[frame]` indices (not numbers) or mask, or a slice. What
        is not given stays whole and is not copied.
        """
        found = self
        if frames is not None:
            parts = {name: getattr(found, name)[:, frames] for name in self._by_view_and_frame}
            found = replace(found, frames=found.frames[frames], **parts)
        if views is not None and not np.array_equal(views, np.arange(len(self.cameras))):
            parts = {name: getattr(found, name)[views] for name in self._by_view_and_frame}
            cameras = tuple(self.cameras[view] for view in views)
            found = replace(found, cameras=cameras, tracked=found.tracked[views], **parts)
        return found

    @property
    def _by_view_and_frame(self) -> tuple[str, ...]:
        """Names of the arrays whose first axes are view and frame."""
        return ("positions", "confidence")


@dataclass(frozen=True)
class Sample(Recording):
    """Some frames of a recording in double precision, with the rays of their detections.

    Made by `recording.sampling.take_sample`.

    rays: `[view, frame, instance, keypoint, 3]` unit vectors in each camera's frame (distortion
        taken out), NaN = missing.
    """

    positions: Floats
    confidence: Floats
    rays: Floats

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shape("sample: rays", self.rays, *self.positions.shape[:4], 3)

    @property
    def _by_view_and_frame(self) -> tuple[str, ...]:
        return ("positions", "confidence", "rays")


@dataclass(frozen=True)
class LiftedPoses:
    """Every detection lifted by itself to a 3D body.

    Lengths are in body sizes (RMS distance of the joints from their centroid). Joints are those
    of the model's skeleton; absent ones are completed.

    body: `[view, frame, instance, joint, 3]` joints about their centroid, in the axes of the
        view's camera (the virtual camera of the instance taken out), NaN where nothing was lifted.
    centre: `[view, frame, instance, 3]` the centroid in the camera's frame.
    spread: `[view, frame, instance, joint]` standard deviation of a joint.
    """

    body: Floats
    centre: Floats
    spread: Floats

    def __post_init__(self) -> None:
        views, frames, instances, joints = self.body.shape[:4]
        check_shape("lifted: body", self.body, None, None, None, None, 3)
        check_shape("lifted: centre", self.centre, views, frames, instances, 3)
        check_shape("lifted: spread", self.spread, views, frames, instances, joints)

    def select(self, views: Ints) -> "LiftedPoses":
        """Return the lifted poses of these views (`[view]` indices) alone, in this order."""
        return LiftedPoses(self.body[views], self.centre[views], self.spread[views])


@dataclass(frozen=True)
class PairwiseCalibration:
    """What is found of the views a and b.

    rotation: `[3, 3]` and translation: `[3]` of b_from_a; the length of the translation is the
        baseline in body sizes.
    matches: `[match, 3]` rows (frame index, instance in a, instance in b) in the frames that were
        looked at.
    frames: how many of the frames both views share.
    score: 0..1, share of the detections explained x in_front x agreement of the lifted bodies.
    residual: median epipolar error in radians.
    in_front: 0..1, share of the matched joints in front of both cameras.
    source: what found it ("lifted", "five-point", "paper").
    alternatives: other answers, best score first, without alternatives of their own.
    """

    a: int
    b: int
    rotation: Floats
    translation: Floats
    matches: Ints
    frames: int
    score: float
    residual: float
    in_front: float
    source: str
    alternatives: tuple["PairwiseCalibration", ...] = ()

    @property
    def hypotheses(self) -> tuple["PairwiseCalibration", ...]:
        """The answer and its alternatives."""
        return (self, *self.alternatives)


@dataclass(frozen=True)
class Averaged:
    """The rig, and how well each pair agrees with it.

    loop_error: `[pair]` angle in radians between a pair's rotation and the rig's.
    translation_error: `[pair]` angle in radians between the directions of translation.
    weight: `[pair]` 0..1, what the pair counted for in the end.
    """

    rig: CameraRig
    loop_error: Floats
    translation_error: Floats
    weight: Floats


@dataclass(frozen=True)
class Matches:
    """Who is who: `labels[view, frame, instance]` is the individual, -1 = nobody.

    One label per detection: cycle consistency by construction.
    """

    labels: Ints

    def select(
        self, *, views: Ints | None = None, frames: Ints | None = None, instances: int | None = None
    ) -> "Matches":
        """Return the labels of some views and frames (`[view]` and `[frame]` indices).

        instances: how many of the first instances, as a sample of the frames has them.
        """
        labels = self.labels
        labels = labels if views is None else labels[views]
        labels = labels if frames is None else labels[:, frames]
        return Matches(labels[:, :, :instances])

    @property
    def individuals(self) -> int:
        """Number of individuals."""
        return int(self.labels.max(initial=-1)) + 1


@dataclass(frozen=True)
class Adjusted:
    """A rig after rounds of adjusting and matching, and the labels that it implies.

    matches: labels in the frames that were adjusted.
    depth_reversed_rig: a rig that fits as well, reversed in depth: what was seen does not tell
        the two apart. None where there is no such rig.
    rounds: rounds of adjusting and matching that were made.
    converged: no detection changed its group, and no camera turned, in the last round.
    """

    rig: CameraRig
    matches: Matches
    depth_reversed_rig: CameraRig | None
    rounds: int
    converged: bool


@dataclass(frozen=True)
class Uncertainty:
    """How well a rig is determined by what was seen.

    split_half_angle: `[pair]` radians between the relative rotations of rigs that were adjusted
        to halves of the joints; about twice the error of the rig.
    outlier_cameras: `[view]` cameras whose errors are several times those of the others.
    weak_perspective: `[view]` cameras in whose images perspective drowns in noise: their distance
        follows from their focal length alone.
    intrinsics_angle: `[pair]` radians by which the relative rotations change where the estimated
        focal lengths change by a standard deviation; 0 where they were given.
    """

    split_half_angle: Floats
    outlier_cameras: Bools
    weak_perspective: Bools
    intrinsics_angle: Floats


@dataclass(frozen=True)
class Poses3D:
    """Triangulated bodies.

    frames: `[frame]` numbers.
    positions: `[frame, individual, keypoint, 3]` in the rig's unit, NaN = missing.
    error: `[frame, individual, keypoint]` RMS reprojection error in pixels over the views used.
    views: `[frame, individual, keypoint]` number of views used.
    confidence: `[frame, individual, keypoint]` mean confidence of the detections used.
    unit: of the positions, as the rig's.
    """

    keypoints: tuple[str, ...]
    frames: Ints
    positions: Floats
    error: Floats
    views: Ints
    confidence: Floats
    unit: str


@dataclass(frozen=True)
class GroupResult:
    """All that is found of one group of cameras that see the same bodies.

    recording: of the cameras of the group alone; everything else is in their order.
    matches: labels in all frames. seconds: wall time by stage.
    """

    recording: Recording
    pairs: tuple[PairwiseCalibration, ...]
    averaged: Averaged
    adjusted: Adjusted
    matches: Matches
    uncertainty: Uncertainty
    poses: Poses3D
    seconds: dict[str, float]

    @property
    def rig(self) -> CameraRig:
        """The adjusted rig."""
        return self.adjusted.rig


@dataclass(frozen=True)
class UnusedPair:
    """A pair of cameras (names) that are not in one group, and the score of the pair."""

    a: str
    b: str
    score: float


@dataclass(frozen=True)
class CalibrationResult:
    """All that a run finds: a result for each group of cameras, the largest group first.

    left_out: names of the cameras that are in no group.
    """

    groups: tuple[GroupResult, ...]
    left_out: tuple[str, ...]
    unused_pairs: tuple[UnusedPair, ...]
