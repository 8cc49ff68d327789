"""The nouns of input: frozen records, checked when they are made. `results` has those of output.

Axis names, always in this order: view, frame, instance, individual, keypoint, coordinate.
An *instance* is a detection in one view; an *individual* is the same body in all views.
*Pose* means the pose of a body; cameras have *extrinsics*. Transforms are named
`target_from_source`: x_cam = R x_world + t. Missing is NaN in floats and -1 in labels.
docs/conventions.md has the rest.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_calib import mapped
from mocap_calib.errors import count, one_line

if TYPE_CHECKING:
    from mocap_calib import front
    from mocap_calib.results import Fault

POSE = 6  # numbers of a change of pose: a turn and a shift

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Octets = NDArray[np.uint8]
# float32 where whole recordings are kept: that is a ten-thousandth of a pixel
Reals = NDArray[np.floating[Any]]

# which views: one name, indices or names of views, or a mask
Views = str | Ints | Bools | Sequence[int] | Sequence[str]

# units of length in metres; arbitrary where no scale is set
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
ARBITRARY = "arbitrary"

# what the axes and the origin of coordinates are; docs/world.md says what each means
WorldKind = Literal["not known", "camera", "floor", "file", "landmarks"]
WORLD_KINDS: tuple[WorldKind, ...] = get_args(WorldKind)


def describe_unit(unit: str) -> str:
    """Return in what lengths are."""
    return "arbitrary lengths" if unit == ARBITRARY else f"lengths in {unit}"


def check_unit(owner: str, unit: str) -> None:
    """Raise ValueError for what is no unit of length."""
    if unit not in (ARBITRARY, *METRES):
        known = ", ".join(METRES)
        raise ValueError(f"{owner}: unit: expected one of {known}, {ARBITRARY}, got {unit!r}")


def check_factor(owner: str, factor: float) -> None:
    """Raise ValueError for a factor of lengths that is not a number above 0."""
    if not 0 < factor < np.inf:
        raise ValueError(f"{owner}: factor: expected a number above 0, got {factor}")


# takes reports of progress (stage, steps that are done, steps in all); the library never prints
Progress = Callable[[str, int, int], None]

# runs independent work in threads, in processes or on other machines: of a function and items,
# which can be pickled, the results in any order. Items may be taken long before their results come
Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress: the default."""


# --- what all records share


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


def as_array(owner: str, values: ArrayLike, kind: type[Any], *shape: int | None) -> NDArray[Any]:
    """Return values, which may be lists, as an array of the documented shape `[*shape]`.

    kind: float, int or bool; arrays of 32-bit floats stay as they are. None in the shape stands
    for any length.

    Raises ValueError, which names the owner, for another shape and for what is no such number.
    """
    try:
        given = np.asarray(values)
        is_kept = kind is float and given.dtype == np.float32
        with np.errstate(invalid="ignore"):  # NaN as a whole number
            array = given if is_kept else np.asarray(given, dtype=kind)
    except (TypeError, ValueError):
        raise ValueError(f"{owner}: expected numbers, got {_quote(values)}") from None
    if kind is int and given.dtype.kind == "f" and not np.array_equal(given, array):
        raise ValueError(f"{owner}: expected whole numbers, got {_quote(values)}")
    check_shape(owner, array, *shape)
    return array


def check_names(owner: str, names: Sequence[str]) -> None:
    """Raise ValueError where names are one text, or one of them is there twice."""
    if isinstance(names, str):
        raise ValueError(f"{owner}: expected a list of names, got the text {_quote(names)}")
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise ValueError(f"{owner}: expected each name once, got {_quote(twice)} several times")


class Record:
    """What the frozen records share: they compare by value, print in short, and take lists.

    Two records are equal where their arrays have equal shapes and elements; NaN equals NaN.
    Cameras and rigs copy the arrays that they are made of; recordings and all that is as large as
    they are do not: what is written into the array of a caller changes the record.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(
            _equal(getattr(self, each.name), getattr(other, each.name))
            for each in fields(self)  # type: ignore[arg-type]  # all records are dataclasses
            if each.compare
        )

    # records hold arrays, which have no hash
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        parts = [
            f"{each.name}={_summarise(getattr(self, each.name))}"
            for each in fields(self)  # type: ignore[arg-type]
        ]
        return f"{type(self).__name__}({', '.join(parts)})"

    def _hold(self, owner: str, name: str, kind: type[Any], *shape: int | None) -> None:
        """Hold the field of that name to its shape; a list becomes an array. Raises ValueError."""
        array = as_array(f"{owner}: {name}", getattr(self, name), kind, *shape)
        object.__setattr__(self, name, array)

    def _copy(self, owner: str, name: str, kind: type[Any], *shape: int | None) -> None:
        """Hold the field to its shape in an array of its own. Raises ValueError."""
        self._hold(owner, name, kind, *shape)
        object.__setattr__(self, name, np.array(getattr(self, name)))


def _equal(first: object, second: object) -> bool:
    """Return whether two values of a field are equal, arrays by their elements."""
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return np.array_equal(first, second, equal_nan=True)
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_equal, first, second))
    if isinstance(first, float) and isinstance(second, float) and np.isnan(first):
        return bool(np.isnan(second))
    return bool(first == second)


def _summarise(value: object) -> str:
    """Return the value of a field in a few words: the shape of an array, the length of a tuple.

    Vectors and points are told in full.
    """
    if isinstance(value, np.ndarray):
        return str(value.tolist()) if value.shape == (3,) else f"{value.dtype}{list(value.shape)}"
    if isinstance(value, Record):
        return f"{type(value).__name__}(...)"
    if isinstance(value, tuple) and (len(value) > 4 or isinstance(next(iter(value), 0), Record)):
        return f"{len(value)} x {type(value[0]).__name__}"
    return repr(value)


def _quote(value: object) -> str:
    """Return a value as Python has it, in one short line."""
    return one_line(repr(value), 60)


# --- skeletons


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


# --- cameras


@dataclass(frozen=True, eq=False, repr=False)
class Camera(Record):
    """The intrinsics of one camera.

    size: (width, height) in pixels, (0, 0) = unknown.
    matrix: `[3, 3]`; pixel centres are integers (OpenCV).
    distortion: `[4 | 5 | 8]` OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, or `[4]` of cv2.fisheye when
        `fisheye` is set; none where it is left out.
    centre_sigma, focal_sigma: standard deviations of the principal point along each axis, and of
        the focal length, in pixels; None = not stated.
    """

    name: str
    size: tuple[int, int]
    matrix: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(5))
    fisheye: bool = False
    centre_sigma: float | None = field(default=None, kw_only=True)
    focal_sigma: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self._copy(f"camera {self.name}", "matrix", float, 3, 3)
        self._copy(f"camera {self.name}", "distortion", float, None)
        if self.distortion[8:].any():
            given = len(self.distortion)
            raise ValueError(
                f"camera {self.name}: distortion: expected at most 8 coefficients, got {given}"
            )
        object.__setattr__(self, "size", tuple(self.size))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name}, {self._describe()})"

    @property
    def focal(self) -> float:
        """Mean focal length in pixels."""
        return float((self.matrix[0, 0] + self.matrix[1, 1]) / 2)

    def _describe(self) -> str:
        """Return image size, focal length and kind of lens in a few words."""
        width, height = self.size
        lens = "no distortion"
        if self.fisheye:
            lens = "fisheye"
        elif self.distortion.any():
            lens = "distortion"
        return f"{width} x {height}, f {self.focal:.1f} px, {lens}"


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedCamera(Camera):
    """A camera whose intrinsics were estimated from the recording.

    Its principal point is the given one, or the middle of the image.

    focal_sigma: standard deviation of its focal length, in pixels.
    k1_sigma: standard deviation of the first distortion coefficient, 0 = not estimated.
    """

    focal_sigma: float = field(kw_only=True)
    k1_sigma: float = field(kw_only=True)

    @classmethod
    def of(cls, camera: Camera, *, focal_sigma: float, k1_sigma: float) -> Self:
        """Return a camera with the standard deviations of its estimated intrinsics."""
        sigmas = {"focal_sigma": focal_sigma, "k1_sigma": k1_sigma}
        return cls(**_intrinsic_fields(camera) | sigmas)


@dataclass(frozen=True, eq=False, repr=False)
class AssumedCamera(Camera):
    """A camera with assumed intrinsics: only the size of its images is known."""


@dataclass(frozen=True, eq=False, repr=False)
class PosedCamera(Camera):
    """One camera of a rig: its intrinsics and extrinsics, as OpenCV takes them.

    rotation: `[3, 3]` and translation: `[3]` of cam_from_world.
    """

    rotation: Floats = field(kw_only=True)
    translation: Floats = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._copy(f"camera {self.name}", "rotation", float, 3, 3)
        self._copy(f"camera {self.name}", "translation", float, 3)

    @property
    def rvec(self) -> Floats:
        """`[3]` rotation vector of cam_from_world in radians, as of `cv2.Rodrigues`."""
        return _rotation_vectors(self.rotation)

    @property
    def tvec(self) -> Floats:
        """`[3]` translation of cam_from_world, as OpenCV calls it."""
        return self.translation

    @property
    def P(self) -> Floats:
        """`[3, 4]` projection matrix, K [R t], without distortion."""
        return self.matrix @ np.column_stack([self.rotation, self.translation])

    @property
    def centre(self) -> Floats:
        """`[3]` camera centre in world coordinates, C = -R' t."""
        return -self.rotation.T @ self.translation

    def _describe(self) -> str:
        """Return the intrinsics and the centre in a few words."""
        centre = ", ".join(f"{coordinate + 0.0:.4g}" for coordinate in self.centre)  # no -0
        return f"{super()._describe()}, at ({centre})"


# how a camera's clock differs from the common one
ClockKind = Literal["in step", "clock", "rate", "dropped", "not known"]


@dataclass(frozen=True)
class CameraClock:
    """How the clock of one camera differs from the common clock of most cameras.

    kind: "in step"; "clock", its frame numbers are off by `offset`; "rate", it has `rate` frames
        for each of the others; "dropped", it lost frames and numbered the others without gaps;
        "not known", the detections do not determine it.
    offset: its frame number minus that of the common clock; at the first frame, where it changes.
    rate: frames of this camera for one of the common clock.
    table: (frame, offset) of the frames of the common clock from which on an offset holds.
    evidence: the numbers that support this.
    """

    camera: str
    kind: ClockKind = "not known"
    offset: int = 0
    rate: float = 1.0
    table: tuple[tuple[int, int], ...] = ()
    evidence: Mapping[str, float] = field(default_factory=dict, compare=False)

    @property
    def differs(self) -> bool:
        """Whether it differs from the common clock."""
        return self.kind in ("clock", "rate", "dropped")


@dataclass(frozen=True)
class MeasuredCue:
    """A known length and its measured value.

    text: what it is the length of, as "height of 0". metres: the known length. measured: its length
    in metres in the results. sigma: relative standard deviation of their ratio. residual: by how
    many standard deviations it is longer than by the other cues, NaN = no other cue.
    """

    text: str
    metres: float
    measured: float
    sigma: float
    residual: float


@dataclass(frozen=True)
class MeasuredLandmark:
    """A point of known position, and its distance from where the cameras see it.

    distance: in metres; NaN = no two cameras agree on its position, and it was not used.
    """

    name: str
    distance: float


@dataclass(frozen=True, eq=False, repr=False)
class World(Record):
    """What the axes, the origin and the unit of coordinates are.

    kind: one of `WORLD_KINDS`: the axes of a camera, of a floor (z up, the origin on it), of a file
        with cameras, or of landmarks of known position; or not known.
    camera: name of the camera whose axes they are, "" = none.
    up: `[3]` unit vector against gravity, NaN = not known. up_sigma: its standard deviation in
        radians.
    floor: `[3]` a point of the floor, NaN = not known. floor_sigma: standard deviation of its
        height in the unit.
    scale_sigma: relative standard deviation of lengths, NaN = arbitrary or not known.
    remarks: how axes and floor were found, or why they were not, a line each.
    cues: the known lengths that set the scale, if any.
    landmarks: the known points that set the axes and the scale, if any.
    axes_unmet, scale_unmet: why the requested axes or scale could not be set, in a line; "" = they
        were.
    """

    kind: WorldKind = "not known"
    camera: str = ""
    up: Floats = field(default_factory=lambda: np.full(3, np.nan))
    up_sigma: float = np.nan
    floor: Floats = field(default_factory=lambda: np.full(3, np.nan))
    floor_sigma: float = np.nan
    scale_sigma: float = np.nan
    remarks: tuple[str, ...] = ()
    cues: tuple[MeasuredCue, ...] = ()
    landmarks: tuple[MeasuredLandmark, ...] = ()
    axes_unmet: str = ""
    scale_unmet: str = ""

    def __post_init__(self) -> None:
        self._copy("world", "up", float, 3)
        self._copy("world", "floor", float, 3)

    def scale(self, factor: float) -> "World":
        """Return the world with all lengths multiplied by a factor."""
        return replace(self, floor=factor * self.floor, floor_sigma=factor * self.floor_sigma)

    def turn(self, rotation: Floats, shift: Floats | float = 0.0) -> "World":
        """Return the world in other axes, x_new = rotation x + shift.

        rotation: `[3, 3]`. shift: `[3]` in the new axes.
        """
        return replace(self, up=rotation @ self.up, floor=rotation @ self.floor + shift)


@dataclass(frozen=True, eq=False, repr=False)
class CameraRig(Record):
    """Cameras and their extrinsics.

    `rig["cam1"]` is one of them, `for camera in rig` each in turn.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world.
    unit: what a length of 1 is ("m", "mm", ... or "arbitrary").
    clocks: of the cameras that are not on the common clock.
    world: what the axes of the coordinates are.
    """

    cameras: tuple[Camera, ...]
    rotation: Floats
    translation: Floats
    unit: str = ARBITRARY
    clocks: tuple[CameraClock, ...] = field(default=(), compare=False)
    world: World = field(default_factory=World, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", intrinsics_of(self.cameras))
        check_names("rig: cameras", self.names)
        check_unit("rig", self.unit)
        self._copy("rig", "rotation", float, len(self.cameras), 3, 3)
        self._copy("rig", "translation", float, len(self.cameras), 3)

    def __repr__(self) -> str:
        lines = [f"  {camera.name}: {camera._describe()}" for camera in self]
        title = f"CameraRig of {count(len(self), 'camera')}, {describe_unit(self.unit)}"
        return "\n".join([title, *lines])

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[PosedCamera]:
        return (self._pose(view) for view in range(len(self)))

    def __getitem__(self, name: str) -> PosedCamera:
        """Return the camera of that name. Raises KeyError."""
        return self._pose(find_name(self.names, name))

    def __contains__(self, camera: object) -> bool:
        """Return whether a camera, or one of that name, is in the rig."""
        if isinstance(camera, str):
            return camera in self.names
        return any(camera == each for each in self)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def centres(self) -> Floats:
        """`[view, 3]` camera centres in world coordinates, C = -R' t."""
        return -np.einsum("vji,vj->vi", self.rotation, self.translation)

    @property
    def P(self) -> Floats:
        """`[view, 3, 4]` projection matrices, K [R t], without distortion."""
        return np.array([camera.P for camera in self])

    def relative(self, a: int, b: int) -> tuple[Floats, Floats]:
        """Return R `[3, 3]` and t `[3]` of b_from_a, for the views a and b: x_b = R x_a + t."""
        rotation = self.rotation[b] @ self.rotation[a].T
        return rotation, self.translation[b] - rotation @ self.translation[a]

    def select(self, views: Views) -> "CameraRig":
        """Return the rig of these views (indices, names, or a mask) alone, in this order.

        Raises KeyError for a name that no camera has, and ValueError for a mask of another length.
        """
        index = find_views(self.names, views)
        return replace(
            self,
            cameras=tuple(self.cameras[view] for view in index),
            rotation=self.rotation[index],
            translation=self.translation[index],
            clocks=tuple(
                clock for clock in self.clocks if clock.camera in {self.names[k] for k in index}
            ),
        )

    def stand(self, rotation: Floats, centres: Floats) -> "CameraRig":
        """Return the rig with other extrinsics, in the same unit.

        rotation: `[view, 3, 3]` of cam_from_world; centres: `[view, 3]` in world coordinates.
        """
        translation = -np.einsum("vij,vj->vi", rotation, centres)
        return replace(self, rotation=rotation, translation=translation)

    def scale(self, factor: float, unit: str) -> "CameraRig":
        """Return the rig with all lengths multiplied by a factor, which are in `unit` then.

        Raises ValueError for a factor that is not above 0, and for what is no unit.
        """
        check_factor("rig", factor)
        translation, world = factor * self.translation, self.world.scale(factor)
        return replace(self, translation=translation, unit=unit, world=world)

    @property
    def rvec(self) -> Floats:
        """`[view, 3]` rotation vectors of cam_from_world in radians."""
        return _rotation_vectors(self.rotation)

    if TYPE_CHECKING:  # bound by `front`
        project = front.project
        triangulate = front.triangulate

    def _pose(self, view: int) -> PosedCamera:
        """Return the camera of a view (index) with its extrinsics."""
        camera = self.cameras[view]
        return PosedCamera(
            **_intrinsic_fields(camera),
            rotation=self.rotation[view],
            translation=self.translation[view],
        )


def intrinsics_of(cameras: Sequence[Camera] | CameraRig) -> tuple[Camera, ...]:
    """Return the cameras of a rig, or cameras, without extrinsics."""
    if isinstance(cameras, CameraRig):
        return cameras.cameras
    return tuple(
        Camera(**_intrinsic_fields(each)) if isinstance(each, PosedCamera) else each
        for each in cameras
    )


def _intrinsic_fields(camera: Camera) -> dict[str, Any]:
    """Return the fields that all cameras have."""
    return {each.name: getattr(camera, each.name) for each in fields(Camera)}


def _rotation_vectors(rotation: Floats) -> Floats:
    """Return the rotation vectors `[..., 3]` in radians of rotations `[..., 3, 3]`."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - for users alone

    return Rotation.from_matrix(rotation).as_rotvec()


def find_views(names: tuple[str, ...], views: Views) -> Ints:
    """Return the `[view]` indices of views that are given by index, name or mask.

    names: of all cameras.

    Raises KeyError for a name that no camera has, and ValueError for a mask of another length.
    """
    given = [views] if isinstance(views, str) else views
    if np.asarray(given).dtype == np.bool_:
        return np.flatnonzero(as_array("views", given, bool, len(names)))
    index = [find_name(names, view) if isinstance(view, str) else int(view) for view in given]
    return np.array(index, dtype=np.int64)


def find_name(names: tuple[str, ...], name: str) -> int:
    """Return the index of the camera of that name. Raises KeyError."""
    if name not in names:
        raise KeyError(f"expected one of the cameras {', '.join(names)}, found {name!r}")
    return names.index(name)


# --- detections


@dataclass(frozen=True, eq=False, repr=False)
class Keypoints2D(Record):
    """The detections of one camera, as in one keypoint file.

    frames: `[frame]` numbers as the file has them, ascending, each once.
    positions: `[frame, instance, keypoint, 2]` pixels, NaN = missing. The instance index is the
        detection's position within its frame in file order (for files with one column per
        individual: the column's position).
    confidence: `[frame, instance, keypoint]`, as the file has it, 0 = missing.
    tracked: the instance index names the same individual in all frames of this file.
    image_size: (width, height), (0, 0) = not in the file.
    missing: number of missing points by how the file marks them ("(0, 0)", "empty or NaN", ...);
        remarks: notes on the file, a line each. Both are for `inspect`; no stage uses them.
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
        object.__setattr__(self, "keypoints", tuple(self.keypoints))
        object.__setattr__(self, "image_size", tuple(self.image_size))
        self._hold(self.source, "positions", float, None, None, len(self.keypoints), 2)
        self._hold(self.source, "frames", int, len(self.positions))
        self._hold(self.source, "confidence", float, *self.positions.shape[:3])


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Record):
    """The detections of all views on one clock.

    frames: `[frame]` numbers that at least two views have.
    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]` in 0..1, scaled for each view, 0 = missing.
    tracked: `[view]` the instance index names the same individual in all frames.
    vocabulary: `[keypoint]` index of each keypoint in the model's skeleton, -1 = not in it.
    model: the name of a shipped model, a file of weights, or "none".
    corrected: how the intrinsics of cameras were corrected, by the sizes of their images.
    """

    cameras: tuple[Camera, ...]
    keypoints: tuple[str, ...]
    frames: Ints
    positions: Reals
    confidence: Reals
    tracked: Bools
    vocabulary: Ints
    model: str = field(default="people", kw_only=True)
    corrected: tuple["Fault", ...] = field(default=(), kw_only=True)
    # the arrays whose first axes are view and frame
    _by_view_and_frame: ClassVar[tuple[str, ...]] = ("positions", "confidence")

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", intrinsics_of(self.cameras))
        object.__setattr__(self, "keypoints", tuple(self.keypoints))
        views, keypoints = len(self.cameras), len(self.keypoints)
        self._hold("recording", "positions", float, views, None, None, keypoints, 2)
        self._hold("recording", "confidence", float, *self.positions.shape[:4])
        self._hold("recording", "frames", int, self.positions.shape[1])
        self._hold("recording", "tracked", bool, views)
        self._hold("recording", "vocabulary", int, keypoints)

    def __repr__(self) -> str:
        span = f" ({self.frames[0]} to {self.frames[-1]})" if len(self.frames) else ""
        parts = [
            count(len(self.cameras), "camera"),
            f"{count(len(self.frames), 'frame')}{span}",
            f"at most {count(self.positions.shape[2], 'instance')} a frame",
            count(len(self.keypoints), "keypoint"),
            f"model {self.model}",
        ]
        return f"{type(self).__name__}({', '.join(parts)})"

    if TYPE_CHECKING:  # bound by `front`
        from_arrays = staticmethod(front.from_arrays)
        from_keypoints = staticmethod(front.from_keypoints)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def detected(self) -> Bools:
        """`[view, frame, instance]` where there is a detection, of any keypoint."""
        return mapped.in_blocks(
            lambda block: np.isfinite(self.positions[:, block, ..., 0]).any(-1),
            len(self.frames),
            axis=1,
        )

    @property
    def seen(self) -> Bools:
        """`[view, frame, instance, keypoint]` where a keypoint is detected."""
        return mapped.in_blocks(
            lambda block: np.isfinite(self.positions[:, block, ..., 0]), len(self.frames), axis=1
        )

    def select(
        self, *, views: Views | None = None, frames: Ints | Bools | slice | None = None
    ) -> Self:
        """Return the recording with these views and these frames alone, in this order.

        views: `[view]` indices or mask, or names. frames: `[frame]` indices (not numbers) or mask,
        or a slice. By default all; slices and what stays whole are not copied.

        Raises KeyError for a name that no camera has, and ValueError for a mask of another length.
        """
        found = self
        if frames is not None:
            parts: dict[str, Any] = {
                name: mapped.take(getattr(found, name), mapped.as_slice(frames), axis=1)
                for name in self._by_view_and_frame
            }
            found = replace(found, frames=found.frames[frames], **parts)
        index = None if views is None else find_views(self.names, views)
        if index is not None and not np.array_equal(index, np.arange(len(self.cameras))):
            parts = {name: found._take(name, index) for name in self._by_view_and_frame}
            cameras = tuple(self.cameras[view] for view in index)
            found = replace(found, cameras=cameras, tracked=found.tracked[index], **parts)
        return found

    def show(self, source: Ints, frames: Ints) -> Self:
        """Return the recording with other frames in each view.

        source: `[view, frame]` index of the frame to show, -1 = none. frames: `[frame]` numbers.
        """
        view = np.arange(len(self.cameras))[:, None]

        def show(name: str, block: slice) -> Reals:
            part: Reals = getattr(self, name)[view, source[:, block]]
            part[source[:, block] < 0] = 0.0 if name == "confidence" else np.nan
            return part

        parts: dict[str, Any] = {
            name: mapped.in_blocks(partial(show, name), len(frames), axis=1)
            for name in self._by_view_and_frame
        }
        return replace(self, frames=frames, **parts)

    def _take(self, name: str, views: Ints) -> Reals:
        """Return an array of views and frames with these views (`[view]` indices) alone."""
        array: Reals = getattr(self, name)
        return mapped.in_blocks(lambda block: array[views, block], len(self.frames), axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Sample(Recording):
    """Some frames of a recording in double precision, with the rays of their detections.

    Made by `recording.sampling.take_sample`.

    rays: `[view, frame, instance, keypoint, 3]` unit vectors in each camera's frame,
        undistorted, NaN = missing.
    """

    positions: Floats
    confidence: Floats
    rays: Floats
    _by_view_and_frame: ClassVar = ("positions", "confidence", "rays")
