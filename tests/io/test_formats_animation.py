"""Formats that are only written: what other programs make of them is where our joints are."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from pathlib import Path
from runpy import run_path
from unittest.mock import MagicMock

import c3d
import numpy as np
import pytest
from scenes import scene

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.conversion import convert_poses, load_pose_sources
from mocap_calib.io.poses.axes import turn_between, turn_up_axis, turn_upright, up_axis
from mocap_calib.io.poses.blender import describe_scene
from mocap_calib.io.poses.bvh import _angles
from mocap_calib.io.poses.bvh_motion import find_motion, make_tree, place_joints
from mocap_calib.io.poses.common import PoseFile, bare_poses, known_edges
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.poses.opensim import marker_names
from mocap_calib.io.poses.read import parse_poses
from mocap_calib.io.poses.write import format_poses, write_poses
from mocap_calib.io.registry import find_format
from mocap_calib.recording.joints import match_names
from mocap_calib.types import World

FLOOR = World("floor", up=np.array([0.0, 0, 1]), floor=np.zeros(3))
COCO = (
    *("nose", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist"),
    *("right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle"),
    "right_ankle",
)
ONLY_WRITTEN = [each.name for each in POSE_FORMATS if each.only_written]


def described(keypoints=None, missing=0.0, **changes):
    """A simulated scene; z up, on the floor."""
    made = scene(**{"people": 1, "frames": 60, **changes})
    there = np.isfinite(made.poses).all((0, 1, 3))
    names = keypoints or tuple(n for n, k in zip(made.joints, there, strict=True) if k)
    points = made.poses[:, :, [made.joints.index(name) for name in names]].copy()
    points[np.random.default_rng(0).random(points.shape[:3]) < missing] = np.nan
    frames = np.arange(10, 10 + len(points))
    poses = replace(bare_poses(names, frames, points, unit="m"), world=FLOOR)
    return PoseFile(poses, 29.97, rig=made.rig)


def only(written):
    (content,) = written.files.values()
    return content


# --- BVH


def forward_kinematics(text):
    """Return name -> `[frame, 3]` of the joints of a BVH file, and the seconds of a frame."""
    words = iter(text.split())
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
        z, x, y = np.radians(own[:, -3:]).T if own.size else np.zeros((3, frames))
        turn = about(2, z) @ about(0, x) @ about(1, y)
        if joint["above"] < 0:
            places.append(own[:, :3])
            turns.append(turn)
        else:
            above = joint["above"]
            places.append(places[above] + turns[above] @ joint["offset"])
            turns.append(turns[above] @ turn)
    assert column == table.shape[1]
    return {j["name"]: p for j, p in zip(joints, places, strict=True)}, step


def about(axis, angle):
    """Return rotations `[frame, 3, 3]` about an axis."""
    turn = np.zeros((len(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn[:, axis, axis] = 1
    turn[:, a, a] = turn[:, b, b] = np.cos(angle)
    turn[:, b, a] = np.sin(angle)
    turn[:, a, b] = -turn[:, b, a]
    return turn


@pytest.mark.parametrize(
    ("keypoints", "changes"),
    [
        (None, {}),
        (COCO, {}),
        (("mid_hip", "spine", "neck", "head_top"), {}),  # nothing says where left is
        (None, {"people": 0, "animals": (("quadruped", 1),)}),
        (None, {"people": 0, "animals": (("bird", 1),)}),
    ],
)
def test_joints_of_a_bvh_are_where_the_points_are(keypoints, changes):
    """But for what bone lengths vary by: nothing in simulated bodies, 0.01 mm of rounding. COCO has
    no bones in its trunk: hips and shoulders are joined, which give way by 30 mm (measured).
    """
    file = described(keypoints, **changes)
    found, step = forward_kinematics(only(format_poses(file, "bvh", Path("x.bvh"))).decode())
    assert step == pytest.approx(1 / 29.97)
    upright = file.poses.positions[:, 0][..., [1, 2, 0]]  # z up -> y up
    compared = [k for k, name in enumerate(file.poses.keypoints) if name in found]
    assert len(compared) >= len(file.poses.keypoints) - 1
    error = [
        np.linalg.norm(found[file.poses.keypoints[k]] - upright[:, k], axis=-1) for k in compared
    ]
    assert np.max(error) < (0.06 if keypoints == COCO else 2e-5)


def test_what_is_missing_stays_as_it_was():
    file = described(COCO, missing=0.2)
    whole = described(COCO).poses.positions[:, 0][..., [1, 2, 0]]
    found, _ = forward_kinematics(only(format_poses(file, "bvh", Path("x.bvh"))).decode())
    error = np.stack(
        [
            np.linalg.norm(found[name] - whole[:, k], axis=-1)
            for k, name in enumerate(COCO)
            if name in found
        ]
    )
    assert np.isfinite(error).all()
    assert np.median(error) < 0.02  # metres; measured 0.007
    gap = replace(file.poses, frames=np.where(np.arange(60) < 30, 10, 15) + np.arange(60))
    again, _ = forward_kinematics(
        only(format_poses(replace(file, poses=gap), "bvh", Path("x.bvh"))).decode()
    )
    assert all(len(each) == 65 for each in again.values())
    for each in again.values():
        np.testing.assert_allclose(each[30:35], each[29:30].repeat(5, axis=0))


def test_a_tree_has_its_root_at_the_hips():
    tree = make_tree(described(COCO))
    assert tree.names[0] == "hips"
    assert {tree.names[k] for k in tree.children(0)} == {"left_hip", "right_hip"}
    assert all(parent < k for k, parent in enumerate(tree.parents))
    assert make_tree(described()).names[0] == "mid_hip"
    file = described()
    points = place_joints(make_tree(file), turn_upright(file, "y").poses.positions[:, 0])
    motion = find_motion(make_tree(file), points)
    left = motion.offsets[make_tree(file).names.index("left_hip")]
    assert left[0] > 0.9 * np.linalg.norm(left)  # x is left, y up
    neck = motion.offsets[make_tree(file).names.index("neck")]
    assert neck[1] > 0.8 * np.linalg.norm(neck)


def test_bodies_that_no_skeleton_joins_are_refused_in_a_line():
    poses = bare_poses(("a", "b"), np.arange(3), np.zeros((3, 1, 2, 3)), unit="m")
    with pytest.raises(MismatchError, match="that a skeleton joins"):
        format_poses(PoseFile(poses, 30.0), "bvh", Path("x"))


@pytest.mark.parametrize("name", ["bvh", "blender"])
@pytest.mark.parametrize("frames", [1, 4])
def test_bodies_that_were_never_seen_are_written(name, frames):
    for value in (0.0, np.nan):
        points = np.full((frames, 1, len(COCO), 3), value)
        poses = bare_poses(COCO, np.arange(frames), points, unit="arbitrary")
        assert "nan" not in only(format_poses(PoseFile(poses, 30.0), name, Path("x"))).decode()


def test_the_smallest_turn_between_two_directions():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 50, 3))
    b[0], b[1], b[2] = a[0], -3 * a[1], 0
    turn = turn_between(a, b)
    np.testing.assert_allclose(
        turn @ turn.swapaxes(-1, -2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-9
    )
    turned = np.einsum("nij,nj->ni", turn, a)
    along = np.linalg.norm(a, axis=-1, keepdims=True) * b
    np.testing.assert_allclose(
        turned[3:], (along / np.linalg.norm(b, axis=-1, keepdims=True).clip(1e-9))[3:], atol=1e-9
    )
    np.testing.assert_allclose(turned[1], -a[1], atol=1e-9)
    np.testing.assert_allclose(turn[[0, 2]], np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)


# --- axes, units and names


@pytest.mark.parametrize("seed", range(4))
def test_what_is_up_becomes_the_axis_of_the_format(seed):
    """Poses and cameras together: pixels stay. A world that says nothing stays as it is."""
    file = described()
    up = np.random.default_rng(seed).normal(size=3)
    turn = turn_between(np.array([0.0, 0, 1]), up)
    away = replace(
        file,
        poses=file.poses.turn(turn),
        rig=replace(file.rig, rotation=file.rig.rotation @ turn.T),
    )
    for axis in ("y", "z"):
        back = turn_upright(away, axis)
        assert up_axis(back) == axis
        height = back.poses.positions[..., "xyz".index(axis)]
        np.testing.assert_allclose(height, file.poses.positions[..., 2], atol=1e-9)
        pixels = [each.rig.project(each.poses.positions[0, 0]) for each in (file, back)]
        np.testing.assert_allclose(*pixels, atol=1e-6)
    silent = replace(file, poses=replace(file.poses, world=World()))
    assert turn_upright(silent, "y") is silent
    assert up_axis(silent) == ""
    assert up_axis(turn_up_axis(silent, "-y")) == "y"


def test_trc_and_c3d_of_a_floor_are_upright_in_their_units_and_names(tmp_path):
    file = described(COCO)
    back = parse_poses(only(format_poses(file, "trc", Path("x.trc"))), "x")
    np.testing.assert_allclose(back.poses.positions, file.poses.positions[..., [1, 2, 0]])
    assert back.poses.unit == "m"
    assert back.poses.keypoints[:3] == ("Nose", "LShoulder", "RShoulder")
    assert (match_names(back.poses.keypoints, scene_skeleton()) >= 0).all()
    content = only(format_poses(file, "c3d", Path("x.c3d")))
    back = parse_poses(content, "x")
    np.testing.assert_allclose(back.poses.positions, 1000 * file.poses.positions, rtol=1e-6)
    (tmp_path / "x.c3d").write_bytes(content)
    with (tmp_path / "x.c3d").open("rb") as handle, pytest.warns(UserWarning, match="analog"):
        reader = c3d.Reader(handle)
    assert reader.get("POINT:Y_SCREEN").string_value == "+Z"
    assert back.poses.unit == "mm"
    unknown = replace(file, poses=replace(file.poses, unit="arbitrary"))
    for name in ("trc", "c3d"):
        with pytest.raises(MismatchError, match="arbitrary"):
            format_poses(unknown, name, Path("x"))


def scene_skeleton():
    from mocap_calib.recording.joints import load_skeleton

    return load_skeleton("people")


def test_markers_of_people_are_called_as_opensim_s():
    def named(*names):
        poses = bare_poses(names, np.arange(1), np.zeros((1, 1, len(names), 3)), unit="m")
        return marker_names(PoseFile(poses))

    assert named("pelvis", "l_knee", "LeftBigToe", "watch") == ("Hip", "LKnee", "LBigToe", "watch")
    assert named("left_hip", "LHip", "neck") == ("left_hip", "LHip", "neck")  # else one twice
    assert named("withers", "tail_base", "left_elbow") == ("withers", "tail_base", "left_elbow")


# --- Blender and rerun


def test_a_blender_scene_has_all_that_is_known():
    file = described(COCO, people=2)
    said = describe_scene(file)
    assert len(said["bodies"]) == 2
    assert len(said["cameras"]) == 4
    assert said["floor"][2] == 0
    assert {tuple(edge) for edge in said["edges"]} == set(known_edges(file))
    bare = describe_scene(replace(file, rig=None, poses=replace(file.poses, world=World())))
    assert (bare["cameras"], bare["floor"]) == ([], None)
    assert only(format_poses(file, "blender", Path("x"))) == only(
        format_poses(file, "blender", Path("x"))
    )


def test_cameras_of_a_blender_scene_see_what_ours_see():
    """Its camera model, sensor 1 wide: focal length and shifts in widths, pixels not square."""
    file = described(COCO)
    for k, camera in enumerate(file.rig.cameras):
        matrix = np.array([[900.0, 0, 650 + k], [0, 870 + 20 * k, 340], [0, 0, 1]])
        size = (1280, 720) if k % 2 else (1000, 1100)
        rig = file.rig.select(np.array([k]))
        rig = replace(rig, cameras=(replace(camera, matrix=matrix, size=size),))
        said = only_camera(describe_scene(replace(file, rig=rig)))
        place = rig.centres[0] + rig.rotation[0].T @ [0.3, -0.2, 4.0]
        x, y, z, _ = np.linalg.solve(said["matrix"], [*place, 1.0])
        wide, high = size[0] * said["aspect_x"], size[1] * said["aspect_y"]
        right, up = said["lens"] * np.array([x, y]) / -z - said["shift"]
        pixel = [size[0] * (0.5 + right) - 0.5, size[1] * (0.5 - up * wide / high) - 0.5]
        expected = matrix[:2, :2] @ [0.3 / 4, -0.2 / 4] + matrix[:2, 2]
        np.testing.assert_allclose(pixel, expected, atol=1e-6)


def only_camera(said):
    """Return the camera of a scene that has one."""
    (camera,) = said["cameras"]
    return camera


CHECK = """
import json, runpy, sys
import bpy
from bpy_extras.object_utils import world_to_camera_view
made = runpy.run_path(sys.argv[-1], run_name="__main__")
scene = bpy.data.scenes["poses"]
scene.frame_set(18)
seen = scene.view_layers[0].depsgraph
place = lambda name: bpy.data.objects[name].evaluated_get(seen).matrix_world.translation
cameras = {}
for camera in bpy.data.collections["cameras"].objects:
    made["look_through"](scene, camera)
    scene.view_layers[0].update()
    x, y, z = world_to_camera_view(scene, camera, place("individual_1 left_wrist"))
    cameras[camera.name] = [x * camera["width"] - 0.5, (1 - y) * camera["height"] - 0.5]
bone = bpy.data.objects["individual_0 bones"].evaluated_get(seen).pose.bones["left_hip-left_knee"]
print("FOUND", json.dumps({
    "cameras": cameras,
    "knee": [list(bone.tail), list(place("individual_0 left_knee"))],
    "hidden": bpy.data.objects["individual_0 left_elbow"].hide_render,
    "objects": len(scene.objects),
    "range": [scene.frame_start, scene.frame_end, scene.render.fps / scene.render.fps_base],
    "floor": "floor" in scene.objects,
}))
"""


def test_bodies_of_a_blender_scene_differ_in_colour_and_keep_time(monkeypatch):
    """Seven bodies, more than there are colours; what Blender does is left out."""
    for name in ("bmesh", "bpy", "mathutils"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    script = resources.files("mocap_calib.io.poses") / "blender_scene.py"
    made = run_path(str(script))
    colours: list[tuple[float, ...]] = []
    made["build"].__globals__["build_body"] = lambda _scene, _said, _body, one: colours.append(one)
    nothing = {"title": "", "frames": [10, 11, 13], "fps": 29.97, "cameras": [], "floor": None}
    scene = made["build"]({**nothing, "bodies": list(range(7))})
    assert scene.render.fps / scene.render.fps_base == pytest.approx(29.97)
    assert (scene.frame_start, scene.frame_end) == (10, 13)
    assert len(set(colours)) == 5
    assert colours[5:] == colours[:2]


def test_points_of_a_blender_scene_are_hidden_where_they_are_missing(monkeypatch):
    """Keys where that changes, at the frames of the file; places where there are any."""
    for name in ("bmesh", "bpy", "mathutils"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    made = run_path(str(resources.files("mocap_calib.io.poses") / "blender_scene.py"))
    keys: list[tuple[list[tuple[int, float]], str]] = []
    made["animate"].__globals__["add_keys"] = lambda _, key, kind: keys.append((key, kind))
    track = [[1.0, 2.0, 3.0], None, None, [4.0, 5.0, 6.0], [4.0, 5.0, 7.0]]
    made["animate"](MagicMock(), [10, 11, 13, 14, 15], track)
    places = [
        ([(10, a), (14, b), (15, c)], "LINEAR")
        for a, b, c in zip(track[0], *track[3:], strict=True)
    ]
    assert keys == places + 2 * [([(10, 0.0), (11, 1.0), (14, 0.0)], "CONSTANT")]


@pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")
def test_blender_builds_what_we_mean(tmp_path):
    """Measured: 0.001 px. Focal lengths that differ and shifted middles, in images of two sizes."""
    file = described(COCO, people=2)
    file.poses.positions[8, 0, 3] = np.nan
    cameras = [
        replace(
            camera,
            matrix=np.array([[900.0, 0, 650 + k], [0, 870 + 20 * k, 340], [0, 0, 1]]),
            size=(1280, 720) if k % 2 else (1000, 1100),
        )
        for k, camera in enumerate(file.rig.cameras)
    ]
    rig = replace(file.rig, cameras=tuple(cameras))
    write_poses(tmp_path / "poses.blend.py", replace(file, rig=rig), "blender")
    (tmp_path / "check.py").write_text(CHECK, encoding="utf-8", newline="\n")
    done = subprocess.run(
        ["blender", "-b", "--factory-startup", "-noaudio", "--python-exit-code", "3", "--python"]
        + [tmp_path / "check.py", "--", tmp_path / "poses.blend.py"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("FOUND"))
    found = json.loads(line.removeprefix("FOUND"))
    wrist = file.poses.positions[8, 1, COCO.index("left_wrist")]
    for camera in rig:
        x, y, depth = camera.P @ np.append(wrist, 1)
        np.testing.assert_allclose(found["cameras"][camera.name], [x / depth, y / depth], atol=0.1)
    np.testing.assert_allclose(*found["knee"], atol=1e-4)
    knee = file.poses.positions[8, 0, COCO.index("left_knee")]
    np.testing.assert_allclose(found["knee"][1], knee, atol=1e-3)
    assert found["hidden"]
    assert found["objects"] == 2 * (len(COCO) + 1) + 4 + 1  # points, bones, cameras, floor
    assert found["range"] == pytest.approx([10, 69, 29.97])
    assert found["floor"]


def test_rerun_says_what_is_missing_or_writes_a_recording():
    try:
        import rerun  # noqa: F401
    except ImportError:
        with pytest.raises(MismatchError, match=r"mocap-calib\[rerun\]"):
            format_poses(described(), "rerun", Path("x"))
        pytest.skip("the package rerun-sdk is not installed")
    content = only(format_poses(described(COCO, missing=0.2), "rerun", Path("x")))
    assert content.startswith(b"RRF")
    assert all(name.encode() in content for name in ("individual_0", "cam1", "left_wrist"))


# --- reading and converting


@pytest.mark.parametrize("name", ONLY_WRITTEN)
def test_formats_that_are_only_written_are_not_read(name):
    known = find_format(POSE_FORMATS, name)
    assert not known.sniff(b"HIERARCHY")
    with pytest.raises(MismatchError, match="only written"):
        parse_poses(b"HIERARCHY", "there", name)


def test_the_cameras_of_a_run_go_with_its_poses(tmp_path):
    from mocap_calib.io.cameras.write import write_cameras

    file = described(COCO)
    write_poses(tmp_path / "poses3d.h5", replace(file, rig=None), "poses-h5")
    write_cameras(tmp_path / "cameras.yaml", file.rig, "mocap-calib")
    for source in (tmp_path, tmp_path / "poses3d.h5"):
        done = convert_poses([source], tmp_path / "new.py", "blender")
        assert done.notes == ()
        sizes = [(tmp_path / "new.py").stat().st_size]
        done = convert_poses([source], tmp_path / "new.npz", "npz")
    write_cameras(tmp_path / "cameras.yaml", file.rig.scale(1000, "mm"), "mocap-calib")
    done = convert_poses([tmp_path], tmp_path / "new.py", "blender")
    assert "left out" in done.notes[0]
    assert (tmp_path / "new.py").stat().st_size < min(sizes)
    assert load_pose_sources([tmp_path]).rate == 29.97


def test_angles_do_not_jump_by_a_turn():
    text = only(format_poses(described(COCO), "bvh", Path("x.bvh"))).decode()
    rows = [list(map(float, line.split())) for line in text.splitlines()[-60:]]
    assert (
        max(abs(b - a) for one, two in pairwise(rows) for a, b in zip(one, two, strict=True)) < 350
    )


@pytest.mark.parametrize("x", [-90.0, -30.0, 0.0, 45.0, 90.0])
def test_angles_of_a_bvh_make_the_turns_again(x):
    """Also where a limb points straight up, so that z and y turn about one axis."""
    angles = np.radians([[20.0, x, -70.0], [150.0, x, 30.0]])
    turns = turned_about_z_x_y(angles)
    found = turned_about_z_x_y(np.radians(_angles(turns, 2)))
    np.testing.assert_allclose(found, turns, atol=1e-6)


def turned_about_z_x_y(angles):
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    z, x, y = (matrix_from_vector(angles[:, [k]] * axis) for k, axis in enumerate(axes))
    return z @ x @ y
