"""filled_in.tsv: the keypoints that were completed, a row a point, beside files of any format.

Keypoint formats have no place for such a mark. Columns, with tabs between: the camera's name, the
frame number, the instance (order in the file), the keypoint. Readers of keypoints pass it over;
`describe_filled` says what it lists.
"""

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from mocap_calib.errors import count
from mocap_calib.types import Bools, Keypoints2D

FILLED_TABLE = "filled_in.tsv"
_HEADER = ["camera", "frame", "instance", "keypoint"]


def format_filled_table(views: Sequence[Keypoints2D], filled: Bools) -> bytes:
    """Return the table.

    filled: `[view, frame, instance, keypoint]` the points that were completed.
    """
    text = io.StringIO()
    table = csv.writer(text, delimiter="\t", lineterminator="\n")
    table.writerow(_HEADER)
    for view, points in zip(views, filled, strict=True):
        for frame, instance, keypoint in np.argwhere(points):
            number, name = view.frames[frame], view.keypoints[keypoint]
            table.writerow([view.camera, number, instance, name])
    return text.getvalue().encode()


def describe_filled(views: Sequence[Keypoints2D]) -> tuple[str, ...]:
    """Return a line for each view of whose keypoints a table beside its file lists some."""
    tables = {view.source: _find_table(Path(view.source)) for view in views}
    rows = {path: _count_rows(path) for path in set(tables.values()) if path}
    lines = []
    for view in views:
        table = tables[view.source]
        # the user may have given the camera another name
        names = {view.camera, Path(view.source).stem}
        filled = sum(rows[table][name] for name in names) if table else 0
        if filled:
            counted = count(filled, "keypoint")
            lines.append(f"{view.camera}: {counted} filled in by `complete`, not measured")
    return tuple(lines)


def _find_table(path: Path) -> Path | None:
    """Return the table beside a file or a folder of frames, None where there is none."""
    places = (path.with_name(f"{path.name}.{FILLED_TABLE}"), path.with_name(FILLED_TABLE))
    return next((place for place in places if place.is_file()), None)


def _count_rows(path: Path) -> Mapping[str, int]:
    """Return the number of rows of each camera in a table; of none where it is something else."""
    cameras: Counter[str] = Counter()
    with (
        suppress(OSError, csv.Error),
        path.open(encoding="utf-8", errors="replace", newline="") as f,
    ):
        rows = csv.reader(f, delimiter="\t")
        if next(rows, None) == _HEADER:
            cameras.update(row[0] for row in rows if row)
    return cameras
