"""Read Ultralytics' pose labels and predictions: a .txt file per frame, a line per detection.

A line holds a class, the centre and size of a box, and the points. Traps: positions are shares of
the image, whose size the file does not say; keypoints have no names; a point has two numbers or
three; the box's confidence and the track's number may follow; a second run appends its lines to
the files of the first.
"""

import re
from collections.abc import Iterator

import numpy as np

from mocap_calib.config import LARGEST_SHARE
from mocap_calib.errors import FormatError, argument
from mocap_calib.io.document import Document
from mocap_calib.io.file import (
    NO_SCORE,
    make_view,
    stack_detections,
    visibility_as_confidence,
)
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import LAYOUTS, layout_remedy
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import frames_of
from mocap_calib.types import Floats, Keypoints2D

_BOX = 5  # numbers before the points: class, centre and size
_BEHIND = (0, 1, 2)  # numbers that may follow them: the box's confidence, the track's number
_LINE_OF_NUMBERS = re.compile(r"\s*[0-9]+(\s+[-+.0-9eEnaif]+){6,}\s*")

Row = tuple[str, Floats]  # a line as messages name it, and its numbers behind the box


def sniff(document: Document) -> bool:
    """Return whether the first line holds numbers: a class, then shares of the image."""
    lines = (line for line in document.head.splitlines() if not _is_comment(line))
    return _LINE_OF_NUMBERS.fullmatch(next(lines, "")) is not None


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera, in pixels of the image size that the user gives. Raises FormatError."""
    source = document.source
    size = options.size_of(document.origin.camera)
    if size == (0, 0):
        raise FormatError(
            source,
            "the size of the images, of which positions are shares",
            "none",
            f"say {argument('image_size', 'WIDTHxHEIGHT')}",
        )
    if not options.layout:
        raise _names_wanted(document, source)
    file_names, numbers = frames_of(document)
    rows = [list(_rows(document)) for document in document.documents()]
    values = stack_detections(_detections(rows, len(options.layout)), len(options.layout), source)
    _check_shares(values, source)
    is_unscored = bool(np.isnan(values[..., 2]).all())
    view = make_view(
        document.origin,
        options.layout,
        numbers,
        _in_pixels(values, size, is_unscored=is_unscored),
        tracked=False,
        image_size=size,
        rows=file_names,
        remarks=(NO_SCORE,) if is_unscored else (),
    )
    return (view,)


def _names_wanted(document: Document, source: str) -> FormatError:
    """Return the error of a file without --layout, with the layouts that its first line fits."""
    _, cells = next(_lines(document))
    count = len(cells) - _BOX
    fitting = [
        name
        for name, names in LAYOUTS.items()
        if any(count - width * len(names) in _BEHIND for width in (2, 3))
    ]
    return FormatError(
        source,
        "the names of its keypoints",
        f"{count} numbers after the box",
        layout_remedy(fitting),
    )


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def _lines(document: Document) -> Iterator[tuple[int, list[str]]]:
    """Return the number and the cells of each line that holds a detection."""
    for number, line in enumerate(document.text.splitlines(), start=1):
        if not _is_comment(line):
            yield number, line.split()


def _rows(document: Document) -> Iterator[Row]:
    """Return what messages call each line, and its numbers behind the box. Raises FormatError."""
    line_of: dict[tuple[str, ...], int] = {}
    for number, cells in _lines(document):
        source = f"{document.source}: line {number}"
        first = line_of.setdefault(tuple(cells), number)
        if first != number:
            raise FormatError(
                source,
                "each detection once",
                f"what line {first} says",
                "a second run appended to the files: predict into a new folder",
            )
        try:
            yield source, np.array([float(cell) for cell in cells[_BOX:]])
        except ValueError as error:
            raise FormatError(
                source, "numbers", error, "the file is damaged: export it again"
            ) from None


def _detections(rows: list[list[Row]], keypoints: int) -> list[list[Floats]]:
    """Return the `[keypoint, 3]` detections of each file, score NaN where the model has none.

    A point has two numbers or three, whichever more lines fit. Raises FormatError.
    """
    width = _numbers_per_point(rows, keypoints)
    return [[_points(row, keypoints, width) for row in rows_of_file] for rows_of_file in rows]


def _numbers_per_point(rows: list[list[Row]], keypoints: int) -> int:
    """Return how many numbers a point has in most lines, 2 or 3."""
    lengths = np.array(
        [len(numbers) for rows_of_file in rows for _, numbers in rows_of_file], dtype=np.int64
    )
    lines_with_2 = np.isin(lengths - 2 * keypoints, _BEHIND).sum()
    lines_with_3 = np.isin(lengths - 3 * keypoints, _BEHIND).sum()
    return 2 if lines_with_2 > lines_with_3 else 3


def _points(row: Row, keypoints: int, width: int) -> Floats:
    """Return `[keypoint, 3]` of a line with `width` numbers a point. Raises FormatError."""
    source, numbers = row
    if len(numbers) - width * keypoints not in _BEHIND:
        raise FormatError(
            source,
            f"2 or 3 numbers for each of {keypoints} keypoints after the box, "
            "as in the other lines",
            f"{len(numbers)} numbers",
            f"give {argument('layout')} with as many names as there are keypoints",
        )
    points = numbers[: width * keypoints].reshape(keypoints, width)
    absent = np.full((keypoints, 3 - width), np.nan)
    return np.column_stack([points, absent])


def _check_shares(values: Floats, source: str) -> None:
    """Raise FormatError where `[..., 3]` values have positions that are no shares of the image."""
    largest = np.nanmax(np.abs(values[..., :2]), initial=0.0)
    if largest > LARGEST_SHARE:
        raise FormatError(
            source,
            "positions from 0 to 1",
            f"{largest:.1f}",
            "these are pixels, of a letterboxed image perhaps: export them again",
        )


def _in_pixels(values: Floats, size: tuple[int, int], *, is_unscored: bool) -> Floats:
    """Return `[..., 3]` pixels and confidences of shares of the image and scores."""
    positions, scores = values[..., :2], values[..., 2]
    is_missing = (positions == 0).all(-1, keepdims=True)
    if is_unscored:
        confidence = np.where(np.isfinite(positions[..., 0]), 1.0, np.nan)
    else:
        confidence = visibility_as_confidence(scores)
    pixels = np.where(is_missing, 0.0, positions * size)
    return np.concatenate([pixels, confidence[..., None]], axis=-1)


FORMAT = Format(
    kind="keypoints",
    name="ultralytics",
    title="Ultralytics .txt, a folder per camera",
    sniff=sniff,
    read=read,
    per_frame=True,
)
