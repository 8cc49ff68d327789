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
from mocap_calib.io.detections import view_of_frames
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions, layout_remedy
from mocap_calib.types import Floats, Keypoints2D

_BOX = 5  # numbers before the points: class, centre and size
_WIDTHS = (2, 3)  # of a point
_BEHIND = (0, 1, 2)  # numbers that may follow them: the box's confidence, the track's number
_LINE_OF_NUMBERS = re.compile(r"\s*[0-9]+(\s+[-+.0-9eEnaif]+){6,}\s*")


def sniff(document: Document) -> bool:
    """Return whether the first line holds numbers: a class, then shares of the image."""
    lines = (line for line in document.head.splitlines() if not _is_comment(line))
    return _LINE_OF_NUMBERS.fullmatch(next(lines, "")) is not None


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera, in pixels of the image size that the user gives. Raises FormatError."""
    size, count = options.size_of(document.camera), len(options.layout)
    if size == (0, 0):
        expected = "the size of the images, of which positions are shares"
        remedy = f"say {argument('image_size', 'WIDTHxHEIGHT')}"
        raise document.refuse(expected, "none", remedy)
    if not count:
        numbers = len(next(_lines(document))[1]) - _BOX
        counts = [(numbers - behind) / width for width in _WIDTHS for behind in _BEHIND]
        found = f"{numbers} numbers after the box"
        raise document.refuse("the names of its keypoints", found, layout_remedy(counts))
    rows = {each.path.name: list(_rows(each)) for each in document.documents()}
    widths = [_widths(len(numbers), count) for of_file in rows.values() for _, numbers in of_file]
    longest = max((len(numbers) for of_file in rows.values() for _, numbers in of_file), default=0)
    width = 2 if sum(2 in each for each in widths) > sum(3 in each for each in widths) else 3
    if longest - width * count == max(_BEHIND):
        document.account.add_names(["track"], "columns")
    view = view_of_frames(
        document,
        options,
        list(rows),
        [[_points(*row, count, width, size) for row in of_file] for of_file in rows.values()],
        names=options.layout,
        image_size=size,
    )
    return (view,)


def _widths(numbers: int, keypoints: int) -> list[int]:
    """Return how many numbers a point can have where so many follow the box: 2, 3 or none."""
    return [width for width in _WIDTHS if numbers - width * keypoints in _BEHIND]


def _lines(document: Document) -> Iterator[tuple[int, list[str]]]:
    """Return the number and the cells of each line that holds a detection."""
    for number, line in enumerate(document.text.splitlines(), start=1):
        if not _is_comment(line):
            yield number, line.split()


def _rows(document: Document) -> Iterator[tuple[str, Floats]]:
    """Return what messages call each line, and its numbers behind the box. Raises FormatError."""
    line_of: dict[tuple[str, ...], int] = {}
    for number, cells in _lines(document):
        source = f"{document.source}: line {number}"
        first = line_of.setdefault(tuple(cells), number)
        if first != number:
            remedy = "a second run appended to the files: predict into a new folder"
            raise FormatError(source, "each detection once", f"what line {first} says", remedy)
        try:
            yield source, np.array([float(cell) for cell in cells[_BOX:]])
        except ValueError as error:
            raise FormatError(source, "numbers", error, "export it again") from None


def _points(
    source: str, numbers: Floats, keypoints: int, width: int, size: tuple[int, int]
) -> Floats:
    """Return `[keypoint, 3]` pixels and scores of a line with `width` numbers a point.

    Scores are NaN where it has none. Raises FormatError.
    """
    if width not in _widths(len(numbers), keypoints):
        after = f"for each of {keypoints} keypoints after the box, as in the other lines"
        remedy = f"give {argument('layout')} with as many names as there are keypoints"
        raise FormatError(source, f"2 or 3 numbers {after}", f"{len(numbers)} numbers", remedy)
    points = numbers[: width * keypoints].reshape(keypoints, width)
    largest = np.nanmax(np.abs(points[:, :2]), initial=0.0)
    if largest > LARGEST_SHARE:
        remedy = "these are pixels, of a letterboxed image perhaps: export them again"
        raise FormatError(source, "positions from 0 to 1", f"{largest:.1f}", remedy)
    scores = np.full((keypoints, 3 - width), np.nan)
    return np.column_stack([points * (*size, 1)[:width], scores])


FORMAT = Format(
    name="ultralytics",
    title="Ultralytics .txt, a folder per camera",
    sniff=sniff,
    read=read,
    per_frame=True,
)
