"""What Python users call: read a recording, write whatever was found, and methods of records.

Compiled kernels, and what imports them, are imported by the functions that need them: importing
numba takes most of a second, and a file is read without it.

Methods whose work is done in rooms above `results` are bound to the records here, and
`mocap_calib.__getattr__` imports this module first: `rig.project(...)` works for every user. The
package itself calls the functions of the rooms.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib import __version__
from mocap_calib.errors import MismatchError
from mocap_calib.io.camera_files import CAMERA_FORMATS, load_cameras, write_cameras
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.keypoints import write_keypoints
from mocap_calib.io.kinds import choose_format
from mocap_calib.io.pose_files import POSE_FORMATS, write_poses
from mocap_calib.io.poses import check_rate, describe_poses
from mocap_calib.io.read_options import ReadOptions, parse_layout
from mocap_calib.io.units import ARBITRARY
from mocap_calib.notebook.tables import describe_group, describe_result, describe_rig
from mocap_calib.results import CalibrationResult, GroupResult, Mend, Poses3D
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

Paths = str | Path | Sequence[str | Path]
ImageSizes = tuple[int, int] | Mapping[str, tuple[int, int]]


def read_recording(  # noqa: PLR0913 - each says one thing that files may leave open
    keypoints: Paths,
    cameras: str | Path | Sequence[Camera] | CameraRig | None = None,
    *,
    format: str | None = None,
    layout: str | Sequence[str] = (),
    image_size: ImageSizes = (0, 0),
    camera_regex: str = "",
    frame_offset: Mapping[str, int] | None = None,
    crop_offset: Mapping[str, tuple[float, float]] | None = None,
    views: str | Sequence[str] = (),
    skeleton: str | Path | None = None,
    model: str | Path = "auto",
    mends: Sequence[Mend] = (),
) -> Recording:
    """Read keypoint files and the cameras that they belong to, as `mocap-calib run` does.

    keypoints: a folder with a file or a folder per camera, or files, or `name=path` pairs, or a
        file of all cameras.
    cameras: a file or folder with the intrinsics; or cameras that were read or made. With a rig,
        keypoints of cameras that it does not have are left out. None: nothing is known of them but
        the sizes of their images, and `calibrate` estimates their intrinsics.
    format: name of the format of the keypoints, where their content does not show it.
    layout: names of the keypoints in files that do not name them, or a known list ("body_25").
    image_size: (width, height) in pixels, or camera -> (width, height), where the files do not say
        it; positions from 0 to 1 are multiplied by it.
    camera_regex: finds the name of the camera in a path: its group `camera`, its first group, or
        all of it.
    frame_offset: camera -> what is added to its frame numbers.
    crop_offset: camera -> (x, y) of the part of the image in which its keypoints were found.
    views: views in one file: endings of keypoint names ("top", "bot" or "top,bot"), each a camera.
    skeleton: a YAML file with your names of joints, a mapping `aliases`: your name -> joint.
    model: whose joints the names are compared with; "auto": the shipped model that knows most of
        them. `calibrate` uses the same unless it is told another.
    mends: what is known to be wrong with the files: `Mirrored("cam2")`, `Rotated("cam1", 90)`, ...
        Intrinsics for images of another size than the files have are corrected; `corrected` of the
        recording says how.

    Raises FormatError for whatever is wrong with a file, and MismatchError where keypoints and
    cameras do not go together.
    """
    from mocap_calib.job.load import KeypointSource, load_recording

    sizes = image_size if isinstance(image_size, Mapping) else {}
    known = isinstance(cameras, CameraRig)
    options = ReadOptions(
        layout=parse_layout(layout) if isinstance(layout, str) and layout else tuple(layout),
        image_size=(0, 0) if isinstance(image_size, Mapping) else image_size,
        image_sizes=sizes,
        camera_pattern=_check_pattern(camera_regex),
        frame_offset=frame_offset or {},
        crop_offset=crop_offset or {},
        views=tuple(views.split(",") if isinstance(views, str) and views else views),
    )
    source = KeypointSource(
        paths=_list_paths(keypoints),
        format=format,
        options=options,
        aliases=None if skeleton is None else Path(skeleton),
        model=None if model == "auto" else str(model),
        mends=tuple(mends),
    )
    return load_recording(source, _camera_file(cameras), only_known_cameras=known).recording


def write(
    thing: CameraRig | Poses3D | Keypoints2D | Sequence[Keypoints2D] | CalibrationResult,
    path: str | Path,
    format: str | None = None,
    *,
    fps: float | None = None,
    individuals: Sequence[str] = (),
    verdict: CalibrationResult | None = None,
) -> tuple[str, ...]:
    """Write cameras, 3D poses, keypoints, or all that a run finds; whole or not at all.

    path: the file, or the folder where the format is several files. A result fills a folder with
        the files of `mocap-calib run`.
    format: a name of docs/formats.md; without it the ending of the path says it. Beside the files
        of a result, those of a format that is named are written too.
    fps: frames per second of poses, which some formats need; also for the poses of a result.
    individuals: `[individual]` names, for `Poses3D`.
    verdict: the result that a rig is from: the file of the rig holds the verdict on it.

    Returns what of the thing the format does not hold, in words. Raises MismatchError where the
    format cannot hold it, or its ending does not say the format; TypeError for other things; and
    ValueError for `fps` and `individuals` of things that have none, and for wrong ones.
    """
    path = Path(path)
    check_rate(fps)
    if isinstance(thing, CalibrationResult):
        _refuse_arguments(thing, individuals=individuals)
        return _write_result(thing, path, format, fps)
    if isinstance(thing, Poses3D):
        file = describe_poses(thing, fps, individuals)
        return write_poses(path, file, format or choose_format("poses", path))
    _refuse_arguments(thing, fps=fps, individuals=individuals)
    if isinstance(thing, CameraRig):
        form = format or choose_format("cameras", path)
        return write_cameras(path, thing, form, _provenance_of(thing, verdict))
    views = _list_views(thing)
    return write_keypoints(path, views, format or choose_format("keypoints", path))


def _provenance_of(rig: CameraRig, result: CalibrationResult | None) -> dict[str, Any]:
    """Return what the file of a rig holds of its verdict, by the result that it is from.

    Raises ValueError where no group of the result has these cameras.
    """
    if result is None:
        return {"version": __version__}
    from mocap_calib.report import run_report, verdict_of_cameras

    for group in result.groups:
        if set(rig.names) <= set(group.rig.names):
            return {"version": __version__, **verdict_of_cameras(run_report(group, result))}
    raise ValueError("verdict: expected the result that the rig is from, got one of other cameras")


def _list_views(thing: object) -> tuple[Keypoints2D, ...]:
    """Return the keypoints of one camera, or of several. Raises TypeError for anything else."""
    views = tuple(thing) if isinstance(thing, Iterable) else (thing,)
    if not views or not all(isinstance(view, Keypoints2D) for view in views):
        raise TypeError(
            "write: expected a CameraRig, Poses3D, Keypoints2D (one, or a list) or "
            f"CalibrationResult, got {type(thing).__name__}"
        )
    return views


def _refuse_arguments(thing: object, **arguments: Any) -> None:
    """Raise ValueError where an argument is given that says nothing about the thing."""
    for name, value in arguments.items():
        if value is not None and value != ():
            raise ValueError(
                f"write: expected {name}= with 3D poses, got it with {type(thing).__name__}; "
                "leave it out"
            )


def _write_result(
    result: CalibrationResult, path: Path, format: str | None, fps: float | None
) -> tuple[str, ...]:
    """Write the files of a run; return what a further format does not hold."""
    from mocap_calib.io.results.further_formats import check_formats
    from mocap_calib.job.results import write_result

    formats = () if format is None else (format,)
    unit = result.groups[0].rig.unit if result.groups else ARBITRARY
    for each in (*CAMERA_FORMATS, *POSE_FORMATS):
        if each.name == format and each.unit and unit == ARBITRARY:
            kind = "cameras" if each in CAMERA_FORMATS else "poses"
            raise MismatchError(
                f"format={format}",
                "a format that leaves the unit of length open",
                f"one in {each.unit}, and a result does not know lengths",
                f"write the {kind} of a group by themselves, after .scale(factor, unit)",
            )
    check_formats(formats, fps, unit)
    groups = write_result(path, result, inputs={}, described={}, formats=formats, fps=fps)
    for error in groups[0].refused.values():
        raise error
    return tuple(note for group in groups for note in group.notes)


def _list_paths(keypoints: Paths) -> tuple[str, ...]:
    """Return one path, or several, as texts."""
    return tuple(map(str, [keypoints] if isinstance(keypoints, str | Path) else keypoints))


def _camera_file(cameras: str | Path | Sequence[Camera] | CameraRig | None) -> CameraFile | None:
    """Return what a file says of cameras, or cameras at hand as a file would say them.

    Raises TypeError for anything else.
    """
    if cameras is None:
        return None
    if isinstance(cameras, str | Path):
        return load_cameras(cameras)
    if not isinstance(cameras, Iterable) or not all(isinstance(each, Camera) for each in cameras):
        raise TypeError(
            "cameras: expected a path, a CameraRig, a list of Camera, or None, "
            f"got {type(cameras).__name__}"
        )
    return CameraFile(cameras=intrinsics_of(cameras), extrinsics={})


def _check_pattern(pattern: str) -> str:
    """Return a regular expression that is one. Raises MismatchError."""
    try:
        re.compile(pattern)
    except re.error as error:
        raise MismatchError(
            "camera_regex", "a regular expression", f"{pattern} ({error})", "mend it"
        ) from None
    return pattern


# --- methods of records


def project(rig: CameraRig, points: ArrayLike) -> Floats:
    """Return the pixels `[view, ..., 2]` of points `[..., 3]` in world coordinates.

    The distortion of the lenses is applied. NaN stays NaN, and a point behind a camera is NaN
    there. Pixels outside the image are returned like any other.

    Raises ValueError where the last axis of the points is not 3.
    """
    from mocap_calib.geometry.lens import project_points

    return project_points(rig, points)


def triangulate(
    rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """Return the points `[..., 3]` that pixels `[view, ..., 2]` show, and their errors `[...]`.

    As robust as the triangulation of a run: a view that contradicts the others is
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
    from mocap_calib.recording.image_sizes import join_sized
    from mocap_calib.recording.joints import fit_vocabulary

    names = (name for view in views for name in view.keypoints)
    skeleton, aliases = fit_vocabulary(names, aliases_file=None)
    return join_sized(views, intrinsics_of(cameras), skeleton, aliases)


def to_xarray(
    poses: Poses3D, fps: float | None = None, individuals: Sequence[str] = ()
) -> "xarray.Dataset":
    """Return the poses as a data set of `movement`: position over time, space, keypoint, ...

    fps: frames per second; without, times are frame numbers. individuals: `[individual]` names;
    without, they are individual_0, individual_1, ...

    Raises MismatchError where the package xarray, an extra, is absent, and ValueError for other
    numbers of names, names that occur twice and a rate that is not above 0.
    """
    from mocap_calib.io.formats.movement import to_dataset

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
        "project": project,
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
