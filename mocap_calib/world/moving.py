"""Move cameras, poses and their covariances to other coordinates."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.results import GroupResult, Poses3D, RigCovariance
from mocap_calib.types import CameraRig, Floats, World


@dataclass(frozen=True)
class Similarity:
    """How points move: x' = scale R x + shift, with a rotation `[3, 3]` and a shift `[3]`."""

    scale: float
    rotation: Floats
    shift: Floats

    def apply(self, points: Floats) -> Floats:
        """Return points `[..., 3]` where they are then."""
        return self.scale * points @ self.rotation.T + self.shift

    @property
    def still(self) -> bool:
        """Whether nothing moves, to the last digit."""
        turned = not np.array_equal(self.rotation, np.eye(3))
        return not turned and not self.shift.any() and self.scale == 1


def move_rig(rig: CameraRig, by: Similarity, unit: str, world: World) -> CameraRig:
    """Return a rig in other coordinates, whose unit and world are said."""
    if by.still:
        return replace(rig, unit=unit, world=world)
    rotation = nearest_rotation(rig.rotation @ by.rotation.T)  # a file holds it to the last digit
    translation = by.scale * rig.translation - rotation @ by.shift
    return replace(rig, rotation=rotation, translation=translation, unit=unit, world=world)


def move_poses(poses: Poses3D, by: Similarity, unit: str, world: World) -> Poses3D:
    """Return poses in other coordinates, whose unit and world are said."""
    if by.still:
        return replace(poses, unit=unit, world=world)
    return replace(poses.scale(by.scale, unit).turn(by.rotation, by.shift), world=world)


def move_covariance(covariance: RigCovariance, by: Similarity) -> RigCovariance:
    """Return the covariance of a rig in other coordinates: its axes turn, its size scales."""
    turn = np.kron(np.eye(2), by.rotation)  # turns of the cameras, and shifts of their centres
    matrix = np.einsum("ij,vjwk,lk->viwl", turn, covariance.matrix, turn)
    return replace(covariance, matrix=matrix, size=by.scale * covariance.size)


def move_group(group: GroupResult, by: Similarity, unit: str, world: World) -> GroupResult:
    """Return all that is known of a group of cameras in other coordinates.

    A rig reversed in depth stays where it is: nothing of it was measured.
    """
    averaged = move_rig(group.averaged.rig, by, unit, world)
    adjusted = move_rig(group.rig, by, unit, world)
    covariance = move_covariance(group.uncertainty.covariance, by)
    changes: Mapping[str, Any] = {
        "averaged": replace(group.averaged, rig=averaged),
        "adjusted": replace(group.adjusted, rig=adjusted),
        "uncertainty": replace(group.uncertainty, covariance=covariance),
        "poses": move_poses(group.poses, by, unit, world),
    }
    return replace(group, **changes)
