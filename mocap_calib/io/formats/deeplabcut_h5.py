"""Read and write DeepLabCut's .h5: a pandas table inside HDF5, without pandas.

Traps: there are two layouts, `table` and `fixed`. The `table` layout keeps the labels of the
columns as pickles, and unpickling runs whatever the file says: the unpickler here knows lists,
tuples, text and numbers and refuses everything else. More than 64 kB of labels do not fit an
attribute: pandas then dies and leaves a table without content. PyTables can compress with blosc,
which h5py does not have.

Written is the `fixed` layout, which needs no pickles; DeepLabCut reads both layouts.
"""

import io
import pickle
from typing import Any, Never

import numpy as np

from mocap_calib import mapped
from mocap_calib.io.detections import SCORES, SIZES
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats.deeplabcut import (
    LEVELS,
    LEVELS_OF_ONE,
    LabelledTable,
    Labels,
    table_of_view,
    view_of_table,
)
from mocap_calib.io.hdf5 import damage_refused, has_attribute, require_filters, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Keypoints2D

_CSV_INSTEAD = "use the .csv that DeepLabCut writes next to it"
_DISTRUST = f"do not trust this file; {_CSV_INSTEAD}"
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

_Parts = tuple[Labels, list[Labels], list[str], list[Any]]  # of a table, with blocks of values


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with a pandas table."""
    return has_attribute(document, "pandas_type")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of a DeepLabCut .h5 in the `table` or the `fixed` layout.

    Raises FormatError.
    """
    with damage_refused(document.source, "a whole DeepLabCut .h5", _CSV_INSTEAD):
        table = _read_table(document)
    return (view_of_table(table, document),)


def _read_table(document: Document) -> LabelledTable:
    """Return the one pandas table of a file. Raises FormatError."""
    groups = [item for item in document.hdf5.values() if "pandas_type" in item.attrs]
    if len(groups) > 1:
        found = f"{len(groups)}: {', '.join(group.name[1:] for group in groups)}"
        raise document.refuse("one pandas table", found, "keep one of them, or give its .csv")
    (group,) = groups
    _check_pickles(group, document)
    require_filters(group, document.source, _CSV_INSTEAD)
    layout = text(group.attrs["pandas_type"])
    if layout not in ("frame_table", "frame"):
        raise document.refuse("a pandas DataFrame", f"a {layout}", _CSV_INSTEAD)
    parse = _read_table_layout if layout == "frame_table" else _read_fixed_layout
    levels, columns, rows, blocks = parse(group, document)
    values = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)
    labelled = all(len(labels) == len(levels) for labels in columns)
    if values.shape != (len(rows), len(columns)) or not labelled:
        counted = f"{len(rows)} rows and {len(columns)} columns of {len(levels)} labels"
        raise ValueError(f"{values.shape} values for {counted}")
    values = values.astype(np.float64, copy=False)
    return LabelledTable(levels, columns, rows, values, rows.__getitem__)


def _read_table_layout(group: Any, document: Document) -> _Parts:
    """Return levels, columns, rows and blocks of the `table` layout. Raises FormatError."""
    if "table" not in group:
        raise document.refuse("a table", "an aborted write without one", _CSV_INSTEAD)
    dataset = group["table"]
    names = sorted(name for name in dataset.dtype.names if name.startswith("values_block_"))
    columns: list[Labels] = []
    for name in names:
        labels_of_block = _unpickle(dataset.attrs[f"{name}_kind"], document)
        columns += [tuple(map(text, labels)) for labels in labels_of_block]
    content = dataset[...]
    levels: Labels = LEVELS if columns and len(columns[0]) == len(LEVELS) else LEVELS_OF_ONE
    if "info" in group.attrs:
        levels = tuple(map(text, _unpickle(group.attrs["info"], document)[1]["names"]))
    blocks = [content[name].reshape(len(content), -1).astype(np.float64) for name in names]
    return levels, columns, list(map(text, content["index"])), blocks


def _read_fixed_layout(group: Any, document: Document) -> _Parts:
    """Return levels, columns, rows and blocks of the `fixed` layout.

    pandas holds a block column by column, and PyTables usually transposes it.
    """
    levels: Labels = ()
    columns: list[Labels] = []
    blocks: list[Any] = []
    while f"block{len(blocks)}_values" in group:
        levels, labels = _read_multi_index(group, f"block{len(blocks)}_items")
        columns += labels
        block = group[f"block{len(blocks)}_values"]
        if block.attrs.get("transposed"):
            blocks.append(mapped.in_blocks(block.__getitem__, len(block)))
        else:
            blocks.append(block[...].T)
    if "axis1" in group:
        return levels, columns, list(map(text, group["axis1"][...])), blocks
    return levels, columns, list(map("/".join, _read_multi_index(group, "axis1")[1])), blocks


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


class _CallError(pickle.UnpicklingError):
    """A pickle that calls something."""


class _PlainUnpickler(pickle.Unpickler):
    """Build lists, tuples, dictionaries, text and numbers; refuse any class or function."""

    def find_class(self, module: str, name: str) -> Never:
        raise _CallError(f"a pickle that calls {module}.{name}")


def _load_plain(content: bytes) -> Any:
    return _PlainUnpickler(io.BytesIO(content), encoding="utf-8").load()


def _unpickle(content: Any, document: Document) -> Any:
    """Return the labels in a pickle. Raises FormatError."""
    if not isinstance(content, bytes):
        found = type(content).__name__
        raise document.refuse("column labels as pandas stores them", found, _CSV_INSTEAD)
    try:
        return _load_plain(content)
    except Exception as error:  # a damaged pickle can raise anything
        raise document.refuse("column labels", error, _DISTRUST) from None


def _check_pickles(group: Any, document: Document) -> None:
    """Raise FormatError for pickles that PyTables, and so pandas, would run.

    These are attributes that it takes for pickles, and arrays of pickled objects. None of them is
    run here; but who reads the file in the next program should have been warned.
    """
    items = [group]
    group.visititems(lambda _, item: items.append(item))
    for item in items:
        for name, value in item.attrs.items():
            try:
                # PyTables' own test
                if isinstance(value, bytes) and len(value) > 2 and value.endswith(b"."):
                    _load_plain(value)
            except _CallError as error:
                raise document.refuse(f"plain labels in `{name}`", error, _DISTRUST) from None
            except Exception:
                continue  # a damaged pickle, or none: nothing that any program runs
        if text(item.attrs.get("PSEUDOATOM", "")) == "object":
            found = f"pickled objects in `{item.name}`"
            raise document.refuse("arrays of text and numbers", found, _DISTRUST)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write `<camera>.h5`."""
    return {f"{view.camera}.h5": _format(view) for view in views}


def _format(view: Keypoints2D) -> bytes:
    import h5py  # noqa: PLC0415 - as in document.py

    table = table_of_view(view)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        _set_texts(file, _FILE)
        group = file.create_group(_KEY)
        _set_texts(group, _GROUP)
        group.attrs["ndim"] = np.int64(2)
        group.attrs["nblocks"] = np.int64(1)
        for index in ("axis0", "block0_items"):
            group.attrs[f"{index}_nlevels"] = np.int64(len(table.levels))
            _write_multi_index(group, index, table)
        _write_array(group, "axis1", view.frames, kind=b"integer")
        group["axis1"].attrs["name"] = np.bytes_(_PICKLED_NONE)
        _write_array(group, "block0_values", table.values)
    return buffer.getvalue()


def _write_multi_index(group: Any, name: str, table: LabelledTable) -> None:
    """Write the columns as the different labels of each level, and codes into them."""
    for k, labels in enumerate(zip(*table.columns, strict=True)):
        level, known = table.levels[k].encode(), list(dict.fromkeys(labels))
        dataset = f"{name}_level{k}"
        encoded = np.array([label.encode() for label in known])
        _write_array(group, dataset, encoded, kind=b"string", name=level, nan_rep=b"")
        _set_texts(group[dataset], {f"{name}_name{table.levels[k]}": level})
        dtype = np.int8 if len(known) < 128 else np.int16
        codes = np.array([known.index(label) for label in labels], dtype=dtype)
        _write_array(group, f"{name}_label{k}", codes)


def _write_array(group: Any, dataset: str, values: Any, **attributes: bytes) -> None:
    group[dataset] = values
    _set_texts(group[dataset], {**_ARRAY, **attributes})
    group[dataset].attrs["transposed"] = np.uint8(1)


def _set_texts(item: Any, attributes: dict[str, bytes]) -> None:
    """Set attributes in the types that PyTables reads as text."""
    import h5py  # noqa: PLC0415 - as in document.py

    for name, value in attributes.items():
        if value:
            item.attrs.create(name, value, dtype=h5py.string_dtype("utf-8", len(value)))
        else:
            item.attrs[name] = h5py.Empty("S1")


HDF5 = Format(
    name="deeplabcut-h5",
    title="DeepLabCut .h5",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".h5",),
    followed=True,
    loses=(SIZES, SCORES),
)
