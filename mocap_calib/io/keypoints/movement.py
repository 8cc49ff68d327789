"""movement's netCDF (HDF5): `position` and `confidence` with named dimensions, singular or, before movement 0.17, plural."""

import io
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import blank, fill_missing_scores, make_view, malformed
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_REMEDY = "save it from movement again"
_DIMS = ("time", "individual", "keypoint", "space")
_USUAL = ("time", "space", "keypoint", "individual")


def sniff(document: Document) -> bool:
    """HDF5 with positions over a space."""
    return {"position", "space"} <= keys(document)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """One camera; frames are the times in frames, or seconds times fps. Raises FormatError."""
    source, file = item.origin.source, item.document.hdf5
    with damage_refused(source, "a whole netCDF file of movement", _REMEDY):
        positions = turned(file, "position", _DIMS, source)
        axes = names(file, "space", source)
        if axes != ("x", "y"):
            raise malformed(
                source, "2D positions (x, y)", ", ".join(axes), "give the 2D poses of each camera"
            )
        nodes = names(file, "keypoint" if "keypoint" in file else "keypoints", source)
        values = blank(positions.shape[0], positions.shape[1], positions.shape[2], source)
        values[..., :2] = positions
        if "confidence" in file:
            values[..., 2] = turned(file, "confidence", _DIMS[:3], source)
        frames = _frames(file, source)
        if (len(frames), len(nodes)) != (len(values), values.shape[2]):
            raise malformed(
                source,
                f"{len(values)} times and {values.shape[2]} keypoints",
                f"{len(frames)} and {len(nodes)}",
                _REMEDY,
            )
    values, remarks = fill_missing_scores(values)
    return (make_view(item.origin, nodes, frames, values, tracked=True, remarks=remarks),)


def turned(file: Any, name: str, wanted: tuple[str, ...], source: str) -> Floats:
    """A variable with its dimensions, named in the singular, in the wanted order. Raises FormatError.

    Movement has written more than one order, and whoever transposes writes his own: what the file says counts, and only
    where it says nothing the order that movement has now.
    """
    values = array(file, name, source).astype(np.float64)
    usual = tuple(dim for dim in _USUAL if dim in wanted)
    found = _numbered(file, name) or _referenced(file, name) or usual
    lengths = {dim: len(file[key]) for dim in found for key in (dim, f"{dim}s") if key in file}
    fits = sorted(found) == sorted(wanted) and values.ndim == len(wanted)
    if not fits or any(
        lengths.get(dim, length) != length for dim, length in zip(found, values.shape, strict=True)
    ):
        expected = f"`{name}` over {', '.join(usual)}, as long as their coordinates"
        raise malformed(source, expected, f"{', '.join(found)} of shape {values.shape}", _REMEDY)
    return values.transpose([found.index(dim) for dim in wanted])


def _numbered(file: Any, name: str) -> tuple[str, ...]:
    """The dimensions of a variable by the numbers that netCDF gives them; nothing where it has given none."""
    own = [
        key
        for dim in _USUAL
        for key in (dim, f"{dim}s")
        if key in file and "_Netcdf4Dimid" in file[key].attrs
    ]
    dims = {int(file[key].attrs["_Netcdf4Dimid"]): key.removesuffix("s") for key in own}
    numbers = np.ravel(file[name].attrs.get("_Netcdf4Coordinates", ())).tolist()
    return tuple(dims[int(number)] for number in numbers) if dims.keys() >= set(numbers) else ()


def _referenced(file: Any, name: str) -> tuple[str, ...]:
    """The dimensions of a variable by the references of HDF5's dimension scales; nothing where it has none."""
    references = file[name].attrs.get("DIMENSION_LIST", ())
    return tuple(file[scales[0]].name.rpartition("/")[2].removesuffix("s") for scales in references)


def _frames(file: Any, source: str) -> Any:
    """Frame numbers from the times."""
    times = array(file, "time", source).astype(np.float64)
    if text(file.attrs.get("time_unit", "frames")) == "seconds":
        rate = float(np.asarray(file.attrs.get("fps", np.nan)).reshape(-1)[0])
        if not rate > 0:
            raise malformed(
                source, "frames per second (`fps`) beside times in seconds", rate, _REMEDY
            )
        times = times * rate
    frames = np.rint(times)
    if (
        not np.isfinite(times).all()
        or (np.abs(times - frames) > 0.01).any()
        or (frames < 0).any()
        or (frames > 2**53).any()
    ):
        raise malformed(
            source, "times that are whole frames", "others", "save it with time_unit frames"
        )
    return frames.astype(np.int64)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """A file per camera. Raises MismatchError where the instances of a view are not followed: movement's individuals are."""
    return {f"{view.camera}.nc": _content(view) for view in views}


def _content(view: Keypoints2D) -> bytes:
    if not view.tracked and view.positions.shape[1] > 1:
        raise MismatchError(
            f"{view.source}: expected one individual or followed ones, as movement has, found detections in any order; choose csv or coco"
        )
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs.update(
            {
                "ds_type": "poses",
                "time_unit": "frames",
                "source_software": "mocap-calib",
                "_NCProperties": "version=2",
            }
        )
        labels = {
            "space": ["x", "y"],
            "keypoint": list(view.keypoints),
            "individual": [f"individual_{k}" for k in range(view.positions.shape[1])],
        }
        scales = {
            name: file.create_dataset(name, data=np.array(entries, dtype=h5py.string_dtype()))
            for name, entries in labels.items()
        }
        scales["time"] = file.create_dataset("time", data=view.frames)
        for number, name in enumerate(_USUAL):
            scales[name].make_scale(name)
            scales[name].attrs["_Netcdf4Dimid"] = np.int32(number)
        position = view.positions.transpose(0, 3, 2, 1)
        confidence = np.where(
            np.isfinite(position[:, 0]), view.confidence.transpose(0, 2, 1), np.nan
        )
        for name, values, own in (
            ("position", position, _USUAL),
            ("confidence", confidence, (_USUAL[0], *_USUAL[2:])),
        ):
            dataset = file.create_dataset(name, data=values)
            dataset.attrs["_Netcdf4Coordinates"] = np.array(
                [_USUAL.index(dim) for dim in own], dtype=np.int32
            )
            for axis, dim in enumerate(own):
                dataset.dims[axis].attach_scale(scales[dim])
    return buffer.getvalue()
