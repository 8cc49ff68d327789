"""sleap-io reads our analysis .h5, and mocap_calib reads what sleap-io makes of it.

That is a project (.slp), and analysis files with the axes in three orders.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import sleap_io
from expected import EXPECTED, FILES, near

sys.path.append(
    str(Path(__file__).parents[3])
)  # mocap_calib's readers need no more than what is installed here

from mocap_calib.io.keypoints import read_keypoints

ORDERS = {
    "matlab": {"preset": "matlab"},
    "standard": {"preset": "standard"},
    "custom": {"node_dim": 0, "xy_dim": 1, "frame_dim": 2, "track_dim": 3},
}
SINGLE = 1e-4  # pixels: sleap-io keeps 32 bits


def read_back(path: Path, positions: np.ndarray, followed: bool) -> None:
    """Read a file of sleap-io; a mistake where it does not hold the positions."""
    (view,) = read_keypoints([path])
    assert view.keypoints == tuple(EXPECTED["keypoints"])
    assert view.tracked == followed, f"{path.name}: tracked {view.tracked}"
    near(f"read from its {path.suffixes[-1]}", view.positions, positions, SINGLE)


for camera, values in EXPECTED["detections"].items():
    positions = np.array(values)
    positions[positions == -99.0] = np.nan
    labels = sleap_io.load_analysis_h5(FILES / "sleap" / f"{camera}.analysis.h5")
    name = "track" if camera == "tracked" else "untracked"
    assert [track.name for track in labels.tracks] == [f"{name}_0", f"{name}_1"]
    near(f"sleap-io {version('sleap-io')} (px, {camera})", labels.numpy(), positions, SINGLE)
    project = FILES / "sleap" / f"{camera}.slp"
    sleap_io.save_slp(labels, str(project))
    read_back(project, positions, True)
    for order, arguments in ORDERS.items():
        path = FILES / "sleap" / f"{camera}.{order}.h5"
        sleap_io.save_analysis_h5(labels, str(path), **arguments)
        read_back(path, positions, camera == "tracked")
