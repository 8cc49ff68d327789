"""DeepLabCut's .csv: 3 or 4 header rows, then a row per frame."""

import csv
import io
import re

import numpy as np

from mocap_calib.io.file import malformed
from mocap_calib.io.keypoints.deeplabcut import LEVELS, Table, keypoints_from_table
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Keypoints2D


def sniff(document: Document) -> bool:
    """The first cell names a header row; the wrong separator is recognised too, to be refused in words."""
    return (
        re.match(
            rb'(\xef\xbb\xbf)?"?(scorer|individuals|bodyparts|coords)"?[,;\t]',
            document.content[:64],
        )
        is not None
    )


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """The detections of a DeepLabCut or Lightning Pose .csv. Raises FormatError."""
    return (keypoints_from_table(_table(item.document.text, item.origin.source), item.origin),)


def _table(text: str, source: str) -> Table:
    header, rows = _split(text, source)
    coords = header.get("coords", [])
    if not any(coords[1:]):
        raise malformed(
            source,
            "commas between cells and a header row `coords`",
            text.splitlines()[0][:60],
            "export it with commas",
        )
    # the index takes one column, or three (folder, video, image), the latter two without a heading
    named = [k for k, cell in enumerate(coords) if k and cell]
    first, end = named[0], named[-1] + 1
    levels = tuple(level for level in LEVELS if level in header)
    # the row `scorer` is shorter than the others in some files, and nobody needs it
    labels = [(header[level] + [""] * end)[first:end] for level in levels]
    if any("" in row for level, row in zip(levels, labels, strict=True) if level != "scorer"):
        raise malformed(
            source,
            "header rows of one length",
            "an empty cell among them",
            "export it from DeepLabCut again",
        )
    if header.get("scorer", [])[end:] == [
        "set"
    ]:  # Lightning Pose's last column: what the frame was used for
        rows = [(number, row[:end]) for number, row in rows]
    values = np.array(
        [_numbers(row, first, end, f"{source}: row {number}") for number, row in rows]
    ).reshape(len(rows), end - first)
    lines = [f"row {number} ({row[first - 1]})" for number, row in rows]
    return Table(
        levels,
        tuple(zip(*labels, strict=True)),
        ["/".join(row[:first]) for _, row in rows],
        values,
        lines,
    )


def _split(text: str, source: str) -> tuple[dict[str, list[str]], list[tuple[int, list[str]]]]:
    """Header rows by their first cell, and the other rows with their numbers in the file."""
    header: dict[str, list[str]] = {}
    rows: list[tuple[int, list[str]]] = []
    try:
        for number, row in enumerate(csv.reader(io.StringIO(text, newline="")), start=1):
            if row and row[0] in LEVELS and not rows:
                header[row[0]] = row
            elif any(row):
                rows.append((number, row))
    except csv.Error as error:
        raise malformed(
            source, "comma-separated values", error, "export it from DeepLabCut again"
        ) from None
    return header, rows


def _numbers(row: list[str], first: int, end: int, source: str) -> Floats:
    """The cells of one row; empty ones are NaN. A row may be short only if it has nothing to say: else the file is cut."""
    if first < len(row) < end and not any(row[first:]):
        return np.full(end - first, np.nan)
    if len(row) < end:
        raise malformed(
            source, f"{end} cells", len(row), "the file is cut or damaged: export it again"
        )
    if any(row[end:]):
        raise malformed(
            source,
            f"{end} cells, as many as the header has",
            len(row),
            "it has commas in its numbers, perhaps: write numbers like 12.5",
        )
    try:
        return np.array([float(cell) if cell else np.nan for cell in row[first:end]])
    except ValueError as error:
        raise malformed(
            source, "numbers with a decimal point", error, "write numbers like 12.5"
        ) from None
