"""Writing DeepLabCut's .csv and .h5, a file per camera. The .h5 has pandas' `fixed` layout, which needs no pickles; DeepLabCut reads both."""

import csv
import io
from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.keypoints.deeplabcut import LEVELS
from mocap_calib.types import Floats, Keypoints2D

_SCORER = "mocap-calib"
_KEY = "df_with_missing"
_ARRAY = {"CLASS": b"ARRAY", "FLAVOR": b"numpy", "TITLE": b"", "VERSION": b"2.4"}  # of PyTables


def write_csv(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Camera.csv with frame numbers and empty cells for missing points. Raises MismatchError where instances are not followed."""
    return {f"{view.camera}.csv": _csv(view) for view in views}


def write_h5(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Camera.h5. Raises MismatchError where instances are not followed."""
    return {f"{view.camera}.h5": _h5(view) for view in views}


def _csv(view: Keypoints2D) -> bytes:
    levels, columns, values = _table(view)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(
        [level, *labels] for level, labels in zip(levels, zip(*columns, strict=True), strict=True)
    )
    cells = np.where(np.isnan(values), "", values.astype(str)).tolist()
    writer.writerows([int(frame), *row] for frame, row in zip(view.frames, cells, strict=True))
    return text.getvalue().encode()


def _table(view: Keypoints2D) -> tuple[tuple[str, ...], list[tuple[str, ...]], Floats]:
    """Names of the levels, labels of each column, `[frame, column]` values."""
    frames, instances, keypoints = view.confidence.shape
    if not view.tracked and instances > 1:
        raise MismatchError(
            f"{view.source}: expected one individual or followed ones, as DeepLabCut has, found detections in any order; choose csv or coco"
        )
    seen = np.isfinite(view.positions[..., :1])
    values = np.where(
        seen, np.concatenate([view.positions, view.confidence[..., None]], axis=-1), np.nan
    )
    individuals = [(f"individual{k + 1}",) for k in range(instances)] if instances > 1 else [()]
    columns = [
        (_SCORER, *who, name, coord)
        for who in individuals
        for name in view.keypoints
        for coord in ("x", "y", "likelihood")
    ]
    return (
        LEVELS if instances > 1 else ("scorer", "bodyparts", "coords"),
        columns,
        values.reshape(frames, instances * keypoints * 3),
    )


def _h5(view: Keypoints2D) -> bytes:
    levels, columns, values = _table(view)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        _mark(
            file,
            {"CLASS": b"GROUP", "PYTABLES_FORMAT_VERSION": b"2.1", "TITLE": b"", "VERSION": b"1.0"},
        )
        group = file.create_group(_KEY)
        kinds = {
            "axis0_variety": b"multi",
            "axis1_variety": b"regular",
            "block0_items_variety": b"multi",
            "pandas_type": b"frame",
        }
        _mark(
            group,
            {
                "CLASS": b"GROUP",
                "TITLE": b"",
                "VERSION": b"1.0",
                "encoding": b"UTF-8",
                "errors": b"strict",
                **kinds,
            },
        )
        counts = {
            "ndim": 2,
            "nblocks": 1,
            "axis0_nlevels": len(levels),
            "block0_items_nlevels": len(levels),
        }
        group.attrs.update({name: np.int64(count) for name, count in counts.items()})
        for name in ("axis0", "block0_items"):
            _multi_index(group, name, levels, columns)
        _array(group, "axis1", view.frames, kind=b"integer")
        group["axis1"].attrs["name"] = np.bytes_(
            b"N."
        )  # a pickled None, which PyTables looks for in ASCII
        _array(group, "block0_values", values)
    return buffer.getvalue()


def _multi_index(
    group: Any, name: str, levels: Sequence[str], columns: list[tuple[str, ...]]
) -> None:
    """Levels, and codes into them."""
    for k, (level, labels) in enumerate(zip(levels, zip(*columns, strict=True), strict=True)):
        known = list(dict.fromkeys(labels))
        place = {label: code for code, label in enumerate(known)}
        _array(
            group,
            f"{name}_level{k}",
            np.array([label.encode() for label in known]),
            kind=b"string",
            name=level.encode(),
            nan_rep=b"",
        )
        _mark(group[f"{name}_level{k}"], {f"{name}_name{level}": level.encode()})
        _array(
            group,
            f"{name}_label{k}",
            np.array(
                [place[label] for label in labels], dtype=np.int8 if len(known) < 128 else np.int16
            ),
        )


def _array(group: Any, dataset: str, values: Any, **attributes: bytes) -> None:
    group[dataset] = values
    _mark(group[dataset], {**_ARRAY, **attributes})
    group[dataset].attrs["transposed"] = np.uint8(1)


def _mark(item: Any, attributes: dict[str, bytes]) -> None:
    for name, value in attributes.items():
        if value:
            item.attrs.create(
                name, value, dtype=h5py.string_dtype("utf-8", len(value))
            )  # what PyTables reads as text
        else:
            item.attrs[name] = h5py.Empty("S1")
