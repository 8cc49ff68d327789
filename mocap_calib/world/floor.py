"""Bodies, and the floor that they stand on: so the up direction.

The lowest foot of each body lies on the floor, but for some. Its height over its place in the plane
is a regression of least absolute deviations, solved by reweighting, in axes in which the bodies'
own axis is up. The axis is a prior: it decides directions that the feet leave open, as on one walk
to and fro. Feet in one place share their error, so places count, not frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import AveragingConfig, FloorConfig
from mocap_calib.geometry.rotation import body_size, looking_along, mean_of_known
from mocap_calib.kinematics import SIDES, leg_lengths
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.recording.joints import choose_skeleton, load_section, match_names
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import Bools, Floats, Ints, Recording, Skeleton

NO_FEET = "no feet are among the keypoints"  # of people, of animals on four legs
# joints that touch the floor, by kind of skeleton
FEET = {
    "people": ("left_ankle", "right_ankle"),
    "quadruped": ("left_back_paw", "right_back_paw", "left_front_paw", "right_front_paw"),
    "rodent": ("left_hindpaw", "right_hindpaw", "left_forepaw", "right_forepaw"),
}
_LEG = ("hip", "knee", "ankle")


@dataclass(frozen=True)
class Joints:
    """The keypoints of poses that are joints of a skeleton.

    kind: name of the skeleton ("people", "quadruped", ...).
    columns: joint -> index of the keypoint.
    """

    kind: str
    columns: dict[str, int]

    def present(self, names: Sequence[str]) -> list[int]:
        """Return the indices of the keypoints of these joints, without joints that are absent."""
        return [self.columns[name] for name in names if name in self.columns]

    @property
    def feet(self) -> list[int]:
        """Indices of the keypoints of the feet."""
        return self.present(FEET.get(self.kind, ()))

    @property
    def trunk(self) -> list[int]:
        """Indices of the keypoints of the trunk, as its kinematics have it."""
        joints = load_section(self.kind, "kinematics").get("trunk", ())
        return self.present([side + joint for joint in joints for side in ("", *SIDES)])

    @property
    def have_feet(self) -> bool:
        """Whether bodies with these joints can show a floor."""
        return len(self.feet) >= 2 and bool(self.trunk)


def find_joints(keypoints: tuple[str, ...], skeleton: Skeleton | None = None) -> Joints:
    """Return the joints that keypoints are, by their names.

    skeleton: of the model; None: the shipped one that knows most of the names.
    """
    skeleton = skeleton or choose_skeleton(keypoints)
    known = match_names(keypoints, skeleton)
    columns = {skeleton.keypoints[joint]: k for k, joint in enumerate(known) if joint >= 0}
    return Joints(skeleton.name, columns)


def joints_of_recording(recording: Recording) -> Joints:
    """Return the joints that the keypoints of a recording are, by the vocabulary of its model."""
    return find_joints(_spell_joints(recording))


def stated_joints(recording: Recording) -> tuple[str, ...]:
    """Return the joint `[keypoint]` of each keypoint, "" = none; empty where names say the same.

    Names do not say it where a user's file of names or another model does.
    """
    if joints_of_recording(recording).columns == find_joints(recording.keypoints).columns:
        return ()
    known = zip(_spell_joints(recording), recording.vocabulary, strict=True)
    return tuple(name if joint >= 0 else "" for name, joint in known)


def _spell_joints(recording: Recording) -> tuple[str, ...]:
    """Return the model's joint `[keypoint]` of each keypoint, its own name where it is none."""
    names = load_vocabulary(recording.model).keypoints
    known = zip(recording.keypoints, recording.vocabulary, strict=True)
    return tuple(names[joint] if joint >= 0 else own for own, joint in known)


def sample_poses(poses: Poses3D) -> Poses3D:
    """Return at most 10,000 of the frames with bodies, and of these the triangulated points.

    Points that fewer than two views saw follow from other frames and other bodies.
    """
    seen = mapped.in_blocks(
        lambda block: np.isfinite(poses.positions[block, ..., 0]).any((1, 2)), len(poses.frames)
    )
    poses = poses.select(frames=mapped.some_frames(np.flatnonzero(seen)))
    triangulated = poses.source == POINT_SOURCES.index("triangulated")
    positions = np.where(triangulated[..., None], poses.positions, np.nan)
    return replace(poses, positions=positions, raw=positions)


def distance(positions: Floats, a: int, b: int) -> Floats:
    """Return the distance `[frame, individual]` between two keypoints."""
    return np.asarray(np.linalg.norm(positions[:, :, a] - positions[:, :, b], axis=-1))


def lengths_of_legs(positions: Floats, joints: Joints) -> Floats:
    """Return the length `[individual]` of people's legs, hip to ankle; NaN = not known."""
    legs = [joints.present([side + joint for joint in _LEG]) for side in SIDES]
    return leg_lengths(positions, [leg for leg in legs if len(leg) == len(_LEG)])


def stand_straight(positions: Floats, joints: Joints, least: float) -> Bools:
    """Return whether people `[frame, individual]` stand on a straight leg.

    least: distance of hip and ankle, as a share of the length of the leg.
    """
    length = lengths_of_legs(positions, joints)
    straight = np.zeros(positions.shape[:2], dtype=bool)
    for side in SIDES:
        ends = joints.present([f"{side}hip", f"{side}ankle"])
        if len(ends) == 2:
            straight |= distance(positions, *ends) > least * length
    return straight


@dataclass(frozen=True)
class Floor:
    """A plane that bodies stand on, in the axes and the unit of the poses.

    up: `[3]` unit vector. up_sigma: standard deviation of its direction in radians (RMS angle).
    point: `[3]` of the floor, below the middle of the bodies. sigma: of its height.
    """

    up: Floats
    up_sigma: float
    point: Floats
    sigma: float


def find_floor(poses: Poses3D, joints: Joints, config: FloorConfig) -> Floor | str:
    """Return the floor below bodies, or the reason in words why it is not determined."""
    positions = poses.positions
    if not joints.have_feet:
        return NO_FEET
    size = body_size(positions)
    if not np.isfinite(size):
        return "no bodies were found"
    feet = positions[:, :, joints.feet]
    rise = mean_of_known(positions[:, :, joints.trunk], 2) - mean_of_known(feet, 2)
    seen = np.isfinite(rise[..., 0])
    if not seen.any():
        return "no feet were seen"
    axis, stand = _axis_of_bodies(positions, rise, joints, config)
    axis_sigma = config.sigma if stand else 4 * config.sigma
    axes = looking_along(axis, np.eye(3)[np.abs(axis).argmin()])  # rows: two of the floor, then up
    places = feet[seen] @ axes.T
    lowest = np.where(np.isfinite(places[..., 2]), places[..., 2], np.inf).argmin(1)
    places = places[np.arange(len(places)), lowest]
    middle = np.median(places, axis=0)
    plane, covariance, residual = _fit_plane(
        places - middle,
        np.nonzero(seen)[1],
        axis_sigma=axis_sigma,
        height_sigma=size * config.sigma * (1.0 if stand else 2.0),
        size=size,
        config=config,
    )
    spread = 1.4826 * float(np.median(np.abs(residual))) / size
    if spread > config.sigma:
        return f"the feet are at different heights (by {100 * spread:.0f} % of the body's size)"
    tension = _tension(plane[:2], covariance[:2, :2], axis_sigma)
    covariance = max(tension, 1.0) * covariance
    up = np.array([*-plane[:2], 1.0]) @ axes
    up = up / np.linalg.norm(up)
    sigma = float(np.sqrt(np.trace(covariance[:2, :2]) + 2 * config.up_sigma**2))
    if sigma > 2 * config.sigma:
        why = "feet and bodies contradict each other" if tension > 1 else "feet are in few places"
        return f"{why} (up is uncertain by {np.degrees(sigma):.0f} deg)"
    point = middle @ axes + (plane[2] - _ankle_height(positions, joints, size, config)) * up
    sole_sigma = config.sigma * size
    return Floor(up, sigma, point, float(np.hypot(np.sqrt(covariance[2, 2]), sole_sigma)))


def _axis_of_bodies(
    positions: Floats, rise: Floats, joints: Joints, config: FloorConfig
) -> tuple[Floats, bool]:
    """Return the direction `[3]` from feet to trunk, and whether it is that of people who stand.

    positions: `[frame, individual, keypoint, 3]`. rise: `[frame, individual, 3]`, NaN = not seen.
    """
    seen = np.isfinite(rise[..., 0])
    straight = np.zeros_like(seen)
    if joints.kind == "people":
        straight = stand_straight(positions, joints, config.straight) & seen
    stand = bool(straight.sum() >= seen.sum() / 4)  # else their axis is that of a few frames
    directions = rise[straight if stand else seen]
    axis = np.median(directions / np.linalg.norm(directions, axis=-1, keepdims=True), axis=0)
    return axis / np.linalg.norm(axis), stand


def _tension(slope: Floats, covariance: Floats, axis_sigma: float) -> float:
    """Return how far the plane of the feet is from what the bodies' axis says, 1 = as expected.

    It is chi squared per degree of freedom of the difference between the feet alone and the axis
    alone, by which the variance grows (Birge 1932): 0 to 0.1 in recordings with truth, 2.9 where a
    bystander far behind the cameras seems to stand 0.3 m lower.

    slope: `[2]` of the feet over the plane upright on the axis, covariance: `[2, 2]` of it, both
        with the axis as a prior. axis_sigma: its standard deviation.
    """
    gained = axis_sigma**2 * np.eye(2) - covariance  # information of the feet beyond the prior's
    return float(slope @ np.linalg.pinv(gained, rcond=1e-6) @ slope) / 2


def _fit_plane(
    places: Floats,
    individual: Ints,
    *,
    axis_sigma: float,
    height_sigma: float,
    size: float,
    config: FloorConfig,
) -> tuple[Floats, Floats, Floats]:
    """Fit the height of the feet over their place.

    Returns the slopes in both directions and the height in the middle `[3]`, their covariance
    `[3, 3]`, and the residuals `[point]`.

    places: `[point, 3]` about their middle, along the plane upright on the axis of the bodies, and
        along that axis. individual: `[point]`. height_sigma: of feet in one place. size: of bodies.
    """
    near = config.near * size
    kink = config.sigma * size / 4  # nearer than this the loss is smooth
    design, height = np.column_stack([places[:, :2], np.ones(len(places))]), places[:, 2]
    prior = np.diag([1 / axis_sigma**2] * 2 + [1e-12 / height_sigma**2])
    cells = np.floor(places[:, :2] / near).astype(np.int64)
    count = len(np.unique(np.column_stack([individual, cells]), axis=0))
    residual = height - np.median(height)
    for _ in range(AveragingConfig.iterations):
        weight = 1 / np.maximum(np.abs(residual), kink) / (1 + (residual / near) ** 2)
        known = (count / weight.sum() / height_sigma**2 * weight)[:, None] * design
        normal = known.T @ design + prior
        solution = np.linalg.solve(normal, known.T @ height)
        residual = height - design @ solution
    return solution, np.linalg.inv(normal), residual


def _ankle_height(positions: Floats, joints: Joints, size: float, config: FloorConfig) -> float:
    """Return the height of people's ankles over the sole; paws of animals have none."""
    if joints.kind != "people":
        return 0.0
    legs = lengths_of_legs(positions, joints)
    legs = legs[np.isfinite(legs)]
    return config.ankle_height * (float(np.median(legs)) if len(legs) else 2 * size)
