"""Read NWB by pynwb and ndx-pose, written here by mocap_calib with its extra."""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pynwb
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

sys.path.append(
    str(Path(__file__).parents[3])
)  # mocap_calib's writers need no more than what is installed here

from mocap_calib.io.pose_files import load_poses, write_poses

path = FILES / "poses.nwb"
write_poses(path, load_poses(FILES / "poses-poses-h5.h5"), "nwb-3d")
with pynwb.NWBHDF5IO(str(path), "r") as file:
    behavior = file.read().processing["behavior"]
    found = np.full(POSITIONS.shape, np.nan)
    for i, individual in enumerate(EXPECTED["individuals"]):
        for k, keypoint in enumerate(EXPECTED["keypoints"]):
            series = behavior[individual][keypoint]
            found[:, i, k] = series.data[:]
            assert series.unit == "m"
            assert np.allclose(series.timestamps[:], FRAMES / EXPECTED["rate"])
near(f"ndx-pose {version('ndx-pose')}, pynwb {version('pynwb')} (m)", found, POSITIONS, 0.0)
