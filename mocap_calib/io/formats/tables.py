"""Read tables with a row per point: the plain one that anything can write, and caliscope's.

The plain table (docs/formats.md) has the columns `camera,frame,individual,keypoint,x,y,score`.
`individual` names the same body in all frames; a table of detections in any order calls the column
`instance`. The columns camera, individual (or instance) and score may be absent.

caliscope's xy.csv holds all cameras. Traps: keypoints have numbers instead of names; frames are
counted by the synchronisation index, which all cameras share; older files call the columns `port`
and `point_id` instead of `cam_id` and `keypoint_id`; points have no score.
"""

import csv
import io
import re
from collections.abc import Sequence

import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.detections import (
    MIXED,
    SCORES,
    SIZES,
    blank,
    check_cameras,
    frame_number,
    make_view,
)
from mocap_calib.io.document import Document
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.table import ROW_NUMBERS, read_table
from mocap_calib.types import Floats, Ints, Keypoints2D

_NEEDED = {"frame", "keypoint", "x", "y"}
_KNOWN = ("camera", "frame", "individual", "instance", "keypoint", "x", "y", "score")


# --- points


def views_of_points(
    document: Document,
    *,
    camera: Sequence[str],
    frame: Sequence[str],
    identity: Sequence[str],
    keypoint: Sequence[str],
    values: Floats,
    lines: Sequence[int],
    tracked: bool,
    remarks: tuple[str, ...] = (),
) -> tuple[Keypoints2D, ...]:
    """Return the cameras of a table with a row per point, in the order in which they appear.

    camera, keypoint: `[row]` names; an empty keypoint states only that the frame is there.
    frame: `[row]` text with the frame number.
    identity: `[row]` name of an individual (`tracked`), or number of an instance.
    values: `[row, 3]` x, y, score. lines: `[row]` line numbers in the file.

    Raises FormatError.
    """
    source, cells = document.source, np.array([frame, identity, keypoint], dtype=object)
    cameras, camera_of_row = _code(camera)
    check_cameras(cameras, source)
    views = []
    for k, name in enumerate(cameras):
        rows = np.flatnonzero(camera_of_row == k)
        (texts, frames), (names, identities), (keypoints, places) = map(_code, cells[:, rows])
        numbers, frame_of_text = np.unique(_frame_numbers(texts, source), return_inverse=True)
        instance_of_text = _instances(names, tracked=tracked, source=source)
        named = [text for text in keypoints if text]
        rank = np.cumsum([bool(text) for text in keypoints]) - 1
        is_point = np.array([bool(text) for text in keypoints])[places]
        at = (frame_of_text[frames], instance_of_text[identities], rank[places])
        at = tuple(each[is_point] for each in at)
        points = blank(len(numbers), int(instance_of_text.max()) + 1, len(named), source)
        flat, first = np.unique(np.ravel_multi_index(at, points.shape[:3]), return_inverse=True)
        if len(flat) < len(first):
            same = np.flatnonzero(first == np.argmax(np.bincount(first) > 1))
            row = same[0]
            which = f"frame {numbers[at[0][row]]}, individual {at[1][row]}, {named[at[2][row]]}"
            some = ", ".join(str(lines[row]) for row in rows[is_point][same[:3]])
            remedy = "remove the double rows, or tell individuals apart"
            found = f"{which} {len(same)} times, in rows {some}"
            raise FormatError(source, "each point once", found, remedy)
        points[at] = values[rows[is_point]]
        origin = Origin(name, source)
        views.append(make_view(origin, named, numbers, points, tracked=tracked, remarks=remarks))
    return tuple(views)


def _code(texts: Sequence[str]) -> tuple[list[str], Ints]:
    """Return the texts in the order in which they appear, and `[row]` indices of them."""
    code_of = {text: code for code, text in enumerate(dict.fromkeys(texts))}
    return list(code_of), np.array([code_of[text] for text in texts], dtype=np.int64)


def _frame_numbers(texts: list[str], source: str) -> Ints:
    """Return the `[text]` frame numbers. Raises FormatError."""
    numbers = [frame_number(text) for text in texts]
    if -1 in numbers:
        found = repr(texts[numbers.index(-1)])
        raise FormatError(source, "a frame number in each row", found, "correct the column")
    return np.array(numbers, dtype=np.int64)


def _instances(names: list[str], *, tracked: bool, source: str) -> Ints:
    """Return the `[name]` instance index of each name.

    That of an instance is its number. Individuals come by number where each name is a number of
    its own, else in the order in which they appear. Raises FormatError.
    """
    numbers = [int(name) if re.fullmatch("[0-9]{1,9}", name) else -1 for name in names]
    if tracked:
        all_differ = len({*numbers} - {-1}) == len(names)
        return np.unique(numbers, return_inverse=True)[1] if all_differ else np.arange(len(names))
    if -1 in numbers:
        expected, remedy = "whole numbers in the column instance", "call the column individual"
        raise FormatError(source, expected, repr(names[numbers.index(-1)]), remedy)
    return np.array(numbers, dtype=np.int64)


# --- the plain table


def sniff(document: Document) -> bool:
    """Return whether the header has three of the columns that are needed, or all of them.

    A table that lacks one is recognised so that `read` can name the column.
    """
    return len(_NEEDED & _headings(document)) >= len(_NEEDED) - 1


def _headings(document: Document) -> set[str]:
    """Return the headings in lower case, without that of a column of row numbers."""
    headings = {cell.casefold() for cell in document.header}
    return {heading for heading in headings if not ROW_NUMBERS.fullmatch(heading)}


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read each camera in the table; the file's camera where there is no column `camera`.

    Raises FormatError.
    """
    names, found = _headings(document), ",".join(document.header)
    if missing := [name for name in _KNOWN if name in _NEEDED - names]:
        expected = f"the columns {','.join(_KNOWN)}"
        raise document.refuse(f"a column {missing[0]} among {expected}", found, "add it")
    if "z" in names or {"individual", "instance"} <= names:
        among = "(individual or instance; camera, they and score may be absent)"
        expected = f"the columns {','.join(_KNOWN)} {among}"
        raise document.refuse(expected, found, "rename or remove columns")
    identity = "instance" if "instance" in names else "individual"
    table = read_table(
        document, texts=("camera", "frame", identity, "keypoint"), numbers=("x", "y", "score")
    )
    cameras = table.text("camera", document.camera)
    if "camera" in names and "" in cameras:
        remedy = "fill it, or remove the column"
        raise table.refuse(cameras.index(""), "the camera's name", "an empty cell", remedy)
    return views_of_points(
        document,
        camera=cameras,
        frame=table.text("frame"),
        identity=table.text(identity, "0"),
        keypoint=table.text("keypoint"),
        values=table.numbers,
        lines=table.lines,
        tracked=identity == "individual",
    )


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write all cameras into one table.

    The first frame has all individuals and keypoints, the others what there is; a frame without
    any point has one empty row.
    """
    identity = "individual" if all(view.tracked for view in views) else "instance"
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["camera", "frame", identity, "keypoint", "x", "y", "score"])
    for view in views:
        points = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
        is_there = np.isfinite(points[..., 0])
        for frame, number in enumerate(view.frames.tolist()):
            listed = np.argwhere(is_there[frame] | (frame == 0)).tolist()
            for individual, keypoint in listed:
                point = points[frame, individual, keypoint].tolist()
                cells = point if is_there[frame, individual, keypoint] else ("", "", "")
                name = view.keypoints[keypoint]
                writer.writerow([view.camera, number, individual, name, *cells])
            if not listed:
                writer.writerow([view.camera, number, 0, "", "", "", ""])
    return {"keypoints.csv": text.getvalue().encode()}


PLAIN = Format(
    name="csv",
    title="csv with a row per point (camera,frame,individual,keypoint,x,y,score)",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".csv",),
    loses=(MIXED, SIZES, SCORES),
)


# --- caliscope


def sniff_caliscope(document: Document) -> bool:
    """Return whether the header has the synchronisation index and image positions."""
    return {"sync_index", "img_loc_x", "img_loc_y"} <= set(document.header)


def read_caliscope(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras of the table; keypoints are called as the layout says, else by number.

    Raises FormatError.
    """
    header = document.header
    camera = next((name for name in ("cam_id", "port") if name in header), "")
    keypoint = next((name for name in ("keypoint_id", "point_id") if name in header), "")
    if not camera or not keypoint:
        expected = "the columns cam_id (or port) and keypoint_id (or point_id)"
        raise document.refuse(expected, ",".join(header), "export it from caliscope again")
    table = read_table(
        document,
        texts=(camera, "sync_index", "object_id", keypoint),
        numbers=("img_loc_x", "img_loc_y", "score"),
    )
    keypoints = table.text(keypoint)
    names = {str(number): name for number, name in enumerate(options.layout)}
    for number in dict.fromkeys(keypoints) if names else ():
        if number not in names:
            expected = f"a number of a keypoint below {len(names)}, as many as the layout has"
            remedy = f"give {argument('layout')} with more names, or leave it out"
            raise table.refuse(keypoints.index(number), expected, number, remedy)
    keypoints = tuple(names.get(number, number) for number in keypoints)
    return views_of_points(
        document,
        camera=table.text(camera),
        frame=table.text("sync_index"),
        identity=table.text("object_id", "0"),
        keypoint=keypoints,
        values=table.numbers,
        lines=table.lines,
        tracked=True,
    )


CALISCOPE = Format(
    name="caliscope",
    title="caliscope .csv",
    sniff=sniff_caliscope,
    read=read_caliscope,
    passed_over=("obj_loc_x", "obj_loc_y", "obj_loc_z", "frame_index", "frame_time"),
)
