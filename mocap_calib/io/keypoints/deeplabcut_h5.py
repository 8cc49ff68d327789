"""DeepLabCut's .h5: a pandas table inside HDF5, read without pandas.

pandas keeps the column labels of its `table` layout as pickles, and unpickling runs whatever the file says.
The unpickler here knows lists, tuples, text and numbers and refuses everything else.
"""

import io
import pickle
from typing import Any, Never

import numpy as np
from numpy.typing import NDArray

from mocap_calib.io.file import malformed
from mocap_calib.io.hdf5 import damage_refused, has_attribute, require_filters
from mocap_calib.io.hdf5 import text as _text
from mocap_calib.io.keypoints.deeplabcut import LEVELS, Table, keypoints_from_table
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Keypoints2D

_CSV_INSTEAD = "use the .csv that DeepLabCut writes next to it"


def sniff(document: Document) -> bool:
    """HDF5 with a pandas table."""
    return has_attribute(document, "pandas_type")


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """The detections of a DeepLabCut .h5 in the `table` or the `fixed` layout. Raises FormatError."""
    source = item.origin.source
    with damage_refused(source, "a whole DeepLabCut .h5", _CSV_INSTEAD):
        table = _table(item.document.hdf5, source)
    return (keypoints_from_table(table, item.origin),)


def _table(file: Any, source: str) -> Table:
    kinds = {
        key: _text(item.attrs["pandas_type"])
        for key, item in file.items()
        if "pandas_type" in item.attrs
    }
    if not kinds:
        raise malformed(
            source,
            "a pandas table as DeepLabCut writes it",
            f"HDF5 with {', '.join(map(str, file)) or 'nothing'}",
            "export DeepLabCut .csv or COCO",
        )
    if len(kinds) > 1:
        raise malformed(
            source,
            "one pandas table",
            f"{len(kinds)}: {', '.join(kinds)}",
            "which one? keep that one, or give its .csv",
        )
    key, kind = next(iter(kinds.items()))
    _check_pickles(file[key], source)
    require_filters(file[key], source, _CSV_INSTEAD)
    if kind == "frame_table":
        return _from_table_layout(file[key], source)
    if kind == "frame":
        return _from_fixed_layout(file[key])
    raise malformed(source, "a pandas DataFrame", f"a {kind}", _CSV_INSTEAD)


def _from_table_layout(group: Any, source: str) -> Table:
    if "table" not in group:
        # more than 64 kB of column labels do not fit an attribute: pandas dies and leaves a stub
        raise malformed(source, "a table", "an aborted write without one", _CSV_INSTEAD)
    dataset = group["table"]
    blocks = sorted(name for name in dataset.dtype.names if name.startswith("values_block_"))
    if "index" not in dataset.dtype.names or not blocks:
        raise malformed(
            source,
            "the columns index and values_block_0",
            ", ".join(dataset.dtype.names),
            _CSV_INSTEAD,
        )
    columns = [
        tuple(map(_text, labels))
        for name in blocks
        for labels in _unpickle(dataset.attrs[f"{name}_kind"], source)
    ]
    content = dataset[...]
    values = np.concatenate(
        [content[name].reshape(len(content), -1).astype(np.float64) for name in blocks], axis=1
    )
    levels = (
        tuple(map(_text, _unpickle(group.attrs["info"], source)[1]["names"]))
        if "info" in group.attrs
        else _usual_levels(columns)
    )
    return _checked(levels, columns, list(map(_text, content["index"])), values)


def _from_fixed_layout(group: Any) -> Table:
    columns: list[tuple[str, ...]] = []
    blocks = []
    levels: tuple[str, ...] = ()
    for block in range(
        sum(name.startswith("block") and name.endswith("_values") for name in group)
    ):
        levels, labels = _multi_index(group, f"block{block}_items")
        columns += labels
        values = group[f"block{block}_values"]
        # pandas holds a block column by column, and PyTables usually turns it
        blocks.append(values[...] if values.attrs.get("transposed") else values[...].T)
    rows = (
        list(map(_text, group["axis1"][...]))
        if "axis1" in group
        else ["/".join(row) for row in _multi_index(group, "axis1")[1]]
    )
    return _checked(levels, columns, rows, np.concatenate(blocks, axis=1).astype(np.float64))


def _checked(
    levels: tuple[str, ...],
    columns: list[tuple[str, ...]],
    rows: list[str],
    values: NDArray[np.float64],
) -> Table:
    if values.shape != (len(rows), len(columns)) or any(
        len(labels) != len(levels) for labels in columns
    ):
        raise ValueError(
            f"{values.shape} values for {len(rows)} rows and {len(columns)} columns of {len(levels)} labels"
        )
    return Table(levels, tuple(columns), rows, values)


def _multi_index(group: Any, name: str) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Names of the levels, and the labels of each entry, of a pandas MultiIndex stored as levels and codes."""
    names: list[str] = []
    labels: list[list[str]] = []
    while f"{name}_level{len(names)}" in group:
        level, codes = group[f"{name}_level{len(names)}"], group[f"{name}_label{len(names)}"][...]
        entries = [*map(_text, level[...]), ""]  # code -1 = no label
        names.append(_text(level.attrs.get("name", "")))
        labels.append([entries[code] for code in codes])
    return tuple(names), list(zip(*labels, strict=True))


def _usual_levels(columns: list[tuple[str, ...]]) -> tuple[str, ...]:
    return (
        LEVELS if columns and len(columns[0]) == len(LEVELS) else ("scorer", "bodyparts", "coords")
    )


class _PlainUnpickler(pickle.Unpickler):
    """Builds lists, tuples, dictionaries, text and numbers; any class or function is refused."""

    def find_class(self, module: str, name: str) -> Never:
        raise _CallError(f"a pickle that calls {module}.{name}")


def _check_pickles(group: Any, source: str) -> None:
    """Refuses what PyTables, and so pandas, would run: attributes that it takes for pickles, and arrays of pickled objects. Raises FormatError.

    None of it is run here; but who reads the file in the next program should have been told.
    """
    found = [group]
    group.visititems(lambda _, item: found.append(item))
    for item in found:
        for name, value in item.attrs.items():
            if (
                isinstance(value, bytes) and len(value) > 2 and value.endswith(b".")
            ):  # PyTables' own test
                try:
                    _PlainUnpickler(io.BytesIO(value), encoding="utf-8").load()
                except _CallError as error:
                    raise malformed(
                        source,
                        f"plain labels in `{name}`",
                        error,
                        f"do not trust this file; {_CSV_INSTEAD}",
                    ) from None
                except Exception:
                    continue
        if _text(item.attrs.get("PSEUDOATOM", "")) == "object":
            raise malformed(
                source,
                "arrays of text and numbers",
                f"pickled objects in `{item.name}`",
                f"do not trust this file; {_CSV_INSTEAD}",
            )


class _CallError(pickle.UnpicklingError):
    """A pickle that calls something."""


def _unpickle(content: Any, source: str) -> Any:
    if not isinstance(content, bytes):
        raise malformed(
            source, "column labels as pandas stores them", type(content).__name__, _CSV_INSTEAD
        )
    try:
        return _PlainUnpickler(io.BytesIO(content), encoding="utf-8").load()
    except Exception as error:  # a damaged pickle can raise anything
        raise malformed(
            source, "column labels", error, f"do not trust this file; {_CSV_INSTEAD}"
        ) from None
