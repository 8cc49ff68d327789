"""Real recordings with reference calibrations, where they are at hand: the project's figures as a
regression test.

Judging reads truth and reference; no stage does (test_no_truth.py).
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scenes import PEOPLE, calibrate_group, precision, rotation_errors_deg

from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.read import read_cameras
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.types import CameraRig

RECORDINGS = Path(__file__).parents[2] / "shared" / "recordings"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not at hand"),
]

# name, bounds of median and largest rotation error (degrees), bound of the matching precision
FIGURES = [
    ("h36m_S1_walking", 0.35, 0.8, 1.0),
    ("h36m_S1_mix", 0.55, 1.0, 1.0),
    ("h36m_S6_mix", 0.55, 1.0, 1.0),
    ("h36m_S5_multi3", 0.5, 1.0, 0.98),
    ("shelf", 0.8, 1.6, 0.97),
    ("pose2sim_single", 1.6, 3.0, 0.99),
    ("humaneva_S1_projected", 0.5, 1.0, 1.0),
    ("panoptic_band1_projected", 1.5, 3.0, 0.99),
]


@pytest.mark.parametrize(
    ("name", "median", "largest", "least_precision"), FIGURES, ids=[f[0] for f in FIGURES]
)
def test_recording(name, median, largest, least_precision):
    folder = RECORDINGS / name
    views = read_keypoints([folder / "keypoints"])
    found = make_recording(views, read_cameras(folder / "intrinsics.toml"), PEOPLE, {})
    result = calibrate_group(found)
    reference, names = read_reference(folder / "reference.toml", result.rig)
    errors = rotation_errors_deg(result.rig, reference)
    assert np.median(errors) <= median
    assert errors.max() <= largest
    frames, instances = result.matches.labels.shape[1:]
    ids = np.load(folder / "truth.npz")["ids"][[names.index(n) for n in result.rig.names]]
    identity = np.full((len(ids), ids.shape[1], max(instances, ids.shape[2])), -1)
    identity[..., : ids.shape[2]] = ids
    identity = identity[:, found.frames, :instances]
    assert identity.shape[1] == frames
    assert precision(result.matches.labels, identity) >= least_precision


def read_reference(path: Path, like: CameraRig) -> tuple[CameraRig, list[str]]:
    """The reference in the order of a rig, and the names in the file's own order."""
    entries = [e for e in tomllib.loads(path.read_text()).values() if "rotation" in e]
    by_name = {e["name"]: e for e in entries}
    rotation = matrix_from_vector(np.array([by_name[n]["rotation"] for n in like.names], float))
    translation = np.array([by_name[n]["translation"] for n in like.names], float)
    return CameraRig(like.cameras, rotation, translation, "arbitrary"), [e["name"] for e in entries]
