"""Real recordings with reference calibrations: the project's figures as a regression test.

MOCAP_CALIB_RECORDINGS names their folder (benchmarks/README.md). Judging reads truth and reference;
no stage does.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scenes import precision, rotation_errors_deg

import mocap_calib as mc

RECORDINGS = Path(os.environ.get("MOCAP_CALIB_RECORDINGS", "none"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RECORDINGS.is_dir(), reason="MOCAP_CALIB_RECORDINGS names no folder"),
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
    found = mc.read_recording(folder / "keypoints", folder / "intrinsics.toml")
    (group,) = mc.calibrate(found).groups
    reference = mc.read_rig(folder / "reference.toml")
    errors = rotation_errors_deg(group.rig, reference.select(group.rig.names))
    assert np.median(errors) <= median
    assert errors.max() <= largest
    labels = group.matches.labels
    views = [reference.names.index(each) for each in group.rig.names]
    ids = np.load(folder / "truth.npz")["ids"][views][:, found.frames]
    instances = labels.shape[2]
    identity = np.full(labels.shape, -1)
    identity[..., : ids.shape[2]] = ids[..., :instances]
    assert precision(labels, identity) >= least_precision
