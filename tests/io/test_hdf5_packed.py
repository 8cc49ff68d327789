"""Datasets that are packed here are read by HDF5."""

import h5py
import numpy as np
import pytest

from mocap_calib.io.hdf5_packed import write_packed

RNG = np.random.default_rng(0)
TRACKS = np.where(RNG.random((70_000, 3, 1, 1)) < 0.5, np.nan, RNG.normal(size=(70_000, 3, 5, 3)))


@pytest.mark.parametrize(
    "array",
    [
        TRACKS,
        TRACKS.astype(np.float32)[..., 0],
        TRACKS[:7, 1:2],
        np.arange(200_000),
        np.arange(12, dtype=np.int8).reshape(4, 3),
        np.zeros((0, 2, 5)),
        np.zeros((3, 0, 5)),
    ],
    ids=["tracks", "single", "few", "one axis", "bytes", "no frame", "nobody"],
)
def test_packed_is_what_it_was(array, tmp_path):
    for name in ("a.h5", "b.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            write_packed(file, "array", array)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with h5py.File(tmp_path / "a.h5") as file:
        found = file["array"][()]
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)


@pytest.mark.parametrize("keypoints", [16, 17])
def test_missing_numbers_take_hardly_any_room(keypoints, tmp_path):
    array = np.full((20_000, 2, keypoints, 3), np.nan)
    array[:, 0] = RNG.normal(size=(20_000, keypoints, 3))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_packed(file, "array", array)
    assert (tmp_path / "a.h5").stat().st_size < 0.5 * array.nbytes


@pytest.mark.parametrize("keypoints", [15, 16, 17])
def test_a_keypoint_that_alone_is_seen_takes_its_own_room(keypoints, tmp_path):
    """Of the bytes of one plane after the other, its own lie at regular distances."""
    array = np.full((60_000, 1, keypoints), np.nan)
    array[..., 0] = RNG.normal(size=(60_000, 1))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_packed(file, "array", array)
    assert (tmp_path / "a.h5").stat().st_size < 0.16 * array.nbytes
