"""Write DeepLabCut's .csv and .h5, a file per camera.

The .h5 has pandas' `fixed` layout, which needs no pickles; DeepLabCut reads both layouts.
"""

import csv
import io
from typing import Any

import h5py
import numpy as np

from mocap_calib.io.formats.deeplabcut import COORDS, LEVELS, LEVELS_OF_ONE, Table
from mocap_calib.types import Keypoints2D

_SCORER = "mocap-calib"
_KEY = "df_with_missing"
_PICKLED_NONE = b"N."  # which PyTables looks for in ASCII

# attributes of PyTables and pandas, without which they do not read the file
_FILE = {"CLASS": b"GROUP", "PYTABLES_FORMAT_VERSION": b"2.1", "TITLE": b"", "VERSION": b"1.0"}
_ARRAY = {"CLASS": b"ARRAY", "FLAVOR": b"numpy", "TITLE": b"", "VERSION": b"2.4"}
_GROUP = {
    "CLASS": b"GROUP",
    "TITLE": b"",
    "VERSION": b"1.0",
    "encoding": b"UTF-8",
    "errors": b"strict",
    "axis0_variety": b"multi",
    "axis1_variety": b"regular",
    "block0_items_variety": b"multi",
    "pandas_type": b"frame",
}


def write_csv(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write `<camera>.csv` with frame numbers and empty cells for missing points.

    Raises MismatchError where instances are not followed.
    """
    return {f"{view.camera}.csv": _format_csv(view) for view in views}


def write_h5(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write `<camera>.h5`."""
    return {f"{view.camera}.h5": _format_h5(view) for view in views}


def _table(view: Keypoints2D) -> Table:
    """Return the labelled columns of a camera."""
    frames, instances, keypoints = view.confidence.shape
    seen = np.isfinite(view.positions[..., :1])
    triples = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
    values = np.where(seen, triples, np.nan).reshape(frames, instances * keypoints * 3)
    individuals = [(f"individual{k + 1}",) for k in range(instances)] if instances > 1 else [()]
    columns = [
        (_SCORER, *individual, keypoint, coord)
        for individual in individuals
        for keypoint in view.keypoints
        for coord in COORDS
    ]
    levels = LEVELS if instances > 1 else LEVELS_OF_ONE
    return Table(levels, tuple(columns), list(map(str, view.frames)), values)


def _labels_by_level(table: Table) -> list[tuple[str, tuple[str, ...]]]:
    """Return the name of each level and its labels, one per column."""
    return list(zip(table.levels, zip(*table.columns, strict=True), strict=True))


def _format_csv(view: Keypoints2D) -> bytes:
    table = _table(view)
    cells = np.where(np.isnan(table.values), "", table.values.astype(str)).tolist()
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([level, *labels] for level, labels in _labels_by_level(table))
    writer.writerows([frame, *row] for frame, row in zip(table.rows, cells, strict=True))
    return text.getvalue().encode()


def _format_h5(view: Keypoints2D) -> bytes:
    table = _table(view)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        _set_texts(file, _FILE)
        group = file.create_group(_KEY)
        _set_texts(group, _GROUP)
        levels = np.int64(len(table.levels))
        group.attrs["ndim"] = np.int64(2)
        group.attrs["nblocks"] = np.int64(1)
        group.attrs["axis0_nlevels"] = levels
        group.attrs["block0_items_nlevels"] = levels
        _write_multi_index(group, "axis0", table)
        _write_multi_index(group, "block0_items", table)
        _write_array(group, "axis1", view.frames, kind=b"integer")
        group["axis1"].attrs["name"] = np.bytes_(_PICKLED_NONE)
        _write_array(group, "block0_values", table.values)
    return buffer.getvalue()


def _write_multi_index(group: Any, name: str, table: Table) -> None:
    """Write the columns as the different labels of each level, and codes into them."""
    for k, (level, labels) in enumerate(_labels_by_level(table)):
        known = list(dict.fromkeys(labels))
        code_of = {label: code for code, label in enumerate(known)}
        _write_array(
            group,
            f"{name}_level{k}",
            np.array([label.encode() for label in known]),
            kind=b"string",
            name=level.encode(),
            nan_rep=b"",
        )
        _set_texts(group[f"{name}_level{k}"], {f"{name}_name{level}": level.encode()})
        dtype = np.int8 if len(known) < 128 else np.int16
        codes = np.array([code_of[label] for label in labels], dtype=dtype)
        _write_array(group, f"{name}_label{k}", codes)


def _write_array(group: Any, dataset: str, values: Any, **attributes: bytes) -> None:
    group[dataset] = values
    _set_texts(group[dataset], {**_ARRAY, **attributes})
    group[dataset].attrs["transposed"] = np.uint8(1)


def _set_texts(item: Any, attributes: dict[str, bytes]) -> None:
    """Set attributes in the types that PyTables reads as text."""
    for name, value in attributes.items():
        if value:
            dtype = h5py.string_dtype("utf-8", len(value))
            item.attrs.create(name, value, dtype=dtype)
        else:
            item.attrs[name] = h5py.Empty("S1")
