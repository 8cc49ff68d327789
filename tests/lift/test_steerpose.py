"""The network, its data and its training."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import recording, scene

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.lift import lift, rays_by_joint
from mocap_calib.lift.lifter import ModelConfig, load_lifter
from mocap_calib.recording.joints import load_skeleton, match_names, normalise_name
from mocap_calib.synthetic import people
from mocap_calib.training import TrainConfig
from mocap_calib.training.model import (
    LifterModule,
    load_steerer,
    module_of,
    normalise,
    save_model,
)
from mocap_calib.training.poses import PoseSet, load_poses
from mocap_calib.training.synthesis import Batch, Synthesiser, _target
from mocap_calib.training.train import lifting_loss, optimise, train_lifter
from mocap_calib.types import silent

PEOPLE = load_skeleton("people")
SMALL = TrainConfig(steps=3, batch=8, width=16, layers=1)


@pytest.fixture(scope="module")
def poses() -> PoseSet:
    found = people(
        np.random.default_rng(0), individuals=2, frames=40, fps=10.0, room=(3.0, 3.0)
    ).reshape(-1, 29, 3)
    return PoseSet(found, np.full(len(found), 1 / len(found)))


@pytest.mark.parametrize(
    "name",
    [
        "left_shoulder",
        "LShoulder",
        "l_shoulder",
        "shoulder_left",
        "ShoulderL",
        "Left Shoulder",
        "leftShoulder",
        "left-shoulder",
    ],
)
def test_spellings_of_one_joint(name):
    assert normalise_name(name) == "left_shoulder"


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("thorax", "neck"),
        ("Pelvis", "mid_hip"),
        ("MidHip", "mid_hip"),
        ("head", "head_top"),
        ("LBigToe", "left_big_toe"),
        ("leye", "left_eye"),
        ("rightankle", "right_ankle"),
        ("Lshoulder", "left_shoulder"),
        ("tail", None),
    ],
)
def test_aliases_map_onto_the_vocabulary(name, joint):
    (found,) = match_names((name,), PEOPLE)
    assert found == (-1 if joint is None else PEOPLE.keypoints.index(joint))


def test_a_joint_is_taken_once_and_its_own_name_wins():
    assert match_names(("thorax", "neck"), PEOPLE).tolist() == [-1, PEOPLE.keypoints.index("neck")]


def test_rays_are_ordered_by_the_vocabulary():
    """Keypoint 1 is no joint of the model, and the model's joint 1 is no keypoint."""
    rays = np.arange(9.0).reshape(3, 3)
    found = rays_by_joint(rays, np.array([2, -1, 0]), 3)
    np.testing.assert_array_equal(found, [rays[2], [np.nan] * 3, rays[0]])


def test_normalise_forgets_place_and_size_and_hidden_joints():
    rng = torch.Generator().manual_seed(0)
    pose, seen = torch.randn(4, 9, 2, generator=rng), torch.rand(4, 9, generator=rng) > 0.3
    first, _, _ = normalise(pose, seen)
    pose[~seen] = float("nan")
    second, centre, scale = normalise(3 * pose + 7, seen)
    torch.testing.assert_close(first[seen], second[seen], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(
        (second * scale[:, None, None] + centre[:, None])[seen], (3 * pose + 7)[seen]
    )


def test_lifter_does_not_look_at_hidden_joints():
    lifter = LifterModule(ModelConfig(29, 16, 1)).eval()
    pose, seen = torch.randn(2, 29, 2), torch.ones(2, 29, dtype=torch.bool)
    seen[:, 5:9] = False
    with torch.no_grad():
        first = lifter(pose, seen)[0]
        pose[:, 5:9] = 1e6
        torch.testing.assert_close(lifter(pose, seen)[0], first)


def unit_size(joints: np.ndarray) -> np.ndarray:
    return joints / np.sqrt((joints**2).sum(-1).mean(-1))[:, None, None]


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
    np.testing.assert_allclose(unit_size(joints), unit_size(true_joints.numpy()), rtol=0, atol=2e-5)
    np.testing.assert_allclose(log_deviation, true_log_deviation.numpy(), rtol=0, atol=1e-5)


def test_attention_to_large_scores_is_finite():
    """Exponentials of what is above 88 are not, in 32 bits; the largest is taken away first."""
    lifter, _ = load_lifter()
    name = "encoder.layers.0.self_attn.in_proj_weight"
    sharp = replace(lifter, weights={**lifter.weights, name: 100 * lifter.weights[name]})
    joints, _ = sharp(np.ones((3, 29, 2), np.float32), np.ones((3, 29), dtype=bool))
    assert np.isfinite(joints).all()


def test_gradient_of_the_loss():
    """Against finite differences, in double precision, through the whole network."""
    torch.manual_seed(0)
    lifter = LifterModule(ModelConfig(5, 4, 1, 1)).double()
    batch = Batch(
        torch.randn(2, 5, 2).double(),
        torch.ones(2, 5, dtype=torch.bool),
        torch.randn(2, 5, 3).double(),
    )
    weight = lifter.head.weight

    def loss_of(head: torch.Tensor) -> torch.Tensor:
        out = torch.func.functional_call(lifter, {"head.weight": head}, (batch.pose, batch.seen))
        error = out[0] - batch.target
        return torch.sqrt(error.square().sum(-1) + 1e-8).mean()

    assert torch.autograd.gradcheck(loss_of, (weight.detach().clone().requires_grad_(),))
    assert torch.isfinite(lifting_loss(lifter, batch))


def test_targets_are_what_is_seen(poses):
    """Without noise, outliers and perspective, the visible part of the target is the input."""
    config = replace(SMALL, noise=(1e-9, 1e-9), outliers=0.0, distance=(1e4, 1e4), joint_spread=0.0)
    batch = Synthesiser(poses, PEOPLE, config, seed=1).batch(64)
    torch.testing.assert_close(
        batch.target[..., :2][batch.seen], batch.pose[batch.seen], atol=2e-3, rtol=0
    )


def test_views_are_upright_rotations(poses):
    views = Synthesiser(poses, PEOPLE, replace(SMALL, roll_deg=0.0), seed=2)._views(200)
    torch.testing.assert_close(
        views @ views.transpose(1, 2), torch.eye(3).expand_as(views), atol=1e-5, rtol=0
    )
    assert (views[:, 1, 2] < 0).all()  # the image's down is the world's down


def test_views_roll_as_far_as_is_said(poses):
    """The image's right points up by the sine of the roll."""
    views = Synthesiser(poses, PEOPLE, replace(SMALL, roll_deg=5.0), seed=2)._views(500)
    assert np.degrees(np.arcsin(views[:, 0, 2].numpy()).std()) == pytest.approx(5.0, rel=0.2)


def test_joints_are_hidden_the_more_the_more_is_said(poses):
    """Without scattered ones, layouts and limbs still hide some."""
    seen = []
    for occlusion in (0.0, 0.8):
        config = replace(SMALL, occlusion=occlusion)
        known = torch.ones(500, len(PEOPLE.keypoints), dtype=torch.bool)
        hidden = Synthesiser(poses, PEOPLE, config, seed=3)._hide_joints(known)
        seen.append(float(hidden.double().mean()))
    assert seen[1] + 0.1 < seen[0] < 0.99


def test_depths_are_told_from_the_mean_of_the_joints_that_are_seen():
    """In the units of the pose: a joint 0.3 behind that, 6 away, is 0.05 / scale behind it."""
    points, depth = torch.zeros(1, 3, 3), torch.tensor([[5.7, 6.3, 6.6]])
    seen = torch.tensor([[True, True, False]])
    found = _target(points, depth, seen, centre=torch.zeros(1, 2), scale=torch.tensor([0.1]))
    expected = torch.tensor([[-0.5, 0.5, 1.0]])
    torch.testing.assert_close(found[..., 2], expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("steps", "first"), [(100, 1 / 25), (20, 1.0)])
def test_a_training_of_more_than_twenty_steps_begins_with_small_ones(steps, first):
    """Adam's first step is the learning rate, whatever the gradient."""
    model = torch.nn.Linear(1, 1, bias=False)
    seen: list[float] = []

    def next_loss() -> torch.Tensor:
        seen.append(model.weight.item())
        return model.weight.sum()

    optimise(model, next_loss, TrainConfig(steps=steps, learning_rate=0.01), progress=silent)
    assert seen[0] - seen[1] == pytest.approx(0.01 * first, rel=0.01)
    assert seen[-2] - seen[-1] < 1e-4


def test_same_seed_same_weights(poses):
    first, second, other = (
        train_lifter(poses, PEOPLE, replace(SMALL, seed=s), progress=silent) for s in (0, 0, 1)
    )
    same = [
        torch.equal(a, b)
        for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    ]
    assert all(same)
    assert not torch.equal(first.head.weight, other.head.weight)


@pytest.mark.parametrize("steps", [1, 19, 20, 21])
def test_training_may_be_as_short_as_one_likes(steps):
    """Twenty steps have a warm-up of exactly one, by which torch cannot divide."""
    model = torch.nn.Linear(1, 1)
    said = []
    optimise(
        model,
        lambda: model(torch.ones(1)).square().sum(),
        replace(SMALL, steps=steps),
        progress=lambda *step: said.append(step[1:]),
    )
    assert said == [(done, steps) for done in range(1, steps + 1)]


def test_training_lowers_the_loss(poses):
    losses = []
    train_lifter(
        poses,
        PEOPLE,
        replace(SMALL, steps=60, batch=32),
        progress=lambda stage, *_: losses.append(float(stage.split()[-1].rstrip(")"))),
    )
    assert np.mean(losses[-10:]) < 0.9 * np.mean(losses[:5])  # measured 0.6


def test_checkpoint_round_trip(tmp_path):
    lifter = LifterModule(ModelConfig(29, 16, 1)).eval()
    save_model(tmp_path / "w.safetensors", lifter, PEOPLE, {"data": "none"})
    found, skeleton = load_steerer(tmp_path / "w.safetensors")
    assert skeleton == PEOPLE
    assert found.config == lifter.config
    assert all(
        torch.equal(a, b)
        for a, b in zip(lifter.state_dict().values(), found.state_dict().values(), strict=True)
    )


def test_shipped_weights_are_small_and_speak_for_themselves():
    from importlib import resources

    from safetensors import safe_open

    path = resources.files("mocap_calib") / "weights" / "people.safetensors"
    assert path.stat().st_size < 2e6
    with safe_open(str(path), framework="pt") as file:
        description = file.metadata()["mocap_calib"]
    for word in ("mocap-calib train", "held_out_error", "NSF EIA-0196217", "terms"):
        assert word in description


def test_not_weights(tmp_path):
    (tmp_path / "w.safetensors").write_bytes(b"not weights at all")
    with pytest.raises(FormatError, match="expected weights that `train` wrote"):
        load_lifter(tmp_path / "w.safetensors")
    with pytest.raises(FormatError, match="found neither"):
        load_lifter(tmp_path / "missing.safetensors")


def test_poses_of_other_joints_are_refused(tmp_path):
    np.savez(tmp_path / "p.npz", poses=np.zeros((10, 2, 3)), joints=np.array(["nose", "neck"]))
    with pytest.raises(MismatchError, match="nose, neck"):
        load_poses(tmp_path / "p.npz", PEOPLE, "train")


def test_poses_of_a_folder_have_their_names_beside_them(tmp_path):
    """And no file of poses is unpacked into objects, which could run anything."""
    names, poses = ["nose", "neck", "left_hip", "right_hip"], np.ones((20, 4, 3))
    np.savez(tmp_path / "poses3d.npz", poses=poses)
    (tmp_path / "joints.json").write_text(json.dumps({"names": names}), encoding="utf-8")
    assert len(load_poses(tmp_path, PEOPLE, "train").poses) > 10
    np.savez(tmp_path / "p.npz", poses=poses.astype(object), joints=np.array(names))
    with pytest.raises(FormatError, match="expected an npz file of 3D poses"):
        load_poses(tmp_path / "p.npz", PEOPLE, "train")


def test_lifted_bodies_are_where_and_how_they_are():
    """Against the truth of a scene.

    Measured: median joint error 0.16 body sizes, median distance error 4 %; bounds at twice that.
    """
    made, found = (
        scene(noise_px=1.0, missing=0.0, outliers=0.0),
        recording(noise_px=1.0, missing=0.0, outliers=0.0),
    )
    bodies = lift(found, load_lifter()[0], progress=silent)
    error, distance = [], []
    for view in range(len(made.rig.cameras)):
        true = made.poses @ made.rig.rotation[view].T + made.rig.translation[view]
        middle = true.mean(2, keepdims=True)
        size = np.sqrt(((true - middle) ** 2).sum(-1).mean(-1))[..., None]
        frame, instance = np.nonzero(
            (made.identity[view] >= 0) & np.isfinite(bodies.centre[view, ..., 0])
        )
        who = made.identity[view, frame, instance]
        body = (true - middle)[frame, who] / size[frame, who][..., None]
        error.append(np.linalg.norm(bodies.body[view, frame, instance] - body, axis=-1).mean(-1))
        place = np.linalg.norm(middle[frame, who, 0], axis=-1) / size[frame, who, 0]
        distance.append(np.linalg.norm(bodies.centre[view, frame, instance], axis=-1) / place)
    assert np.median(np.concatenate(error)) < 0.35
    assert abs(np.median(np.concatenate(distance)) - 1) < 0.1


def test_lifting_is_covariant_to_the_virtual_camera():
    """A camera turned about its own axes, seeing the same rays, lifts the same bodies, turned."""
    found = recording()
    turn = matrix_from_vector(np.array([0.0, 0.25, 0.0]))
    turned = replace(found, rays=found.rays @ turn.T)
    first, second = (lift(r, load_lifter()[0], progress=silent) for r in (found, turned))
    error = np.linalg.norm(second.body - first.body @ turn.T, axis=-1)
    assert np.nanmedian(error) < 0.05  # not zero: upright means the camera's upright
