"""Read caliscope's xy.csv: a row per point, all cameras in one table.

Traps: keypoints have numbers instead of names; frames are counted by the synchronisation index,
which all cameras share; older files call the columns `port` and `point_id` instead of `cam_id` and
`keypoint_id`; points have no score.
"""

import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.long_table import Points, views_from_points
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.table_cells import Cells, read_cells
from mocap_calib.types import Keypoints2D


def sniff(document: Document) -> bool:
    """Return whether the header has the synchronisation index and image positions."""
    return {"sync_index", "img_loc_x", "img_loc_y"} <= set(document.header)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras of the table; keypoints are called as the layout says, else by number.

    Raises FormatError.
    """
    camera_column, keypoint_column = _find_columns(document)
    cells = read_cells(document)
    keypoints = cells.columns[keypoint_column]
    if options.layout:
        keypoints = _name_keypoints(keypoints, options.layout, cells)
    scores = np.full(len(cells), np.nan)
    points = Points(
        camera=cells.columns[camera_column],
        frame=cells.columns["sync_index"],
        identity=cells.columns.get("object_id", ("0",) * len(cells)),
        keypoint=keypoints,
        values=np.column_stack([cells.numbers("img_loc_x"), cells.numbers("img_loc_y"), scores]),
        lines=cells.lines,
    )
    return views_from_points(points, document, tracked=True)


def _find_columns(document: Document) -> tuple[str, str]:
    """Return the names of the columns of cameras and of keypoints. Raises FormatError."""
    header = document.header
    camera = next((name for name in ("cam_id", "port") if name in header), None)
    keypoint = next((name for name in ("keypoint_id", "point_id") if name in header), None)
    if camera is None or keypoint is None:
        raise FormatError(
            document.source,
            "the columns cam_id (or port) and keypoint_id (or point_id)",
            ",".join(header),
            "export it from caliscope again",
        )
    return camera, keypoint


def _name_keypoints(
    numbers: tuple[str, ...], layout: tuple[str, ...], cells: Cells
) -> tuple[str, ...]:
    """Return the layout's name for each row's number. Raises FormatError."""
    names = {str(number): name for number, name in enumerate(layout)}
    for row, number in enumerate(numbers):
        if number not in names:
            raise FormatError(
                cells.place(row),
                f"a number of a keypoint below {len(names)}, as many as the layout has",
                number,
                f"give {argument('layout')} with more names, or leave it out",
            )
    return tuple(names[number] for number in numbers)


FORMAT = Format(
    kind="keypoints",
    name="caliscope",
    title="caliscope .csv",
    sniff=sniff,
    read=read,
)
