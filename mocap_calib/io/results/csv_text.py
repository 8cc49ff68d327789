"""What the writers of CSV share: lines, and frames in pieces."""

import csv
import io
from collections.abc import Iterator, Sequence

from mocap_calib import mapped

_PIECE = 4096  # frames: Python's numbers take four times the room of numpy's


def format_csv_line(cells: Sequence[str]) -> str:
    """Return a line of CSV, quoted where it needs to be."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def slice_frames(frames: int) -> Iterator[slice]:
    """Yield slices of so many frames that are written in one go."""
    return mapped.frame_slices(frames, _PIECE)
