"""What the HDF5 readers share: text, arrays of a size that memory holds, and damage said in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import FormatError
from mocap_calib.io.file import MOST_POINTS, malformed
from mocap_calib.io.keypoints.document import HDF5_DAMAGE, Document
from mocap_calib.types import Ints

_MOST_UNPACKED = (
    100  # times as much as is stored; tracks of which a fiftieth is there take up to 60
)
_SMALL = 100_000_000  # bytes that any file may unpack to,
_MOST_EMPTY = 1_000_000_000  # and what deflate may have packed as tightly as it can: hundreds of tracks, nearly all of them missing points
_DEFLATE = 1032
_REMEDY = "the file is cut or damaged: export it again"


@contextmanager
def damage_refused(source: str, expected: str, remedy: str) -> Iterator[None]:
    """Turns what h5py and numpy raise on damaged files into a FormatError."""
    try:
        yield
    except FormatError:
        raise
    except HDF5_DAMAGE as error:
        raise malformed(
            source, expected, f"an error ({error or type(error).__name__})", remedy
        ) from None


def text(value: Any) -> str:
    """A string as HDF5 gives it: bytes, text, or an array of one of them."""
    if isinstance(value, np.ndarray):
        value = value.reshape(-1)[0] if value.size else ""
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def marked(document: Document, name: str) -> bool:
    """Whether anything at the top of an HDF5 file has the attribute; nothing in other files has. Raises FormatError."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        return document.hdf5 is not None and any(
            name in item.attrs for item in document.hdf5.values()
        )


def keys(document: Document) -> set[str]:
    """The names of what lies at the top of an HDF5 file; nothing for other files."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        return set() if document.hdf5 is None else set(map(text, document.hdf5))


def array(group: Any, name: str, source: str) -> NDArray[Any]:
    """A dataset of a size that memory holds. Raises FormatError where there is none, and what h5py raises on damage."""
    dataset = group.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise malformed(source, f"a dataset `{name}`", "none", "export it again")
    _check_size(dataset, source)
    return np.asarray(dataset[...])


def _check_size(dataset: Any, source: str) -> None:
    """Refuses a dataset that unpacks to far more than it has in the file: deflate packs 1032 bytes of nothing into one, and some are only claimed."""
    claimed, stored = (dataset.size or 0) * dataset.dtype.itemsize, dataset.id.get_storage_size()
    most = max(_MOST_UNPACKED * stored + _SMALL, min(_DEFLATE * stored, _MOST_EMPTY))
    if claimed > most or (dataset.size or 0) > 4 * MOST_POINTS:
        expected = (
            f"at most {most / 1e6:.0f} MB of `{dataset.name}` in the {stored / 1e6:.1f} MB stored"
        )
        raise malformed(
            source,
            expected,
            f"{claimed / 1e6:.0f} MB",
            "the file is damaged, or nearly all of it is missing points: export it with fewer tracks",
        )


def integers(group: Any, name: str, source: str) -> Ints:
    """A dataset of whole numbers. Raises FormatError."""
    values = array(group, name, source)
    if values.dtype.kind not in "iu" or (
        values.size and int(values.max()) > np.iinfo(np.int64).max
    ):
        raise malformed(source, f"whole numbers in `{name}`", values.dtype, "export it again")
    return values.astype(np.int64)


def names(group: Any, name: str, source: str) -> tuple[str, ...]:
    """A list of names."""
    return tuple(text(entry) for entry in array(group, name, source).reshape(-1))


def require_filters(group: Any, source: str, remedy: str) -> None:
    """Refuses blosc, with which PyTables can compress and which h5py does not have, and sizes beyond reason. Raises FormatError."""
    for dataset in (item for item in group.values() if isinstance(item, h5py.Dataset)):
        _check_size(dataset, source)
        layout = dataset.id.get_create_plist()
        for number, _, _, name in map(layout.get_filter, range(layout.get_nfilters())):
            if not h5py.h5z.filter_avail(number):
                raise malformed(
                    source,
                    "compression that HDF5 has itself",
                    f"filter {number} ({text(name) or 'blosc?'})",
                    remedy,
                )
