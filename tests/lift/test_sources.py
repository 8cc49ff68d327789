"""What a network is trained on: which parts of a source go together, and how they are mixed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_calib.errors import MismatchError
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.training import TrainConfig
from mocap_calib.training.poses import TrainingSource, check_source, load_pose_sets

SMALL = TrainConfig(bodies=30)


@pytest.fixture
def poses(tmp_path) -> Path:
    joints = load_skeleton("rodent").keypoints
    values = np.random.default_rng(0).normal(size=(40, len(joints), 3))
    np.savez(tmp_path / "p.npz", poses=values, joints=np.array(joints))
    return tmp_path / "p.npz"


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (TrainingSource(), "expected POSES, or a skeleton with a section `body`"),
        (TrainingSource(skeleton="rodent", procedural=0.0), "expected POSES, or a skeleton"),
        (TrainingSource((Path("a.npz"),), procedural=0.2), "expected POSES, or a skeleton"),
        (TrainingSource((Path("a.npz"),), up=("+x", "+y")), "once for each of 1 files"),
        (TrainingSource((Path("a"),), Path("p.h5")), "or calibrated=, found both"),
        (TrainingSource(calibrated=Path("nowhere/p.h5")), "or up=, found neither"),
    ],
)
def test_parts_that_do_not_go_together(source, message):
    with pytest.raises(MismatchError, match=message):
        check_source(source)


@pytest.mark.parametrize(
    ("beside", "asked", "share"),
    [(True, None, 0.5), (True, 0.2, 0.2), (True, 0.0, 0.0), (False, None, 1.0)],
)
def test_share_of_procedural_bodies(poses, beside, asked, share):
    source = TrainingSource((poses,) if beside else (), skeleton="rodent", procedural=asked)
    training, testing = load_pose_sets(source, load_skeleton("rodent"), SMALL)
    for found in (training, testing):
        made = found.weight[-SMALL.bodies :].sum() if share else 0.0
        assert made == pytest.approx(share)
        assert found.weight.sum() == pytest.approx(1.0)


def test_default_share_is_a_setting(poses):
    source = TrainingSource((poses,), skeleton="rodent")
    config = replace(SMALL, procedural=0.3)
    training, _ = load_pose_sets(source, load_skeleton("rodent"), config)
    assert training.weight[-SMALL.bodies :].sum() == pytest.approx(0.3)
