"""Numbers in HDF5 files."""

import h5py
import numpy as np
import pytest

from mocap_calib.errors import FormatError
from mocap_calib.io.hdf5 import integers


@pytest.mark.parametrize("kind", [np.int64, np.uint64])
def test_whole_numbers_are_read_where_64_bits_hold_each(tmp_path, kind):
    """Nanoseconds since 1970: a sum of six would not go into 64 bits with a sign."""
    times = 1_700_000_000_000_000_000 + np.arange(6)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = times.astype(kind)
        file["wrong"] = np.array([1, 2**63], dtype=np.uint64)
        file["halves"] = np.array([0.5, 1.0])
        np.testing.assert_array_equal(integers(file, "time", "a.h5"), times)
        for name in ("wrong", "halves"):
            with pytest.raises(FormatError, match=f"whole numbers in `{name}`"):
                integers(file, name, "a.h5")
