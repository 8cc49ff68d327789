"""Turn tables with a row per point, or per detection, into detections.

The columns may be called anything. Work goes column by column, since there are many rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import (
    Origin,
    blank,
    check_cameras,
    fill_missing_scores,
    frame_number,
    make_view,
    unique_names,
)
from mocap_calib.types import Floats, Ints, Keypoints2D


@dataclass(frozen=True)
class Points:
    """The points of a table, a row each.

    camera: `[row]` name.
    frame: `[row]` text with the frame number.
    identity: `[row]` the name of an individual, or the number of an instance.
    keypoint: `[row]` name; an empty one says only that the frame is there.
    values: `[row, 3]` x, y, score.
    lines: `[row]` line numbers in the file.
    """

    camera: Sequence[str]
    frame: Sequence[str]
    identity: Sequence[str]
    keypoint: Sequence[str]
    values: Floats
    lines: Ints


@dataclass(frozen=True)
class _Coded:
    """A column as its different texts and, of each row, which of them it has.

    texts: the different texts, in the order in which they appear.
    codes: `[row]` indices into the texts.
    """

    texts: list[str]
    codes: Ints

    def select(self, rows: Ints) -> "_Coded":
        """Return these rows (`[row]` indices), with only the texts that occur in them."""
        used, first, codes = np.unique(self.codes[rows], return_index=True, return_inverse=True)
        appearance = np.argsort(first)
        code_by_appearance = np.empty_like(appearance)
        code_by_appearance[appearance] = np.arange(len(appearance))
        texts = [self.texts[used[k]] for k in appearance]
        return _Coded(texts, code_by_appearance[codes])


@dataclass(frozen=True)
class _Table:
    """Points with coded columns; `values` is `[row, 3]`, `lines` is `[row]`."""

    frame: _Coded
    identity: _Coded
    keypoint: _Coded
    values: Floats
    lines: Ints

    def select(self, rows: Ints) -> "_Table":
        """Return these rows (`[row]` indices) of the table."""
        return _Table(
            frame=self.frame.select(rows),
            identity=self.identity.select(rows),
            keypoint=self.keypoint.select(rows),
            values=self.values[rows],
            lines=self.lines[rows],
        )


def views_from_points(
    points: Points, document: Document, *, tracked: bool, remarks: tuple[str, ...] = ()
) -> tuple[Keypoints2D, ...]:
    """Return the cameras of the table, in the order in which they appear.

    tracked: `points.identity` names the same individual in all frames.

    Raises FormatError.
    """
    source = document.source
    cameras = _code(points.camera)
    check_cameras(cameras.texts, source)
    table = _Table(
        frame=_code(points.frame),
        identity=_code(points.identity),
        keypoint=_code(points.keypoint),
        values=points.values,
        lines=points.lines,
    )
    views = []
    for index, camera in enumerate(cameras.texts):
        rows = np.flatnonzero(cameras.codes == index)
        views.append(
            _view(table.select(rows), Origin(camera, source), tracked=tracked, remarks=remarks)
        )
    return tuple(views)


def _code(column: Sequence[str]) -> _Coded:
    """Return a column as its different texts and the index of each row's text."""
    texts = list(dict.fromkeys(column))
    code_of = {text: code for code, text in enumerate(texts)}
    codes = (code_of[text] for text in column)
    return _Coded(texts, np.fromiter(codes, dtype=np.int64, count=len(column)))


def _view(table: _Table, origin: Origin, *, tracked: bool, remarks: tuple[str, ...]) -> Keypoints2D:
    """Return the detections of one camera, whose rows these are. Raises FormatError."""
    source = origin.source
    number_of_text = _frame_numbers(table.frame.texts, source)
    frames = np.unique(number_of_text)
    instance_of_text = _instances(table.identity.texts, tracked=tracked, source=source)
    keypoints = unique_names([name for name in table.keypoint.texts if name], source)
    values = blank(len(frames), int(instance_of_text.max()) + 1, len(keypoints), source)

    frame = np.searchsorted(frames, number_of_text)[table.frame.codes]
    instance = instance_of_text[table.identity.codes]
    keypoint = _keypoint_indices(table.keypoint.texts, keypoints)[table.keypoint.codes]
    named = keypoint >= 0
    cells = (frame[named], instance[named], keypoint[named])
    _check_each_point_once(
        cells, frames=frames, keypoints=keypoints, lines=table.lines[named], source=source
    )
    values[cells] = table.values[named]
    values, score_remarks = fill_missing_scores(values)
    return make_view(
        origin, keypoints, frames, values, tracked=tracked, remarks=remarks + score_remarks
    )


def _frame_numbers(texts: list[str], source: str) -> Ints:
    """Return the `[text]` frame number of each text. Raises FormatError."""
    numbers = np.array([frame_number(text) for text in texts], dtype=np.int64)
    if (numbers < 0).any():
        raise FormatError(
            source,
            "a frame number in each row",
            repr(texts[int(np.argmin(numbers))]),
            "mend the column of frames",
        )
    return numbers


def _instances(names: list[str], *, tracked: bool, source: str) -> Ints:
    """Return the `[name]` instance index of each name.

    That of an instance is its number. Individuals come by number where each name is a number of
    its own, else in the order in which they appear. Raises FormatError.
    """
    numbers = np.array([_small_number(name) for name in names], dtype=np.int64)
    if tracked:
        all_differ = len(set(numbers.tolist()) - {-1}) == len(names)
        if all_differ:
            return np.unique(numbers, return_inverse=True)[1]
        return np.arange(len(names))
    if (numbers < 0).any():
        raise FormatError(
            source,
            "whole numbers in the column instance",
            repr(names[int(np.argmin(numbers))]),
            "call the column individual, if it names them",
        )
    return numbers


def _keypoint_indices(texts: list[str], keypoints: Sequence[str]) -> Ints:
    """Return the `[text]` index of each text among the keypoints; -1 for an empty one."""
    index_of = {name: index for index, name in enumerate(keypoints)}
    return np.array([index_of.get(text, -1) for text in texts], dtype=np.int64)


def _small_number(name: str) -> int:
    """Return the whole number of at most nine digits that a name is; -1 for any other name."""
    is_number = name.isascii() and name.isdigit() and len(name) < 10
    return int(name) if is_number else -1


def _check_each_point_once(
    cells: tuple[Ints, Ints, Ints],
    *,
    frames: Ints,
    keypoints: Sequence[str],
    lines: Ints,
    source: str,
) -> None:
    """Raise FormatError where two rows are of one point.

    cells: `[row]` frame index, instance and keypoint index.
    frames: `[frame]` numbers. lines: `[row]` line numbers.
    """
    frame, instance, keypoint = cells
    if not len(frame):
        return
    shape = (len(frames), int(instance.max()) + 1, len(keypoints))
    place = np.ravel_multi_index(cells, shape)
    places, counts = np.unique(place, return_counts=True)
    if (counts == 1).all():
        return
    twice = np.flatnonzero(place == places[counts > 1][0])
    first = twice[0]
    rows = ", ".join(map(str, lines[twice][:3]))
    raise FormatError(
        source,
        "each point once",
        f"frame {frames[frame[first]]}, individual {instance[first]}, "
        f"{keypoints[keypoint[first]]} {len(twice)} times, in rows {rows}",
        "remove the double rows, or tell individuals apart",
    )
