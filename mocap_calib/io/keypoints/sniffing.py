"""Find out from the content which format a file has; HDF5 is looked at in another process."""

from dataclasses import replace

from mocap_calib.errors import FormatError
from mocap_calib.io.crash_guard import guard_hdf5
from mocap_calib.io.keypoints.document import Document, Item, describe
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS, KeypointFormat
from mocap_calib.io.registry import find_format, format_names


def sniff_item(item: Item, format: str | None) -> Item:
    """Return the item with the format that its content shows; as it is where that is known.

    It is left unknown for a damaged file, which is complained of when it is read.

    format: name of the only format to try; None: all of them.
    """
    if item.format is not None:
        return item
    document = item.document
    try:
        found = guard_hdf5(
            document.start, document.size, document.source, sniff_content, document, format
        )
    except FormatError:
        return item
    return replace(item, format=found)  # without the content: many items need not fit into memory


def shows_keypoints(item: Item) -> bool:
    """Return whether a sniffed item is of one of the formats, or of one that is damaged."""
    return item.format != ""


def shows_single_frame(item: Item) -> bool:
    """Return whether a sniffed item is of a format that has a file per frame."""
    if not item.format:
        return False
    return find_format(KEYPOINT_FORMATS, item.format).per_frame


def sniff_content(document: Document, format: str | None) -> str:
    """Return the name of the format that the content shows, "" where it shows none.

    Only `format` is tried where it is given. Raises FormatError where the content is damaged.
    """
    for each in KEYPOINT_FORMATS:
        if format in (None, each.name) and each.sniff(document):
            return each.name
    return ""


def require_format(item: Item, format: str | None) -> KeypointFormat:
    """Return the format of an item: what it is known to have, else what its content shows.

    format: name of the only format to try; None: all of them.

    Raises FormatError where the content is of no format, or not of the one that is named.
    """
    document = item.document
    name = sniff_content(document, format) if item.format is None else item.format
    if name:
        return find_format(KEYPOINT_FORMATS, name)
    found, remedy = describe(document)
    if format is not None:
        expected = find_format(KEYPOINT_FORMATS, format).title
        remedy = remedy or "name another format, or none"
    else:
        expected = f"one of: {', '.join(format_names(KEYPOINT_FORMATS))}"
        remedy = remedy or "export one of these (docs/formats.md)"
    raise FormatError(document.source, expected, found, remedy)
