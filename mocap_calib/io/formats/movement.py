"""Read and write movement's netCDF 4, which is HDF5: `position` and `confidence` over named axes.

In two dimensions of space they are the keypoints of a camera, in three 3D poses.

Traps: dimensions were plural (`keypoints`, `individuals`) before movement 0.17; their order has
changed, and whoever transposes writes another; the file says the order by netCDF's numbers of
dimensions, or by HDF5's references, or not at all; times are frames, or seconds with `fps`.
Beside 3D poses we write `frame`, `views` and `reprojection_error`, which movement leaves alone.
Reading needs h5py alone; h5netcdf writes what makes HDF5 a netCDF 4.
"""

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_calib import __version__
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.detections import SCORES, SIZES, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_EXACT_FLOAT
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, damage_refused, integers, keys, names, opened_hdf5, text
from mocap_calib.io.poses import COVARIANCES, MOST_VIEWS, PoseFile, is_hdf5_that, mark_missing
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.units import known_unit
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints, Keypoints2D

if TYPE_CHECKING:
    import xarray

_REMEDY = "save it from movement again"
_PLANE, _SPACE = ("x", "y"), ("x", "y", "z")
_OUR_AXES = ("time", "individual", "keypoint", "space")
_MOVEMENT_AXES = ("time", "space", "keypoint", "individual")  # the order that movement has now
_PER_POINT = ("time", "keypoint", "individual")
_TOLERANCE = 0.25  # of a frame, by which a time may be off


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with positions over a space."""
    return {"position", "space"} <= keys(document)


def sniff_poses(document: Document) -> bool:
    """Return whether there are positions in three dimensions."""
    return is_hdf5_that(
        document, lambda file: "position" in file and "space" in file and len(file["space"]) == 3
    )


# --- reading


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; frames are the times in frames, or seconds times fps. Raises FormatError."""
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole netCDF file of movement", _REMEDY):
        space = names(file, "space", source)
        if space != _PLANE:
            remedy = "give the 2D poses of each camera"
            raise document.refuse("2D positions (x, y)", ", ".join(space), remedy)
        positions = read_variable(file, "position", _OUR_AXES, source)
        scores = _read_if_there(file, "confidence", positions, source)
        labels = _read_labels(file, "keypoint", source)
        numbers = _frame_numbers(file, source)
    values = np.concatenate([positions, scores[..., None]], axis=-1)
    return (make_view(document.origin, labels, numbers, values, tracked=True),)


def read_poses(document: Document) -> PoseFile:
    """Read 3D poses; frames are counted from the times where the file has no numbers.

    Raises FormatError.
    """
    source = document.source
    with opened_hdf5(document, "a 3D data set of movement", _REMEDY) as file:
        if names(file, "space", source) != _SPACE:
            raise ValueError("space that is not x, y, z")
        positions = read_variable(file, "position", _OUR_AXES, source)
        views = np.nan_to_num(_read_if_there(file, "views", positions, source), nan=0.0)
        poses = Poses3D(
            keypoints=_read_labels(file, "keypoint", source),
            frames=_frame_numbers(file, source),
            positions=mark_missing(positions),
            error=_read_if_there(file, "reprojection_error", positions, source),
            views=views.clip(0, MOST_VIEWS).astype(np.int64),
            confidence=_read_if_there(file, "confidence", positions, source),
            unit=known_unit(text(file.attrs.get("unit", "")), source),
        )
        return PoseFile(poses, _frame_rate(file), _read_labels(file, "individual", source))


def _read_labels(file: Any, axis: str, source: str) -> tuple[str, ...]:
    """Return the labels along an axis, whose name may be in the plural."""
    return names(file, axis if axis in file else f"{axis}s", source)


def _read_if_there(file: Any, name: str, positions: Floats, source: str) -> Floats:
    """Return `[frame, individual, keypoint]` of a variable, NaN where the file has none."""
    if name not in file:
        return np.full(positions.shape[:3], np.nan)
    return read_variable(file, name, _OUR_AXES[:3], source)


def read_variable(file: Any, name: str, axes: tuple[str, ...], source: str) -> Floats:
    """Return a variable as an array `[*axes]`; axes are named in the singular.

    What the file says of the order counts; only where it says nothing, it is the order that
    movement has now. Raises FormatError.
    """
    values = array(file, name, source).astype(np.float64)
    usual = tuple(axis for axis in _MOVEMENT_AXES if axis in axes)
    found = _axes_by_number(file, name) or _axes_by_reference(file, name) or usual
    if sorted(found) != sorted(axes) or not _fit_coordinates(file, found, values.shape):
        expected = f"`{name}` over {', '.join(usual)}, as long as their coordinates"
        got = f"{', '.join(found)} of shape {values.shape}"
        raise FormatError(source, expected, got, _REMEDY)
    return values.transpose([found.index(axis) for axis in axes])


def _fit_coordinates(file: Any, axes: tuple[str, ...], shape: tuple[int, ...]) -> bool:
    """Return whether these axes are as long as their coordinates, where the file has them."""
    lengths = {axis: len(file[key]) for axis in axes for key in _spellings(file, axis)}
    return len(axes) == len(shape) and all(
        lengths.get(axis, length) == length for axis, length in zip(axes, shape, strict=True)
    )


def _spellings(file: Any, axis: str) -> list[str]:
    """Return the coordinates of an axis in the file, singular or plural."""
    return [key for key in (axis, f"{axis}s") if key in file]


def _axes_by_number(file: Any, name: str) -> tuple[str, ...]:
    """Return the axes of a variable by netCDF's numbers; none where it has not given any."""
    axis_of_number = {
        int(file[key].attrs["_Netcdf4Dimid"]): axis
        for axis in _MOVEMENT_AXES
        for key in _spellings(file, axis)
        if "_Netcdf4Dimid" in file[key].attrs
    }
    numbers = np.ravel(file[name].attrs.get("_Netcdf4Coordinates", ())).tolist()
    known = axis_of_number.keys() >= set(numbers)
    return tuple(axis_of_number[int(number)] for number in numbers) if known else ()


def _axes_by_reference(file: Any, name: str) -> tuple[str, ...]:
    """Return the axes of a variable by HDF5's dimension scales; none where it has not given any."""
    references = file[name].attrs.get("DIMENSION_LIST", ())
    paths = [file[scales[0]].name for scales in references]
    return tuple(path.rpartition("/")[2].removesuffix("s") for path in paths)


def _frame_rate(file: Any) -> float:
    """Return the frames per second, NaN where the file does not say them."""
    return float(np.ravel(file.attrs.get("fps", np.nan))[0])


def _frame_numbers(file: Any, source: str) -> Ints:
    """Return the `[frame]` numbers, from the times where there are none. Raises FormatError."""
    if "frame" in file:
        return integers(file, "frame", source)
    times = array(file, "time", source).astype(np.float64)
    if text(file.attrs.get("time_unit", "frames")) == "seconds":
        times = times * _frame_rate(file)
    frames = np.rint(times)
    with np.errstate(invalid="ignore"):  # of times that are infinite
        is_whole = (frames >= 0) & (frames <= LARGEST_EXACT_FLOAT)
        is_whole &= np.abs(times - frames) <= _TOLERANCE
    if times.ndim != 1 or not is_whole.all():
        remedy = "save it with time_unit frames, or seconds and fps"
        raise FormatError(source, "times that are whole frames", "others", remedy)
    return frames.astype(np.int64)


# --- writing

Variables = Mapping[str, tuple[tuple[str, ...], Floats | Ints]]  # name -> axes, values


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a file per camera.

    Raises MismatchError where the instances of a view are not followed: movement's individuals are.
    """
    return {f"{view.camera}.nc": _format_view(view) for view in views}


def _format_view(view: Keypoints2D) -> bytes:
    individuals = tuple(f"individual_{k}" for k in range(view.positions.shape[1]))
    confidence = np.where(np.isfinite(view.positions[..., 0]), view.confidence, np.nan)
    variables = {
        "position": (_MOVEMENT_AXES, view.positions.transpose(0, 3, 2, 1)),
        "confidence": (_PER_POINT, confidence.transpose(0, 2, 1)),
    }
    labels = {"space": _PLANE, "keypoint": view.keypoints, "individual": individuals}
    attributes = {
        "ds_type": "poses",
        "time_unit": "frames",
        "source_software": "mocap-calib",
    }
    return _format_netcdf(view.frames, labels, variables, attributes)


def write_poses(file: PoseFile, title: str) -> bytes:
    """Write 3D poses."""
    times, labels = _coordinates(file)
    variables, attributes = _variables(file.poses), _attributes(file, title)
    return _format_netcdf(times, labels, variables, attributes, fillvalue=np.nan)


def _format_netcdf(
    times: Floats | Ints,
    labels: Mapping[str, tuple[str, ...]],
    variables: Variables,
    attributes: Mapping[str, Any],
    **of_positions: float,
) -> bytes:
    """Return a file.

    times: `[frame]`. labels: of the other axes. of_positions: how h5netcdf writes these.
    """
    import h5netcdf  # noqa: PLC0415 - as in document.py
    import h5py  # noqa: PLC0415 - as in document.py

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as out:
        lengths = {"time": len(times)} | {axis: len(texts) for axis, texts in labels.items()}
        out.dimensions = {axis: lengths[axis] for axis in _MOVEMENT_AXES}
        out.create_variable("time", ("time",), data=times)
        for axis, texts in labels.items():
            entries = np.array(texts, dtype=object)
            out.create_variable(axis, (axis,), data=entries, dtype=h5py.string_dtype())
        for name, (axes, values) in variables.items():
            options = of_positions if name == "position" else {}
            out.create_variable(name, axes, data=values, **options)
        for name, value in attributes.items():
            out.attrs[name] = value
    return content.getvalue()


def to_dataset(file: PoseFile) -> "xarray.Dataset":
    """Return the data set of xarray that the file would hold.

    Raises MismatchError where xarray is not installed.
    """
    try:
        import xarray  # noqa: PLC0415 - an extra
    except ImportError:
        remedy = "install it with `pip install mocap-calib[xarray]`"
        raise MismatchError("to_xarray", "the package xarray", "none", remedy) from None
    times, labels = _coordinates(file)
    coordinates = {"time": times} | {axis: list(texts) for axis, texts in labels.items()}
    return xarray.Dataset(_variables(file.poses), coordinates, _attributes(file, title=""))


def _coordinates(file: PoseFile) -> tuple[Floats | Ints, dict[str, tuple[str, ...]]]:
    """Return the times `[frame]`, seconds where the rate is known, and the other labels."""
    frames = file.poses.frames
    labels = {"space": _SPACE, "keypoint": file.poses.keypoints, "individual": file.individuals}
    return frames / file.rate if np.isfinite(file.rate) else frames, labels


def _variables(poses: Poses3D) -> Variables:
    return {
        "position": (_MOVEMENT_AXES, poses.positions.transpose(0, 3, 2, 1)),
        "confidence": (_PER_POINT, poses.confidence.transpose(0, 2, 1)),
        "reprojection_error": (_PER_POINT, poses.error.transpose(0, 2, 1)),
        "views": (_PER_POINT, poses.views.transpose(0, 2, 1)),
        "frame": (("time",), poses.frames),
    }


def _attributes(file: PoseFile, title: str) -> dict[str, Any]:
    """Return the attributes of a data set of movement, and the unit."""
    has_rate = np.isfinite(file.rate)
    attributes = {
        "source_software": f"mocap-calib {__version__}",
        "ds_type": "poses",
        "time_unit": "seconds" if has_rate else "frames",
        "unit": file.poses.unit,
        "fps": file.rate if has_rate else None,
        "log": title or None,
    }
    return {name: value for name, value in attributes.items() if value is not None}


KEYPOINTS = Format(
    name="movement",
    title="movement .nc",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".nc",),
    followed=True,
    loses=(SIZES, SCORES),
)
POSES = Format(
    name="movement-3d",
    title="movement netCDF",
    sniff=sniff_poses,
    read=read_poses,
    write=write_poses,
    endings=(".nc",),
    loses=(COVARIANCES,),
)
