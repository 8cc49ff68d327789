"""Fit poses in the axes of the first camera, whatever the world is that they stand in.

What the joints of a body share of their accelerations is a median of coordinates, which the axes
change. A run fits before it knows any world; what is fitted afterwards is then the same.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.types import CameraRig, Floats, Poses3D


def in_first_camera(rig: CameraRig, poses: Poses3D) -> tuple[CameraRig, Poses3D]:
    """Return cameras and poses in the axes of the first camera; the origin stays."""
    axes = rig.rotation[0]
    if _are_own(axes):
        return rig, poses
    return replace(rig, rotation=nearest_rotation(rig.rotation @ axes.T)), poses.turn(axes)


def back_from_first_camera(fitted: Poses3D, rig: CameraRig, poses: Poses3D) -> Poses3D:
    """Return poses that were fitted in the first camera's axes in those of the rig.

    poses: as they were before, whose triangulated points stay to the last digit.
    """
    axes = rig.rotation[0]
    if _are_own(axes):
        return fitted
    return replace(fitted.turn(axes.T), raw=poses.raw, world=poses.world)


def _are_own(axes: Floats) -> bool:
    """Return whether the axes are those of the world, to the last digit."""
    return np.array_equal(axes, np.eye(3))
