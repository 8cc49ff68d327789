"""The network in numpy, and the bodies that it predicts: laws, and scenes with truth."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import PEOPLE, lifted, recording, scene
from scipy.special import erfc

import mocap_calib as mc
from mocap_calib.config import LEAST_LIFT_SPREAD
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels.lifter import activate
from mocap_calib.lift import complete_sample, lift, rays_by_joint
from mocap_calib.lift.lifter import choose_model, load_lifter, models
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.results import LiftedPoses
from mocap_calib.training.model import module_of, normalise
from mocap_calib.types import Sample, silent

CLEAN = {"noise_px": 1.0, "missing": 0.0, "outliers": 0.0}
PLAIN = {"people": 1, "false_detections": 0.0, "outliers": 0.0, "missing": 0.0}
close = np.testing.assert_allclose


def lift_people(sample: Sample) -> LiftedPoses:
    return lift(sample, load_lifter()[0], progress=silent)


# the network


def test_the_kernel_of_the_activation_is_that_of_its_definition():
    """To what the approximation of erf is good for, 2e-7, and single precision."""
    x = np.linspace(-6, 6, 2001)
    expected = x * erfc(-x / np.sqrt(2)) / 2
    bias = np.array([0.5, -2.0], dtype=np.float32)
    compiled = (x[:, None] - bias).astype(np.float32)
    activate(compiled, bias)
    close(compiled, np.column_stack([expected] * 2), rtol=3e-7, atol=8e-7)


@pytest.mark.parametrize("name", ["people", "quadruped"])
def test_numpy_and_torch_compute_the_same(name):
    """To 2e-5 of a body's size; measured 1.0e-5 in 32 bits, and torch's own rounding is as much."""
    lifter, skeleton = load_lifter(name)
    rng = np.random.default_rng(0)
    seen = rng.random((100, len(skeleton.keypoints))) < 0.7
    pose, _, _ = normalise(torch.from_numpy(rng.normal(size=(*seen.shape, 2))), torch.tensor(seen))
    pose = pose.float()
    joints, log_deviation = lifter(pose.numpy(), seen)
    with torch.no_grad():
        module = module_of(lifter).double()
        true_joints, true_log_deviation = module(pose.double(), torch.from_numpy(seen))
    sized, true = (
        each / np.sqrt((each**2).sum(-1).mean(-1))[:, None, None]
        for each in (joints, true_joints.numpy())
    )
    close(sized, true, rtol=0, atol=2e-5)
    close(log_deviation, true_log_deviation.numpy(), rtol=0, atol=1e-5)


def test_attention_to_large_scores_is_finite():
    """Exponentials of what is above 88 are not, in 32 bits; the largest is taken away first."""
    lifter, _ = load_lifter()
    name = "encoder.layers.0.self_attn.in_proj_weight"
    sharp = replace(lifter, weights={**lifter.weights, name: 100 * lifter.weights[name]})
    joints, _ = sharp(np.ones((3, 29, 2), np.float32), np.ones((3, 29), dtype=bool))
    assert np.isfinite(joints).all()


def test_shipped_models_say_what_they_are_and_fit_their_vocabulary():
    cards = models()
    assert "people" in cards
    for name, card in cards.items():
        lifter, skeleton = load_lifter(name)
        assert skeleton == load_skeleton(name)
        assert lifter.config.joints == len(skeleton.keypoints)
        assert {"data", "terms", "command", "held_out_error"} <= set(card)
        assert sum(weight.nbytes for weight in lifter.weights.values()) < 4e6
    assert "NSF EIA-0196217" in str(cards["people"])


# lifted bodies


def test_lifted_bodies_are_where_and_how_they_are():
    """Against the truth of a scene.

    Measured: median joint error 0.16 body sizes, median distance error 4 %; bounds at twice that.
    """
    made, bodies = scene(**CLEAN), lifted(**CLEAN)
    error, distance = [], []
    for view in range(len(made.rig)):
        true = made.poses @ made.rig.rotation[view].T + made.rig.translation[view]
        middle = true.mean(2, keepdims=True)
        size = np.sqrt(((true - middle) ** 2).sum(-1).mean(-1))[..., None]
        known = (made.identity[view] >= 0) & np.isfinite(bodies.centre[view, ..., 0])
        frame, instance = np.nonzero(known)
        who = made.identity[view, frame, instance]
        body = (true - middle)[frame, who] / size[frame, who][..., None]
        error.append(np.linalg.norm(bodies.body[view, frame, instance] - body, axis=-1).mean(-1))
        place = np.linalg.norm(middle[frame, who, 0], axis=-1) / size[frame, who, 0]
        distance.append(np.linalg.norm(bodies.centre[view, frame, instance], axis=-1) / place)
    assert np.median(np.concatenate(error)) < 0.35
    assert abs(np.median(np.concatenate(distance)) - 1) < 0.1


def test_a_lifted_body_is_of_unit_size_where_its_joints_are_seen():
    """Rays pass the joints at 0.007 body sizes in the median, and farther from any other place."""
    bodies, sample = lifted(**CLEAN), recording(**CLEAN)
    known = np.isfinite(bodies.centre[..., 0])
    body = bodies.body[known]
    close(body.mean(1), 0, atol=1e-6)
    close((body**2).sum(-1).mean(-1), 1, rtol=1e-5)
    rays = rays_by_joint(sample.rays, sample.vocabulary, body.shape[1])[known]
    points = body + bodies.centre[known][:, None]
    gap = np.linalg.norm(np.cross(rays, points), axis=-1)
    assert np.nanmedian(gap) < 0.015
    for step in 0.03 * np.concatenate([np.eye(3), -np.eye(3)]):
        moved = np.linalg.norm(np.cross(rays, points + step), axis=-1)
        assert np.nanmean(moved**2) > np.nanmean(gap**2)


@pytest.mark.parametrize("radians", [0.25, np.pi / 2])
def test_a_body_turns_with_the_camera_that_sees_it(radians):
    """A camera that looks aside sees another upright; one on its side finds what is down: 3e-6."""
    found = recording()
    on_side = radians > 1
    turns = [
        matrix_from_vector([0.0, 0.0, view * radians] if on_side else [0.0, radians, 0.0])
        for view in range(4)
    ]
    rays = np.stack([of_view @ turn.T for of_view, turn in zip(found.rays, turns, strict=True)])
    bodies = lift_people(replace(found, rays=rays))
    for view, turn in enumerate(turns):
        error = np.linalg.norm(bodies.body[view] - lifted().body[view] @ turn.T, axis=-1)
        assert (np.nanmax(error) < 3e-5) if on_side else (np.nanmedian(error) < 0.05)
        if on_side:
            close(bodies.centre[view], lifted().centre[view] @ turn.T, atol=1e-3)
            close(bodies.spread[view], lifted().spread[view], atol=3e-5)


def test_joints_are_lifted_by_the_confidence_that_their_view_reaches_at_its_best():
    """So a detector whose confidences are a tenth of another's has the same bodies.

    The barely confident joints are as if they were not seen; views that see nobody have no body.
    """
    sample = recording()
    confidence = sample.confidence * np.array([0.1, 1.0, 1.0, 0.0])[:, None, None, None]
    bodies = lift_people(replace(sample, confidence=confidence))
    close(bodies.body[:3], lifted().body[:3], atol=1e-5)
    assert np.isnan(bodies.body[3]).all()
    doubtful = np.arange(len(sample.keypoints)) % 3 == 0
    low = np.where(doubtful, 0.01, 1.0) * sample.seen
    unseen = np.where(doubtful[:, None], np.nan, sample.rays)
    first = lift_people(replace(sample, confidence=low))
    second = lift_people(replace(sample, rays=unseen, confidence=np.where(doubtful, 0, low)))
    np.testing.assert_array_equal(first.body, second.body)


def test_networks_that_know_too_few_joints_are_refused():
    """Too few of them; or several subjects none of whose joints the network knows."""
    found, lifter = recording(), load_lifter()[0]
    assert choose_model(found, lifter)[1] is lifter
    few = replace(lifter, config=replace(lifter.config, joints=int(found.vocabulary.max())))
    with pytest.raises(mc.MismatchError):
        choose_model(found, few)
    with pytest.raises(mc.MismatchError):
        lift_people(replace(found, vocabulary=np.full_like(found.vocabulary, -1)))


# joints that were not seen, filled in


def test_hidden_limbs_are_found_to_a_third_of_a_body():
    """The left arm and the right leg of a simulated walker are hidden.

    Measured: 0.31 of the visible pose's RMS radius; margin 0.1. A joint deserves the mean
    confidence of its detection, and less, the less certain the network is.
    """
    whole = recording(**PLAIN)
    hidden = np.isin(whole.keypoints, ["left_elbow", "left_wrist", "right_knee", "right_ankle"])
    part = replace(
        whole,
        positions=np.where(hidden[:, None], np.nan, whole.positions),
        confidence=np.where(hidden, 0, whole.confidence),
        rays=np.where(hidden[:, None], np.nan, whole.rays),
    )
    bodies = lift_people(part)
    views = complete_sample(part, bodies, PEOPLE)
    positions = np.stack([view.positions for view in views])
    confidence = np.stack([view.confidence for view in views])
    filled, kept = whole.vocabulary[hidden], whole.vocabulary[~hidden]
    gap = np.linalg.norm(positions[..., filled, :] - whole.positions[..., hidden, :], axis=-1)
    offset = whole.positions - np.nanmean(whole.positions, axis=3, keepdims=True)
    radius = np.sqrt(np.nanmean((offset**2).sum(-1), axis=3))
    assert np.nanmedian(gap / radius[..., None]) < 0.42
    np.testing.assert_array_equal(positions[..., kept, :], part.positions[..., ~hidden, :])
    seen = part.confidence > 0
    mean = part.confidence.sum(-1) / np.maximum(seen.sum(-1), 1)
    spread = np.maximum(bodies.spread[..., filled], LEAST_LIFT_SPREAD)
    expected = mean[..., None] * LEAST_LIFT_SPREAD / (LEAST_LIFT_SPREAD + spread)
    there = np.isfinite(positions[..., filled, 0])
    close(confidence[..., filled][there], expected[there], rtol=1e-6)


def test_joints_of_another_skeleton_are_near_the_true_ones():
    """COCO has no foot; the big toes of the model are put where those of the walker are.

    Measured: below a tenth of the height.
    """
    made, sample = scene(**PLAIN), recording(**PLAIN)
    views = complete_sample(sample, lifted(**PLAIN), PEOPLE)
    toes = [f"{side}_big_toe" for side in ("left", "right")]
    true = made.rig.project(made.poses[:, 0][:, [made.joints.index(name) for name in toes]])
    columns = [PEOPLE.keypoints.index(name) for name in toes]
    found = np.stack([view.positions for view in views])[:, :, 0][:, :, columns]
    height = sample.positions[:, :, 0, :, 1]
    extent = np.nanmax(height, -1) - np.nanmin(height, -1)
    assert np.nanmedian(np.linalg.norm(found - true, axis=-1) / extent[..., None]) < 0.1


def test_complete_marks_what_it_filled_in(tmp_path, small, tool):
    """The table has the points that the completed files have and the given ones have not.

    Readers of the files are told.
    """
    given, cameras = small / "keypoints", small / "intrinsics.toml"
    done = tool("complete", given, "--cameras", cameras, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    table = (tmp_path / "out" / "filled_in.tsv").read_text("utf-8")
    rows = {tuple(row.values()) for row in csv.DictReader(table.splitlines(), delimiter="\t")}
    expected = set()
    views = mc.read_keypoints([tmp_path / "out"])
    for before, after in zip(mc.read_keypoints([given]), views, strict=True):
        assert after.keypoints == PEOPLE.keypoints
        assert len(after.frames) == 30
        seen = np.zeros(after.confidence.shape, bool)
        columns = [after.keypoints.index(name) for name in before.keypoints]
        frames = np.searchsorted(after.frames, before.frames)
        there = np.isfinite(before.positions[..., 0])
        seen[np.ix_(frames, range(before.positions.shape[1]), columns)] = there
        for frame, instance, keypoint in np.argwhere(np.isfinite(after.positions[..., 0]) & ~seen):
            number, name = str(after.frames[frame]), after.keypoints[keypoint]
            expected.add((after.camera, number, str(instance), name))
    assert rows == expected
    assert len(rows) == table.count("\n") - 1 > 1000
    said = tool("inspect", tmp_path / "out").stdout
    assert all(f"WARNING: {view.camera}: " in said for view in views)
    refused = tool("complete", given, "--cameras", cameras, "-o", tmp_path / "b", "--model", "none")
    assert refused.returncode == 1
