"""pynwb and ndx-pose: they write the NWB here, through the code of the extra, and read it."""

import sys

sys.path = [path for path in sys.path if not path.endswith("consumers")] + [path for path in sys.path if path.endswith("consumers")]

from importlib.metadata import version

import ndx_pose  # noqa: F401 - its types
import numpy as np
import pynwb
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

with pynwb.NWBHDF5IO(str(FILES / "poses-nwb-3d.nwb"), "r") as file:
    behavior = file.read().processing["behavior"]
    found = np.full(POSITIONS.shape, np.nan)
    for i, individual in enumerate(EXPECTED["individuals"]):
        for k, keypoint in enumerate(EXPECTED["keypoints"]):
            series = behavior[individual][keypoint]
            found[:, i, k] = series.data[:]
            assert series.unit == "m"
            assert np.allclose(series.timestamps[:], FRAMES / EXPECTED["rate"])
near(f"ndx-pose {version('ndx-pose')}, pynwb {version('pynwb')} (m)", found, POSITIONS, 0.0)
