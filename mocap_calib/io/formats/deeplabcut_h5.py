"""Read DeepLabCut's .h5: a pandas table inside HDF5, read without pandas.

Traps: there are two layouts, `table` and `fixed`. The `table` layout keeps the labels of the
columns as pickles, and unpickling runs whatever the file says: the unpickler here knows lists,
tuples, text and numbers and refuses everything else. More than 64 kB of labels do not fit an
attribute: pandas then dies and leaves a table without content. PyTables can compress with blosc,
which h5py does not have.
"""

import io
import pickle
from typing import Any, Never

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats import deeplabcut_writer
from mocap_calib.io.formats.deeplabcut import LEVELS, LEVELS_OF_ONE, Table, keypoints_from_table
from mocap_calib.io.hdf5 import damage_refused, has_attribute, require_filters, text
from mocap_calib.io.keypoints.losses import SCORES, SIZES
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_CSV_INSTEAD = "use the .csv that DeepLabCut writes next to it"
_DISTRUST = f"do not trust this file; {_CSV_INSTEAD}"

Labels = tuple[str, ...]  # of a column, one per level


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with a pandas table."""
    return has_attribute(document, "pandas_type")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of a DeepLabCut .h5 in the `table` or the `fixed` layout.

    Raises FormatError.
    """
    source = document.source
    with damage_refused(source, "a whole DeepLabCut .h5", _CSV_INSTEAD):
        table = _read_table(document.hdf5, source)
    return (keypoints_from_table(table, document.origin),)


def _read_table(file: Any, source: str) -> Table:
    """Return the one pandas table of an open file. Raises FormatError."""
    group = _only_pandas_group(file, source)
    _check_pickles(group, source)
    require_filters(group, source, _CSV_INSTEAD)
    kind = text(group.attrs["pandas_type"])
    if kind == "frame_table":
        return _from_table_layout(group, source)
    if kind == "frame":
        return _from_fixed_layout(group)
    raise FormatError(source, "a pandas DataFrame", f"a {kind}", _CSV_INSTEAD)


def _only_pandas_group(file: Any, source: str) -> Any:
    """Return the group of the one pandas table. Raises FormatError."""
    keys = [key for key, item in file.items() if "pandas_type" in item.attrs]
    if not keys:
        raise FormatError(
            source,
            "a pandas table as DeepLabCut writes it",
            f"HDF5 with {', '.join(map(str, file)) or 'nothing'}",
            "export DeepLabCut .csv or COCO",
        )
    if len(keys) > 1:
        raise FormatError(
            source,
            "one pandas table",
            f"{len(keys)}: {', '.join(keys)}",
            "which one? keep that one, or give its .csv",
        )
    return file[keys[0]]


# pandas' `table` layout


def _from_table_layout(group: Any, source: str) -> Table:
    """Return the table of a group in the `table` layout. Raises FormatError."""
    if "table" not in group:
        raise FormatError(source, "a table", "an aborted write without one", _CSV_INSTEAD)
    dataset = group["table"]
    blocks = sorted(name for name in dataset.dtype.names if name.startswith("values_block_"))
    if "index" not in dataset.dtype.names or not blocks:
        raise FormatError(
            source,
            "the columns index and values_block_0",
            ", ".join(dataset.dtype.names),
            _CSV_INSTEAD,
        )
    columns: list[Labels] = []
    for name in blocks:
        labels_of_block = _unpickle(dataset.attrs[f"{name}_kind"], source)
        columns += [tuple(map(text, labels)) for labels in labels_of_block]
    content = dataset[...]
    rows = list(map(text, content["index"]))
    values = [content[name].reshape(len(content), -1).astype(np.float64) for name in blocks]
    levels = _levels_of_table_layout(group, columns, source)
    return _make_table(levels, columns, rows=rows, values=np.concatenate(values, axis=1))


def _levels_of_table_layout(group: Any, columns: list[Labels], source: str) -> Labels:
    """Return the names of the levels; the usual ones where the file has none."""
    if "info" in group.attrs:
        info = _unpickle(group.attrs["info"], source)
        return tuple(map(text, info[1]["names"]))
    if columns and len(columns[0]) == len(LEVELS):
        return LEVELS
    return LEVELS_OF_ONE


# pandas' `fixed` layout


def _from_fixed_layout(group: Any) -> Table:
    """Return the table of a group in the `fixed` layout."""
    levels: Labels = ()
    columns: list[Labels] = []
    blocks = []
    for block in range(_count_blocks(group)):
        levels, labels = _read_multi_index(group, f"block{block}_items")
        columns += labels
        blocks.append(_read_block(group[f"block{block}_values"]))
    if "axis1" in group:
        rows = list(map(text, group["axis1"][...]))
    else:
        rows = ["/".join(labels) for labels in _read_multi_index(group, "axis1")[1]]
    values = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)
    return _make_table(levels, columns, rows=rows, values=values.astype(np.float64, copy=False))


def _count_blocks(group: Any) -> int:
    names = [name for name in group if name.startswith("block") and name.endswith("_values")]
    return len(names)


def _read_block(dataset: Any) -> Any:
    """Return the `[row, column]` values of a block.

    pandas holds a block column by column, and PyTables usually transposes it.
    """
    if dataset.attrs.get("transposed"):
        return mapped.in_blocks(lambda rows: dataset[rows], len(dataset))
    return dataset[...].T


def _read_multi_index(group: Any, name: str) -> tuple[Labels, list[Labels]]:
    """Return the names of the levels, and the labels of each entry, of a pandas MultiIndex.

    It is stored as the different labels of each level and, for each entry, codes into them.
    """
    levels: list[str] = []
    labels_by_level: list[list[str]] = []
    while f"{name}_level{len(levels)}" in group:
        level = group[f"{name}_level{len(levels)}"]
        codes = group[f"{name}_label{len(levels)}"][...]
        known = [*map(text, level[...]), ""]  # code -1 = no label
        levels.append(text(level.attrs.get("name", "")))
        labels_by_level.append([known[code] for code in codes])
    return tuple(levels), list(zip(*labels_by_level, strict=True))


def _make_table(levels: Labels, columns: list[Labels], *, rows: list[str], values: Floats) -> Table:
    """Return the table of `[row, column]` values. Raises ValueError where lengths do not agree."""
    labelled = all(len(labels) == len(levels) for labels in columns)
    if values.shape != (len(rows), len(columns)) or not labelled:
        raise ValueError(
            f"{values.shape} values for {len(rows)} rows and {len(columns)} columns "
            f"of {len(levels)} labels"
        )
    return Table(levels, tuple(columns), rows, values)


# Pickles


class _CallError(pickle.UnpicklingError):
    """A pickle that calls something."""


class _PlainUnpickler(pickle.Unpickler):
    """Build lists, tuples, dictionaries, text and numbers; refuse any class or function."""

    def find_class(self, module: str, name: str) -> Never:
        raise _CallError(f"a pickle that calls {module}.{name}")


def _load_plain(content: bytes) -> Any:
    return _PlainUnpickler(io.BytesIO(content), encoding="utf-8").load()


def _unpickle(content: Any, source: str) -> Any:
    """Return the labels in a pickle. Raises FormatError."""
    if not isinstance(content, bytes):
        raise FormatError(
            source, "column labels as pandas stores them", type(content).__name__, _CSV_INSTEAD
        )
    try:
        return _load_plain(content)
    except Exception as error:  # a damaged pickle can raise anything
        raise FormatError(source, "column labels", error, _DISTRUST) from None


def _check_pickles(group: Any, source: str) -> None:
    """Raise FormatError for pickles that PyTables, and so pandas, would run.

    These are attributes that it takes for pickles, and arrays of pickled objects. None of them is
    run here; but who reads the file in the next program should have been told.
    """
    items = [group]

    def collect(_: str, item: Any) -> None:
        items.append(item)

    group.visititems(collect)
    for item in items:
        for name, value in item.attrs.items():
            _check_attribute(name, value, source)
        if text(item.attrs.get("PSEUDOATOM", "")) == "object":
            raise FormatError(
                source, "arrays of text and numbers", f"pickled objects in `{item.name}`", _DISTRUST
            )


def _check_attribute(name: str, value: Any, source: str) -> None:
    """Raise FormatError where an attribute is a pickle that calls something."""
    looks_like_pickle = isinstance(value, bytes) and len(value) > 2 and value.endswith(b".")
    if not looks_like_pickle:  # by PyTables' own test
        return
    try:
        _load_plain(value)
    except _CallError as error:
        raise FormatError(source, f"plain labels in `{name}`", error, _DISTRUST) from None
    except Exception:
        return  # a damaged pickle, or none: nothing that anybody runs


HDF5 = Format(
    kind="keypoints",
    name="deeplabcut-h5",
    title="DeepLabCut .h5",
    sniff=sniff,
    read=read,
    write=deeplabcut_writer.write_h5,
    endings=(".h5",),
    followed=True,
    loses=(SIZES, SCORES),
)
