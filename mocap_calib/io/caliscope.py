"""caliscope's xy.csv: all cameras in one table, keypoints by number, frames by synchronisation index."""

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document, Item, ReadOptions
from mocap_calib.io.long_table import Row, cells_of, number, views_of
from mocap_calib.io.reading import malformed
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
        raise malformed(source, "the columns cam_id (or port) and keypoint_id (or point_id)", ",".join(header), "export it from caliscope again")
    rows = []
    for place, cells in cells_of(item):
        name = _name(cells[keypoint], options.layout, place)
        x, y = number(cells["img_loc_x"], place), number(cells["img_loc_y"], place)
        rows.append(Row(cells[camera], cells["sync_index"], cells.get("object_id", "0"), name, x, y, float("nan")))
    return views_of(rows, item, tracked=True)


def _name(cell: str, layout: tuple[str, ...], place: str) -> str:
    if not layout:
        return cell
    if not cell.isascii() or not cell.isdigit() or len(cell) > 6 or int(cell) >= len(layout):
        raise _beyond(cell, layout, place)
    return layout[int(cell)]


def _beyond(cell: str, layout: tuple[str, ...], place: str) -> FormatError:
    return malformed(place, f"a number of a keypoint below {len(layout)}, as many as the layout has", cell, "give --layout with more names, or without")
