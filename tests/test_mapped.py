"""Arrays of long recordings: on disk, worked on in blocks, they hold what arrays in memory hold."""

import gc
import mmap
import os

import numpy as np

from mocap_calib import mapped

ON_DISK = hasattr(os, "posix_fallocate")
LARGE = (1_000_000, 3)  # 24 MB as doubles


def is_mapped(array: np.ndarray) -> bool:
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, memoryview | mmap.mmap)


def test_what_a_large_array_holds_stays_when_its_memory_is_given_back():
    array = mapped.empty(LARGE)
    assert is_mapped(array) == ON_DISK
    assert not is_mapped(mapped.empty((1000, 3)))
    array[:] = np.arange(3_000_000).reshape(LARGE)
    half = array[500_000:]
    mapped.let_go()
    np.testing.assert_array_equal(array, np.arange(3_000_000).reshape(LARGE))
    del array
    gc.collect()
    mapped.let_go()
    np.testing.assert_array_equal(half, np.arange(1_500_000, 3_000_000).reshape(-1, 3))


def test_arrays_stay_in_memory_where_the_disk_is_full(monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
    array = mapped.empty(LARGE)
    array[:] = 1.0
    assert not is_mapped(array)


def test_what_is_usual_is_told_by_some_frames():
    """Evenly spread, from the first on; all of a short recording."""
    for frames, step in ((0, 1), (10_000, 1), (10_001, 2), (30_000, 3)):
        found = mapped.some_frames(np.arange(frames))
        np.testing.assert_array_equal(found, np.arange(0, frames, step))


def test_frames_that_follow_each_other_are_a_slice():
    values = np.arange(10)
    for frames in ([3, 4, 5], [7], np.arange(10)):
        found = mapped.as_slice(frames)
        assert isinstance(found, slice)
        np.testing.assert_array_equal(values[found], values[frames])
    mask = values % 2 == 0
    for frames in ([], [0, 0], [-1, 0], [5, 4], [1, 3], mask, slice(2, 9, 3), [[1, 2], [3, 4]]):
        assert mapped.as_slice(frames) is frames


def test_blocks_and_far_frames_are_those_of_the_whole():
    rng = np.random.default_rng(0)
    array = rng.normal(size=(4, 10_000, 2))
    blocks = mapped.in_blocks(lambda block: 2 * array[:, block], 10_000, axis=1)
    np.testing.assert_array_equal(blocks, 2 * array)
    for frames in (rng.permutation(10_000)[:5000], np.arange(10_000) % 3 == 0, [4, 4, 1]):
        np.testing.assert_array_equal(mapped.take(array, frames, axis=1), array[:, frames])
        np.testing.assert_array_equal(mapped.take(array[0], frames), array[0, frames])
    assert mapped.in_blocks(lambda block: array[:, block], 0, axis=1).shape == (4, 0, 2)
