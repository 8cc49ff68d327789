"""The classic filters, on motions whose filtered form is known."""

import numpy as np
import pytest

from mocap_calib.config import FilterConfig
from mocap_calib.errors import MismatchError
from mocap_calib.io.poses.common import bare_poses
from mocap_calib.poses.filters import filter_poses


def wave(hertz: float, fps: float = 100.0, frames: int = 1000) -> np.ndarray:
    """`[frame, 1, 1, 3]` a joint that swings."""
    swing = np.sin(2 * np.pi * hertz * np.arange(frames) / fps)
    return np.repeat(swing[:, None, None, None], 3, axis=-1)


def filtered(positions: np.ndarray, config: FilterConfig, fps: float | None = 100.0) -> np.ndarray:
    frames = np.arange(len(positions))
    poses = bare_poses(("joint",), frames, positions, unit="m")
    return filter_poses(poses, config, fps=fps).positions


@pytest.mark.parametrize(("hertz", "gain"), [(1.0, 1.0), (6.0, 0.7071), (30.0, 0.0)])
def test_butterworth_has_its_cutoff_and_no_delay(hertz, gain):
    found = filtered(wave(hertz), FilterConfig(order=4, cutoff=6.0))
    middle = slice(200, 800)
    assert np.allclose(found[middle], gain * wave(hertz)[middle], atol=2e-3)


def test_savgol_keeps_a_polynomial_and_median_drops_a_spike():
    time = np.linspace(-1, 1, 50)
    cubic = np.repeat((time**3 - time)[:, None, None, None], 3, axis=-1)
    assert np.allclose(filtered(cubic, FilterConfig(method="savgol")), cubic)
    spiky = cubic.copy()
    spiky[20] += 5
    assert np.abs(filtered(spiky, FilterConfig(method="median")) - cubic).max() < 0.2


def test_nothing_passes_a_gap():
    positions = wave(1.0)
    positions[400:410] = np.nan
    positions[410:] += 100
    found = filtered(positions, FilterConfig())
    assert (np.isnan(found) == np.isnan(positions)).all()
    assert np.nanmax(np.abs(found - positions)) < 0.1


def test_a_piece_shorter_than_the_filter_stays():
    positions = wave(1.0, frames=5)
    assert np.array_equal(filtered(positions, FilterConfig()), positions)


@pytest.mark.parametrize(
    ("config", "fps", "says"),
    [
        (FilterConfig(), None, "give --fps"),
        (FilterConfig(cutoff=60.0), 100.0, "below 50 Hz"),
        (FilterConfig(method="savgol", window=3), None, "longer window"),
    ],
)
def test_a_filter_that_cannot_be_is_refused(config, fps, says):
    with pytest.raises(MismatchError, match=says):
        filtered(wave(1.0), config, fps)
