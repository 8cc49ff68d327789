"""netCDF of `movement`: position (time, space, keypoint, individual; older files have other orders) and confidence, netCDF4 on HDF5.

Dimensions were plural (`keypoints`, `individuals`) before movement 0.17. Reading needs h5py alone; h5netcdf writes what
makes HDF5 a netCDF4.
"""

import io

import h5netcdf
import h5py
import numpy as np

from mocap_calib import __version__
from mocap_calib.io.file import malformed, one_line
from mocap_calib.io.hdf5 import array, integers, names
from mocap_calib.io.keypoints.movement import read_variable
from mocap_calib.io.poses.arrays import looks
from mocap_calib.io.poses.common import DAMAGE, PoseFile, WrittenPoses, attribute
from mocap_calib.io.units import known_unit
from mocap_calib.types import Floats, Ints, Poses3D

_DIMENSIONS = ("time", "space", "keypoint", "individual")
_SPACE = ("x", "y", "z")


def sniff(content: bytes) -> bool:
    """Positions in space: those in two dimensions are keypoints."""
    return looks(
        content, lambda file: "position" in file and "space" in file and len(file["space"]) == 3
    )


def parse(content: bytes, source: str) -> PoseFile:
    """Frame numbers are counted from the times where the file has no numbers. Raises FormatError."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            return _parse(file, source)
    except DAMAGE as error:
        raise malformed(
            source,
            "a 3D data set of movement",
            f"an error ({one_line(error)})",
            "save it again with ds.to_netcdf",
        ) from None


def _parse(file: h5py.File, source: str) -> PoseFile:
    keypoints, individuals = (
        names(file, name if name in file else f"{name}s", source) for name in _DIMENSIONS[2:]
    )
    if names(file, "space", source) != _SPACE:
        raise ValueError("space that is not x, y, z")
    positions = read_variable(file, "position", ("time", "individual", "keypoint", "space"), source)
    shape = positions.shape[:3]
    rate = float(np.ravel(file.attrs["fps"])[0]) if "fps" in file.attrs else np.nan
    found = {
        name: _optional(file, name, shape, source)
        for name in ("confidence", "reprojection_error", "views")
    }
    views = np.nan_to_num(found["views"], nan=0.0).clip(0, 1e6).astype(np.int64)
    missing = ~np.isfinite(positions).all(-1, keepdims=True)
    unit = known_unit(attribute(file.attrs, "unit"), source)
    error, confidence = found["reprojection_error"], found["confidence"]
    return PoseFile(
        Poses3D(
            keypoints,
            _frames(file, rate, source),
            np.where(missing, np.nan, positions),
            error,
            views,
            confidence,
            unit,
        ),
        rate,
        individuals,
    )


def _optional(file: h5py.File, name: str, shape: tuple[int, ...], source: str) -> Floats:
    """`[frame, individual, keypoint]` of a variable, NaN where it is not there."""
    if name not in file:
        return np.full(shape, np.nan)
    return read_variable(file, name, ("time", "individual", "keypoint"), source)


def _frames(file: h5py.File, rate: float, source: str) -> Ints:
    if "frame" in file:
        return integers(file, "frame", source)
    times = array(file, "time", source).astype(np.float64)
    if attribute(file.attrs, "time_unit") == "seconds":
        times = times * rate
    frames = np.round(times)
    if (
        not (np.isfinite(frames) & (np.abs(frames) < 2**53)).all()
        or (np.abs(frames - times) > 0.25).any()
    ):
        raise ValueError("times that are no frames of the rate fps")
    return frames.astype(np.int64)


def write(file: PoseFile, title: str) -> WrittenPoses:
    """Movement's own variables, and beside them frame, views and reprojection_error, which it leaves alone."""
    poses, content = file.poses, io.BytesIO()
    seconds = np.isfinite(file.rate) and file.rate > 0
    with h5netcdf.File(content, "w") as out:
        out.dimensions = dict(
            zip(
                _DIMENSIONS,
                (len(poses.frames), 3, len(poses.keypoints), len(file.individuals)),
                strict=True,
            )
        )
        times = poses.frames / file.rate if seconds else poses.frames
        out.create_variable("time", ("time",), data=times)
        for name, texts in zip(
            _DIMENSIONS[1:], (("x", "y", "z"), poses.keypoints, file.individuals), strict=True
        ):
            out.create_variable(
                name, (name,), data=np.array(texts, dtype=object), dtype=h5py.string_dtype()
            )
        out.create_variable(
            "position", _DIMENSIONS, data=poses.positions.transpose(0, 3, 2, 1), fillvalue=np.nan
        )
        per_point = ("time", "keypoint", "individual")
        for name, values in (
            ("confidence", poses.confidence),
            ("reprojection_error", poses.error),
            ("views", poses.views),
        ):
            out.create_variable(name, per_point, data=values.transpose(0, 2, 1))
        out.create_variable("frame", ("time",), data=poses.frames)
        attributes = {
            "source_software": f"mocap-calib {__version__}",
            "ds_type": "poses",
            "time_unit": "seconds" if seconds else "frames",
            "unit": poses.unit,
        }
        for name, value in (
            attributes | ({"fps": file.rate} if seconds else {}) | ({"log": title} if title else {})
        ).items():
            out.attrs[name] = value
    return WrittenPoses(content.getvalue())
