"""What formats with a file or an entry per frame share: numbers from names, points from lists."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_calib.io.file import frame_number, malformed
from mocap_calib.io.keypoints.document import Item, describe
from mocap_calib.types import Floats


def frames_of(item: Item) -> tuple[list[str], list[int]]:
    """Names and numbers of the frames in a folder with a file per frame. Raises FormatError."""
    names = [path.name for path in item.members or (item.path,)]
    return names, frame_numbers(names, item.origin.source)


def json_frames(item: Item) -> list[tuple[Any, str]]:
    """What each file of a folder with a file per frame says, and the file as complaints name it. Raises FormatError where one is no JSON."""
    frames = []
    for document in item.documents():
        if document.json is None:
            raise malformed(
                document.source,
                "JSON of a frame",
                describe(document)[0],
                "export it again, or remove it",
            )
        frames.append((document.json, document.source))
    return frames


def frame_numbers(names: Sequence[str], source: str) -> list[int]:
    """The integer at the end of each name, before its suffix and `_keypoints`; where one has none there, the last integer of all. Raises FormatError."""
    names = [re.sub(r"_keypoints(?=(\.\w+)?$)", "", re.split(r"[/\\]", name)[-1]) for name in names]
    numbers = [frame_number(name) for name in names]
    if min(numbers, default=0) < 0:
        digits = [re.findall(r"[0-9]+", name) for name in names]
        numbers = [frame_number(found[-1]) if found else -1 for found in digits]
    if min(numbers, default=0) < 0:
        raise malformed(
            source,
            "a frame number in each file name",
            names[numbers.index(min(numbers))],
            "rename or remove it",
        )
    return numbers


def triples(points: Any, source: str, named: str = "keypoints") -> Floats:
    """`[keypoint, 3]` of a flat list x, y, c. Raises FormatError."""
    if not isinstance(points, list) or len(points) % 3:
        found = f"{len(points)} numbers" if isinstance(points, list) else type(points).__name__
        raise malformed(source, f"`{named}` to be a list of x, y, c", found, "export it again")
    return numbers_of(points, source, named).reshape(-1, 3)


def numbers_of(values: Any, source: str, named: str) -> Floats:
    """An array of what JSON holds; null is NaN. Raises FormatError."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise malformed(source, f"`{named}` to hold numbers", error, "export it again") from None
