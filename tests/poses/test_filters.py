"""The classic filters, through the command, on motions whose filtered form is known."""

import numpy as np
import pytest

import mocap_calib as mc

FPS = 100.0


def wave(hertz: float, frames: int = 1000) -> np.ndarray:
    """`[frame, 3]` a joint that swings."""
    swing = np.sin(2 * np.pi * hertz * np.arange(frames) / FPS)
    return np.repeat(swing[:, None], 3, axis=1)


@pytest.fixture
def filtered(tool, tmp_path, given):
    """Filters points `[frame, 3]` of one joint by the command."""

    def run(points: np.ndarray, *words: object, frames: np.ndarray | None = None) -> np.ndarray:
        said = tool(*given(points, frames), *words)
        assert (said.returncode, said.stderr) == (0, "")
        found, before = (mc.read_poses(tmp_path / f"{name}.npz") for name in ("out", "given"))
        assert found.keypoints == before.keypoints
        np.testing.assert_array_equal(found.frames, before.frames)
        return found.positions[:, 0, 0]

    return run


@pytest.mark.parametrize(("hertz", "gain"), [(1.0, 1.0), (6.0, 0.7071), (30.0, 0.0)])
def test_butterworth_has_its_cutoff_and_no_delay(filtered, hertz, gain):
    found = filtered(wave(hertz), "--order", 4, "--cutoff", 6, "--fps", FPS)
    middle = slice(200, 800)
    assert np.allclose(found[middle], gain * wave(hertz)[middle], atol=2e-3)


def test_savgol_keeps_a_polynomial_and_median_drops_a_spike(filtered):
    time = np.linspace(-1, 1, 50)
    cubic = np.repeat((time**3 - time)[:, None], 3, axis=1)
    assert np.allclose(filtered(cubic, "--method", "savgol"), cubic)
    spiky = cubic.copy()
    spiky[20] += 5
    assert np.abs(filtered(spiky, "--method", "median") - cubic).max() < 0.2


@pytest.mark.parametrize("missing", [True, False])
def test_nothing_passes_a_gap(filtered, missing):
    """Of points that are missing, and of frames that are not there."""
    points, frames = wave(1.0), np.arange(1000)
    points[410:] += 100
    if missing:
        points[400:410] = np.nan
    else:
        points, frames = (
            np.delete(points, np.s_[400:410], axis=0),
            np.delete(frames, np.s_[400:410]),
        )
    found = filtered(points, "--fps", FPS, frames=frames)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(points))
    assert np.nanmax(np.abs(found - points)) < 0.1


def test_a_piece_shorter_than_the_filter_stays(filtered):
    points = wave(1.0, frames=5)
    np.testing.assert_array_equal(filtered(points, "--fps", FPS), points)


@pytest.mark.parametrize(
    "words",
    ["--cutoff 60 --fps 100", "--method savgol --window 3", "--method median --window 2001"],
)
def test_a_filter_that_cannot_be_is_refused_in_one_line(tool, tmp_path, given, words):
    said = tool(*given(wave(1.0, 50)), *words.split())
    assert (said.returncode, said.stderr.count("\n")) == (1, 1)
    assert "expected" in said.stderr
    assert not (tmp_path / "out.npz").exists()


@pytest.fixture
def given(tmp_path):
    """Writes points `[frame, 3]` of one joint; returns the words that filter them."""

    def write(points: np.ndarray, frames: np.ndarray | None = None) -> tuple[object, ...]:
        numbers = np.arange(len(points)) if frames is None else frames
        full = np.ones((len(points), 1, 1))
        poses = mc.Poses3D(["joint"], numbers, points[:, None, None], full, full, full, "m")
        mc.write(poses, tmp_path / "given.npz")
        return "filter", tmp_path / "given.npz", "-o", tmp_path / "out.npz"

    return write
