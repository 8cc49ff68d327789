"""What the cameras of a rig see of points: pixels, and how far off these are."""

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.geometry.rays import points_in_cameras
from mocap_calib.kernels.lens import reprojection_errors
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Bools, CameraRig, Floats


def project(rig: CameraRig, points: Floats) -> Floats:
    """Return the pixels `[view, 2, N]` of points `[3, N]` in world coordinates; NaN = behind."""
    return np.stack(list(map(lens.project, rig.cameras, points_in_cameras(rig, points))))


def reprojection_error(rig: CameraRig, points: Floats, *, pixels: Floats, used: Bools) -> Floats:
    """Return the RMS distance `[N]` in pixels of points from their detections in the used views.

    points: `[3, N]` in world coordinates; pixels: `[view, 2, N]` the detections; used: `[view, N]`.
    NaN where no view is used. A view that has a point behind it adds no distance.
    """
    error = np.empty(points.shape[1])
    pose = np.concatenate([rig.rotation, rig.translation[:, :, None]], axis=2)
    reprojection_errors(*contiguous(pose, lens.rows(rig.cameras), points, pixels, used), error)
    return error
