"""Find the floor that subjects stand on, and so what is up.

The lowest foot of each body lies on the floor or above it. Its height over its place in the plane
is a quantile regression (Koenker and Bassett 1978), solved by reweighting, in axes in which the
bodies' own axis is up. The axis is a prior: where the feet leave a direction open, as on one walk
to and fro, it decides. Feet in one place share their error, so that places count, not frames.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import FloorConfig
from mocap_calib.geometry.alignment import body_size
from mocap_calib.results import Poses3D
from mocap_calib.types import CameraRig, Floats, Ints
from mocap_calib.world.body import (
    Joints,
    leg_lengths,
    mean_of,
    stand_straight,
)

# the joints that touch the floor, and those above them in the middle of the body
FEET = {
    "people": ("left_ankle", "right_ankle"),
    "quadruped": ("left_back_paw", "right_back_paw", "left_front_paw", "right_front_paw"),
    "rodent": ("left_hindpaw", "right_hindpaw", "left_forepaw", "right_forepaw"),
}
_TRUNK = {
    "people": ("left_shoulder", "right_shoulder", "neck"),
    "quadruped": (
        *("spine", "croup", "neck_base", "tail_base"),
        *("left_shoulder", "right_shoulder", "left_hip", "right_hip"),
    ),
    "rodent": (
        *("spine_front", "spine_middle", "spine_back", "tail_base"),
        *("left_shoulder", "right_shoulder", "left_hip", "right_hip"),
    ),
}
NO_FEET = "no feet are among the keypoints"  # of people, of animals on four legs


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


@dataclass(frozen=True)
class _Lowest:
    """The lowest foot of each body in each frame.

    points: `[point, 3]`. individual: `[point]`. size: of the bodies. trust: `[point]` 0..1,
    less where the detectors' noise makes the height of a foot uncertain.
    axis: `[3]` of the bodies, and axis_sigma: its standard deviation in radians. height_sigma: of
    the height of feet in one place.
    """

    points: Floats
    individual: Ints
    trust: Floats
    size: float
    axis: Floats
    axis_sigma: float
    height_sigma: float


def find_floor(poses: Poses3D, joints: Joints, rig: CameraRig, config: FloorConfig) -> Floor | str:
    """Return the floor under the bodies, or the reason why it is not determined, in words."""
    found = _lowest_feet(poses, joints, config)
    if isinstance(found, str):
        return found
    slope, covariance, middle, residual = _fit_plane(found, config)
    tension = _tension(slope[:2], covariance[:2, :2], found.axis_sigma)
    covariance = max(tension, 1.0) * covariance
    first, second = _plane_axes(found.axis)
    up = _unit(found.axis - slope[0] * first - slope[1] * second)
    sigma = float(np.sqrt(np.trace(covariance[:2, :2]) + 2 * config.up_sigma**2))
    reason = _doubt_feet(found, residual, config) or _doubt_up(found, up, rig, config)
    if reason:
        return reason
    if sigma > config.most_up_sigma:
        why = "feet and bodies contradict each other" if tension > 1 else "feet are in few places"
        return f"{why} (up is uncertain by {np.degrees(sigma):.0f} deg)"
    drop, drop_sigma = _soles_below(poses, joints, found.size, config)
    point = middle + (slope[2] - drop) * up
    height_sigma = float(np.sqrt(covariance[2, 2] + drop_sigma**2))
    return Floor(up, sigma, point, height_sigma)


def has_feet(joints: Joints) -> bool:
    """Return whether the keypoints are of bodies that can show a floor."""
    feet = joints.present(FEET.get(joints.kind, ()))
    return len(feet) >= 2 and bool(joints.present(_TRUNK.get(joints.kind, ())))


def _doubt_feet(found: _Lowest, residual: Floats, config: FloorConfig) -> str:
    """Return why feet do not lie in a plane, empty where they do.

    residual: `[point]` heights over the plane.
    """
    near = np.abs(residual) < config.reach * found.size
    share = float(near @ found.trust / found.trust.sum())
    if share < config.least_share:
        return f"{100 * (1 - share):.0f} % of the feet are far from one plane"
    spread = 1.4826 * float(np.median(np.abs(residual[near]))) / found.size
    if spread > config.most_spread:
        return f"the feet are at different heights (by {100 * spread:.0f} % of the body's size)"
    return ""


def _tension(slope: Floats, covariance: Floats, axis_sigma: float) -> float:
    """Return how far the plane of the feet is from what the bodies' axis says, 1 = as expected.

    It is chi squared per degree of freedom of the difference between the feet alone and the axis
    alone, by which the variance grows (Birge 1932): 0 to 0.1 in recordings with truth, 2.9 where a
    bystander far behind the cameras seems to stand 0.3 m lower.

    slope: `[2]` of the feet over the plane upright on the axis, covariance: `[2, 2]` of it, both
        with the axis as a prior. axis_sigma: its standard deviation.
    """
    told = axis_sigma**2 * np.eye(2) - covariance  # what the feet told beyond the prior
    return float(slope @ np.linalg.pinv(told, rcond=1e-6) @ slope) / 2


def _doubt_up(found: _Lowest, up: Floats, rig: CameraRig, config: FloorConfig) -> str:
    """Return why a direction is not up, empty where it is."""
    if np.arccos(np.clip(up @ found.axis, -1, 1)) > config.most_lean:
        return "the feet lie in a plane on which the bodies do not stand upright"
    against = _against_cameras(up, rig, config)
    if against > config.most_against_cameras:
        return (
            f"the plane of the feet leans by {np.degrees(against):.0f} deg against the cameras, "
            "which are level"
        )
    return ""


def _lowest_feet(poses: Poses3D, joints: Joints, config: FloorConfig) -> _Lowest | str:
    """Return the lowest foot of each body, or why there is none, in words."""
    if not has_feet(joints):
        return NO_FEET
    feet, trunk = joints.present(FEET[joints.kind]), joints.present(_TRUNK[joints.kind])
    positions = poses.positions
    size = body_size(positions)
    middle, above = mean_of(positions, feet), mean_of(positions, trunk)
    seen = np.isfinite(middle[..., 0]) & np.isfinite(above[..., 0])
    bodies = sum(
        int(np.isfinite(positions[block, ..., 0]).any(-1).sum())
        for block in mapped.frame_slices(len(positions))
    )
    if not bodies:
        return "nobody was found"
    if not np.isfinite(size) or seen.sum() < max(config.least_feet, config.least_seen * bodies):
        return f"feet were seen of {seen.sum()} of the {bodies} bodies looked at"
    axis, sigma = _body_axis(poses, joints, above - middle, config)
    frame, individual = np.nonzero(seen)
    each = positions[frame, individual][:, feet]
    height = np.where(np.isfinite(each[..., 0]), each @ axis, np.inf)
    which = height.argmin(-1)
    variances = poses.covariance[frame, individual, np.array(feet)[which]][:, (0, 3, 5)]
    noise = np.sqrt(variances.sum(-1, dtype=np.float64))
    mapped.let_go()
    height_sigma = size * config.height_sigma
    height_sigma *= 1.0 if sigma == config.stand_sigma else 2.0
    return _Lowest(
        points=each[np.arange(len(each)), which],
        individual=individual,
        trust=1 / (1 + (np.nan_to_num(noise) / height_sigma) ** 2),
        size=size,
        axis=axis,
        axis_sigma=sigma,
        height_sigma=height_sigma,
    )


def _body_axis(
    poses: Poses3D, joints: Joints, rise: Floats, config: FloorConfig
) -> tuple[Floats, float]:
    """Return the direction `[3]` from the feet to the trunk, and its standard deviation.

    It is the geometric median over the bodies (Weiszfeld); of people over those who stand, if
    there are enough.

    rise: `[frame, individual, 3]` from the middle of the feet to that of the trunk, NaN = missing.
    """
    sigma = config.crouch_sigma
    if joints.kind == "people":
        straight = stand_straight(poses, joints, config.straight)
        seen = np.isfinite(rise[..., 0])
        if (straight & seen).sum() >= config.least_standing * seen.sum():
            rise, sigma = np.where(straight[..., None], rise, np.nan), config.stand_sigma
    directions = rise[np.isfinite(rise[..., 0])]
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    middle = directions.mean(0)
    for _ in range(30):
        weight = 1 / np.maximum(np.linalg.norm(directions - middle, axis=1), 1e-3)
        middle = weight @ directions / weight.sum()
    return _unit(middle), sigma


def _fit_plane(found: _Lowest, config: FloorConfig) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit the height of the feet over their place.

    Returns the slopes in both directions and the height in the middle `[3]`, their covariance
    `[3, 3]`, the middle of the feet `[3]` without its height, and the residuals `[point]`.
    """
    first, second = _plane_axes(found.axis)
    scale = found.height_sigma
    middle = np.median(found.points, axis=0)
    offset = found.points - middle
    place = np.stack([offset @ first, offset @ second, np.ones(len(offset))], axis=1)
    height = offset @ found.axis
    prior = np.diag([1 / found.axis_sigma**2] * 2 + [1e-12 / scale**2])
    places = _count_places(found, place, config)
    residual = height - np.median(height)
    for _ in range(config.steps):
        below = np.where(residual > 0, config.quantile, 1 - config.quantile)
        weight = below * config.kink * found.size
        weight /= np.maximum(np.abs(residual), config.kink * found.size)
        weight *= found.trust / (1 + (residual / (config.reach * found.size)) ** 2)
        information = places / weight.sum() / scale**2
        normal = information * (place * weight[:, None]).T @ place + prior
        solution = np.linalg.solve(normal, information * (place * weight[:, None]).T @ height)
        residual = height - place @ solution
    return solution, np.linalg.inv(normal), middle, residual


def _count_places(found: _Lowest, place: Floats, config: FloorConfig) -> float:
    """Return in how many places feet were: cells of a grid, of each individual by itself.

    A place counts for what its most certain foot does.
    """
    cells = np.floor(place[:, :2] / (config.cell * found.size)).astype(np.int64)
    keys = np.column_stack([found.individual, cells])
    _, cell = np.unique(keys, axis=0, return_inverse=True)
    best = np.zeros(cell.max() + 1)
    np.maximum.at(best, cell.ravel(), found.trust)
    return float(best.sum())


def _soles_below(
    poses: Poses3D, joints: Joints, size: float, config: FloorConfig
) -> tuple[float, float]:
    """Return how far soles are below the joints that stand for feet, and its standard deviation."""
    if joints.kind != "people":
        return 0.0, config.paw_sigma * size
    legs = leg_lengths(poses, joints)
    legs = legs[np.isfinite(legs)]
    leg = float(np.median(legs)) if len(legs) else config.leg_of_size * size
    return config.ankle_height * leg, config.ankle_sigma * leg


def level_axis(rig: CameraRig, config: FloorConfig) -> Floats | None:
    """Return the direction `[3]` on which the horizontal axes of the images stand upright.

    Its sign is open. None where they do not agree on one.
    """
    right = rig.rotation[:, 0]
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    if values[0] > np.sin(config.level_roll) ** 2 or values[1] < np.sin(config.level_spread) ** 2:
        return None
    return vectors[:, 0]


def _against_cameras(up: Floats, rig: CameraRig, config: FloorConfig) -> float:
    """Return the angle in radians between up and what level cameras say, 0 where they do not."""
    axis = level_axis(rig, config) if len(rig) >= config.level_cameras else None
    return 0.0 if axis is None else float(np.arccos(min(abs(float(up @ axis)), 1.0)))


def _plane_axes(up: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors `[3]` that span the plane on which a direction stands upright."""
    first = _unit(np.cross(up, np.eye(3)[np.abs(up).argmin()]))
    return first, np.cross(up, first)


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector)
