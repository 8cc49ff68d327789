"""The network in numpy, and the bodies that it predicts: laws, and scenes with truth."""

import csv
import json
import re
import shlex
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from safetensors.numpy import load_file, save_file
from scenes import PEOPLE, calibrated, lifted, recording, scene
from scipy.special import erfc

import mocap_calib
import mocap_calib as mc
from mocap_calib.config import LEAST_LIFT_SPREAD
from mocap_calib.errors import DegenerateError, FormatError, MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.pose_files import write_poses
from mocap_calib.io.poses import PoseFile
from mocap_calib.kernels.lifter import activate
from mocap_calib.lift import complete_sample, lift, rays_by_joint
from mocap_calib.lift.lifter import (
    DESCRIPTION,
    ModelConfig,
    choose_model,
    describe_model,
    load_lifter,
    models,
    shipped_weights,
)
from mocap_calib.recording.joints import (
    SHIPPED,
    choose_skeleton,
    load_section,
    load_skeleton,
    match_names,
    parse_skeleton,
)
from mocap_calib.results import LiftedPoses, Poses3D
from mocap_calib.synthetic.body_plan import (
    assemble,
    parse_body,
    sample_bones,
    sample_turns,
)
from mocap_calib.training import OWN_SPECIES_TRAINING, TrainConfig
from mocap_calib.training.model import LifterModule, load_steerer, module_of, normalise, save_model
from mocap_calib.training.poses import (
    PoseSet,
    TrainingSource,
    check_source,
    load_pose_sets,
    load_poses,
    load_vocabulary,
    mix,
    own_poses,
    own_skeleton,
    procedural_poses,
    up_of_rig,
)
from mocap_calib.training.synthesis import Batch, Synthesiser
from mocap_calib.training.train import (
    held_out_error,
    lifting_loss,
    optimise,
    train_lifter,
    training_config,
)
from mocap_calib.types import CameraRig, Sample, silent

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


def test_complete_marks_what_it_filled_in(tmp_path, small, tool):
    """The table has the points that the completed files have and the given ones have not.

    Readers of the files are told.
    """
    words = ("complete", small / "keypoints", "--cameras", small / "intrinsics.toml", "-o")
    done = tool(*words, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    table = (tmp_path / "out" / "filled_in.tsv").read_text("utf-8")
    rows = {tuple(row.values()) for row in csv.DictReader(table.splitlines(), delimiter="\t")}
    expected, views = set(), mc.read_keypoints([tmp_path / "out"])
    for before, after in zip(mc.read_keypoints([small / "keypoints"]), views, strict=True):
        assert after.keypoints == PEOPLE.keypoints
        filled = np.isfinite(after.positions[..., 0])
        columns = [after.keypoints.index(name) for name in before.keypoints]
        there = np.ix_(before.frames, range(before.positions.shape[1]), columns)
        filled[there] &= ~np.isfinite(before.positions[..., 0])
        for frame, instance, keypoint in np.argwhere(filled):
            where = str(after.frames[frame]), str(instance), after.keypoints[keypoint]
            expected.add((after.camera, *where))
    assert rows == expected
    assert len(rows) == table.count("\n") - 1 > 1000
    said = tool("inspect", tmp_path / "out").stdout
    assert all(f"WARNING: {view.camera}: " in said for view in views)
    assert tool(*words, tmp_path / "b", "--model", "none").returncode == 1


ANIMALS = [name for name in SHIPPED if name != "people"]
RODENT = load_skeleton("rodent")
SETS = yaml.safe_load(Path(__file__).with_name("joints_of_sets.yaml").read_text("utf-8"))
CARDS = sorted((Path(mocap_calib.__file__).parent / "weights").glob("*.md"))
SMALL = TrainConfig(steps=3, batch=8, width=16, layers=1, bodies=50)
SIDES = ("left", "right")
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def poses() -> PoseSet:
    found = np.concatenate(scene(people=2).poses)
    return PoseSet(found, np.full(len(found), 1 / len(found)))


# vocabularies


@pytest.mark.parametrize("name", SETS)
def test_names_choose_their_vocabulary_and_mean_each_joint_once(name):
    names = SETS[name]["joints"]
    chosen = choose_skeleton(names)
    found = match_names(tuple(names), chosen)
    assert chosen.name == SETS[name]["model"]
    assert (found < 0).sum() == SETS[name]["lacking"]
    known = found[found >= 0].tolist()
    assert len(set(known)) == len(known)
    for joint, meant in SETS[name].get("meaning", {}).items():
        assert chosen.keypoints[found[names.index(joint)]] == meant


# bodies that are made


@pytest.mark.parametrize("name", ANIMALS)
def test_procedural_bodies_keep_their_bones_their_sides_and_their_ranges(name):
    """Vocabularies are trees with two sides."""
    skeleton = load_skeleton(name)
    assert len(skeleton.edges) == len(skeleton.keypoints) - 1
    body, rng = parse_body(load_section(name, "body"), skeleton), np.random.default_rng(0)
    assert sorted(body.order.tolist()) == list(range(len(skeleton.keypoints)))
    assert training_config(load_section(name, "training")).straighten == 0
    bones = sample_bones(rng, body, 200)
    made = assemble(body, bones, *sample_turns(rng, body, 200))
    parent, child = np.array(skeleton.edges).T
    length = np.linalg.norm(made[:, child] - made[:, parent], axis=-1)
    close(length, np.linalg.norm(bones[:, child], axis=-1), atol=1e-12)
    left, right = np.array(skeleton.symmetries).T
    still = assemble(body, bones, np.zeros_like(bones), np.zeros((200, 3)))
    for each in (bones, still):
        close(each[:, left], each[:, right] * [1, -1, 1], atol=1e-12)
    for posture in body.postures:
        turn, facing = sample_turns(rng, replace(body, postures=(posture,)), 300)
        for (bone, axis), numbers in posture.angles.items():
            if len(numbers) == 2:
                own = [joint == bone or joint.split("_", 1)[-1] == bone for joint in body.joints]
                angles = facing[:, None] if bone == "root" else turn[:, own]
                found = np.rad2deg(angles[..., ("roll", "pitch", "yaw").index(axis)])
                assert found.min() >= numbers[0] - 1e-9, (bone, axis)
                assert found.max() <= numbers[1] + 1e-9, (bone, axis)


BONES = {"bones": {"b": [1, 0, 0]}}


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({}, "skeleton t: body: .*'b'"),
        ({"bones": {"b": [1, 0, 0], "c": [1, 0, 0]}}, "'c'"),
        (BONES | {"always": {"b.twist": [0, 1]}}, "b.twist"),
        (BONES | {"postures": {"x": {"angles": {"z.roll": [0, 1]}}}}, "z"),
    ],
)
def test_a_wrong_body_and_a_wrong_setting_are_named(fields, named):
    skeleton = parse_skeleton({"name": "t", "keypoints": ["a", "b"], "edges": [["a", "b"]]}, "t")
    with pytest.raises(FormatError, match=named):
        parse_body(fields, skeleton)
    with pytest.raises(FormatError, match="elevation_degg"):
        training_config({"elevation_degg": [0, 1]})


# poses that are given


@pytest.fixture
def rodents(tmp_path) -> Path:
    values = np.random.default_rng(0).normal(size=(40, len(RODENT.keypoints), 3))
    np.savez(tmp_path / "p.npz", poses=values, joints=np.array(RODENT.keypoints))
    return tmp_path / "p.npz"


def test_sets_of_other_joints_axes_and_units_train_together(tmp_path):
    whole = procedural_poses(RODENT, load_section("rodent", "body"), 60, seed=0).poses
    few = ["nose", "neck", "spine_front", "tail_base", "left_knee", "right_knee"]
    columns = [RODENT.keypoints.index(name) for name in few]
    # -y up, millimetres: x = -y, y = -z, z = x
    lying = 1000 * whole[:, columns][..., [1, 2, 0]] * [-1, -1, 1]
    np.savez(tmp_path / "poses3d.npz", poses3d=lying)
    (tmp_path / "joints.json").write_text(json.dumps({"names": few}))
    read = load_poses(tmp_path, RODENT, "train", up="-y")
    assert np.isfinite(read.poses[..., 0]).any(0).sum() == len(few)
    # whatever the heading, heights are heights
    close(read.poses[:, columns, 2], 1000 * whole[:42][:, columns, 2], atol=1e-9)
    both = mix([read, PoseSet(whole, np.full(60, 1 / 60))], [1.0, 3.0])
    assert both.weight[:42].sum() == pytest.approx(0.25)
    lifter = train_lifter(both, RODENT, SMALL, progress=silent)
    errors = held_out_error(lifter, both, RODENT, SMALL, examples=64)
    assert np.isfinite(list(errors.values())).all()
    with pytest.raises(FormatError, match="north"):
        load_poses(tmp_path, RODENT, "train", up="north")


def test_other_joints_and_files_that_could_run_anything_are_refused(tmp_path):
    given, names = np.ones((20, 2, 3)), np.array(["nose", "neck"])
    np.savez(tmp_path / "p.npz", poses=given, joints=names)
    with pytest.raises(MismatchError, match="nose, neck"):
        load_poses(tmp_path / "p.npz", PEOPLE, "train")
    np.savez(tmp_path / "p.npz", poses=given.astype(object), joints=names)
    with pytest.raises(FormatError):
        load_poses(tmp_path / "p.npz", PEOPLE, "train")
    (tmp_path / "w.safetensors").write_bytes(b"not weights at all")
    for name in ("w.safetensors", "missing.safetensors"):
        with pytest.raises(FormatError):
            load_lifter(tmp_path / name)


NORM, LAYER = "encoder.norm.bias", "encoder.layers.3.linear1.weight"


def one_row(weights, _):
    weights[LAYER] = weights[LAYER][:1]


def not_finite(weights, _):
    weights[NORM][3] = np.nan


def set_size(**sizes):
    return lambda _, size: size.update(sizes)


DAMAGES = {
    "one row": (one_row, rf"`{LAYER}`: shape \[.*\], found shape \[1, .*; the file is damaged"),
    "gone": (lambda weights, _: weights.pop(NORM), rf"`{NORM}`: shape .*, found none"),
    "further": (lambda weights, _: weights.update(x=np.ones(2, np.float32)), "`x`: none, found"),
    "doubles": (lambda weights, _: weights.update({NORM: np.ones(64)}), "32-bit|shape"),
    "not finite": (not_finite, f"finite 32-bit floats as weights `{NORM}`"),
    "no heads": (set_size(heads=0), "as large as its skeleton and its weights"),
    "giant": (set_size(joints=10**9, width=10**9, layers=10**9), "as large as"),
    "layers": (set_size(layers=10**9), "as large as"),
    "text": (set_size(width="64"), "a whole number"),
}


@pytest.mark.parametrize("model", ["people", "people_token"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_weights_are_refused_in_a_line_before_memory_is_taken(damage, model, tmp_path):
    """A tensor of one row was broadcast, and sizes of 1e9 asked for 70 TB."""
    path, description = tmp_path / "w.safetensors", describe_model(model)
    weights = load_file(str(shipped_weights(model)))
    change, said = DAMAGES[damage]
    change(weights, description["model"])
    save_file(weights, path, metadata={DESCRIPTION: json.dumps(description)})
    with pytest.raises(FormatError, match=said):
        load_steerer(path)


@pytest.mark.filterwarnings("error")
def test_weights_too_large_for_their_floats_warn_of_nothing():
    lifter, _ = load_lifter()
    large = {name: np.float32(1e25) * weight for name, weight in lifter.weights.items()}
    seen = np.ones((3, 29), dtype=bool)
    joints, _ = replace(lifter, weights=large)(np.ones((3, 29, 2), np.float32), seen)
    assert not np.isfinite(joints).all()


ONE = (Path("a.npz"),)


@pytest.mark.parametrize(
    "source",
    [
        TrainingSource(),
        TrainingSource(skeleton="rodent", procedural=0.0),
        TrainingSource(ONE, procedural=0.2),
        TrainingSource(ONE, up=("+x", "+y")),
        TrainingSource(ONE, Path("p.h5")),
        TrainingSource(calibrated=Path("nowhere/p.h5")),
    ],
)
def test_parts_of_a_source_that_do_not_go_together_are_refused(source):
    with pytest.raises(MismatchError):
        check_source(source)


@pytest.mark.parametrize(
    ("beside", "asked", "share"),
    [(True, None, 0.3), (True, 0.2, 0.2), (True, 0.0, 0.0), (False, None, 1.0)],
)
def test_share_of_procedural_bodies(rodents, beside, asked, share):
    """The default is a setting."""
    source = TrainingSource((rodents,) if beside else (), skeleton="rodent", procedural=asked)
    for found in load_pose_sets(source, RODENT, replace(SMALL, procedural=0.3)):
        made = found.weight[-SMALL.bodies :].sum() if share else 0.0
        assert made == pytest.approx(share)
        assert found.weight.sum() == pytest.approx(1.0)


# poses of a run, of a species that no model knows


def made_poses() -> Poses3D:
    """Return the true bodies of three people, 60 frames, with all that a run would say of them."""
    made = scene()
    shape = made.poses.shape[:3]
    return Poses3D(
        keypoints=made.joints,
        frames=np.arange(shape[0]),
        positions=made.poses.copy(),
        error=np.ones(shape),
        views=np.full(shape, 4),
        confidence=np.ones(shape),
        unit="arbitrary",
    )


def test_the_own_skeleton_joins_what_is_rigid_with_two_sides():
    """A tree over all joints, with the bones of the arms and legs in it: measured all six."""
    skeleton = own_skeleton("own", calibrated().poses)
    names = skeleton.keypoints
    joined = {frozenset((names[a], names[b])) for a, b in skeleton.edges}
    assert len(joined) == len(names) - 1
    limbs = ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow")
    bones = [{f"{side}_{a}", f"{side}_{b}"} for side in ("left", "right") for a, b in limbs]
    assert sum(frozenset(bone) in joined for bone in bones) >= 5
    assert (names.index("left_knee"), names.index("right_knee")) in skeleton.symmetries


def test_own_poses_stand_upright():
    """The cameras, upright within a few degrees, tell what is up: noses are above ankles."""
    found = calibrated()
    skeleton = own_skeleton("own", found.poses)
    learnt = own_poses(found.poses, skeleton, up_of_rig(found.rig), "train")
    close(learnt.weight, 1 / len(learnt.poses))
    nose, ankle = (skeleton.keypoints.index(name) for name in ("nose", "left_ankle"))
    way = learnt.poses[:, nose] - learnt.poses[:, ankle]
    tilt = np.degrees(np.arccos(way[:, 2] / np.linalg.norm(way, axis=1)))
    assert np.nanmedian(tilt) < 25.0  # a stride apart: measured 12
    tilted = np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]]])
    rig = CameraRig(scene().rig.cameras[:2], tilted, np.zeros((2, 3)), "m")
    close(up_of_rig(rig), Z, atol=1e-12)


def test_what_was_never_seen_is_not_learnt():
    """A keypoint without a point, two never seen together, an individual without a point.

    No warning is raised (warnings are errors in tests). Too few poses are refused.
    """
    found = made_poses()
    at = {name: k for k, name in enumerate(found.keypoints)}
    found.positions[:, :, at["left_small_toe"]] = np.nan
    found.positions[:30, :, at["right_ear"]] = np.nan
    found.positions[30:, :, at["left_ear"]] = np.nan
    found.positions[:, 2] = np.nan
    found.error[np.isnan(found.positions[..., 0])] = np.nan
    skeleton = own_skeleton("own", found)
    assert set(found.keypoints) - set(skeleton.keypoints) == {"left_small_toe"}
    assert len(skeleton.edges) == len(skeleton.keypoints) - 1
    learnt = own_poses(found, skeleton, Z, "train").poses
    assert learnt.shape == (42 * 2, len(skeleton.keypoints), 3)  # two people, 7 tenths of 60 frames
    arrays = {each.name: getattr(found, each.name) for each in fields(found)}
    few = {name: x[:20] for name, x in arrays.items() if isinstance(x, np.ndarray)}
    with pytest.raises(DegenerateError):
        own_poses(replace(found, **few), skeleton, Z, "test")
    found.positions[...] = found.error[...] = np.nan
    with pytest.raises(DegenerateError):
        own_skeleton("own", found)


def test_the_vocabulary_is_that_of_the_poses_of_a_run_unless_another_is_asked_for(tmp_path):
    path = tmp_path / "own.h5"
    write_poses(path, PoseFile(made_poses(), 60.0), "poses-h5")
    own, settings = load_vocabulary(TrainingSource(calibrated=path))
    assert (own.name, settings) == ("own", OWN_SPECIES_TRAINING)
    asked, _ = load_vocabulary(TrainingSource(calibrated=path, skeleton="rodent"))
    assert asked.keypoints == RODENT.keypoints
    usual, _ = load_vocabulary(TrainingSource(poses=(path,)))
    assert usual.keypoints == PEOPLE.keypoints


# what the network is shown


def test_normalise_forgets_place_and_size_and_hidden_joints():
    rng = torch.Generator().manual_seed(0)
    pose, seen = torch.randn(4, 9, 2, generator=rng), torch.rand(4, 9, generator=rng) > 0.3
    first, _, _ = normalise(pose, seen)
    pose[~seen] = float("nan")
    second, centre, scale = normalise(3 * pose + 7, seen)
    torch.testing.assert_close(first[seen], second[seen], atol=1e-5, rtol=1e-5)
    back = second * scale[:, None, None] + centre[:, None]
    torch.testing.assert_close(back[seen], (3 * pose + 7)[seen])


EXACT = replace(SMALL, noise=(1e-9, 1e-9), outliers=0.0, distance=(1e4, 1e4), joint_spread=0.0)


def test_targets_are_what_is_seen_with_depths_from_the_mean_of_the_joints_that_are_seen(poses):
    """Without noise, outliers and perspective, the visible part of the target is the input."""
    batch = Synthesiser(poses, PEOPLE, EXACT, seed=1).batch(64)
    pose = batch.pose[batch.seen]
    torch.testing.assert_close(batch.target[..., :2][batch.seen], pose, atol=2e-3, rtol=0)
    depth = torch.where(batch.seen, batch.target[..., 2], 0.0).mean(1)
    close(depth.numpy(), 0, atol=3e-3)
    assert batch.target[..., 2].std() > 0.3


def test_views_are_upright_but_for_the_roll_and_hide_joints_as_is_said(poses):
    """Heads are above ankles in images whose y is down; people lean by a few degrees."""
    nose, ankle = (PEOPLE.keypoints.index(name) for name in ("head_top", "left_ankle"))
    spread, seen = [], []
    for roll, occlusion in ((0.0, 0.0), (30.0, 0.8)):
        config = replace(EXACT, roll_deg=roll, occlusion=occlusion)
        batch = Synthesiser(poses, PEOPLE, config, seed=2).batch(500)
        way = (batch.target[:, nose] - batch.target[:, ankle]).numpy()
        assert (way[:, 1] < 0).mean() > 0.95
        spread.append(np.degrees(np.arctan2(way[:, 0], -way[:, 1])).std())
        seen.append(float(batch.seen.double().mean()))
    assert spread[0] < 20
    assert np.sqrt(spread[1] ** 2 - spread[0] ** 2) == pytest.approx(30, rel=0.2)
    assert seen[1] + 0.1 < seen[0] < 0.99


def test_joints_that_the_data_lack_are_never_seen_and_no_target():
    """A leaf's ancestor, the root, and the middle of a limb; the loss has finite gradients."""
    column = [RODENT.keypoints.index(name) for name in ("tail_0", "spine_middle", "left_elbow")]
    whole = procedural_poses(RODENT, load_section("rodent", "body"), 60, seed=0)
    whole.poses[:, column] = np.nan
    batch = Synthesiser(whole, RODENT, SMALL, seed=0).batch(64)
    assert not batch.seen[:, column].any()
    assert torch.isnan(batch.target[:, column]).all()
    known = np.setdiff1d(np.arange(len(RODENT.keypoints)), column)
    assert torch.isfinite(batch.target[:, known]).all()
    assert torch.isfinite(batch.pose).all()
    lifter = LifterModule(ModelConfig(len(RODENT.keypoints), 16, 1))
    lifting_loss(lifter, batch).backward()
    assert all(torch.isfinite(p.grad).all() for p in lifter.parameters())
    joints, deviation = (part.detach() for part in lifter(batch.pose, batch.seen))
    other = joints.clone()
    other[:, column] += 1.0  # what is said of them does not count
    losses = [lifting_loss(lambda *_, x=x: (x, deviation), batch) for x in (joints, other)]
    assert losses[0] == losses[1]


# the network and its training


def test_the_loss_is_least_at_the_truth():
    """Of poses; and of deviations, where they are as large as the errors."""
    torch.manual_seed(0)
    target, seen = torch.randn(500, 5, 3), torch.ones(500, 5, dtype=torch.bool)
    batch = Batch(torch.randn(500, 5, 2), seen, target)

    def loss(off: float, log_deviation: float) -> float:
        torch.manual_seed(1)  # errors are looked at from random sides, too
        found = target + off * torch.randn(500, 5, 3), torch.full((500, 5, 2), log_deviation)
        return float(lifting_loss(lambda *_: found, batch))

    assert loss(0.0, -2.0) < loss(0.1, -2.0) < loss(0.3, -2.0)
    assert np.argmin([loss(0.3, x) for x in (-4.0, -2.0, np.log(0.3), 0.5, 2.0)]) == 2


@pytest.mark.parametrize(("steps", "first"), [(100, 1 / 25), (21, 1 / 25), (20, 1.0), (1, 0.0)])
def test_a_training_of_any_length_begins_and_ends_with_small_steps(steps, first):
    """Adam's first step is the learning rate, whatever the gradient."""
    model = torch.nn.Linear(1, 1, bias=False)
    seen: list[float] = []
    done: list[int] = []

    def next_loss() -> torch.Tensor:
        seen.append(model.weight.item())
        return model.weight.sum()

    config = TrainConfig(steps=steps, learning_rate=0.01)
    optimise(model, next_loss, config, progress=lambda *step: done.append(step[1]))
    seen.append(model.weight.item())
    assert done == list(range(1, steps + 1))
    assert seen[0] - seen[1] == pytest.approx(0.01 * first, rel=0.01, abs=1e-6)
    assert seen[-2] - seen[-1] < 1e-4


def test_same_seed_same_weights_and_training_lowers_the_loss(poses, tmp_path):
    """Checkpoints hold them."""
    losses = []
    config = replace(SMALL, steps=60, batch=32)
    said = lambda stage, *_: losses.append(float(stage.split()[-1].rstrip(")")))  # noqa: E731
    first = train_lifter(poses, PEOPLE, config, progress=said)
    assert np.mean(losses[-10:]) < 0.9 * np.mean(losses[:5])  # measured 0.6
    again, other = (
        train_lifter(poses, PEOPLE, replace(config, seed=seed), progress=silent) for seed in (0, 1)
    )
    assert not torch.equal(first.head.weight, other.head.weight)
    save_model(tmp_path / "w.safetensors", first.eval(), PEOPLE, {"data": "none"})
    kept, skeleton = load_steerer(tmp_path / "w.safetensors")
    assert (skeleton, kept.config) == (PEOPLE, first.config)
    for model in (again, kept):
        pairs = zip(first.state_dict().values(), model.state_dict().values(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)


@pytest.mark.slow
def test_the_loop_on_the_command_line(tmp_path, tool):
    """simulate one -> run by geometry alone -> train on what it found -> run with that model."""
    simulated = ["--people", "1", "--cameras", "3", "--frames", "240"]
    tool("simulate", *simulated, "-o", tmp_path / "one")
    files = [tmp_path / "one/keypoints", "--cameras", tmp_path / "one/intrinsics.toml"]
    tool("run", *files, "--model", "none", "-o", tmp_path / "alone", "--no-report")
    model, short = tmp_path / "own.safetensors", ["--steps", "3", "--batch", "8"]
    trained = tool("train", "--from", tmp_path / "alone/poses3d.h5", *short, "-o", model, "--json")
    assert set(json.loads(trained.stdout)) == {"joint_3d", "steered_2d", "completed_2d"}
    done = tool("run", *files, "--model", model, "-o", tmp_path / "own")
    assert "the model of poses3d knows 17" in done.stderr
    missing = tool("run", *files, "--model", "horse", "-o", tmp_path / "no")
    assert missing.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.stem)
def test_the_command_of_a_card_trains(card, tmp_path, tool):
    """For a few steps. Poses are made here: those of the card are its publisher's."""
    (typed,) = re.findall(r"`mocap-calib train ([^`]+)`", card.read_text("utf-8"))
    words = shlex.split(typed)
    for name, value in (("--steps", "2"), ("--batch", "8")):
        if name in words:
            words[words.index(name) + 1] = value
    joints = load_skeleton(words[words.index("--skeleton") + 1]).keypoints
    options = {k + 1 for k, word in enumerate(words) if word.startswith("-")}
    rng = np.random.default_rng(0)
    body = rng.normal(size=(len(joints), 3))
    alike = body + 0.05 * rng.normal(size=(60, len(joints), 3))
    for k, word in enumerate(words):
        if k not in options and not word.startswith("-"):
            path = tmp_path / word
            if not path.suffix:
                path.mkdir()
                path = path / "poses3d.npz"
            np.savez(path, poses=alike, joints=joints)
    done = tool("train", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / words[words.index("-o") + 1]).stat().st_size > 10_000


SPELLED = (
    "left_shoulder, LShoulder, l_shoulder, shoulder_left, Left Shoulder, leftShoulder, ShoulderL"
)


MEANT = dict.fromkeys(SPELLED.split(", "), "left_shoulder")


MEANT |= {"thorax": "neck", "Pelvis": "mid_hip", "head": "head_top", "LBigToe": "left_big_toe"}


MEANT |= {"left-shoulder": "left_shoulder", "MidHip": "mid_hip", "rightankle": "right_ankle"}


def test_spellings_and_aliases_are_the_joint_where_it_has_not_its_own_name():
    found = {name: match_names((name,), PEOPLE)[0] for name in MEANT}
    assert {name: PEOPLE.keypoints[joint] for name, joint in found.items()} == MEANT
    assert match_names(("thorax", "neck"), PEOPLE).tolist() == [-1, PEOPLE.keypoints.index("neck")]
    assert match_names(("tail",), PEOPLE).tolist() == [-1]


def knee_bends(bodies: np.ndarray) -> np.ndarray:
    """Return the distances `[B, side]` of knees from the line of hip and ankle, of its length."""
    at = {name: bodies[:, k] for k, name in enumerate(PEOPLE.keypoints)}
    legs = [[at[f"{side}_{name}"] for name in ("hip", "knee", "ankle")] for side in SIDES]
    return np.stack([
        np.linalg.norm(np.cross(knee - hip, ankle - hip), axis=-1)
        / np.square(np.linalg.norm(ankle - hip, axis=-1))
        for hip, knee, ankle in legs
    ], axis=-1)  # fmt: skip


def test_knees_are_straightened_by_a_share_that_both_legs_have(poses):
    """From 0 to 0.7 of the way, all shares alike."""
    bent = int(knee_bends(poses.poses).min(1).argmax())
    one = PoseSet(poses.poses[[bent]], np.ones(1))
    exact = replace(EXACT, noise=(1e-9, 1e-9), length_spread=0.0, straighten=0.7)
    target = Synthesiser(one, PEOPLE, exact, seed=0).batch(500).target.numpy()
    left = knee_bends(target) / knee_bends(one.poses)
    close(left[:, 0], left[:, 1], atol=0.02)
    close([left.min(), left.mean(), left.max()], [0.3, 0.65, 1.0], atol=0.03)
