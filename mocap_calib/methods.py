"""Methods of records whose work is done in rooms above `results`, bound to the records here.

`mocap_calib.__getattr__` imports this module before it returns the first name of the front door,
so `rig.project(...)` and `result.plot()` work for every user. The package itself calls the
functions of the rooms, and imports go one way.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.geometry.lens import project_points
from mocap_calib.notebook.tables import describe_group, describe_result, describe_rig
from mocap_calib.results import CalibrationResult, GroupResult, Poses3D
from mocap_calib.types import (
    Camera,
    CameraRig,
    Floats,
    Keypoints2D,
    Recording,
    as_array,
    check_names,
    intrinsics_of,
)

if TYPE_CHECKING:
    import xarray
    from plotly.graph_objects import Figure


def triangulate(
    rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """Return the points `[..., 3]` that pixels `[view, ..., 2]` show, and their errors `[...]`.

    As robust as the triangulation of a run : a view that contradicts the others is
    left out. A point is NaN where fewer than two views agree on it, or see it from almost the same
    side. The error is the RMS reprojection error in pixels over the views that were used.

    pixels: NaN (or infinite) = missing. confidence: `[view, ...]` weights, 0 = missing; None: all
    count alike.

    Raises ValueError for arrays of other shapes.
    """
    from mocap_calib.rig.triangulate import triangulate_pixels

    middle = np.shape(pixels)[1:-1]
    seen = as_array("pixels", pixels, float, len(rig), *middle, 2)
    given = np.ones(seen.shape[:-1]) if confidence is None else confidence
    weight = as_array("confidence", given, float, len(rig), *middle)
    seen = np.where(np.isfinite(seen), seen, np.nan)
    weight = np.where(np.isfinite(weight), weight, 0.0)
    return triangulate_pixels(rig, seen, weight)


def from_arrays(
    positions: ArrayLike,
    confidence: ArrayLike | None = None,
    *,
    keypoints: Sequence[str],
    cameras: Sequence[Camera] | CameraRig,
    frames: ArrayLike | None = None,
    tracked: bool = False,
) -> Recording:
    """Return the recording of detections in arrays.

    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing; or
        `[view, frame, keypoint, 2]` of a single subject.
    confidence: `[view, frame, instance, keypoint]` (or without instances), 0 = missing; None: 1 of
        all that is detected.
    keypoints: `[keypoint]` names. cameras: `[view]`, in the order of the positions.
    frames: `[frame]` numbers, ascending, each once; None: counted from 0.
    tracked: the instance index names the same individual in all frames; so it does for a single
        subject.

    Raises ValueError for arrays of other shapes, for frames that do not ascend and for names that
    occur twice, and MismatchError as `from_keypoints` does.
    """
    from mocap_calib.recording.synchronise import split_by_view

    known = intrinsics_of(cameras)
    check_names("keypoints", keypoints)
    check_names("cameras", [camera.name for camera in known])
    given = np.asarray(positions, dtype=np.float64)
    weight = np.ones(given.shape[:-1]) if confidence is None else np.asarray(confidence, float)
    alone = given.ndim == 4  # no axis of instances
    if alone:
        given, weight = given[:, :, None], np.expand_dims(weight, min(2, weight.ndim))
    seen = as_array("positions", given, float, len(known), None, None, len(keypoints), 2)
    weight = as_array("confidence", weight, float, *seen.shape[:-1])
    present = np.isfinite(seen).all(-1) & (weight > 0)
    given_frames = np.arange(seen.shape[1]) if frames is None else frames
    numbers = as_array("frames", given_frames, int, seen.shape[1])
    if (np.diff(numbers) <= 0).any():
        raise ValueError("frames: expected numbers that ascend, each once; sort the frames")
    views = split_by_view(
        known,
        keypoints=tuple(keypoints),
        frames=numbers,
        positions=np.where(present[..., None], seen, np.nan),
        confidence=np.where(present, weight, 0.0),
        tracked=np.full(len(known), tracked or alone),
        source="arrays",
    )
    return from_keypoints(views, known)


def from_keypoints(
    views: Sequence[Keypoints2D], cameras: Sequence[Camera] | CameraRig
) -> Recording:
    """Return the recording of detections that were read or made, a record for each camera.

    They are joined as `read_recording` joins those of files: views and cameras by name, frames by
    number, keypoints by what their names mean to the shipped model that knows most of them.

    Raises MismatchError where they do not belong together.
    """
    from mocap_calib.recording.joints import fit_vocabulary
    from mocap_calib.recording.synchronise import make_recording

    names = (name for view in views for name in view.keypoints)
    skeleton, aliases = fit_vocabulary(names, aliases_file=None)
    return make_recording(views, intrinsics_of(cameras), skeleton, aliases)


def to_xarray(
    poses: Poses3D, fps: float | None = None, individuals: Sequence[str] = ()
) -> "xarray.Dataset":
    """Return the poses as a data set of `movement`: position over time, space, keypoint, ...

    fps: frames per second; without, times are frame numbers. individuals: `[individual]` names;
    without, they are individual_0, individual_1, ...

    Raises MismatchError where the package xarray, an extra, is absent, and ValueError for other
    numbers of names, names that occur twice and a rate that is not above 0.
    """
    from mocap_calib.io.poses.common import describe_poses
    from mocap_calib.io.poses.movement import to_dataset

    return to_dataset(describe_poses(poses, fps, individuals))


def plot(found: GroupResult | CalibrationResult, *, moments: int = 60) -> "Figure":
    """Return a figure of plotly: cameras with their names, floor, and bodies with a slider.

    Of a result, the largest group of cameras.

    moments: how many frames the slider has at most; they are spread over the recording.

    Raises MismatchError where the package plotly, an extra, is absent, and ValueError for no
    moment.
    """
    from mocap_calib.notebook.figure import draw_group

    return draw_group(found if isinstance(found, GroupResult) else found.groups[0], moments)


_BOUND: dict[type[Any], dict[str, Any]] = {
    CameraRig: {
        "project": project_points,
        "triangulate": triangulate,
        "_repr_html_": describe_rig,
    },
    Recording: {
        "from_arrays": staticmethod(from_arrays),
        "from_keypoints": staticmethod(from_keypoints),
    },
    Poses3D: {"to_xarray": to_xarray},
    GroupResult: {"plot": plot, "_repr_html_": describe_group},
    CalibrationResult: {"plot": plot, "_repr_html_": describe_result},
}
for _record, _methods in _BOUND.items():
    for _name, _method in _methods.items():
        setattr(_record, _name, _method)
