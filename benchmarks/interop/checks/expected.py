"""Say what must come out, for scripts in the consumers' environments, without mocap_calib."""

import json
import sys
from pathlib import Path

import numpy as np

FILES = Path(sys.argv[1])
EXPECTED = json.loads((FILES / "expected.json").read_text())
POINTS = np.array(EXPECTED["points"])
FRAMES = np.array(EXPECTED["frames"])
POSITIONS = np.array(EXPECTED["positions"])  # (frame, individual, keypoint, 3) metres
POSITIONS[POSITIONS == -99.0] = np.nan


def pixels(key: str = "pixels") -> dict[str, np.ndarray]:
    """Where each camera sees the points."""
    return dict(zip(EXPECTED["names"], map(np.array, EXPECTED[key]), strict=True))


def near(what: str, found: np.ndarray, expected: np.ndarray, most: float) -> None:
    """Return how far two arrays are apart.

    A mistake where they miss different points or are further apart than `most`.
    """
    found, expected = np.asarray(found, dtype=float), np.asarray(expected, dtype=float)
    assert found.shape == expected.shape, f"{what}: {found.shape} instead of {expected.shape}"
    assert (np.isnan(found) == np.isnan(expected)).all(), f"{what}: other points are missing"
    apart = np.nanmax(np.abs(found - expected))
    assert apart <= most, f"{what}: {apart} apart"
    print(f"{what}: {apart:.1e}")
