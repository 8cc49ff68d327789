"""The package c3d: our C3D."""

from importlib.metadata import version

import c3d
import numpy as np
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

with open(FILES / "poses-c3d.c3d", "rb") as handle:
    reader = c3d.Reader(handle)
    labels = [label.strip() for label in reader.point_labels]
    frames = list(reader.read_frames())
assert labels == [
    f"{who}:{what}" for who in EXPECTED["individuals"] for what in EXPECTED["keypoints"]
], labels
assert [number for number, _, _ in frames] == (FRAMES + 1).tolist()
assert reader.point_rate == EXPECTED["rate"]
points = np.stack([points for _, points, _ in frames])
near(
    f"c3d {version('c3d')} (mm)",
    np.where(points[..., 3:4] < 0, np.nan, points[..., :3]),
    POSITIONS.reshape(len(FRAMES), -1, 3) * 1000,
    2e-3,
)
