"""DeepLabCut's table of labelled columns, whichever file it came from -> detections. Lightning Pose writes the same."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.io.file import NO_SCORE, Origin, blank, frame_number, make_view, malformed
from mocap_calib.types import Floats, Ints, Keypoints2D

LEVELS = ("scorer", "individuals", "bodyparts", "coords")
_SPREAD = re.compile(
    r"[xy]_(ens_median|ens_var|posterior_var|var)|zscore|nll|ensemble_std"
)  # what ensemble Kalman smoothers write beside


@dataclass(frozen=True)
class Table:
    """What the files hold.

    levels: names of the header rows. columns: each column's labels, one per level. rows: frame numbers or image
    paths, as text. values: `[row, column]`, NaN where a cell is empty. lines: where the rows are in the file, as
    complaints say it; the rows themselves where it has no lines.
    """

    levels: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    rows: Sequence[str]
    values: Floats
    lines: Sequence[str] = ()


def keypoints_from_table(table: Table, origin: Origin) -> Keypoints2D:
    """Detections by label, so that jagged tables come out right.

    One instance per individual, in the order of the columns. The pseudo-individual `single`, which holds the
    unique body parts of a scene (corners, levers), is nobody and left out when it shares none with the others.
    Labelled frames have no likelihood: their confidence is 1. Raises FormatError.
    """
    source = origin.source
    place = _columns_by_label(table, source)
    individuals = _individuals(place)
    keypoints = tuple(dict.fromkeys(part for who, part in place if who in individuals))
    values = blank(len(table.rows), len(individuals), len(keypoints), source)
    for (who, part), coords in place.items():
        if who in individuals:
            target = values[:, individuals.index(who), keypoints.index(part)]
            target[:, 2] = 1.0
            for axis, coord in enumerate(("x", "y", "likelihood")):
                if coord in coords:
                    target[:, axis] = table.values[:, coords[coord]]
    unique = sorted({part for who, part in place if who not in individuals})
    remarks: tuple[str, ...] = (
        (f"unique body parts belong to no individual and are left out: {', '.join(unique)}",)
        if unique
        else ()
    )
    if not any("likelihood" in coords for coords in place.values()):
        remarks += (NO_SCORE,)
    return make_view(
        origin,
        keypoints,
        _frames(table.rows, source),
        values,
        tracked=not _any_order(individuals),
        rows=table.lines or table.rows,
        remarks=remarks,
    )


def _columns_by_label(table: Table, source: str) -> dict[tuple[str, str], dict[str, int]]:
    """(individual, body part) -> coordinate -> column."""
    if not {"bodyparts", "coords"} <= set(table.levels) or not set(table.levels) <= set(LEVELS):
        raise malformed(
            source,
            f"header rows among {', '.join(LEVELS)}",
            ", ".join(table.levels) or "none",
            "export it from DeepLabCut again",
        )
    place: dict[tuple[str, str], dict[str, int]] = {}
    for column, labels in enumerate(table.columns):
        label = dict(zip(table.levels, labels, strict=True))
        if _SPREAD.fullmatch(label["coords"]):
            continue
        coords = place.setdefault((label.get("individuals", ""), label["bodyparts"]), {})
        if label["coords"] in coords:
            raise malformed(
                source,
                "each column once",
                f"{' '.join(labels)} twice",
                "keep the columns of one scorer",
            )
        coords[label["coords"]] = column
    found = sorted({coord for coords in place.values() for coord in coords})
    if "z" in found:
        raise malformed(
            source,
            "2D keypoints (x, y, likelihood)",
            "3D ones (x, y, z)",
            "give the 2D file of each camera",
        )
    if (
        not place
        or set(found) - {"x", "y", "likelihood"}
        or not all({"x", "y"} <= coords.keys() for coords in place.values())
    ):
        raise malformed(
            source,
            "columns x, y and perhaps likelihood for each body part",
            ", ".join(found) or "none",
            "export it from DeepLabCut again",
        )
    return place


def _individuals(place: dict[tuple[str, str], dict[str, int]]) -> list[str]:
    names = list(dict.fromkeys(who for who, _ in place))
    shared = {part for who, part in place if who != "single"}
    unique = {part for who, part in place if who == "single"}
    return [who for who in names if who != "single" or not shared or unique & shared]


def _any_order(individuals: list[str]) -> bool:
    """SuperAnimal's `animal0`, `animal1`, ... are detections that nobody follows."""
    return len(individuals) > 1 and all(re.fullmatch(r"animal[0-9]+", name) for name in individuals)


def _frames(rows: Sequence[str], source: str) -> Ints:
    if not rows:
        raise malformed(
            source, "at least one row of data", "none", "export it from DeepLabCut again"
        )
    folders = list(dict.fromkeys(row.replace("\\", "/").rpartition("/")[0] for row in rows))
    if len(folders) > 1:
        raise malformed(
            source,
            "images of one folder, which is a video",
            f"those of {folders[0]} and {folders[1]}",
            "give one file per camera",
        )
    numbers = [frame_number(row) for row in rows]
    if min(numbers) < 0:
        raise malformed(
            source,
            "each row to begin with a frame number or a numbered image",
            rows[numbers.index(min(numbers))],
            "mend the first column",
        )
    return np.array(numbers, dtype=np.int64)
