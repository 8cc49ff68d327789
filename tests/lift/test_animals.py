"""Animals: vocabularies, procedural bodies, training on joints that are known, shipped models."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mocap_calib.errors import FormatError
from mocap_calib.lift.lifter import ModelConfig, load_lifter, models
from mocap_calib.recording.joints import (
    SHIPPED,
    choose_skeleton,
    load_section,
    load_skeleton,
    match_names,
    parse_skeleton,
)
from mocap_calib.synthetic.body_plan import parse_body
from mocap_calib.synthetic.procedural import (
    assemble,
    sample_bodies,
    sample_bones,
    sample_turns,
)
from mocap_calib.training import TrainConfig
from mocap_calib.training.model import LifterModule
from mocap_calib.training.poses import PoseSet, load_poses, mix, procedural_poses
from mocap_calib.training.synthesis import Synthesiser
from mocap_calib.training.train import held_out_error, lifting_loss, train_lifter, training_config
from mocap_calib.types import silent

ANIMALS = [name for name in SHIPPED if name != "people"]
SMALL = TrainConfig(steps=2, batch=8, width=16, layers=1, bodies=50)


def sides(*names: str, left: str = "left_", right: str = "right_") -> list[str]:
    return [side + name for name in names for side in (left, right)]


# what each set calls its joints; those that the vocabulary is meant to lack are listed beside it
SETS = {
    "AP-10K": (
        "quadruped",
        sides("eye", "shoulder", "elbow", "front_paw", "hip", "knee", "back_paw")
        + ["nose", "neck", "root_of_tail"],
        0,
    ),
    "Animal3D": (
        "quadruped",
        sides(
            "eye",
            "front_paw",
            "back_paw",
            "front_thigh",
            "back_thigh",
            "shoulder",
            "front_knee",
            "back_knee",
            "ear",
            "mouth",
        )
        + ["mouth_mid", "tail_base", "neck", "tail_end", "nose", "tail_mid"],
        2,  # corners of the mouth
    ),
    "SuperAnimal-Quadruped": (
        "quadruped",
        [
            "nose",
            "upper_jaw",
            "lower_jaw",
            "neck_base",
            "neck_end",
            "throat_base",
            "throat_end",
            "back_base",
            "back_end",
            "back_middle",
            "tail_base",
            "tail_end",
        ]
        + [
            f"{limb}_{side}_{part}"
            for limb in ("front", "back")
            for side in ("left", "right")
            for part in ("thai", "knee", "paw")
        ]
        + sides("eye", "earbase", "earend", "antler_base", "antler_end")
        + [
            "mouth_end_right",
            "mouth_end_left",
            "belly_bottom",
            "body_middle_right",
            "body_middle_left",
        ],
        14,  # jaw, throat, end of the neck, tips of ears, antlers, mouth, flanks
    ),
    "AcinoSet": (
        "quadruped",
        sides(
            "eye",
            "shoulder",
            "front_knee",
            "front_ankle",
            "front_paw",
            "hip",
            "back_knee",
            "back_ankle",
            "back_paw",
            left="l_",
            right="r_",
        )
        + ["spine", "tail_base", "tail1", "tail2", "nose", "neck_base"],
        0,
    ),
    "MAMMAL": (
        "quadruped",
        sides("eye", "ear", "shoulder", "elbow", "paw", "hip", "knee", "foot")
        + ["nose", "tail_root", "center"],
        0,
    ),
    "dog mocap": (
        "quadruped",
        ["Hips", "Spine", "Spine1", "Neck", "Head", "HeadSite", "Tail", "Tail1", "Tail1Site"]
        + sides(
            "Shoulder",
            "Arm",
            "ForeArm",
            "Hand",
            "HandSite",
            "UpLeg",
            "Leg",
            "Foot",
            "FootSite",
            left="Left",
            right="Right",
        ),
        1,  # Hips is where Spine is
    ),
    "mouse22": (
        "rodent",
        ["Snout", "SpineF", "SpineM", "Tail(base)", "Tail(mid)", "Tail(end)"]
        + [
            f"{part}{side}"
            for part in ("Ear", "Forepaw", "Wrist", "Elbow", "Shoulder", "Hindpaw", "Ankle", "Knee")
            for side in "LR"
        ],
        0,
    ),
    "mouse34": (
        "rodent",
        [
            "Nose",
            "TTI",
            "TailTip",
            "Head",
            "Trunk",
            "Tail_0",
            "Tail_1",
            "Tail_2",
            "Tail_3",
            "Tail_4",
            "Neck",
            "Spine",
        ]
        + [
            f"{part}_{side}"
            for part in (
                "Ear",
                "Eye",
                "Shoulder",
                "Knee",
                "Elbow",
                "Wrist",
                "Forepaw",
                "Heel",
                "Hip",
                "MTP",
                "Lisfranc",
            )
            for side in "LR"
        ],
        2,  # the middle of the foot
    ),
    "rat23": (
        "rodent",
        ["Snout", "SpineF", "SpineM", "SpineL", "TailBase"]
        + [
            f"{part}{side}"
            for part in (
                "Ear",
                "Shoulder",
                "Elbow",
                "Wrist",
                "Hand",
                "Hip",
                "Knee",
                "Ankle",
                "Foot",
            )
            for side in "LR"
        ],
        0,
    ),
    "sleap mouse": (
        "rodent",
        [
            "Nose",
            "Ear_R",
            "Ear_L",
            "TTI",
            "TailTip",
            "Head",
            "Trunk",
            "Tail_0",
            "Tail_1",
            "Tail_2",
            "Neck",
        ]
        + ["Shoulder_left", "Shoulder_right", "Haunch_left", "Haunch_right"],
        0,
    ),
    "SuperAnimal-TopViewMouse": (
        "rodent",
        sides("ear", "ear_tip", "eye", "shoulder", "midside", "hip")
        + [
            "nose",
            "neck",
            "mid_back",
            "mouse_center",
            "mid_backend",
            "mid_backend2",
            "mid_backend3",
            "tail_base",
            "tail_end",
            "head_midpoint",
        ]
        + [f"tail{k}" for k in range(1, 6)],
        7,  # tips of the ears, flanks, more of the back
    ),
    "hawk8": ("bird", sides("wingtip", "primary", "secondary", "tailtip"), 0),
    "chickadee": (
        "bird",
        ["topBeak", "botBeak", "topHead", "backHead", "centerBack", "baseTail", "tipTail"]
        + sides("Eye", "Wing", "Ankle", "Foot", left="left", right="right"),
        0,
    ),
    "3D-POP": (
        "bird",
        [
            "hd_beak",
            "hd_nose",
            "hd_leftEye",
            "hd_rightEye",
            "bp_leftShoulder",
            "bp_rightShoulder",
            "bp_topKeel",
            "bp_bottomKeel",
            "bp_tail",
        ],
        0,
    ),
    "COCO-17": (
        "people",
        sides("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle") + ["nose"],
        0,
    ),
    "a fly": ("people", ["L1A", "L1B", "R1A"], 3),
}


@pytest.mark.parametrize("name", SETS)
def test_names_choose_their_vocabulary_and_mean_each_joint_once(name):
    skeleton, names, unknown = SETS[name]
    chosen = choose_skeleton(names)
    found = match_names(tuple(names), chosen)
    assert chosen.name == skeleton
    assert (found < 0).sum() == unknown, [n for n, k in zip(names, found, strict=True) if k < 0]
    known = found[found >= 0]
    assert len(set(known.tolist())) == len(known)


@pytest.mark.parametrize(
    ("name", "joint", "meant"),
    [
        ("dog mocap", "LeftShoulder", "left_scapula"),
        ("dog mocap", "LeftArm", "left_shoulder"),
        ("dog mocap", "Spine1", "spine"),
        ("AcinoSet", "l_front_knee", "left_elbow"),
        ("Animal3D", "left_front_knee", "left_wrist"),
        ("rat23", "SpineL", "spine_back"),
    ],
)
def test_a_layout_says_what_its_names_mean(name, joint, meant):
    skeleton, names, _ = SETS[name]
    vocabulary = load_skeleton(skeleton)
    assert vocabulary.keypoints[match_names(tuple(names), vocabulary)[names.index(joint)]] == meant


@pytest.mark.parametrize("name", ANIMALS)
def test_vocabularies_are_trees_with_two_sides(name):
    skeleton = load_skeleton(name)
    assert len(skeleton.edges) == len(skeleton.keypoints) - 1
    body = parse_body(load_section(name, "body"), skeleton)
    assert sorted(body.order.tolist()) == list(range(len(skeleton.keypoints)))
    assert training_config(load_section(name, "training")).straighten == 0


@pytest.mark.parametrize("name", ANIMALS)
def test_procedural_bodies_keep_their_bones_and_both_sides_alike(name):
    skeleton = load_skeleton(name)
    body = parse_body(load_section(name, "body"), skeleton)
    rng = np.random.default_rng(0)
    bones = sample_bones(rng, body, 200)
    poses = assemble(body, bones, *sample_turns(rng, body, 200))
    parent, child = np.array(skeleton.edges).T
    length = np.linalg.norm(poses[:, child] - poses[:, parent], axis=-1)
    np.testing.assert_allclose(length, np.linalg.norm(bones[:, child], axis=-1), atol=1e-12)
    left, right = np.array(skeleton.symmetries).T
    np.testing.assert_allclose(bones[:, left], bones[:, right] * [1, -1, 1], atol=1e-12)
    still = assemble(body, bones, np.zeros_like(bones), np.zeros((200, 3)))
    np.testing.assert_allclose(still[:, left], still[:, right] * [1, -1, 1], atol=1e-12)


@pytest.mark.parametrize("name", ANIMALS)
def test_angles_stay_within_their_ranges(name):
    body = parse_body(load_section(name, "body"), load_skeleton(name))
    for posture in body.postures:
        turn, facing = sample_turns(
            np.random.default_rng(1), replace(body, postures=(posture,)), 300
        )
        for (bone, axis), numbers in posture.angles.items():
            if len(numbers) == 2:
                column = ("roll", "pitch", "yaw").index(axis)
                joints = [
                    k
                    for k, joint in enumerate(body.joints)
                    if joint.split("_", 1)[-1] == bone or joint == bone
                ]
                found = np.rad2deg(facing[:, column] if bone == "root" else turn[:, joints, column])
                assert found.min() >= numbers[0] - 1e-9, (bone, axis)
                assert found.max() <= numbers[1] + 1e-9, (bone, axis)


def test_a_gallop_gathers_the_legs_when_the_back_is_bent():
    body = parse_body(load_section("quadruped", "body"), load_skeleton("quadruped"))
    gallop = next(p for p in body.postures if p.opposed == (0.0, 75.0))
    poses = sample_bodies(np.random.default_rng(2), replace(body, postures=(gallop,)), 2000)
    at = {name: poses[:, k] for k, name in enumerate(body.joints)}
    gap = at["left_front_paw"][:, 0] - at["left_back_paw"][:, 0]
    trunk = np.linalg.norm(at["neck_base"] - at["tail_base"], axis=-1) / sum(
        np.linalg.norm(at[a] - at[b], axis=-1)
        for a, b in [("neck_base", "spine"), ("spine", "croup"), ("croup", "tail_base")]
    )
    assert np.corrcoef(gap, trunk)[0, 1] > 0.3
    assert gap.min() < 0 < gap.max()


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({}, "a bone to each joint"),
        ({"bones": {"b": [1, 0, 0], "c": [1, 0, 0]}}, "unknown"),
        ({"bones": {"b": [1, 0, 0]}, "always": {"b.twist": [0, 1]}}, "b.twist"),
        ({"bones": {"b": [1, 0, 0]}, "postures": {"x": {"angles": {"z.roll": [0, 1]}}}}, "found z"),
    ],
)
def test_a_wrong_body_is_named(fields, complaint):
    skeleton = parse_skeleton({"name": "t", "keypoints": ["a", "b"], "edges": [["a", "b"]]}, "t")
    with pytest.raises(FormatError, match=complaint):
        parse_body(fields, skeleton)


def test_a_setting_that_does_not_exist_is_named():
    with pytest.raises(FormatError, match="elevation_degg"):
        training_config({"elevation_degg": [0, 1]})


def partial(skeleton, lacking: list[str]) -> PoseSet:
    whole = procedural_poses(skeleton, load_section("rodent", "body"), 60, seed=0)
    whole.poses[:, [skeleton.keypoints.index(name) for name in lacking]] = np.nan
    return whole


def test_joints_that_the_data_lack_are_never_seen_and_no_target():
    skeleton = load_skeleton("rodent")
    # a leaf's ancestor, the root, and the middle of a limb
    lacking = ["tail_0", "spine_middle", "left_elbow"]
    batch = Synthesiser(partial(skeleton, lacking), skeleton, SMALL, seed=0).batch(64)
    column = [skeleton.keypoints.index(name) for name in lacking]
    known = np.setdiff1d(np.arange(len(skeleton.keypoints)), column)
    assert not batch.seen[:, column].any()
    assert torch.isnan(batch.target[:, column]).all()
    assert torch.isfinite(batch.target[:, known]).all()
    assert torch.isfinite(batch.pose).all()


def test_the_loss_does_not_depend_on_what_is_said_of_unknown_joints():
    torch.manual_seed(0)
    skeleton = load_skeleton("rodent")
    batch = Synthesiser(partial(skeleton, ["nose"]), skeleton, SMALL, seed=0).batch(16)
    lifter = LifterModule(ModelConfig(len(skeleton.keypoints), 16, 1))
    lifting_loss(lifter, batch).backward()
    assert all(torch.isfinite(p.grad).all() for p in lifter.parameters())


def test_sets_of_other_joints_axes_and_units_train_together(tmp_path):
    skeleton = load_skeleton("rodent")
    whole = procedural_poses(skeleton, load_section("rodent", "body"), 60, seed=0).poses
    few = ["nose", "neck", "spine_front", "tail_base", "left_knee", "right_knee"]
    columns = [skeleton.keypoints.index(name) for name in few]
    # -y up, millimetres: x = -y, y = -z, z = x
    lying = 1000 * whole[:, columns][..., [1, 2, 0]] * [-1, -1, 1]
    (tmp_path / "set").mkdir()
    np.savez(tmp_path / "set" / "poses3d.npz", poses3d=lying)
    (tmp_path / "set" / "joints.json").write_text(f'{{"names": {few}}}'.replace("'", '"'))
    read = load_poses(tmp_path / "set", skeleton, "train", up="-y")
    assert np.isfinite(read.poses[..., 0]).any(0).sum() == len(few)
    # whatever the heading, heights are heights
    np.testing.assert_allclose(
        read.poses[:, columns, 2], 1000 * whole[:42][:, columns, 2], atol=1e-9
    )
    both = mix([read, PoseSet(whole, np.full(60, 1 / 60))], [1.0, 3.0])
    assert both.weight[:42].sum() == pytest.approx(0.25)
    lifter = train_lifter(both, skeleton, SMALL, progress=silent)
    assert all(
        np.isfinite(error)
        for error in held_out_error(lifter, both, skeleton, SMALL, examples=64).values()
    )
    with pytest.raises(FormatError, match="up axis"):
        load_poses(tmp_path / "set", skeleton, "train", up="north")


def test_shipped_models_say_what_they_are_and_fit_their_vocabulary():
    cards = models()
    assert "people" in cards
    for name, card in cards.items():
        lifter, skeleton = load_lifter(name)
        assert skeleton == load_skeleton(name)
        assert lifter.config.joints == len(skeleton.keypoints)
        assert {"data", "terms", "command", "held_out_error"} <= set(card)


def test_models_lists_what_is_shipped():
    from click.testing import CliRunner

    from mocap_calib_cli.commands.models import command

    said = CliRunner().invoke(command)
    assert said.exit_code == 0
    assert all(name in said.output for name in models())
    assert "NSF EIA-0196217" in said.output
