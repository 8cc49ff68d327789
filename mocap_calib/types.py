"""The nouns of the program: frozen records, checked when made.

Axis names, always in this order: view, frame, instance, individual, keypoint, coordinate.
An *instance* is a detection in one view; an *individual* is the same body in all views. *Pose* means a body's pose; cameras have *extrinsics*.
Transforms are named `target_from_source`: x_cam = R x_world + t. Missing is NaN in floats and -1 in labels. docs/conventions.md says the rest.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Reals = NDArray[
    np.floating[Any]
]  # float32 where whole recordings are kept, which is a ten-thousandth of a pixel

T = TypeVar("T")
R = TypeVar("R")


def check_shape(owner: str, array: NDArray[np.generic], *shape: int | None) -> None:
    """Holds an array to its documented shape; None stands for any length."""
    if array.ndim != len(shape) or any(
        s is not None and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        expected = tuple("any" if s is None else s for s in shape)
        raise ValueError(f"{owner}: expected shape {expected}, got {array.shape}")


class Progress(Protocol):
    """How the library tells of its progress; it never prints."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` steps of `stage` are finished."""


def silent(stage: str, done: int, total: int) -> None:
    """The progress nobody listens to."""


class Mapper(Protocol):
    """How the library has independent work done: on the threads of this machine, unless the caller knows a better place."""

    def __call__(self, function: Callable[[T], R], items: Iterable[T], /) -> Iterable[R]:
        """`function` of every item, in any order. Both can be pickled, and items may be taken long before their results come."""


@dataclass(frozen=True)
class Skeleton:
    """The vocabulary of one kind of body.

    keypoints: `[keypoint]` names; edges: pairs (parent, child) of indices into them; symmetries: pairs
    (left, right); aliases: other spellings, normalised name -> keypoint name; layouts: what names mean where all of
    a layout occur together (a dog's `shoulder` beside its `arm`), normalised name -> keypoint name.
    """

    name: str
    keypoints: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    symmetries: tuple[tuple[int, int], ...]
    aliases: dict[str, str]
    layouts: tuple[dict[str, str], ...] = ()


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera.

    size: (width, height) in pixels. matrix: `[3, 3]`, pixel centres are integers (OpenCV). distortion:
    `[4 | 5 | 8]` OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, or `[4]` of cv2.fisheye when `fisheye` is set.
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
class CameraRig:
    """Cameras and where they stand.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world; unit: what a length of 1 is
    ("m", "mm", ... or "arbitrary").
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
        """R `[3, 3]` and t `[3]` of b_from_a, for the views a and b: x_b = R x_a + t."""
        rotation = self.rotation[b] @ self.rotation[a].T
        return rotation, self.translation[b] - rotation @ self.translation[a]


@dataclass(frozen=True)
class Keypoints2D:
    """What one keypoint file holds: the detections of one camera.

    frames: `[frame]` numbers as the file has them, ascending, each once. positions: `[frame, instance,
    keypoint, 2]` pixels, NaN = missing; the instance index is the detection's position within its frame in
    file order (for files with one column per individual: the column's position). confidence: `[frame,
    instance, keypoint]`, as the file has it, 0 = missing. tracked: the instance index names the same
    individual in all frames of this file. image_size: (width, height), (0, 0) where the file does not say.
    missing: how many points each custom of the file ("(0, 0)", "empty or NaN", ...) marks as missing; remarks: what a
    person should know of the file, a line each. The latter two are for `inspect`; no stage looks at them.
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
        check_shape(f"{self.source}: frames", self.frames, frames)
        check_shape(f"{self.source}: positions", self.positions, None, None, len(self.keypoints), 2)
        check_shape(f"{self.source}: confidence", self.confidence, frames, instances, keypoints)


@dataclass(frozen=True)
class Recording:
    """All views on one clock.

    frames: `[frame]` numbers that at least two views have. positions: `[view, frame, instance, keypoint, 2]`
    pixels, NaN = missing. confidence: `[view, frame, instance, keypoint]` in 0..1 of each view's own scale,
    0 = missing. tracked: `[view]` the instance index names the same individual in all frames.
    vocabulary: `[keypoint]` index of each keypoint in the model's skeleton, -1 = the model has no such joint.
    """

    cameras: tuple[Camera, ...]
    keypoints: tuple[str, ...]
    frames: Ints
    positions: Reals
    confidence: Reals
    tracked: Bools
    vocabulary: Ints

    def __post_init__(self) -> None:
        views, frames, instances, keypoints = self.positions.shape[:4]
        if (views, keypoints) != (len(self.cameras), len(self.keypoints)):
            raise ValueError(
                f"recording: {views} views, {keypoints} keypoints in positions for {len(self.cameras)} cameras, {len(self.keypoints)} names"
            )
        check_shape("recording: frames", self.frames, frames)
        check_shape("recording: confidence", self.confidence, views, frames, instances, keypoints)
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


@dataclass(frozen=True)
class Sample(Recording):
    """Some frames of a recording in double precision, with the rays of their detections; made by `frames.sample`.

    rays: `[view, frame, instance, keypoint, 3]` unit vectors in each camera's frame (distortion taken out), NaN = missing.
    """

    positions: Floats
    confidence: Floats
    rays: Floats

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shape("sample: rays", self.rays, *self.positions.shape[:4], 3)


@dataclass(frozen=True)
class LiftedPoses:
    """Every detection lifted by itself to a 3D body, in units of body size (RMS joint distance from the centroid).

    body: `[view, frame, instance, joint, 3]` joints about their centroid, in the axes of the view's camera
    (instance virtual camera taken out), NaN where nothing was detected. centre: `[view, frame, instance, 3]`
    the centroid in the camera's frame. spread: `[view, frame, instance, joint]` standard deviation of a joint.
    Joints are those of the model's skeleton; absent ones are completed.
    """

    body: Floats
    centre: Floats
    spread: Floats

    def __post_init__(self) -> None:
        views, frames, instances, joints = self.body.shape[:4]
        check_shape("lifted: body", self.body, None, None, None, None, 3)
        check_shape("lifted: centre", self.centre, views, frames, instances, 3)
        check_shape("lifted: spread", self.spread, views, frames, instances, joints)


@dataclass(frozen=True)
class PairwiseCalibration:
    """What is found of the views a and b.

    rotation: `[3, 3]` and translation: `[3]` of b_from_a; the translation's length is the baseline in body
    sizes. matches: `[match, 3]` rows (frame index, instance in a, instance in b) in the frames that were looked at;
    frames: how many of those the views share. in_front: 0..1, share of the matched joints in front of both cameras. score: 0..1,
    share of the detections explained x in_front x agreement of the lifted bodies. residual: median epipolar error in
    radians. source: what proposed it ("lifted", "five-point", "paper"). rivals: other answers, best score first, without rivals of their own.
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
    rivals: tuple["PairwiseCalibration", ...] = ()

    @property
    def modes(self) -> tuple["PairwiseCalibration", ...]:
        """The answer and its rivals."""
        return (self, *self.rivals)


@dataclass(frozen=True)
class Averaged:
    """The rig, and how well each pair agrees with it.

    loop_error: `[pair]` angle in radians between a pair's rotation and the rig's; translation_error: `[pair]`
    angle between the directions of translation; weight: `[pair]` 0..1, what the pair counted for in the end.
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

    @property
    def individuals(self) -> int:
        """Number of individuals."""
        return int(self.labels.max(initial=-1)) + 1


@dataclass(frozen=True)
class Poses3D:
    """Triangulated bodies.

    frames: `[frame]` numbers. positions: `[frame, individual, keypoint, 3]` in the rig's unit, NaN = missing.
    error: `[frame, individual, keypoint]` RMS reprojection error in pixels over the views used. views: number of
    views used. confidence: mean confidence of the detections used.
    """

    keypoints: tuple[str, ...]
    frames: Ints
    positions: Floats
    error: Floats
    views: Ints
    confidence: Floats
    unit: str


@dataclass(frozen=True)
class Calibration:
    """All that a run finds of one group of cameras that see the same bodies.

    All is of the cameras of the group. left_out: names of those that no group holds; unused: (name, name, score) of the pairs that are within no group. rounds
    of adjusting and matching were made; converged: no detection changed its group in the last. disagreement: `[pair]` radians between the rigs of halves of
    the joints, about twice the error of the rig. inconsistent: `[view]` cameras whose errors are several times those of the others. rival: a rig that fits as
    well, reversed in depth: what was seen does not tell them apart. near_affine: `[view]` cameras in whose images perspective drowns in noise, whose distance
    follows from their focal length alone. seconds: wall time per stage.
    """

    recording: Recording
    left_out: tuple[str, ...]
    unused: tuple[tuple[str, str, float], ...]
    pairs: tuple[PairwiseCalibration, ...]
    averaged: Averaged
    rig: CameraRig
    rival: CameraRig | None
    matches: Matches
    disagreement: Floats
    inconsistent: Bools
    near_affine: Bools
    poses: Poses3D
    rounds: int
    converged: bool
    seconds: dict[str, float]
