"""What the HDF5 readers share: text, arrays that fit into memory, and damage said in one line."""

import io
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.account import Account
from mocap_calib.io.file import MOST_POINTS
from mocap_calib.types import Ints

if TYPE_CHECKING:
    import h5py

    from mocap_calib.io.document import Document

# what h5py, numpy, zipfile and c3d raise on files that are cut or damaged, or packed by a filter
# that is not installed
DAMAGE = (
    OSError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    RuntimeError,
    ArithmeticError,
    MemoryError,
    EOFError,
    AssertionError,
    NameError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
HDF5 = b"\x89HDF\r\n\x1a\n"
DEFLATE = 1032  # times: as tightly as deflate packs

# how many bytes a dataset may unpack to: as many times what is stored (tracks of which a fiftieth
# is there take up to 60), and what any file may,
_MOST_UNPACKED = 100
_SMALL = 100_000_000
# or what deflate may have packed: hundreds of tracks, nearly all of them missing points
_MOST_EMPTY = 1_000_000_000
_CHUNK = 1 << 19  # bytes that are packed together
_REMEDY = "the file is cut or damaged: export it again"


@contextmanager
def damage_refused(
    source: str, expected: str, remedy: str = "write the file again"
) -> Iterator[None]:
    """Turn what is raised on files that are cut or damaged into a FormatError."""
    try:
        yield
    except DAMAGE as error:
        found = f"an error ({one_line(error) or type(error).__name__})"
        raise FormatError(source, expected, found, remedy) from None


def open_noted(source: Any, account: Account) -> "h5py.File":
    """Open an HDF5 file, a path or a stream, whose account notes the data sets at its top."""
    import h5py  # noqa: PLC0415 - a tenth of the time that reading any .csv takes

    class Noted(h5py.File):  # type: ignore[misc]
        """An open file that notes which names are asked for."""

        def __getitem__(self, name: Any) -> Any:
            account.asked.add(text(name))
            return super().__getitem__(name)

    file = Noted(source, "r", locking=False)
    with suppress(*DAMAGE):
        items = {text(name): h5py.Group.__getitem__(file, name) for name in file}
        account.add_names(name for name, item in items.items() if holds_numbers(item))
    return file


def holds_numbers(item: Any) -> bool:
    """Return whether this is a dataset of numbers."""
    return hasattr(item, "dtype") and item.dtype.kind in "fiub" and bool(item.size)


@contextmanager
def opened_hdf5(
    document: "Document", expected: str, remedy: str = "write the file again"
) -> Iterator["h5py.File"]:
    """Open an HDF5 file, and turn what is raised on damage into a FormatError."""
    with damage_refused(document.source, expected, remedy):
        if document.hdf5 is None:
            raise document.refuse(expected, document.describe()[0], remedy)
        yield document.hdf5


@contextmanager
def created_hdf5(path: Path) -> Iterator["h5py.File"]:
    """Create an HDF5 file to fill. Raises OSError where the disk is full."""
    import h5py  # noqa: PLC0415 - as in document.py

    with _Sink(path) as sink:
        try:
            with h5py.File(sink, "w") as file:
                file.sink = sink
                yield file
        except OSError:
            if sink.failure is None:
                raise
        if sink.failure is not None:
            raise sink.failure


class _Sink(io.FileIO):
    """A file that takes all that HDF5 writes: HDF5 crashes where it cannot close its file.

    failure: of the system, None where all was written. held: what came after it, with its place:
        HDF5 reads it again.
    """

    failure: OSError | None = None

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.held: list[tuple[int, bytes]] = []

    def write(self, data: Any) -> int:
        """Write all of the data, or hold it."""
        place, left = self.tell(), memoryview(data)
        try:
            while left and self.failure is None:
                left = left[super().write(left) :]
        except OSError as error:
            self.failure = error
        if self.failure is not None:
            self.held.append((place, bytes(data)))
        return len(data)

    def readinto(self, buffer: Any) -> int:
        """Read what was written, also what is held."""
        place, view = self.tell(), memoryview(buffer)
        read = super().readinto(view)
        for start, piece in self.held:
            first, last = max(start, place), min(start + len(piece), place + len(view))
            if first < last:
                view[first - place : last - place] = piece[first - start : last - start]
                read = max(read, last - place)
        return read

    def truncate(self, size: int | None = None) -> int:
        """Change the size, unless the file is lost."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


def text(value: Any) -> str:
    """Return a string as HDF5 gives it: bytes, text, or an array of one of them."""
    if isinstance(value, np.ndarray):
        value = value.reshape(-1)[0] if value.size else ""
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def has_attribute(document: "Document", name: str) -> bool:
    """Return whether anything at the top of an HDF5 file has the attribute; False for other files.

    Raises FormatError.
    """
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        if document.hdf5 is None:
            return False
        return any(name in item.attrs for item in document.hdf5.values())


def keys(document: "Document") -> set[str]:
    """Return the names of what lies at the top of an HDF5 file; nothing for other files."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        return set() if document.hdf5 is None else set(map(text, document.hdf5))


def array(group: Any, name: str, source: str) -> NDArray[Any]:
    """Return a dataset `[...]` of a size that memory holds.

    Raises FormatError where there is none, and what h5py raises on damage.
    """
    import h5py  # noqa: PLC0415 - as in document.py

    dataset = group[name] if name in group else None  # noqa: SIM401 - `get` is not noted
    if not isinstance(dataset, h5py.Dataset):
        raise FormatError(source, f"a dataset `{name}`", "none", "export it again")
    _check_size(dataset, source)
    return np.asarray(dataset[...])


def integers(group: Any, name: str, source: str) -> Ints:
    """Return a dataset `[...]` of whole numbers. Raises FormatError."""
    values = array(group, name, source)
    whole = values.dtype.kind in "iu"
    if not whole or (values.size and int(values.max()) > np.iinfo(np.int64).max):
        raise FormatError(source, f"whole numbers in `{name}`", values.dtype, "export it again")
    return values.astype(np.int64)


def names(group: Any, name: str, source: str) -> tuple[str, ...]:
    """Return a dataset of names. Raises as `array` does."""
    return tuple(text(entry) for entry in array(group, name, source).reshape(-1))


def names_if_there(group: Any, name: str, source: str) -> tuple[str, ...]:
    """Return a dataset of names, none where there is no such dataset. Raises as `array` does."""
    return names(group, name, source) if name in group else ()


def write_names(group: Any, name: str, values: Iterable[str]) -> None:
    """Write a dataset of names, without the time."""
    import h5py  # noqa: PLC0415 - as in document.py

    texts = np.array(tuple(values), dtype=object)
    group.create_dataset(name, data=texts, dtype=h5py.string_dtype(), track_times=False)


def write_packed(file: "h5py.File", name: str, array: NDArray[Any]) -> None:
    """Write an array `[frame, ...]` as a dataset that is packed, without the time.

    Raises OSError where the disk is full.
    """
    if not array.size:
        file.create_dataset(name, array.shape, array.dtype, track_times=False)
        return
    frames = max(1, min(len(array), _CHUNK // array[:1].nbytes))
    dataset = file.create_dataset(
        name,
        array.shape,
        array.dtype,
        chunks=(frames, *array.shape[1:]),
        compression="gzip",
        shuffle=True,
        track_times=False,
    )
    sink = getattr(file, "sink", None)
    for block in mapped.frame_slices(len(array), frames):
        dataset[block] = array[block]
        if sink is not None and sink.failure is not None:
            raise sink.failure


def require_filters(group: Any, source: str, remedy: str) -> None:
    """Raise FormatError for blosc and the like, and for sizes beyond reason.

    PyTables can compress with blosc, which h5py does not have.
    """
    import h5py  # noqa: PLC0415 - as in document.py

    for dataset in (item for item in group.values() if isinstance(item, h5py.Dataset)):
        _check_size(dataset, source)
        layout = dataset.id.get_create_plist()
        for index in range(layout.get_nfilters()):
            number, _, _, name = layout.get_filter(index)
            if not h5py.h5z.filter_avail(number):
                found = f"filter {number} ({text(name) or 'blosc?'})"
                raise FormatError(source, "compression that HDF5 has itself", found, remedy)


def most_unpacked(stored: int) -> int:
    """Return how many bytes a part of a file may unpack to that takes this many there."""
    return max(_MOST_UNPACKED * stored + _SMALL, min(DEFLATE * stored, _MOST_EMPTY))


def check_archive(content: bytes, source: str) -> None:
    """Raise FormatError for a zip archive whose parts unpack to far more than they take in it."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for part in archive.infolist():
            _check_unpacked(part.filename, part.compress_size, part.file_size, source)


def _check_size(dataset: Any, source: str) -> None:
    """Raise FormatError for a dataset that unpacks to far more than it has in the file.

    Deflate packs 1032 bytes of nothing into one, and some sizes are only claimed.
    """
    entries = dataset.size or 0
    claimed = entries * dataset.dtype.itemsize
    stored = dataset.id.get_storage_size()
    if entries > 4 * MOST_POINTS:
        claimed = max(claimed, most_unpacked(stored) + 1)
    _check_unpacked(dataset.name, stored, claimed, source)


def _check_unpacked(name: str, stored: int, claimed: int, source: str) -> None:
    """Raise FormatError where so many bytes unpack to far more."""
    most = most_unpacked(stored)
    if claimed > most:
        raise FormatError(
            source,
            f"at most {most / 1e6:.0f} MB of `{name}` in the {stored / 1e6:.1f} MB stored",
            f"{claimed / 1e6:.0f} MB",
            "the file is damaged, or nearly all of it is missing points: "
            "export it with fewer tracks",
        )
