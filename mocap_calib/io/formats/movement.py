"""Read and write movement's netCDF 4, which is HDF5: `position` and `confidence` over named axes.

Traps: dimensions were plural (`keypoints`, `individuals`) before movement 0.17; their order has
changed, and whoever transposes writes another; the file says the order by netCDF's numbers of
dimensions, or by HDF5's references, or not at all; times are frames, or seconds with `fps`.
Reading needs h5py alone; h5netcdf writes what makes HDF5 a netCDF 4.
"""

import io
from typing import Any

import h5netcdf
import h5py
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.detections import SCORES, SIZES, blank, fill_missing_scores, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_EXACT_FLOAT
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

_REMEDY = "save it from movement again"
_OUR_AXES = ("time", "individual", "keypoint", "space")
_MOVEMENT_AXES = ("time", "space", "keypoint", "individual")  # the order that movement has now
_WHOLE = 0.01  # of a frame, that a time may be off


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with positions over a space."""
    return {"position", "space"} <= keys(document)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; frames are the times in frames, or seconds times fps. Raises FormatError."""
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole netCDF file of movement", _REMEDY):
        values = _values(file, source)
        keypoints = names(file, "keypoint" if "keypoint" in file else "keypoints", source)
        frames = _frame_numbers(file, source)
    if (len(frames), len(keypoints)) != (len(values), values.shape[2]):
        expected = f"{len(values)} times and {values.shape[2]} keypoints"
        raise document.refuse(expected, f"{len(frames)} and {len(keypoints)}", _REMEDY)
    values, remarks = fill_missing_scores(values)
    return (make_view(document.origin, keypoints, frames, values, tracked=True, remarks=remarks),)


def _values(file: Any, source: str) -> Floats:
    """Return `[frame, individual, keypoint, 3]` x, y, confidence. Raises FormatError."""
    positions = read_variable(file, "position", _OUR_AXES, source)
    space = names(file, "space", source)
    if space != ("x", "y"):
        remedy = "give the 2D poses of each camera"
        raise FormatError(source, "2D positions (x, y)", ", ".join(space), remedy)
    frames, instances, keypoints = positions.shape[:3]
    values = blank(frames, instances, keypoints, source)
    values[..., :2] = positions
    if "confidence" in file:
        values[..., 2] = read_variable(file, "confidence", _OUR_AXES[:3], source)
    return values


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


def _frame_numbers(file: Any, source: str) -> Ints:
    """Return the `[frame]` numbers from the times. Raises FormatError."""
    times = array(file, "time", source).astype(np.float64)
    if text(file.attrs.get("time_unit", "frames")) == "seconds":
        rate = float(np.asarray(file.attrs.get("fps", np.nan)).reshape(-1)[0])
        if not rate > 0:
            expected = "frames per second (`fps`) beside times in seconds"
            raise FormatError(source, expected, rate, _REMEDY)
        times = times * rate
    frames = np.rint(times)
    with np.errstate(invalid="ignore"):  # of times that are infinite
        is_whole = (frames >= 0) & (frames <= LARGEST_EXACT_FLOAT)
        is_whole &= np.abs(times - frames) <= _WHOLE
    if times.ndim != 1 or not is_whole.all():
        remedy = "save it with time_unit frames"
        raise FormatError(source, "times that are whole frames", "others", remedy)
    return frames.astype(np.int64)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a file per camera.

    Raises MismatchError where the instances of a view are not followed: movement's individuals are.
    """
    return {f"{view.camera}.nc": _format_netcdf(view) for view in views}


def _format_netcdf(view: Keypoints2D) -> bytes:
    position = view.positions.transpose(0, 3, 2, 1)
    confidence = view.confidence.transpose(0, 2, 1)
    confidence = np.where(np.isfinite(position[:, 0]), confidence, np.nan)
    labels = {
        "space": ("x", "y"),
        "keypoint": view.keypoints,
        "individual": tuple(f"individual_{k}" for k in range(view.positions.shape[1])),
    }
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        file.attrs["ds_type"] = "poses"
        file.attrs["time_unit"] = "frames"
        file.attrs["source_software"] = "mocap-calib"
        file.dimensions = dict(zip(_MOVEMENT_AXES, position.shape, strict=True))
        file.create_variable("time", ("time",), data=view.frames)
        for axis, texts in labels.items():
            entries = np.array(texts, dtype=object)
            file.create_variable(axis, (axis,), data=entries, dtype=h5py.string_dtype())
        file.create_variable("position", _MOVEMENT_AXES, data=position)
        file.create_variable("confidence", ("time", "keypoint", "individual"), data=confidence)
    return buffer.getvalue()


KEYPOINTS = Format(
    kind="keypoints",
    name="movement",
    title="movement .nc",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".nc",),
    followed=True,
    loses=(SIZES, SCORES),
)
