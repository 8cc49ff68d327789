"""caliscope's xy.csv: all cameras in one table, keypoints by number, frames by synchronisation index."""

import numpy as np

from mocap_calib.io.file import malformed
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.long_table import Points, cells_of, views_of
from mocap_calib.types import Keypoints2D


def sniff(document: Document) -> bool:
    """A header with synchronisation index and image positions."""
    return {"sync_index", "img_loc_x", "img_loc_y"} <= set(document.header)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The cameras (`cam_id`, or `port` of older files). Keypoints are called by their numbers, or as the layout says. Raises FormatError."""
    header, source = item.document.header, item.origin.source
    camera = next((name for name in ("cam_id", "port") if name in header), None)
    keypoint = next((name for name in ("keypoint_id", "point_id") if name in header), None)
    if camera is None or keypoint is None:
        raise malformed(
            source,
            "the columns cam_id (or port) and keypoint_id (or point_id)",
            ",".join(header),
            "export it from caliscope again",
        )
    cells = cells_of(item)
    names = cells.columns[keypoint]
    if options.layout:
        known = {str(k): name for k, name in enumerate(options.layout)}
        beyond = next((k for k, name in enumerate(names) if name not in known), None)
        if beyond is not None:
            expected = f"a number of a keypoint below {len(known)}, as many as the layout has"
            raise malformed(
                cells.place(beyond),
                expected,
                names[beyond],
                "give --layout with more names, or leave it out",
            )
        names = tuple(map(known.__getitem__, names))
    values = np.column_stack(
        [cells.numbers("img_loc_x"), cells.numbers("img_loc_y"), np.full(len(cells), np.nan)]
    )
    who = cells.columns.get("object_id", ("0",) * len(cells))
    return views_of(
        Points(cells.columns[camera], cells.columns["sync_index"], who, names, values, cells.lines),
        item,
        tracked=True,
    )
