"""The nouns of output: what the stages find, frozen and checked when they are made.

`types` has the nouns of input and says what the axes are called.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.config import EPOCH_MARK, OF_95_PERCENT, SOUND_DEG, VERDICT_LIMITS_DEG, Config
from mocap_calib.errors import Spell, count, spell_arguments, spell_in_python
from mocap_calib.types import (
    Bools,
    CameraClock,
    CameraRig,
    Floats,
    Ints,
    Reals,
    Record,
    Recording,
    World,
    check_factor,
    check_shape,
    check_unit,
    find_name,
)

if TYPE_CHECKING:
    from mocap_calib import front

# how a 3D point was made, by its number in `Poses3D.source`
POINT_SOURCES = ("missing", "triangulated", "one view", "interpolated")

NO_FRAME = np.iinfo(np.int64).min  # the number of a frame that a camera does not have

# how far a rig can be trusted, the best first; docs/how-good.md says what each means
VerdictWord = Literal["well determined", "usable", "weak", "not determined"]
VERDICTS: tuple[VerdictWord, ...] = get_args(VerdictWord)

# what may be wrong with the files of a camera; docs/run-json.md says what each means
FaultWord = Literal[
    "clock",
    "rate",
    "dropped",
    "focal",
    "mirrored",
    "flipped",
    "sides",
    "rotated",
    "resized",
    "cropped",
    "exchanged",
    "duplicate",
    "moved",
    "inconsistent",
]
FAULT_WORDS: tuple[FaultWord, ...] = get_args(FaultWord)


@dataclass(frozen=True, eq=False, repr=False)
class Clocks(Record):
    """Which frame each camera shows at each frame of the common clock.

    frames: `[frame]` numbers of the common clock: those of the first camera that is on it.
    given: `[frame]` numbers in the given recording, which are those of the files.
    source: `[view, frame]` index into these frames, -1 = none.
    cameras: `[view]` the clock of each; it may be found and not applied.
    """

    frames: Ints
    given: Ints
    source: Ints
    cameras: tuple[CameraClock, ...]

    @classmethod
    def of_one(cls, recording: Recording, cameras: Iterable[CameraClock] = ()) -> Self:
        """Return the clocks of an unchanged recording.

        cameras: `[view]` the clock of each, by default not known.
        """
        views, frames = len(recording.cameras), len(recording.frames)
        return cls(
            frames=recording.frames,
            given=recording.frames,
            source=np.broadcast_to(np.arange(frames), (views, frames)),
            cameras=tuple(cameras) or tuple(map(CameraClock, recording.names)),
        )

    @property
    def changed(self) -> bool:
        """Whether a camera shows other frames than in the given recording."""
        same = np.array_equal(self.frames, self.given)
        return not (same and bool((self.source == np.arange(len(self.frames))).all()))

    def numbers(self, camera: str) -> Ints:
        """Return the frame numbers `[frame]` in the files of a camera, NO_FRAME = none.

        Raises KeyError for an unknown name.
        """
        names = tuple(each.camera for each in self.cameras)
        source = self.source[find_name(names, camera.partition(EPOCH_MARK)[0])]
        return np.where(source >= 0, self.given[source], NO_FRAME)

    def after(self, first: "Clocks") -> "Clocks":
        """Return the composition of two changes of clocks, `first` applied first."""
        source = np.take_along_axis(first.source, np.maximum(self.source, 0), axis=1)
        cameras = tuple(
            late if late.differs or not early.differs else early
            for early, late in zip(first.cameras, self.cameras, strict=True)
        )
        source = np.where(self.source >= 0, source, -1)
        return replace(self, given=first.given, source=source, cameras=cameras)


class Mend(Protocol):
    """How the files of one camera are corrected; see `recording.corrections`."""

    @property
    def camera(self) -> str:
        """Name of the camera."""

    @property
    def word(self) -> FaultWord:
        """The fault that it corrects."""

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the detections or the intrinsics of the camera corrected."""


@dataclass(frozen=True, eq=False, repr=False)
class Fault(Record):
    """What is wrong with the files of one camera.

    camera: its name. word: one of `FAULT_WORDS`.
    says: a description, without the name of the camera.
    evidence: the numbers that support it, by name.
    mend: the correction, a clock where that differs, None where it is only reported.
    """

    camera: str
    word: FaultWord
    says: str
    evidence: Mapping[str, float | int | str] = field(default_factory=dict)
    mend: Mend | CameraClock | None = None


@dataclass(frozen=True, eq=False, repr=False)
class LiftedPoses(Record):
    """The 3D body of every detection, predicted from its view alone.

    Lengths are in body sizes (RMS distance of the joints from their centroid). Joints are those
    of the model's skeleton; absent ones are completed.

    body: `[view, frame, instance, joint, 3]` joints about their centroid, in the axes of the
        view's camera, NaN where nothing was lifted.
    centre: `[view, frame, instance, 3]` the centroid in the camera's frame.
    spread: `[view, frame, instance, joint]` standard deviation of a joint.
    """

    body: Floats
    centre: Floats
    spread: Floats

    def select(self, views: Ints) -> "LiftedPoses":
        """Return the lifted poses of these views (`[view]` indices) alone, in this order."""
        return LiftedPoses(self.body[views], self.centre[views], self.spread[views])


@dataclass(frozen=True, eq=False, repr=False)
class PairwiseCalibration(Record):
    """The relative pose of the views a and b, and their matches.

    rotation: `[3, 3]` and translation: `[3]` of b_from_a; the length of the translation is the
        baseline in body sizes.
    matches: `[match, 3]` rows (frame index, instance in a, instance in b) in the sampled frames.
    frames: how many of the frames both views share.
    score: 0..1, share of the detections explained x in_front x agreement of the lifted bodies.
    residual: median epipolar error in radians.
    in_front: 0..1, share of the matched joints in front of both cameras.
    source: the solver ("lifted", "five-point", "paper").
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


@dataclass(frozen=True, eq=False, repr=False)
class Averaged(Record):
    """A rig from pairs, and how well each pair agrees with it.

    loop_error: `[pair]` angle in radians between a pair's rotation and the rig's.
    translation_error: `[pair]` angle in radians between the directions of translation.
    weight: `[pair]` 0..1, the final robust weight of the pair.
    """

    rig: CameraRig
    loop_error: Floats
    translation_error: Floats
    weight: Floats

    @property
    def contradicts(self) -> Bools:
        """`[pair]` which are farther from the rig than the scale of Geman and McClure's loss."""
        return self.weight < 1 / 4


@dataclass(frozen=True, eq=False, repr=False)
class Matches(Record):
    """Identities: `labels[view, frame, instance]` is the individual, -1 = unassigned.

    One label per detection: cycle consistency by construction.
    """

    labels: Ints

    def __post_init__(self) -> None:
        self._hold("matches", "labels", int, None, None, None)

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

    @cached_property
    def individuals(self) -> int:
        """Number of individuals; cached, as each block of a long recording asks for it."""
        return int(self.labels.max(initial=-1)) + 1


@dataclass(frozen=True, eq=False, repr=False)
class Adjusted(Record):
    """A rig after rounds of adjustment and association, and its labels.

    matches: labels in the frames that were adjusted.
    depth_reversed_rig: a depth-reversed rig that fits equally well, so that the detections do not
        decide between the two; None = none.
    rounds: number of rounds of adjustment and association. turn_deg: by how many degrees a camera
        turned in the last one, at most.
    """

    rig: CameraRig
    matches: Matches
    depth_reversed_rig: CameraRig | None
    rounds: int
    turn_deg: float


@dataclass(frozen=True, eq=False, repr=False)
class TimeOffsets(Record):
    """Clock offsets of the cameras by less than a frame.

    tau: `[view]` frames by which a camera's images are later than those of the first camera that
        have the same number, and sigma: `[view]` its standard deviation. NaN where the detections
        do not determine it: nothing moves, or frames do not follow each other.
    used: `[view]` the offsets that are large and certain enough for the rig and the poses to be
        made with them.
    """

    tau: Floats
    sigma: Floats
    used: Bools

    @classmethod
    def unknown(cls, views: int) -> "TimeOffsets":
        """Return unknown offsets of so many views."""
        return cls(np.full(views, np.nan), np.full(views, np.nan), np.zeros(views, dtype=bool))

    @property
    def applied(self) -> Floats:
        """`[view]` the offsets that are used, 0 elsewhere."""
        return np.where(self.used, self.tau, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class RigCovariance(Record):
    """Covariance of the camera poses of a rig, after alignment by a similarity.

    matrix: `[view, 6, view, 6]` covariance of small rotations of the cameras (3, radians, about the
        axes of the world) and of their centres (3, in sizes of the rig).
    size: of the rig: RMS distance of the centres from their middle, in the unit of the rig.
    """

    matrix: Floats
    size: float

    @classmethod
    def unknown(cls, views: int, size: float) -> "RigCovariance":
        """Return the covariance of an unknown rig: half a turn, and its size, of each camera."""
        variance = np.concatenate([np.full(3, np.pi**2), np.ones(3)]) / 3
        matrix = np.diag(np.tile(variance, views)).reshape(views, 6, views, 6)
        return cls(matrix=matrix, size=size)

    @property
    def rotation_sigma(self) -> Floats:
        """`[view]` rotation uncertainty in radians (1 SD)."""
        return np.sqrt(np.einsum("vivi->v", self.matrix[:, :3, :, :3]))

    @property
    def centre_sigma(self) -> Floats:
        """`[view]` position uncertainty of a camera centre in sizes of the rig (1 SD)."""
        return np.sqrt(np.einsum("vivi->v", self.matrix[:, 3:, :, 3:]))

    @property
    def pair_rotation_sigma(self) -> Floats:
        """`[view, view]` uncertainty of relative rotations in radians (1 SD)."""
        return np.minimum(self._pair_sigma(slice(0, 3)), np.pi)

    @property
    def pair_centre_sigma(self) -> Floats:
        """`[view, view]` uncertainty of baselines in sizes of the rig (1 SD)."""
        return self._pair_sigma(slice(3, 6))

    def _pair_sigma(self, entries: slice) -> Floats:
        """Return the standard deviations `[view, view]` of the differences of two views."""
        together = np.einsum("viwi->vw", self.matrix[:, entries, :, entries])
        own = np.diagonal(together)
        variance = own[:, None] + own - together - together.T
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def with_changes(self, changes: Floats) -> "RigCovariance":
        """Return the covariance with further independent errors.

        changes: `[change, view, 6]` errors of one standard deviation.
        """
        more = np.einsum("cvi,cwj->viwj", changes, changes)
        return replace(self, matrix=self.matrix + more)


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty(Record):
    """How well the detections determine a rig.

    covariance: of where the cameras stand; what wrong intrinsics may do is part of it.
    intrinsics_turn: `[view]` radians that a camera may be turned by because of its focal length: of
        given ones, what the rig changes by when they are free; of estimated ones their uncertainty.
    outlier_cameras: `[view]` cameras whose errors are several times those of the others.
    weak_perspective: `[view]` cameras in whose images perspective drowns in noise: their distance
        follows from their focal length alone.
    focal_change: `[view]` what the logarithm of a given focal length would change by if it were
        free, and focal_sigma: `[view]` its standard deviation; NaN where they were estimated.
    wrong_focal: `[view]` cameras whose given focal lengths are certainly wrong.
    aspect_turn: `[view]` radians that a camera may be turned by because images of all are squeezed:
        what the rig changes by when a ratio f_y / f_x of all is free; aspect: what that changes by.
    mirrored: log evidence (nats) that bodies are seen in the mirror, by what the lifting network
        predicts of their depths; NaN where it predicts none.
    """

    covariance: RigCovariance
    intrinsics_turn: Floats
    outlier_cameras: Bools
    weak_perspective: Bools
    focal_change: Floats
    focal_sigma: Floats
    wrong_focal: Bools
    aspect_turn: Floats
    aspect: float = 1.0
    mirrored: float = float("nan")


@dataclass(frozen=True)
class Cause:
    """A named part of the expected error of a rig; docs/how-good.md has them all.

    camera: the one that it is of, "" = all. error_deg: rotation error that it stands for. meaning:
    what was found, with its subject. remedy: what to do about it; arguments stand in it as
    `errors.argument` marks them. measured: whether there was anything to measure it by; else
    error_deg is what is not known for that.
    """

    name: str
    camera: str
    error_deg: float
    meaning: str
    remedy: str
    measured: bool = True

    def __str__(self) -> str:
        return self.render(spell_in_python)

    def render(self, spell: Spell) -> str:
        """Return a line that is read alone, with arguments as `spell` writes them."""
        return spell_arguments(f"{self.meaning}. Next: {self.remedy}.", spell)

    @property
    def passed(self) -> bool:
        """Whether it was measured, and is no more than what a well determined rig may have."""
        return self.measured and self.error_deg <= SOUND_DEG


@dataclass(frozen=True)
class Verdict:
    """How far a rig can be trusted; all of it follows from its causes.

    error_deg: expected rotation error of the least certain camera, in degrees: the root of the sum
        of the squares of its causes. causes: of all cameras, the largest first. checks: those that
        were measured on the residuals, also where nothing was found.
    """

    error_deg: float = np.inf
    causes: tuple[Cause, ...] = ()
    checks: tuple[Cause, ...] = ()

    @property
    def word(self) -> VerdictWord:
        """The verdict in one of the words of `VERDICTS`."""
        return word_of_error(self.error_deg)

    @property
    def reasons(self) -> tuple[Cause, ...]:
        """Why the rig is no better, and what to do about it, the largest cause first.

        Of each kind the largest, from half of what a well determined rig may have on, of which
        there are none.
        """
        if self.word == VERDICTS[0]:
            return ()
        largest = {cause.name: cause for cause in reversed(self.causes)}
        return tuple(
            cause
            for cause in self.causes
            if cause is largest[cause.name] and cause.error_deg >= SOUND_DEG / 2
        )


def word_of_error(degrees: float) -> VerdictWord:
    """Return the verdict on a rig whose least certain camera is expected to be off by so much.

    95 % of the errors are below its limit.
    """
    return VERDICTS[int(np.searchsorted(VERDICT_LIMITS_DEG, OF_95_PERCENT * degrees, side="right"))]


@dataclass(frozen=True, eq=False, repr=False)
class Poses3D(Record):
    """Bodies in space.

    frames: `[frame]` numbers.
    positions: `[frame, individual, keypoint, 3]` in the rig's unit, NaN = missing: the best
        estimate.
    error: `[frame, individual, keypoint]` RMS reprojection error in pixels of the triangulated
        point over the views used.
    views: `[frame, individual, keypoint]` number of views that it was triangulated from.
    confidence: `[frame, individual, keypoint]` mean confidence of the detections used.
    unit: of the positions, as the rig's.
    covariance: `[frame, individual, keypoint, 6]` xx, xy, xz, yy, yz, zz of the errors of the
        positions in the unit squared, as far as they are due to the detectors' noise: where a rig
        is wrong, or a detector sees a joint elsewhere than it is, the errors are larger. 32-bit
        floats. NaN = missing, or not known where it is left out.
    raw: `[frame, individual, keypoint, 3]` the triangulated points, where the positions are more
        than these; left out, they are the positions.
    source: `[frame, individual, keypoint]` what a position is made of, as an index into
        `POINT_SOURCES`; left out, all that is there was triangulated.
    world: what the axes are, as the rig's.
    """

    keypoints: tuple[str, ...]
    frames: Ints
    positions: Floats
    error: Floats
    views: Ints
    confidence: Floats
    unit: str
    covariance: Reals = field(default_factory=lambda: np.zeros(0, dtype=np.float32))
    raw: Floats = field(default_factory=lambda: np.zeros(0))
    source: NDArray[np.integer[Any]] = field(default_factory=lambda: np.zeros(0, dtype=np.int8))
    world: World = field(default_factory=World, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "keypoints", tuple(self.keypoints))
        check_unit("poses", self.unit)
        self._hold("poses", "positions", float, None, None, len(self.keypoints), 3)
        points = self.positions.shape[:3]
        self._hold("poses", "frames", int, points[0])
        self._hold("poses", "error", float, *points)
        self._hold("poses", "views", int, *points)
        self._hold("poses", "confidence", float, *points)
        if np.shape(self.covariance) == (0,):  # not known: takes no memory
            unknown = np.broadcast_to(np.float32(np.nan), (*points, 6))
            object.__setattr__(self, "covariance", unknown)
        self._hold("poses", "covariance", float, *points, 6)
        if np.shape(self.raw) == (0,):
            object.__setattr__(self, "raw", self.positions)
        self._hold("poses", "raw", float, *points, 3)
        if np.shape(self.source) == (0,):
            there = self._in_blocks(lambda block: np.isfinite(self.positions[block]).all(-1))
            object.__setattr__(self, "source", there.astype(np.int8))  # 1: triangulated
        check_shape("poses: source", self.source, *points)

    def scale(self, factor: float, unit: str) -> "Poses3D":
        """Return the poses with all lengths multiplied by a factor, which are in `unit` then.

        Raises ValueError for a factor that is not above 0, and for what is no unit.
        """
        check_factor("poses", factor)
        if factor == 1:
            return replace(self, unit=unit)
        return self._move(
            lambda points: factor * points,
            lambda covariance: factor**2 * covariance,
            unit=unit,
            world=self.world.scale(factor),
        )

    def turn(self, rotation: Floats, shift: Floats | float = 0.0) -> "Poses3D":
        """Return the poses in other axes, to which a rotation `[3, 3]` turns those of the world.

        shift: `[3]` in the unit, of all points, in the new axes.
        """
        # what becomes of a covariance of which one entry is 1, for each of the six
        entries = np.eye(6)[:, ((0, 1, 2), (1, 3, 4), (2, 4, 5))]
        turned = (rotation @ entries @ rotation.T)[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
        return self._move(
            lambda points: points @ rotation.T + shift,
            lambda covariance: covariance @ turned,
            world=self.world.turn(rotation, shift),
        )

    def select(
        self,
        individuals: Sequence[int] | slice = slice(None),
        *,
        frames: Ints | slice = slice(None),
    ) -> "Poses3D":
        """Return the poses of these individuals in these frames (indices) alone, in this order."""
        names = ("positions", "error", "views", "confidence", "covariance", "raw", "source")
        parts: dict[str, Any] = {
            name: mapped.take(getattr(self, name), frames)[:, individuals]
            for name in names
            if name != "raw" or self.raw is not self.positions
        }
        parts.setdefault("raw", parts["positions"])
        return replace(self, frames=self.frames[frames], **parts)

    def _move(
        self,
        points: Callable[[Floats], Floats],
        covariance: Callable[[Reals], Reals],
        **fields: Any,
    ) -> "Poses3D":
        """Return the poses after a move of all points and of their covariance."""
        positions = self._in_blocks(lambda block: points(self.positions[block]))
        raw = positions
        if self.raw is not self.positions:
            raw = self._in_blocks(lambda block: points(self.raw[block]))
        moved = self._in_blocks(lambda block: covariance(self.covariance[block]).astype(np.float32))
        return replace(self, positions=positions, raw=raw, covariance=moved, **fields)

    def _in_blocks(self, function: Callable[[slice], Any]) -> NDArray[Any]:
        """Return what a function makes of all frames, see `mapped.in_blocks`."""
        return mapped.in_blocks(function, len(self.frames))

    @property
    def sigma(self) -> Floats:
        """`[frame, individual, keypoint]` RMS distance of a point from the true one, in the unit.

        As far as it is due to the detectors' noise: what follows from `covariance`.
        """
        return self._in_blocks(
            lambda block: np.sqrt(self.covariance[block][..., [0, 3, 5]].sum(-1, dtype=np.float64))
        )

    if TYPE_CHECKING:  # bound by `front`
        to_xarray = front.to_xarray


@dataclass(frozen=True)
class Smoothing:
    """How the best estimates of poses were made.

    acceleration, bones: standard deviations of accelerations (in the square of the usual step
        between frames) and of the lengths of bones, beyond what they vary by, that were allowed, in
        body sizes; infinite = no limit, which is how it is where nothing was smoothed.
    loss: error of a ray, in standard deviations, that counts by half; NaN = nothing was smoothed.
    held_out, held_out_raw: how badly detections that were not shown are predicted, with these and
        without, as `poses.stage.choose_strengths` measures it; NaN where there was nothing to hide.
    outliers: detections that were dropped since they are far from the estimates.
    """

    acceleration: float = np.inf
    bones: float = np.inf
    loss: float = np.nan
    held_out: float = np.nan
    held_out_raw: float = np.nan
    outliers: int = 0


@dataclass(frozen=True, eq=False, repr=False)
class ObservedPoints(Record):
    """Points and their observations: the input of a bundle adjustment.

    positions: `[point, 3]` in the unit of the rig.
    view, point: `[observation]` indices of the view and of the point.
    pixels: `[observation, 2]`.
    """

    positions: Floats
    view: Ints
    point: Ints
    pixels: Floats

    @classmethod
    def none(cls) -> Self:
        """Return no points."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(np.zeros((0, 3)), nothing, nothing, np.zeros((0, 2)))


@dataclass(frozen=True, eq=False, repr=False)
class GroupResult(Record):
    """The results of one group of cameras that see the same bodies.

    recording: of the cameras of the group alone; everything else is in their order. Its detections
        are where the cameras would have seen them at the time of the first one, where
        `time_offsets` are used.
    matches: labels in all frames.
    assessment: the verdict on the rig, and its causes.
    smoothing: how the best estimates of the poses were made.
    seconds: wall time by stage.
    """

    recording: Recording
    pairs: tuple[PairwiseCalibration, ...]
    averaged: Averaged
    adjusted: Adjusted
    matches: Matches
    uncertainty: Uncertainty
    poses: Poses3D
    time_offsets: TimeOffsets
    assessment: Verdict = field(default_factory=Verdict)  # not determined, until it is assessed
    smoothing: Smoothing = field(default_factory=Smoothing)
    seconds: dict[str, float] = field(default_factory=dict, compare=False)

    def __repr__(self) -> str:
        return f"GroupResult({self._describe()})"

    if TYPE_CHECKING:  # bound by `front`
        plot = front.plot

    @property
    def rig(self) -> CameraRig:
        """The adjusted rig."""
        return self.adjusted.rig

    @property
    def verdict(self) -> VerdictWord:
        """The verdict on the rig, in a word."""
        return self.assessment.word

    @property
    def reasons(self) -> tuple[Cause, ...]:
        """Why the verdict is no better, and what to do about it; `str` of each is a line."""
        return self.assessment.reasons

    @property
    def clock_offsets(self) -> dict[str, float]:
        """By camera, its clock offset by less than a frame; without those of 0.

        The image n of a camera shows what the first camera sees at n minus its offset.
        """
        offsets = (-self.time_offsets.applied).tolist()
        return {name: part for name, part in zip(self.rig.names, offsets, strict=True) if part}

    def _describe(self) -> str:
        """Return the cameras and what was found of them in one line."""
        frames, individuals = self.poses.positions.shape[:2]
        found = f"{count(individuals, 'individual')} in {count(frames, 'frame')}"
        return f"{', '.join(self.rig.names)}: rig {self.verdict}, {found}"


@dataclass(frozen=True)
class UnusedPair:
    """A pair of cameras (names) that are not in one group, and its score."""

    a: str
    b: str
    score: float


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Record):
    """The results of a run: one for each group of cameras, the largest first.

    left_out: names of the cameras that are in no group.
    config, seed: what the run was made with; the model is that of the groups' recordings.
    faults: what is wrong with the files of single cameras.
    clocks: how the clocks of all cameras differ, also of those left out; groups are on one clock.
    """

    groups: tuple[GroupResult, ...]
    left_out: tuple[str, ...]
    unused_pairs: tuple[UnusedPair, ...]
    config: Config = field(default_factory=Config)
    seed: int = 0
    faults: tuple[Fault, ...] = ()
    clocks: Clocks = field(kw_only=True)

    def __repr__(self) -> str:
        lines = [f"  {group._describe()}" for group in self.groups]
        lines += [f"  {fault.camera}: {fault.says}" for fault in self.faults]
        if self.left_out:
            lines.append(f"  left out: {', '.join(self.left_out)}")
        title = f"CalibrationResult of {count(len(self.groups), 'group')} of cameras"
        return "\n".join([title, *lines])

    if TYPE_CHECKING:  # bound by `front`
        plot = front.plot


# where a camera of a calibration is: docs/verify.md says what each means
PlaceWord = Literal["in place", "moved", "focal", "inconsistent", "not checked"]


@dataclass(frozen=True, eq=False, repr=False)
class VerifiedCamera(Record):
    """One camera of a calibration, verified by keypoints.

    word: a `PlaceWord`.
    turn: radians, and shift: in the unit of the rig, by which the camera pose differs from what the
        calibration says, as the other cameras have it; turn_sigma, shift_sigma: their standard
        deviations. NaN where nothing tells.
    relative_shift: the same in sizes of the rig (RMS distance of the cameras from their middle).
    focal_change: of the logarithm of its focal length, 0 where that is as given.
    error_px: median distance in pixels between what it saw and where the points that the other
        cameras know would be seen, with the camera as given; refitted_px: the same with the camera
        as `Verification.rig` has it. Both with the other cameras as that rig has them.
    """

    name: str
    word: PlaceWord
    turn: float = np.nan
    turn_sigma: float = np.nan
    shift: float = np.nan
    shift_sigma: float = np.nan
    relative_shift: float = np.nan
    focal_change: float = np.nan
    error_px: float = np.nan
    refitted_px: float = np.nan

    @property
    def named(self) -> bool:
        """Whether it is reported as wrong."""
        return self.word in ("moved", "focal", "inconsistent")


@dataclass(frozen=True, eq=False, repr=False)
class Verification(Record):
    """How well a given calibration fits keypoints, and which cameras have moved.

    cameras: in the order of the recording. assessment: how far the calibration can be trusted with
        the cameras that moved where they are now. reasons: what is wrong with cameras, why the
        calibration is no better, and what to do about it; `str` of each is a line.
    rig: the calibration with the cameras that moved, or have another focal length, where they are
        now; all else as given, in its coordinates and its unit.
    clocks: how the clocks of the cameras differ, beyond what the calibration says of them.
    provenance: what files of the rig hold of the verdict, the fields of `io.provenance.judgement`.
    """

    cameras: tuple[VerifiedCamera, ...]
    assessment: Verdict
    reasons: tuple[Cause, ...]
    rig: CameraRig
    clocks: Clocks
    provenance: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def __getitem__(self, name: str) -> VerifiedCamera:
        """Return the camera of that name. Raises KeyError."""
        return self.cameras[find_name(tuple(camera.name for camera in self.cameras), name)]

    @property
    def verdict(self) -> VerdictWord:
        """The verdict on the calibration in one of the words of `VERDICTS`."""
        return self.assessment.word

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the cameras that are reported as wrong."""
        return tuple(camera.name for camera in self.cameras if camera.named)

    @property
    def passes(self) -> bool:
        """Whether no camera is reported as wrong, and the keypoints determine that."""
        return not self.named and self.verdict != "not determined"
