"""Turn DeepLabCut's table of labelled columns into detections, whichever file it came from.

Lightning Pose writes the same. Traps: tables are jagged (an individual may lack body parts), so
columns are found by label and not by position; the pseudo-individual `single` holds the unique
body parts of a scene (corners, levers); SuperAnimal's `animal0`, `animal1`, ... are detections in
any order; labelled frames have no likelihood; tables of 3D poses differ only by a column `z`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.file import NO_SCORE, Origin, check_size, frame_number, make_view
from mocap_calib.types import Floats, Ints, Keypoints2D

LEVELS = ("scorer", "individuals", "bodyparts", "coords")
LEVELS_OF_ONE = ("scorer", "bodyparts", "coords")  # of a table of one animal
COORDS = ("x", "y", "likelihood")
_NO_PART, _NO_LIKELIHOOD = -1, -2  # in the place of a column
_DIGITS = 18  # of a number that int64 holds
_UNIQUE = "single"  # the pseudo-individual of unique body parts
_AGAIN = "export it from DeepLabCut again"

# what ensemble Kalman smoothers write beside the coordinates
_SPREAD = re.compile(r"[xy]_(ens_median|ens_var|posterior_var|var)|zscore|nll|ensemble_std")

# (individual, body part) -> coordinate -> column
Columns = dict[tuple[str, str], dict[str, int]]


@dataclass(frozen=True)
class Table:
    """What the files hold.

    levels: names of the header rows.
    columns: each column's labels, one per level.
    rows: frame numbers or image paths, as text.
    values: `[row, column]`, NaN where a cell is empty.
    lines: where the rows are in the file, as messages say it; empty where the file has no lines.
    """

    levels: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    rows: Sequence[str]
    values: Floats
    lines: Sequence[str] = ()


def keypoints_from_table(table: Table, origin: Origin) -> Keypoints2D:
    """Return the detections of a table: one instance per individual, in the order of the columns.

    The pseudo-individual `single` is left out when it shares no body part with the others.
    Without likelihood the confidence is 1. Raises FormatError.
    """
    source = origin.source
    columns = _columns_by_label(table, source)
    individuals = _individuals(columns)
    left_out = sorted({part for name, part in columns if name not in individuals})
    columns = {label: coords for label, coords in columns.items() if label[0] in individuals}
    parts = tuple(dict.fromkeys(part for _, part in columns))
    places = np.full((len(individuals), len(parts), len(COORDS)), _NO_PART)
    for (name, part), coords in columns.items():
        places[individuals.index(name), parts.index(part)] = [
            coords.get(c, _NO_LIKELIHOOD) for c in COORDS
        ]
    check_size(len(table.rows), len(individuals), len(parts), source)
    return make_view(
        origin,
        parts,
        _frame_numbers(table.rows, source),
        _select(table.values, places),
        tracked=not _are_in_any_order(individuals),
        rows=table.lines or table.rows,
        remarks=_remarks(table, left_out),
    )


def _select(values: Floats, places: Ints) -> Floats:
    """Return the `[row, individual, part, 3]` points in the `[row, column]` values of a table.

    places: `[individual, part, 3]` column; `_NO_PART` and `_NO_LIKELIHOOD` where there is none.
    """
    shape = (len(values), *places.shape)
    if np.array_equal(places.ravel(), np.arange(values.shape[1])):
        return values.reshape(shape)  # without a copy
    points = values[:, places.ravel()].reshape(shape)
    points[:, places == _NO_PART] = np.nan
    points[:, places == _NO_LIKELIHOOD] = 1.0
    return points


def _remarks(table: Table, left_out: list[str]) -> tuple[str, ...]:
    """Return what to say of body parts that are left out and of absent scores."""
    remarks = []
    if left_out:
        parts = ", ".join(left_out)
        remarks.append(f"unique body parts belong to no individual and are left out: {parts}")
    coords = table.levels.index("coords")
    if not any(labels[coords] == "likelihood" for labels in table.columns):
        remarks.append(NO_SCORE)
    return tuple(remarks)


def _columns_by_label(table: Table, source: str) -> Columns:
    """Return the columns of each body part. Raises FormatError."""
    levels = set(table.levels)
    if not {"bodyparts", "coords"} <= levels or not levels <= set(LEVELS):
        raise FormatError(
            source,
            f"header rows among {', '.join(LEVELS)}",
            ", ".join(table.levels) or "none",
            _AGAIN,
        )
    columns: Columns = {}
    for column, labels in enumerate(table.columns):
        label = dict(zip(table.levels, labels, strict=True))
        if _SPREAD.fullmatch(label["coords"]):
            continue
        coords = columns.setdefault((label.get("individuals", ""), label["bodyparts"]), {})
        if label["coords"] in coords:
            raise FormatError(
                source,
                "each column once",
                f"{' '.join(labels)} twice",
                "keep the columns of one scorer",
            )
        coords[label["coords"]] = column
    _check_coords(columns, source)
    return columns


def _check_coords(columns: Columns, source: str) -> None:
    """Raise FormatError where body parts have other coordinates than x, y and likelihood."""
    found = sorted({coord for coords in columns.values() for coord in coords})
    if "z" in found:
        raise FormatError(
            source,
            "2D keypoints (x, y, likelihood)",
            "3D ones (x, y, z)",
            "give the 2D file of each camera",
        )
    all_have_positions = all({"x", "y"} <= coords.keys() for coords in columns.values())
    if not columns or not all_have_positions or not set(found) <= set(COORDS):
        raise FormatError(
            source,
            "columns x, y and perhaps likelihood for each body part",
            ", ".join(found) or "none",
            _AGAIN,
        )


def _individuals(columns: Columns) -> list[str]:
    """Return the individuals, without `single` where it shares no body part with the others."""
    names = list(dict.fromkeys(name for name, _ in columns))
    others = {part for name, part in columns if name != _UNIQUE}
    unique = {part for name, part in columns if name == _UNIQUE}
    if others and not unique & others:
        return [name for name in names if name != _UNIQUE]
    return names


def _are_in_any_order(individuals: list[str]) -> bool:
    """Return whether these are SuperAnimal's `animal0`, `animal1`, ..., whom nobody follows."""
    return len(individuals) > 1 and all(re.fullmatch(r"animal[0-9]+", name) for name in individuals)


def _frame_numbers(rows: Sequence[str], source: str) -> Ints:
    """Return the `[row]` frame numbers. Raises FormatError."""
    if not rows:
        raise FormatError(source, "at least one row of data", "none", _AGAIN)
    if all(row.isascii() and row.isdigit() and len(row) <= _DIGITS for row in rows):
        return np.array([int(row) for row in rows], dtype=np.int64)
    folders = list(dict.fromkeys(row.replace("\\", "/").rpartition("/")[0] for row in rows))
    if len(folders) > 1:
        raise FormatError(
            source,
            "images of one folder, which is a video",
            f"those of {folders[0]} and {folders[1]}",
            "give one file per camera",
        )
    numbers = [frame_number(row) for row in rows]
    if min(numbers) < 0:
        raise FormatError(
            source,
            "each row to begin with a frame number or a numbered image",
            rows[numbers.index(min(numbers))],
            "mend the first column",
        )
    return np.array(numbers, dtype=np.int64)
