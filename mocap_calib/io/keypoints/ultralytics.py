"""Ultralytics' pose labels and predictions: a .txt file per frame, a line per detection, positions from 0 to 1 of the image."""

import re
from collections.abc import Iterator

import numpy as np

from mocap_calib.config import ReadConfig
from mocap_calib.errors import FormatError
from mocap_calib.io.file import (
    NO_SCORE,
    make_view,
    malformed,
    stack_detections,
    visibility_as_confidence,
)
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import LAYOUTS
from mocap_calib.io.keypoints.per_frame import frames_of
from mocap_calib.types import Floats, Keypoints2D

_BOX = 5  # class, centre and size
_BEHIND = (
    0,
    1,
    2,
)  # numbers after the points: the box's confidence and the track's number may follow


def sniff(document: Document) -> bool:
    """Lines of numbers: a class, then shares of the image."""
    head = document.content[:65536].decode("utf-8-sig", errors="replace")
    line = next(
        (line for line in head.splitlines() if line.strip() and not line.lstrip().startswith("#")),
        "",
    )
    return re.fullmatch(r"\s*[0-9]+(\s+[-+.0-9eEnaif]+){6,}\s*", line) is not None


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """One camera, in pixels of the image size that the user gives. Raises FormatError."""
    source = item.origin.source
    if options.image_size == (0, 0):
        raise malformed(
            source,
            "the size of the images, of which positions are shares",
            "none",
            "say --image-size WIDTHxHEIGHT",
        )
    if not options.layout:
        raise _unnamed(item.document, source)
    names, numbers = frames_of(item)
    frames = _detections(
        [list(_rows(document)) for document in item.documents()], len(options.layout)
    )
    values = stack_detections(list(frames), len(options.layout), source)
    if np.nanmax(np.abs(values[..., :2]), initial=0.0) > ReadConfig().largest_share:
        found = f"{np.nanmax(np.abs(values[..., :2])):.1f}"
        raise malformed(
            source,
            "positions from 0 to 1",
            found,
            "these are pixels, of a letterboxed image perhaps: export them again",
        )
    unscored = np.isnan(values[..., 2]).all()
    values[..., 2] = (
        np.where(np.isfinite(values[..., 0]), 1.0, np.nan)
        if unscored
        else visibility_as_confidence(values[..., 2])
    )
    missing = (values[..., :2] == 0).all(-1)
    values[..., :2] = np.where(missing[..., None], 0.0, values[..., :2] * options.image_size)
    remarks = (NO_SCORE,) if unscored else ()
    return (
        make_view(
            item.origin,
            options.layout,
            numbers,
            values,
            tracked=False,
            image_size=options.image_size,
            rows=names,
            remarks=remarks,
        ),
    )


def _unnamed(document: Document, source: str) -> FormatError:
    """The complaint of a file without --layout, with the layouts that the numbers of its first line fit."""
    count = len(next(_lines(document))[1]) - _BOX
    fitting = [
        name
        for name, names in LAYOUTS.items()
        if any(count - width * len(names) in _BEHIND for width in (2, 3))
    ]
    remedy = (
        f"say --layout {' or '.join(fitting)}"
        if fitting
        else "say --layout with names separated by commas"
    )
    return malformed(source, "the names of its keypoints", f"{count} numbers after the box", remedy)


def _lines(document: Document) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(document.text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line.split()


def _rows(document: Document) -> Iterator[tuple[str, Floats]]:
    """Place and numbers of each line, the box left out."""
    seen: dict[tuple[str, ...], int] = {}
    for number, cells in _lines(document):
        source = f"{document.source}: line {number}"
        if seen.setdefault(tuple(cells), number) != number:
            raise malformed(
                source,
                "each detection once",
                f"what line {seen[tuple(cells)]} says",
                "a second run appended to the files: predict into a new folder",
            )
        try:
            yield source, np.array([float(cell) for cell in cells[_BOX:]])
        except ValueError as error:
            raise malformed(
                source, "numbers", error, "the file is damaged: export it again"
            ) from None


def _detections(rows: list[list[tuple[str, Floats]]], keypoints: int) -> Iterator[list[Floats]]:
    """`[keypoint, 3]` of each line of each file, score NaN where the model has none: two numbers a point or three, whichever more lines fit."""
    lengths = np.array([len(values) for lines in rows for _, values in lines], dtype=np.int64)
    width = max((3, 2), key=lambda width: int(np.isin(lengths - width * keypoints, _BEHIND).sum()))
    for lines in rows:
        for source, values in lines:
            if len(values) - width * keypoints not in _BEHIND:
                expected = f"2 or 3 numbers for each of {keypoints} keypoints after the box, as in the other lines"
                raise malformed(
                    source,
                    expected,
                    f"{len(values)} numbers",
                    "give --layout with as many names as there are keypoints",
                )
        points = [values[: width * keypoints].reshape(keypoints, width) for _, values in lines]
        yield [np.column_stack([each, np.full((keypoints, 3 - width), np.nan)]) for each in points]
