"""What a file of 3D poses holds besides the poses, and what the formats share."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.geometry.rotation import skew
from mocap_calib.io.document import Document
from mocap_calib.io.file import find_repeated, readable_name
from mocap_calib.io.format import Loss
from mocap_calib.io.hdf5 import DAMAGE
from mocap_calib.io.units import unit_factor
from mocap_calib.recording.joints import choose_skeleton, edges_of_keypoints, match_names
from mocap_calib.results import Poses3D
from mocap_calib.types import ARBITRARY, CameraRig, Floats, Ints, check_names

MOST_VIEWS = 1e6  # of a point, what no file has
_LONGEST = 5_000_000  # frames of a file without gaps: a day and a half at 30 per second
UNNAMED = re.compile(r"individual_[0-9]+")  # what individuals without a name are called


@dataclass(frozen=True)
class PoseFile:
    """Poses and what files say beside.

    poses: where a file lacks them, error, confidence and covariance are NaN and views 0.
    rate: frames per second, NaN where not stated.
    individuals: `[individual]` names; those of a file without names are called individual_0, ...
    notes: what a user should know of what was left out.
    edges: pairs of keypoints (indices) that a skeleton joins, where the file says so.
    joints: `[keypoint]` joint that each is, "" = none, where the keypoints' names do not say so.
    rig: the cameras, in the same coordinates, where they are known: for formats that show them.
    """

    poses: Poses3D
    rate: float = math.nan
    individuals: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    edges: tuple[tuple[int, int], ...] = ()
    rig: CameraRig | None = None
    joints: tuple[str, ...] = ()

    @property
    def spelt(self) -> tuple[str, ...]:
        """`[keypoint]` names that say which joints they are, where that is known."""
        names = self.poses.keypoints
        joints = self.joints or names
        return tuple(joint or name for joint, name in zip(joints, names, strict=True))

    def __post_init__(self) -> None:
        """Raise ValueError for another number of names or joints, and edges of other keypoints."""
        _, count, keypoints = self.poses.positions.shape[:3]
        unnamed = tuple(f"individual_{k}" for k in range(count))
        object.__setattr__(self, "individuals", tuple(self.individuals) or unnamed)
        if len(self.individuals) != count:
            raise ValueError(f"individuals: expected {count} names, got {len(self.individuals)}")
        if self.joints and len(self.joints) != keypoints:
            raise ValueError(f"joints: expected {keypoints}, got {len(self.joints)}")
        ends = {end for edge in self.edges for end in edge}
        if ends and not 0 <= min(ends) <= max(ends) < keypoints:
            expected = f"expected keypoints 0 to {keypoints - 1}"
            raise ValueError(f"edges: {expected}, got {min(ends)} to {max(ends)}")


def describe_poses(
    poses: Poses3D, fps: float | None, individuals: Sequence[str] = (), **known: Any
) -> PoseFile:
    """Return poses with what is known beside them, see `PoseFile`.

    fps: frames per second; None: not known.

    Raises ValueError as `PoseFile` does, for names that occur twice, and for a rate that is not
    above 0.
    """
    check_names("individuals", individuals)
    check_rate(fps)
    return PoseFile(poses, math.nan if fps is None else fps, tuple(individuals), **known)


def check_rate(fps: float | None) -> None:
    """Raise ValueError where frames per second are given and not above 0."""
    if fps is not None and not 0 < fps < math.inf:
        raise ValueError(f"fps: expected a number above 0, got {fps}")


# --- for readers


def is_hdf5_that(document: Document, test: Callable[[Any], bool]) -> bool:
    """Return whether the content is HDF5 that passes a test of it as it is opened.

    Damaged files do not.
    """
    try:
        return document.is_hdf5 and bool(test(document.hdf5))
    except (FormatError, *DAMAGE):
        return False


def mark_missing(positions: Floats) -> Floats:
    """Return `[..., 3]` positions, all NaN where a coordinate is not a finite number."""
    return np.where(np.isfinite(positions).all(-1, keepdims=True), positions, np.nan)


def bare_poses(
    keypoints: Sequence[str],
    frames: Ints,
    positions: Floats,
    *,
    unit: str,
    confidence: Floats | None = None,
) -> Poses3D:
    """Return the poses of a file that says no more than this.

    keypoints: `[keypoint]` names.
    frames: `[frame]` numbers.
    positions: `[frame, individual, keypoint, 3]`, NaN = missing.
    confidence: `[frame, individual, keypoint]`.
    """
    shape = positions.shape[:3]
    unknown = np.full(shape, np.nan)
    return Poses3D(
        keypoints=tuple(keypoints),
        frames=frames,
        positions=positions,
        error=unknown,
        views=np.zeros(shape, dtype=np.int64),
        confidence=unknown if confidence is None else confidence,
        unit=unit,
    )


def check_poses(file: PoseFile, source: str) -> PoseFile:
    """Return the file, with names as `readable_name` has them.

    Raises FormatError as that does, where a name or a frame occurs twice, and where frames are not
    in order.
    """
    given = {"keypoint": file.poses.keypoints, "individual": file.individuals}
    read = {
        what: tuple(readable_name(name, source, what) for name in names)
        for what, names in given.items()
    }
    for what, names in read.items():
        if twice := ", ".join(find_repeated(names)):
            raise FormatError(source, f"each {what} once", f"{twice} twice", "rename one of them")
    if (np.diff(file.poses.frames) <= 0).any():
        raise FormatError(source, "frames in order, each once", "others", "write the file again")
    if read == given:
        return file
    poses = replace(file.poses, keypoints=read["keypoint"])
    return replace(file, poses=poses, individuals=read["individual"])


# --- for writers


def convert_unit(file: PoseFile, unit: str, owner: str) -> PoseFile:
    """Return the poses in another unit of length.

    owner: names who asks for it.

    Raises MismatchError where the poses' own unit is not known.
    """
    factor = unit_factor(file.poses.unit, unit, owner)
    rig = None if file.rig is None else file.rig.scale(factor, unit)
    return replace(file, poses=file.poses.scale(factor, unit), rig=rig)


def known_edges(file: PoseFile) -> tuple[tuple[int, int], ...]:
    """Return the pairs of keypoints (indices) that a skeleton joins.

    Where the file does not say them, the shipped skeleton that knows most of the names does.
    """
    if file.edges:
        return file.edges
    skeleton = choose_skeleton(file.spelt)
    return edges_of_keypoints(skeleton, match_names(file.spelt, skeleton))


def fill_gaps(poses: Poses3D, owner: str) -> tuple[Ints, Floats]:
    """Return all frame numbers from the first to the last, and the positions.

    frames: `[frame]`. positions: `[frame, individual, keypoint, 3]`, NaN where a frame is missing.

    Raises MismatchError where there is no frame, or far too many.
    """
    if not len(poses.frames):
        raise MismatchError(owner, "at least one frame", "none", "nothing to write")
    first, last = int(poses.frames[0]), int(poses.frames[-1])
    if last - first >= _LONGEST:
        expected = f"frames within {_LONGEST} of each other, as the format has no gaps"
        raise MismatchError(owner, expected, f"{first} to {last}", "split the file")
    positions = np.full((last - first + 1, *poses.positions.shape[1:]), np.nan)
    positions[poses.frames - first] = poses.positions
    return np.arange(first, last + 1), positions


def need_rate(file: PoseFile, owner: str) -> float:
    """Return the frames per second. Raises MismatchError where nobody said."""
    if not file.rate > 0 or not np.isfinite(file.rate):
        remedy = f"say it with {argument('fps')}"
        raise MismatchError(owner, "the number of frames per second", "none", remedy)
    return file.rate


def need_keypoints(file: PoseFile, pattern: str, words: str, owner: str) -> None:
    """Raise MismatchError where the name of a keypoint or an individual does not match the pattern.

    words: describe the pattern.
    """
    for name in (*file.poses.keypoints, *file.individuals):
        if not re.fullmatch(pattern, name):
            raise MismatchError(owner, f"names of {words}", f"{name!r}", "rename it")


UNIT = Loss("the unit ({0.poses.unit})", lambda file: file.poses.unit != ARBITRARY)
ERRORS = Loss("reprojection errors", lambda file: np.isfinite(file.poses.error).any())
VIEWS = Loss("numbers of views", lambda file: file.poses.views.any())
CONFIDENCES = Loss("confidences", lambda file: np.isfinite(file.poses.confidence).any())
COVARIANCES = Loss("covariances", lambda file: np.isfinite(file.poses.covariance).any())
QUALITY = (ERRORS, VIEWS, CONFIDENCES, COVARIANCES)  # of positions alone
INDIVIDUALS = Loss(
    "the individuals' names", lambda file: not all(map(UNNAMED.fullmatch, file.individuals))
)
LENSES = Loss(
    "the distortion of lenses", lambda file: any(c.distortion.any() for c in file.rig or ())
)


# --- the axis that points up

# axis that points up -> rotation of the world that makes it y
_UP = {
    "x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}


def turn_up_axis(file: PoseFile, up: str) -> PoseFile:
    """Turn the poses so that the axis that points up is y, as OpenSim and others take it.

    up: x, y, z, -x, -y or -z; the other axes follow. What the file itself says of up is forgotten.
    """
    turned = _turn(file, np.array(_UP[up], dtype=np.float64))
    world = replace(turned.poses.world, up=np.array([0.0, 1.0, 0.0]))
    return replace(turned, poses=replace(turned.poses, world=world))


def turn_upright(file: PoseFile, axis: str) -> PoseFile:
    """Turn the poses so that what is up is this axis, where the poses say what is up.

    axis: y or z; with another, or where none is stated to point up, the axes stay. From the axes
    of the world that are nearest to up to those of the file is a change of axes alone, (X, Y, Z) ->
    (Y, Z, X) for z up and y wanted; the rest is the smallest turn.
    """
    up = file.poses.world.up
    if axis not in ("y", "z") or not np.isfinite(up).all():
        return file
    nearest = max(_UP, key=lambda name: float(_direction(name) @ up))
    turn = np.array(_UP[nearest], dtype=np.float64)
    if axis == "z":  # from y to z: back, as z to y is
        turn = np.array(_UP["z"], dtype=np.float64).T @ turn
    rest = turn_between(turn @ up, _direction(axis))
    if np.array_equal(rest @ turn, np.eye(3)):
        return file
    return _turn(file, rest @ turn)


def up_axis(file: PoseFile) -> str:
    """Return the axis of the file that points up (x, -y, ...), "" where none is known to.

    Within half a degree, which no reader tells from the axis.
    """
    up = file.poses.world.up
    return next((axis for axis in _UP if _direction(axis) @ up > np.cos(np.radians(0.5))), "")


def _direction(axis: str) -> Floats:
    """Return the unit vector `[3]` along an axis: x, -y, ..."""
    found = np.zeros(3)
    found["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return found


def _turn(file: PoseFile, rotation: Floats) -> PoseFile:
    """Return poses and cameras in other axes, to which a rotation `[3, 3]` turns those there."""
    rig = file.rig
    if rig is not None:
        turned = rig.rotation @ rotation.T
        rig = replace(rig, rotation=turned, world=rig.world.turn(rotation))
    return replace(file, poses=file.poses.turn(rotation), rig=rig)


def turn_between(first: Floats, second: Floats) -> Floats:
    """Return the smallest rotations `[..., 3, 3]` that turn vectors `[..., 3]` to along others.

    Of any length. Opposite ones are turned about any axis across; where one of them has no length,
    nothing is.
    """
    a = _unit(first)
    b = _unit(second)
    cosine = (a * b).sum(-1)[..., None, None]
    axis = np.cross(a, b)
    # R = I + [v]x + [v]x^2 / (1 + cos), v = a x b; a half turn is 2 u u' - I, u across
    across = np.cross(a, np.eye(3)[np.abs(a).argmin(-1)])
    across = _unit(across)
    half_turn = 2 * across[..., :, None] * across[..., None, :] - np.eye(3)
    opposite = cosine < -1 + 1e-12
    crossed = skew(axis)
    usual = np.eye(3) + crossed + crossed @ crossed / np.where(opposite, 1.0, 1 + cosine)
    return np.where(opposite, half_turn, usual)


def _unit(vector: Floats) -> Floats:
    """Return vectors `[..., 3]` at length 1; those without length as they are."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(length > 0, length, 1.0), dtype=np.float64)
