"""Arrays of long recordings: on disk as far as memory is wanted for other things.

Arrays with an element per frame are the only ones that grow with a recording. The large ones lie
in temporary files (without a name, in the folder that TMPDIR says) that are mapped into memory:
they are numpy's arrays, for all to use as any other. What goes through them in blocks of frames
and lets go of the pages after each needs no more memory than a block for each thread, however long
the recording.
"""

import mmap
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from math import prod
from threading import Lock
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mocap_calib.compute.parallel import map_in_threads

_LARGE = 1 << 24  # bytes; smaller arrays stay in memory
_ENOUGH = 10_000  # frames that tell what is usual
_BLOCK = 4096  # frames at a time,
_FAR = 32  # where they are far from each other: the system brings in much around each

_maps: WeakSet[mmap.mmap] = WeakSet()
_maps_lock = Lock()  # threads make arrays while others let go of them


def empty(shape: Sequence[int], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return an array to be filled; a large one lies on disk, where there is room for it.

    Under Linux alone: other systems do not say beforehand whether there is room.
    """
    kind = np.dtype(dtype)
    size = prod(shape) * kind.itemsize
    if size < _LARGE or not hasattr(os, "posix_fallocate"):
        return np.empty(shape, kind)
    try:
        with tempfile.TemporaryFile() as file:
            os.posix_fallocate(file.fileno(), 0, size)  # else a full disk would end the program
            mapped = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, kind)
    with _maps_lock:
        _maps.add(mapped)
    return np.frombuffer(mapped, kind).reshape(shape)


def in_blocks(function: Callable[[slice], Any], frames: int, *, axis: int = 0) -> NDArray[Any]:
    """Return what a function makes of blocks of frames, on threads, as `empty` does.

    function: of a slice of frames; what it returns has these along an axis.
    """
    blocks = list(frame_slices(frames))
    if len(blocks) <= 1:
        return np.asarray(function(slice(0, frames)))
    before: tuple[Any, ...] = (slice(None),) * axis
    first = np.asarray(function(blocks[0]))
    shape = list(first.shape)
    shape[axis] = frames
    found = empty(shape, first.dtype)
    found[(*before, blocks[0])] = first

    def fill(block: slice) -> None:
        found[(*before, block)] = function(block)

    for _ in map_in_threads(fill, blocks[1:]):
        let_go()
    return found


def take(array: NDArray[Any], frames: Any, *, axis: int = 0) -> NDArray[Any]:
    """Return an array with some of its frames (indices, a mask or a slice) along an axis alone.

    A few at a time: each lies in as many places as there are entries of the axes before.
    """
    before: tuple[Any, ...] = (slice(None),) * axis
    index = np.asarray(frames) if not isinstance(frames, slice) else None
    if index is None or index.dtype == np.bool_ or array.nbytes < _LARGE:
        return array[(*before, frames)]
    shape = (*array.shape[:axis], len(index), *array.shape[axis + 1 :])
    found = empty(shape, array.dtype)
    for rows in frame_slices(len(index), max(1, _FAR // prod(array.shape[:axis]))):
        found[(*before, rows)] = array[(*before, index[rows])]
    return found


def as_slice(frames: Any) -> Any:
    """Return indices that follow each other as a slice, which copies nothing; others as given."""
    if isinstance(frames, slice):
        return frames
    index = np.asarray(frames)
    are_indices = index.dtype != np.bool_ and index.ndim == 1 and len(index) > 0
    if not are_indices or index[0] < 0 or (np.diff(index) != 1).any():
        return frames
    return slice(int(index[0]), int(index[-1]) + 1)


def some_frames(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array with at most 10,000 of its frames, evenly spread.

    Medians and other percentiles need no more.
    """
    return array[:: max(1, -(-len(array) // _ENOUGH))]


def frame_slices(frames: int, size: int = _BLOCK) -> Iterator[slice]:
    """Yield slices of so many frames, and let go of what was used after each."""
    for start in range(0, frames, size):
        yield slice(start, min(start + size, frames))
        let_go()


def let_go() -> None:
    """Give back the memory of all arrays that lie on disk, until they are used again.

    What they hold stays. It costs some microseconds for each.
    """
    if hasattr(mmap, "MADV_DONTNEED"):
        with _maps_lock:
            maps = list(_maps)
        for mapped in maps:
            mapped.madvise(mmap.MADV_DONTNEED)
