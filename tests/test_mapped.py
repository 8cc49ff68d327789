"""Long recordings: arrays on disk, worked on in blocks, hold what arrays in memory hold."""

import gc
import mmap
import os
from dataclasses import replace

import numpy as np
import pytest
from scenes import calibrate_group, recording

from mocap_calib import mapped
from mocap_calib.io.results.poses_h5 import parse_poses_h5, write_poses_h5
from mocap_calib.results import GroupResult, Poses3D

ON_DISK = hasattr(os, "posix_fallocate")


@pytest.fixture
def all_on_disk(monkeypatch):
    """Put every array on disk, and cut everything into blocks of 7 frames."""
    monkeypatch.setattr(mapped, "_LARGE", 1)
    monkeypatch.setattr(mapped, "_BLOCK", 7)
    monkeypatch.setattr(mapped, "_FAR", 3)
    monkeypatch.setattr(mapped.frame_slices, "__defaults__", (7,))


def is_mapped(array: np.ndarray) -> bool:
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, memoryview | mmap.mmap)


def assert_same(first: GroupResult, second: GroupResult) -> None:
    """All that was found is the same to the last bit, but for how long it took."""
    assert replace(first, seconds={}) == replace(second, seconds={})


@pytest.mark.slow
def test_a_recording_in_small_blocks_on_disk_gives_the_same_to_the_last_bit(request):
    seen = recording(people=1, frames=40, cameras=3)
    in_memory = calibrate_group(seen)
    request.getfixturevalue("all_on_disk")
    on_disk = calibrate_group(seen)
    assert_same(in_memory, on_disk)
    assert is_mapped(on_disk.poses.positions) == ON_DISK
    assert not is_mapped(in_memory.poses.positions)


@pytest.mark.usefixtures("all_on_disk")
def test_what_a_mapped_array_holds_stays_when_its_memory_is_given_back():
    array = mapped.empty((1000, 3))
    array[:] = np.arange(3000).reshape(1000, 3)
    half = array[500:]
    mapped.let_go()
    np.testing.assert_array_equal(array, np.arange(3000).reshape(1000, 3))
    del array
    gc.collect()
    mapped.let_go()
    np.testing.assert_array_equal(half, np.arange(1500, 3000).reshape(500, 3))


def test_what_is_usual_is_told_by_some_frames(monkeypatch):
    """Evenly spread, from the first on; all of a short recording."""
    monkeypatch.setattr(mapped, "_ENOUGH", 4)
    for frames, expected in ((0, []), (4, [0, 1, 2, 3]), (5, [0, 2, 4]), (12, [0, 3, 6, 9])):
        assert mapped.some_frames(np.arange(frames)).tolist() == expected


class OfFewPlaces(np.ndarray):
    """An array of pairs of numbers of which no more than 8 places may be read at a time."""

    def __getitem__(self, index):
        part = super().__getitem__(index)
        assert part.size <= 2 * 8
        return part


@pytest.mark.usefixtures("all_on_disk")
def test_far_frames_are_read_by_the_places_that_they_lie_in(monkeypatch):
    """Each view's lie in a place of their own, around which the system brings in much."""
    monkeypatch.setattr(mapped, "_FAR", 8)
    rng = np.random.default_rng(0)
    array, frames = rng.normal(size=(4, 50, 2)), rng.permutation(50)
    taken = mapped.take(array.view(OfFewPlaces), frames, axis=1)
    np.testing.assert_array_equal(taken, array[:, frames])


def test_frames_that_follow_each_other_are_a_slice():
    values = np.arange(10)
    for frames in ([3, 4, 5], [7], np.arange(10)):
        found = mapped.as_slice(frames)
        assert isinstance(found, slice)
        np.testing.assert_array_equal(values[found], values[frames])
    mask = values % 2 == 0
    for frames in ([], [0, 0], [-1, 0], [5, 4], [1, 3], mask, slice(2, 9, 3), [[1, 2], [3, 4]]):
        assert mapped.as_slice(frames) is frames


@pytest.mark.usefixtures("all_on_disk")
def test_blocks_and_far_frames_are_those_of_the_whole():
    rng = np.random.default_rng(0)
    array = rng.normal(size=(4, 50, 2))
    blocks = mapped.in_blocks(lambda block: 2 * array[:, block], 50, axis=1)
    np.testing.assert_array_equal(blocks, 2 * array)
    for frames in (rng.permutation(50)[:20], np.arange(50) % 3 == 0, slice(3, 40), [4, 4, 1]):
        np.testing.assert_array_equal(mapped.take(array, frames, axis=1), array[:, frames])
        np.testing.assert_array_equal(mapped.take(array[0], frames), array[0, frames])
    assert mapped.in_blocks(lambda block: array[:, block], 0, axis=1).shape == (4, 0, 2)


@pytest.mark.usefixtures("all_on_disk")
def test_arrays_stay_in_memory_where_the_disk_is_full(monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
    array = mapped.empty((5, 2))
    array[:] = 1.0
    assert not is_mapped(array)


def test_poses_written_a_few_rows_at_a_time_are_read_as_they_were(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2000, 1, 5, 3))
    number = np.ones(points.shape[:3])
    poses = Poses3D(
        keypoints=tuple("abcde"),
        frames=np.arange(2000),
        positions=points,
        error=number,
        views=2 * number.astype(np.int64),
        confidence=number,
        unit="m",
    )
    monkeypatch.setattr("mocap_calib.io.hdf5_packed._CHUNK", 1 << 12)
    write_poses_h5(tmp_path / "poses.h5", poses, {})
    assert parse_poses_h5((tmp_path / "poses.h5").read_bytes(), "poses.h5") == poses
