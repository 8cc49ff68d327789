"""Formats of poses that are only written: other programs find our joints where they are."""

import ast
import base64
import importlib.util
import json
import re
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from runpy import run_path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from golden.command import call
from scipy.spatial.transform import Rotation

import mocap_calib as mc
from mocap_calib.types import World

FLOOR = World("floor", up=np.array([0.0, 0, 1]), floor=np.zeros(3))
COCO = ("nose", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist")
COCO += ("right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle")
COCO += ("right_ankle",)
FPS = 29.97


def made(keypoints=None, missing=0.0, **changes) -> tuple[mc.Poses3D, mc.CameraRig]:
    """Return the poses of a simulated scene, z up, on the floor; and its cameras."""
    scene = mc.simulate(replace(mc.SimulateConfig(frames=60), **{"people": 1, **changes}))
    there = np.isfinite(scene.poses).all((0, 1, 3))
    names = keypoints or tuple(n for n, k in zip(scene.joints, there, strict=True) if k)
    points = scene.poses[:, :, [scene.joints.index(name) for name in names]].copy()
    points[np.random.default_rng(0).random(points.shape[:3]) < missing] = np.nan
    return bare(names, points, world=FLOOR), scene.rig


def bare(names, points: np.ndarray, unit="m", **changes) -> mc.Poses3D:
    nothing, views = np.full(points.shape[:3], np.nan), np.zeros(points.shape[:3], dtype=np.int64)
    frames = np.arange(10, 10 + len(points))
    return mc.Poses3D(names, frames, points, nothing, views, nothing, unit, **changes)


# --- BVH


def forward_kinematics(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Return name -> `[frame, 3]` of the joints of a BVH file, its channels, and the time step."""
    words = iter(path.read_text().split())
    joints, open_ = [], []
    for word in words:
        if word in ("ROOT", "JOINT", "End"):
            joints.append({"name": next(words), "above": open_[-1] if open_ else -1, "channels": 0})
        elif word == "{":
            open_.append(len(joints) - 1)
        elif word == "}":
            open_.pop()
        elif word == "OFFSET":
            joints[open_[-1]]["offset"] = np.array([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            count = int(next(words))
            order = [next(words) for _ in range(count)][-3:]
            assert order == ["Zrotation", "Xrotation", "Yrotation"]
            joints[open_[-1]]["channels"] = count
        elif word == "MOTION":
            break
    assert next(words) == "Frames:"
    frames = int(next(words))
    assert (next(words), next(words)) == ("Frame", "Time:")
    step = float(next(words))
    table = np.array([float(word) for word in words]).reshape(frames, -1)
    turns, places, column = [], [], 0
    for joint in joints:
        own = table[:, column : column + joint["channels"]]
        column += joint["channels"]
        angles = own[:, -3:] if own.size else np.zeros((frames, 3))
        turn = Rotation.from_euler("ZXY", angles, degrees=True).as_matrix()
        above = joint["above"]
        places.append(own[:, :3] if above < 0 else places[above] + turns[above] @ joint["offset"])
        turns.append(turn if above < 0 else turns[above] @ turn)
    assert column == table.shape[1]
    return {j["name"]: p for j, p in zip(joints, places, strict=True)}, table, step


@pytest.mark.parametrize(
    ("keypoints", "changes", "root"),
    [
        (None, {}, "mid_hip"),
        (COCO, {}, "hips"),
        (("mid_hip", "spine", "neck", "head_top"), {}, "mid_hip"),  # nothing says where left is
        (None, {"people": 0, "animals": (("quadruped", 1),)}, None),
        (None, {"people": 0, "animals": (("bird", 1),)}, None),
    ],
)
def test_joints_of_a_bvh_are_where_the_points_are(keypoints, changes, root, tmp_path):
    """But for what bone lengths vary by: nothing in simulated bodies, 0.01 mm of rounding. COCO has
    no bones in its trunk: hips and shoulders are joined, which give way by 30 mm (measured).
    """
    poses, _ = made(keypoints, **changes)
    mc.write(poses, tmp_path / "x.bvh", fps=FPS)
    found, table, step = forward_kinematics(tmp_path / "x.bvh")
    assert step == pytest.approx(1 / FPS)
    assert root in (None, next(iter(found)))
    upright = poses.positions[:, 0][..., [1, 2, 0]]  # z up -> y up
    compared = [k for k, name in enumerate(poses.keypoints) if name in found]
    assert len(compared) >= len(poses.keypoints) - 1
    error = [np.linalg.norm(found[poses.keypoints[k]] - upright[:, k], axis=-1) for k in compared]
    assert np.max(error) < (0.06 if keypoints == COCO else 2e-5)
    assert np.abs(np.diff(table[:, 3:], axis=0)).max() < 350, "angles do not jump by a turn"


def test_a_bvh_goes_through_gaps(tmp_path):
    """A fifth of the points missing: median 7 mm off (measured). Absent frames repeat the last."""
    poses, _ = made(COCO, missing=0.2)
    whole = made(COCO)[0].positions[:, 0][..., [1, 2, 0]]
    mc.write(poses, tmp_path / "x.bvh", fps=FPS)
    found = forward_kinematics(tmp_path / "x.bvh")[0]
    error = [
        np.linalg.norm(found[name] - whole[:, k], axis=-1)
        for k, name in enumerate(COCO)
        if name in found
    ]
    assert np.isfinite(error).all()
    assert np.median(error) < 0.02
    late = replace(poses, frames=np.where(np.arange(60) < 30, 10, 15) + np.arange(60))
    mc.write(late, tmp_path / "y.bvh", fps=FPS)
    for each in forward_kinematics(tmp_path / "y.bvh")[0].values():
        assert len(each) == 65
        np.testing.assert_allclose(each[30:35], each[29:30].repeat(5, axis=0))


@pytest.mark.parametrize("name", ["bvh", "blender"])
@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_bodies_that_were_never_seen_are_written(name, frames, value, tmp_path):
    points = np.full((frames, 1, len(COCO), 3), value)
    mc.write(bare(COCO, points, "arbitrary"), tmp_path / "x", name, fps=30.0)
    assert not re.search(r"\bnan\b", (tmp_path / "x").read_text())


# --- Blender


def as_run(folder: Path, poses: mc.Poses3D, rig: mc.CameraRig) -> None:
    """Write poses and cameras as a run does: only then is the rig known beside them."""
    mc.write(poses, folder / "poses3d.h5", fps=FPS)
    mc.write(rig, folder / "cameras.yaml")


def scene_of(path: Path) -> dict[str, Any]:
    """Return what a script for Blender says it builds."""
    assigned = re.search(r"^SCENE = (\(.*?^\))", path.read_text(), re.M | re.S)
    return json.loads(zlib.decompress(base64.b64decode(ast.literal_eval(assigned[1]))))


def odd_cameras(rig: mc.CameraRig) -> mc.CameraRig:
    """Return cameras of focal lengths that differ and shifted middles, in images of two sizes."""
    cameras = [
        replace(
            camera,
            matrix=np.array([[900.0, 0, 650 + k], [0, 870 + 20 * k, 340], [0, 0, 1]]),
            size=(1280, 720) if k % 2 else (1000, 1100),
            distortion=np.zeros(5),
        )
        for k, camera in enumerate(rig.cameras)
    ]
    return replace(rig, cameras=tuple(cameras))


def test_a_blender_scene_has_all_that_is_known(tmp_path):
    poses, rig = made(COCO, people=2)
    as_run(tmp_path, poses, rig)
    for source in (".", "poses3d.h5"):
        done = call("convert", source, f"{len(source)}.py", "--to", "blender", folder=tmp_path)
        assert done.status == 0
    assert (tmp_path / "1.py").read_bytes() == (tmp_path / "10.py").read_bytes()
    said = scene_of(tmp_path / "1.py")
    assert (len(said["bodies"]), len(said["cameras"]), said["floor"][2]) == (2, 4, 0)
    tracks = np.array(said["bodies"][1]["tracks"], dtype=float).swapaxes(0, 1)
    np.testing.assert_allclose(tracks, poses.positions[:, 1], atol=1e-4)
    hip = COCO.index("left_hip")
    assert [hip, COCO.index("left_knee")] in said["edges"]
    mc.write(rig.scale(1000, "mm"), tmp_path / "cameras.yaml")
    done = call("convert", ".", "other.py", "--to", "blender", folder=tmp_path)
    assert "left out" in "\n".join(done.stderr)
    mc.write(replace(poses, world=World()), tmp_path / "bare.py", fps=FPS)
    for name, floor in (("other.py", [0, 0]), ("bare.py", None)):
        said = scene_of(tmp_path / name)
        assert said["cameras"] == []
        assert (said["floor"] is None) == (floor is None)


def test_cameras_of_a_blender_scene_see_what_ours_see(tmp_path):
    """Its camera model, sensor 1 wide: focal length and shifts in widths, pixels not square."""
    poses, rig = made(COCO)
    rig = odd_cameras(rig)
    as_run(tmp_path, poses, rig)
    assert call("convert", ".", "x.py", "--to", "blender", folder=tmp_path).status == 0
    place = np.nanmean(poses.positions, axis=(0, 1, 2))
    expected = rig.project(place)
    for said, camera, pixel in zip(
        scene_of(tmp_path / "x.py")["cameras"], rig.cameras, expected, strict=True
    ):
        x, y, z, _ = np.linalg.solve(said["matrix"], [*place, 1.0])
        wide, high = camera.size[0] * said["aspect_x"], camera.size[1] * said["aspect_y"]
        right, up = said["lens"] * np.array([x, y]) / -z - said["shift"]
        found = [
            camera.size[0] * (0.5 + right) - 0.5,
            camera.size[1] * (0.5 - up * wide / high) - 0.5,
        ]
        np.testing.assert_allclose(found, pixel, atol=1e-6)


@pytest.fixture
def script(tmp_path, monkeypatch) -> dict[str, Any]:
    """The functions of a script; what Blender does is left out."""
    for name in ("bmesh", "bpy", "mathutils"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    mc.write(bare(COCO, np.ones((2, 1, len(COCO), 3))), tmp_path / "x.py", fps=30.0)
    return run_path(str(tmp_path / "x.py"))


def test_bodies_of_a_blender_scene_differ_in_colour_and_keep_time(script):
    """Seven bodies, more than there are colours."""
    colours: list[tuple[float, ...]] = []
    script["build"].__globals__["build_body"] = lambda *given: colours.append(given[-1])
    nothing = {"title": "", "frames": [10, 11, 13], "fps": FPS, "cameras": [], "floor": None}
    scene = script["build"]({**nothing, "bodies": list(range(7))})
    assert scene.render.fps / scene.render.fps_base == pytest.approx(FPS)
    assert (scene.frame_start, scene.frame_end) == (10, 13)
    assert len(set(colours)) == 5
    assert colours[5:] == colours[:2]


def test_points_of_a_blender_scene_are_hidden_where_they_are_missing(script):
    """Keys where that changes, at the frames of the file; places where there are any."""
    keys: list[tuple[list[tuple[int, float]], str]] = []
    script["animate"].__globals__["add_keys"] = lambda _, key, kind: keys.append((key, kind))
    track = [[1.0, 2.0, 3.0], None, None, [4.0, 5.0, 6.0], [4.0, 5.0, 7.0]]
    script["animate"](MagicMock(), [10, 11, 13, 14, 15], track)
    places = [
        ([(10, a), (14, b), (15, c)], "LINEAR")
        for a, b, c in zip(track[0], *track[3:], strict=True)
    ]
    assert keys == places + 2 * [([(10, 0.0), (11, 1.0), (14, 0.0)], "CONSTANT")]


def test_rerun_is_written_where_its_package_is(tmp_path):
    """tests/golden holds the refusal elsewhere."""
    if importlib.util.find_spec("rerun") is None:
        pytest.skip("the package rerun-sdk is not installed")
    as_run(tmp_path, *made(COCO, missing=0.2))
    assert call("convert", ".", "x.rrd", folder=tmp_path).status == 0
    content = (tmp_path / "x.rrd").read_bytes()
    assert content.startswith(b"RRF")
    assert all(name.encode() in content for name in ("individual_0", "cam1", "left_wrist"))
