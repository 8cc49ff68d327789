"""From a recording that no model knows to a model of its own; the paper's solver as a stage."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from scenes import calibrate_group, calibrated, recording, rotation_errors_deg, scene

from mocap_calib.config import PairwiseConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.poses.write import write_poses
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.paper import ReferencePairs
from mocap_calib.paper.solver import PaperConfig, find_by_descent
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.results import Poses3D
from mocap_calib.training import OWN_SPECIES_TRAINING
from mocap_calib.training.model import module_of
from mocap_calib.training.poses import (
    TrainingSource,
    load_vocabulary,
    own_poses,
    own_skeleton,
    up_of_rig,
)
from mocap_calib.types import CameraRig

ALONE = {"people": 1, "false_detections": 0.0, "outliers": 0.0}


@pytest.mark.slow
def test_the_own_skeleton_joins_what_is_rigid():
    """Simulated people: a tree over all joints, with the bones of the arms and legs in it.

    Measured: all six.
    """
    skeleton = own_skeleton("own", calibrated().poses)
    joined = {frozenset((skeleton.keypoints[a], skeleton.keypoints[b])) for a, b in skeleton.edges}
    assert len(joined) == len(skeleton.keypoints) - 1
    bones = [
        (f"{side}_{a}", f"{side}_{b}")
        for side in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"))
    ]
    assert sum(frozenset(bone) in joined for bone in bones) >= 5
    assert (
        skeleton.keypoints.index("left_knee"),
        skeleton.keypoints.index("right_knee"),
    ) in skeleton.symmetries


def test_own_poses_stand_upright():
    """The cameras, upright within a few degrees, tell what is up: noses are above ankles."""
    found = calibrated()
    skeleton = own_skeleton("own", found.poses)
    found_poses = own_poses(found.poses, skeleton, up_of_rig(found.rig), "train")
    poses = found_poses.poses
    np.testing.assert_allclose(found_poses.weight, 1 / len(poses))
    nose, ankle = (skeleton.keypoints.index(name) for name in ("nose", "left_ankle"))
    height = np.linalg.norm(poses[:, nose] - poses[:, ankle], axis=1)
    tilt = np.degrees(np.arccos((poses[:, nose] - poses[:, ankle])[:, 2] / height))
    assert np.nanmedian(tilt) < 25.0  # a stride apart: measured 12


def test_up_of_a_rig():
    tilted = np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]]])
    cameras = scene().rig.cameras[:2]
    assert np.allclose(up_of_rig(CameraRig(cameras, tilted, np.zeros((2, 3)), "m")), [0, 0, 1])


def test_too_few_poses_are_refused():
    found = calibrated()
    few = replace(
        found.poses,
        **{
            each.name: getattr(found.poses, each.name)[:20]
            for each in fields(found.poses)
            if isinstance(getattr(found.poses, each.name), np.ndarray)
        },
    )
    with pytest.raises(DegenerateError, match="at least 20 whole 3D poses to test on"):
        own_poses(few, own_skeleton("own", found.poses), np.array([0.0, 0, 1]), "test")


def made_poses(**changes) -> Poses3D:
    """The true bodies of three people, 60 frames, with all that a run would say of them."""
    made = scene(**changes)
    positions = made.poses.copy()
    shape = positions.shape[:3]
    return Poses3D(
        keypoints=made.joints,
        frames=np.arange(shape[0]),
        positions=positions,
        error=np.ones(shape),
        views=np.full(shape, 4),
        confidence=np.ones(shape),
        unit="arbitrary",
    )


def test_what_was_never_seen_is_not_learnt():
    """A keypoint without a point, two never seen together, an individual without a point.

    No warning is raised (warnings are errors in tests).
    """
    poses = made_poses()
    gone = poses.keypoints.index("left_small_toe")
    early, late = (poses.keypoints.index(name) for name in ("left_ear", "right_ear"))
    poses.positions[:, :, gone] = np.nan
    poses.positions[:30, :, late] = np.nan
    poses.positions[30:, :, early] = np.nan
    poses.positions[:, 2] = np.nan
    poses.error[np.isnan(poses.positions[..., 0])] = np.nan
    skeleton = own_skeleton("own", poses)
    assert set(poses.keypoints) - set(skeleton.keypoints) == {"left_small_toe"}
    assert len(skeleton.edges) == len(skeleton.keypoints) - 1
    learnt = own_poses(poses, skeleton, np.array([0.0, 0, 1]), "train").poses
    assert learnt.shape == (42 * 2, len(skeleton.keypoints), 3)  # two people, 7 tenths of 60 frames


def test_the_vocabulary_is_that_of_the_poses_of_a_run_unless_another_is_asked_for(tmp_path):
    path = tmp_path / "own.h5"
    write_poses(path, PoseFile(replace(made_poses(), unit="arbitrary"), 60.0), "poses-h5")
    own, settings = load_vocabulary(TrainingSource(calibrated=path))
    assert (own.name, settings) == ("own", OWN_SPECIES_TRAINING)
    asked, _ = load_vocabulary(TrainingSource(calibrated=path, skeleton="rodent"))
    assert asked.keypoints == load_skeleton("rodent").keypoints
    usual, _ = load_vocabulary(TrainingSource(poses=(path,)))
    assert usual.keypoints == load_skeleton("people").keypoints


def test_poses_without_points_are_refused_in_one_line():
    poses = made_poses()
    poses.positions[...] = np.nan
    poses.error[...] = np.nan
    with pytest.raises(DegenerateError, match="expected poses with at least 4 keypoints in 3D"):
        own_skeleton("own", poses)
    with pytest.raises(DegenerateError, match="at least 20 whole 3D poses to train on, found 0"):
        own_poses(poses, load_skeleton("people"), np.array([0.0, 0, 1]), "train")


@pytest.mark.slow
def test_the_papers_solver_calibrates_pairs_of_the_pipeline():
    """One person, two views: the paper's pair is adjusted to the rig that ours is.

    Measured 1.8 degrees, ours 1.9: two views of one person are not much.
    """
    alone = ALONE | {"cameras": 2, "frames": 30}
    seen, (lifter, _) = recording(**alone), load_lifter()
    focal = np.array([camera.focal for camera in seen.cameras])
    descend = partial(
        find_by_descent,
        model=module_of(lifter),
        vocabulary=seen.vocabulary,
        config=PaperConfig(iterations=300),
    )
    solve = ReferencePairs(descend, "paper", focal, PairwiseConfig())
    found = calibrate_group(seen, lifter=lifter, pair_solver=solve)
    assert found.pairs[0].source == "paper"
    assert rotation_errors_deg(found.rig, scene(**alone).rig).max() < 2.5


@pytest.mark.slow
def test_the_loop_on_the_command_line(tmp_path, tool):
    """simulate one -> run by geometry alone -> train on what it found -> run with that model."""
    scene_options = ["--people", "1", "--cameras", "3", "--frames", "240"]
    tool("simulate", *scene_options, "-o", tmp_path / "one")
    files = [tmp_path / "one/keypoints", "--cameras", tmp_path / "one/intrinsics.toml"]
    tool("run", *files, "--model", "none", "-o", tmp_path / "alone", "--no-report")
    tool(
        "train",
        "--from",
        tmp_path / "alone/poses3d.h5",
        "--steps",
        "3",
        "--batch",
        "8",
        "-o",
        tmp_path / "own.safetensors",
    )
    done = tool("run", *files, "--model", tmp_path / "own.safetensors", "-o", tmp_path / "own")
    assert "the model of poses3d knows 17" in done.stderr
    missing = tool("run", *files, "--model", "horse", "-o", tmp_path / "no")
    assert missing.returncode == 1
    assert "expected a shipped model (people, quadruped" in missing.stderr
