"""netCDF of `movement`: position and confidence over named dimensions, netCDF4 on HDF5.

* position is over (time, space, keypoint, individual) now; older files have other orders, and
  before movement 0.17 names in the plural (`keypoints`, `individuals`). What the file says of its
  dimensions counts.
* Times are frames or seconds, as `time_unit` says; seconds need `fps`. We write a variable `frame`
  with the frame numbers beside.
* A file of two dimensions in space has keypoints, which `io.formats.movement` reads.
* Reading needs h5py alone; h5netcdf writes what makes HDF5 a netCDF4.
"""

import io
from typing import TYPE_CHECKING, Any

import h5netcdf
import h5py
import numpy as np

from mocap_calib import __version__
from mocap_calib.errors import MismatchError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats.movement import read_variable
from mocap_calib.io.hdf5 import array, integers, names
from mocap_calib.io.poses import (
    COVARIANCES,
    PoseFile,
    attribute,
    is_hdf5_that,
    mark_missing,
    opened_hdf5,
)
from mocap_calib.io.units import known_unit
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

if TYPE_CHECKING:
    import xarray

_DIMENSIONS = ("time", "space", "keypoint", "individual")
_PER_POINT = ("time", "keypoint", "individual")
_SPACE = ("x", "y", "z")
_MOST_VIEWS = 1e6  # what no file has
_FRAME_TOLERANCE = 0.25  # of a frame, by which a time in seconds may be off


def sniff(document: Document) -> bool:
    """Return whether there are positions in three dimensions."""
    return is_hdf5_that(document, _has_space_of_three)


def _has_space_of_three(file: h5py.File) -> bool:
    return "position" in file and "space" in file and len(file["space"]) == 3


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses; frames are counted from the times where the file has no numbers.

    Raises FormatError.
    """
    expected = "a 3D data set of movement"
    remedy = "save it again with ds.to_netcdf"
    with opened_hdf5(document, expected, remedy) as file:
        return _parse(file, document.source)


def _parse(file: h5py.File, source: str) -> PoseFile:
    """Read the poses. Raises FormatError, and ValueError and more where the file is damaged."""
    keypoints = _read_labels(file, "keypoint", source)
    individuals = _read_labels(file, "individual", source)
    if names(file, "space", source) != _SPACE:
        raise ValueError("space that is not x, y, z")
    positions = read_variable(file, "position", ("time", "individual", "keypoint", "space"), source)
    shape = positions.shape[:3]
    rate = float(np.ravel(file.attrs["fps"])[0]) if "fps" in file.attrs else np.nan
    confidence = _read_if_given(file, "confidence", shape, source)
    error = _read_if_given(file, "reprojection_error", shape, source)
    views = _read_if_given(file, "views", shape, source)
    unit = known_unit(attribute(file.attrs, "unit"), source)
    poses = Poses3D(
        keypoints=keypoints,
        frames=_read_frames(file, rate, source),
        positions=mark_missing(positions),
        error=error,
        views=np.nan_to_num(views, nan=0.0).clip(0, _MOST_VIEWS).astype(np.int64),
        confidence=confidence,
        unit=unit,
    )
    return PoseFile(poses, rate, individuals)


def _read_labels(file: h5py.File, dimension: str, source: str) -> tuple[str, ...]:
    """Return the labels along a dimension, whose name may be in the plural."""
    return names(file, dimension if dimension in file else f"{dimension}s", source)


def _read_if_given(file: h5py.File, name: str, shape: tuple[int, ...], source: str) -> Floats:
    """Return `[frame, individual, keypoint]` of a variable, NaN where it is not there."""
    if name not in file:
        return np.full(shape, np.nan)
    return read_variable(file, name, ("time", "individual", "keypoint"), source)


def _read_frames(file: h5py.File, rate: float, source: str) -> Ints:
    """Return `[frame]` numbers. Raises ValueError where times are no frames."""
    if "frame" in file:
        return integers(file, "frame", source)
    times = array(file, "time", source).astype(np.float64)
    if attribute(file.attrs, "time_unit") == "seconds":
        times = times * rate
    frames = np.round(times)
    whole = np.isfinite(frames) & (np.abs(frames) < 2**53)
    if not whole.all() or (np.abs(frames - times) > _FRAME_TOLERANCE).any():
        raise ValueError("times that are no frames of the rate fps")
    return frames.astype(np.int64)


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write movement's own variables.

    The variables frame, views and reprojection_error stand beside them; movement leaves them alone.
    """
    times, labels = _coordinates(file)
    content = io.BytesIO()
    with h5netcdf.File(content, "w") as out:
        lengths = {"time": len(times)} | {name: len(names) for name, names in labels.items()}
        out.dimensions = {name: lengths[name] for name in _DIMENSIONS}
        out.create_variable("time", ("time",), data=times)
        for name, names in labels.items():
            data = np.array(names, dtype=object)
            out.create_variable(name, (name,), data=data, dtype=h5py.string_dtype())
        for name, (dimensions, values) in _variables(file.poses).items():
            blank = {"fillvalue": np.nan} if name == "position" else {}
            out.create_variable(name, dimensions, data=values, **blank)
        for name, value in _attributes(file, title).items():
            out.attrs[name] = value
    return content.getvalue()


def to_dataset(file: PoseFile) -> "xarray.Dataset":
    """Return the data set of xarray that the file would hold.

    Raises MismatchError where xarray is not installed.
    """
    try:
        import xarray  # noqa: PLC0415 - an extra
    except ImportError:
        raise MismatchError(
            "to_xarray",
            "the package xarray",
            "none",
            "install it with `pip install mocap-calib[xarray]`",
        ) from None
    times, labels = _coordinates(file)
    coordinates = {"time": times} | {name: list(names) for name, names in labels.items()}
    return xarray.Dataset(_variables(file.poses), coordinates, _attributes(file, title=""))


def _coordinates(file: PoseFile) -> tuple[Floats | Ints, dict[str, tuple[str, ...]]]:
    """Return the times `[frame]`, seconds where the rate is known, and the other labels."""
    frames = file.poses.frames
    labels = {"space": _SPACE, "keypoint": file.poses.keypoints, "individual": file.individuals}
    return frames / file.rate if _has_rate(file) else frames, labels


def _variables(poses: Poses3D) -> dict[str, tuple[tuple[str, ...], Floats | Ints]]:
    """Return the dimensions and the values of each variable."""
    per_point: dict[str, Floats | Ints] = {
        "confidence": poses.confidence,
        "reprojection_error": poses.error,
        "views": poses.views,
    }
    return {
        "position": (_DIMENSIONS, poses.positions.transpose(0, 3, 2, 1)),
        **{name: (_PER_POINT, values.transpose(0, 2, 1)) for name, values in per_point.items()},
        "frame": (("time",), poses.frames),
    }


def _has_rate(file: PoseFile) -> bool:
    return bool(np.isfinite(file.rate) and file.rate > 0)


def _attributes(file: PoseFile, title: str) -> dict[str, Any]:
    """Return the attributes of a data set of movement, and the unit."""
    has_rate = _has_rate(file)
    attributes: dict[str, Any] = {
        "source_software": f"mocap-calib {__version__}",
        "ds_type": "poses",
        "time_unit": "seconds" if has_rate else "frames",
        "unit": file.poses.unit,
    }
    if has_rate:
        attributes["fps"] = file.rate
    if title:
        attributes["log"] = title
    return attributes


POSES = Format(
    kind="poses",
    name="movement-3d",
    title="movement netCDF",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".nc",),
    loses=(COVARIANCES,),
)
