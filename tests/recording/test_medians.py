"""Medians of rows with gaps are numpy's."""

import numpy as np

from mocap_calib.recording.sampling import known_medians


def test_medians_of_rows_with_gaps_are_those_of_numpy():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(40, 31))
    rows[rng.random(rows.shape) < 0.5] = np.nan
    rows[:, 0] = rng.normal(size=40)  # no row has nothing
    rows[0, 1:] = np.nan
    before = rows.copy()
    assert np.array_equal(known_medians(rows), np.nanmedian(rows, axis=1))
    assert np.array_equal(rows, before, equal_nan=True)
