"""Pose2Sim: our Calib.toml by its own readers, and our TRC by its own."""

from importlib.metadata import version

import cv2
import numpy as np
from expected import EXPECTED, FILES, FRAMES, POINTS, POSITIONS, near, pixels
from Pose2Sim.common import computeP, read_trc, retrieve_calib_params

path = FILES / "pose2sim.toml"
params = retrieve_calib_params(path)
each = zip(params["R"], params["T"], params["K"], params["dist"], strict=True)
found = [
    cv2.projectPoints(POINTS, rotation, translation, matrix, lens)[0][:, 0]
    for rotation, translation, matrix, lens in each
]
near(f"Pose2Sim {version('pose2sim')} Calib.toml (px)", found, list(pixels().values()), 1e-6)
assert len(computeP(path, undistort=True)) == 3
coordinates, _, _, markers, _ = read_trc(str(FILES / "poses-trc_0.trc"))
assert list(markers) == EXPECTED["keypoints"], markers
near(
    "its TRC reader (m)",
    np.asarray(coordinates).reshape(len(FRAMES), -1, 3),
    POSITIONS[:, 0],
    1e-12,
)
