"""matches.csv: identities, a row per detection."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.errors import FormatError, MismatchError, one_line
from mocap_calib.io.document import Document, as_document
from mocap_calib.io.table import format_csv_line, format_lines, read_rows, slice_frames
from mocap_calib.recording.epochs import own_name
from mocap_calib.recording.names import compose_name
from mocap_calib.results import NO_FRAME, Clocks, Matches
from mocap_calib.types import Bools, Ints, Reals, Recording

_COLUMNS = ["camera", "frame", "instance", "individual"]
_REMEDY = "give the file that `match` or `run` wrote"
_WRONG_RECORDING = "give the matches of this recording"


def matches_csv(
    recording: Recording, matches: Matches, clocks: Clocks | None = None
) -> Iterator[bytes]:
    """Yield CSV in pieces of UTF-8, with a row per detection.

    Columns: the camera's own name, the frame number in its own file, the instance (order in the
    file), and the individual (-1 = nobody).

    clocks: by which the recording was put on one clock, None where it is as the files have it.
    """
    yield format_csv_line(_COLUMNS).encode()
    columns = len(_COLUMNS) * recording.positions.shape[2]
    for view, name in enumerate(recording.names):
        camera = format_csv_line([own_name(name, recording.names)]).rstrip("\n")
        numbers = recording.frames if clocks is None else clocks.numbers(name)
        positions, labels = recording.positions[view], matches.labels[view]
        lines = partial(_detections, f"{camera},", positions, labels, numbers)
        yield from map_in_threads(lines, slice_frames(len(recording.frames), columns))


def _detections(first: str, positions: Reals, labels: Ints, numbers: Ints, piece: slice) -> bytes:
    """Return the lines of a view's detections in a piece of its frames.

    first: what each begins with. positions: `[frame, instance, keypoint, 2]`. labels: `[frame,
    instance]`. numbers: `[frame]` of the frames.
    """
    frame, instance = np.nonzero(np.isfinite(positions[piece, ..., 0]).any(axis=-1))
    whole = [numbers[piece][frame], instance, labels[piece][frame, instance]]
    return format_lines(first, np.empty((len(frame), 0)), "", np.stack(whole, axis=-1))


def read_matches_csv(
    given: Path | str, recording: Recording, clocks: Clocks | None = None
) -> Matches:
    """Return the matches in a file or a text, as `matches_csv` writes them.

    clocks: as of `matches_csv`; rows of frames that a camera does not show on the common clock are
        left out.

    A detection that has no row is nobody's. Raises FormatError for bad content and MismatchError
    for a camera, frame or instance that the recording lacks.
    """
    document = as_document(given if isinstance(given, Path) else given.encode())
    source = document.source
    cameras, rows = parse_matches(document)
    if clocks is not None:
        cameras, rows = _on_common_clock(cameras, rows, clocks)
    detections = _find_detections(cameras, rows[:, :2], recording, source)
    individual = rows[:, 2]
    in_frame = np.column_stack([detections[:, :2], individual])[individual >= 0]
    for each, what in (
        (detections, "each detection once"),
        (in_frame, "each individual once per camera and frame"),
    ):
        if len(np.unique(each, axis=0)) != len(each):
            raise FormatError(source, what, "one of them twice", "remove one of the rows")
    labels = np.full(recording.positions.shape[:3], -1, dtype=np.int64)
    labels[tuple(detections.T)] = individual
    return Matches(labels)


def parse_matches(document: Document) -> tuple[list[str], Ints]:
    """Return camera names, and `[row, 3]` frame, instance, individual. Raises FormatError."""
    _, header = next(rows := read_rows(document), (0, ["an empty file"]))
    if header != _COLUMNS:
        expected = f"the columns {','.join(_COLUMNS)}"
        raise document.refuse(expected, ",".join(header), _REMEDY)
    cells = [cells for _, cells in rows]
    try:
        numbers = np.array([list(map(int, row[1:])) for row in cells], dtype=np.int64)
        found = numbers.reshape(len(cells), 3)
    except (ValueError, OverflowError) as error:
        expected = "three whole numbers after the camera in each row"
        raise document.refuse(expected, f"an error ({one_line(error)})", _REMEDY) from None
    if len(found) and not -1 <= found[:, 2].min() <= found[:, 2].max() < len(found):
        raise document.refuse("individuals counted from 0, -1 = nobody", "others", _REMEDY)
    return [compose_name(row[0]) for row in cells], found


def _on_common_clock(cameras: list[str], rows: Ints, clocks: Clocks) -> tuple[list[str], Ints]:
    """Return the rows with frame numbers of the common clock, of what is shown on it.

    cameras: `[row]` names; rows: `[row, 3]` frame, instance, individual.
    """
    numbered = rows.copy()
    kept = np.ones(len(rows), dtype=bool)
    names = np.array(cameras)
    for clock in clocks.cameras:
        own = clocks.numbers(clock.camera)
        shown = np.flatnonzero(own != NO_FRAME)
        of_camera = np.flatnonzero(names == clock.camera)
        if not len(shown) or not len(of_camera):
            continue
        place = np.searchsorted(own[shown], rows[of_camera, 0]).clip(max=len(shown) - 1)
        kept[of_camera] = own[shown[place]] == rows[of_camera, 0]
        numbered[of_camera, 0] = clocks.frames[shown[place]]
    return [cameras[row] for row in np.flatnonzero(kept)], numbered[kept]


def _find_detections(cameras: list[str], rows: Ints, recording: Recording, source: str) -> Ints:
    """Return `[row, 3]` indices (view, frame, instance) of rows (frame number, instance).

    rows: `[row, 2]`, of the cameras of these names.

    Raises MismatchError where the recording has no such detection.
    """
    index = {name: view for view, name in enumerate(recording.names)}
    strangers = ", ".join(sorted({*cameras} - {*index}))
    if strangers:
        expected = f"the cameras {', '.join(recording.names)}"
        raise MismatchError(source, expected, strangers, _WRONG_RECORDING)
    view = np.array([index[name] for name in cameras], dtype=np.int64)
    frame = np.searchsorted(recording.frames, rows[:, 0]).clip(max=len(recording.frames) - 1)
    instance = rows[:, 1].clip(0, recording.positions.shape[2] - 1)
    positions = recording.positions[view, frame, instance]
    detected: Bools = np.isfinite(positions[..., 0]).any(axis=-1)
    known = (recording.frames[frame] == rows[:, 0]) & (instance == rows[:, 1]) & detected
    if not known.all():
        row = int(np.argmin(known))
        found = f"camera {cameras[row]} frame {rows[row, 0]} instance {rows[row, 1]}"
        where = f"{source}: row {row + 2}"
        raise MismatchError(where, "detections of the recording", found, _WRONG_RECORDING)
    return np.column_stack([view, frame, instance])
