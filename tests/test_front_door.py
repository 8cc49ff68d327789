"""`import mocap_calib`: quick, and every name of it there."""

import inspect
import json
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scenes
from scenes import PEOPLE, calibrated, scene

import mocap_calib
from mocap_calib import pipeline
from mocap_calib.io.cameras.read import load_cameras
from mocap_calib.io.poses.read import load_poses
from mocap_calib.lift.lifter import choose_model
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.results import Clocks
from mocap_calib.types import AssumedCamera
from mocap_calib_cli.options import READING

HEAVY = ("numpy", "torch", "scipy", "cv2", "h5py", "yaml")


def best_of_three(code: str) -> tuple[float, list[str]]:
    """Run Python three times; return the shortest time it says, and the modules it imported.

    The code sets `seconds`, of the processor: other work may run. The best counts.
    """
    code += "\nprint(seconds, *sys.modules)"
    best = np.inf
    for _ in range(3):
        said = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout
        seconds, *modules = said.splitlines()[-1].split(" ")
        best = min(best, float(seconds))
    return best, modules


def test_import_is_quick_and_light():
    """Measured 0.03 s, with the interpreter."""
    seconds, modules = best_of_three("""
import sys, time
import mocap_calib
seconds = time.process_time()
""")
    assert not {*HEAVY, "mocap_calib.config"} & set(modules)
    assert seconds < 0.1


def test_help_is_quick_and_light():
    """Measured 0.08 s, with the interpreter."""
    seconds, modules = best_of_three("""
import sys, time
sys.argv = ["mocap-calib", "--help"]
from mocap_calib_cli.main import main
try:
    main()
except SystemExit as end:
    assert end.code == 0
seconds = time.process_time()
""")
    assert not {*HEAVY, "rich"} & set(modules)
    assert seconds < 0.15


def test_cameras_need_no_torch():
    """Rigs are read, project, triangulate and are written without the network."""
    code = """
import sys, mocap_calib as mc
rig = mc.CameraRig([mc.Camera(name, (9, 9), [[9, 0, 4], [0, 9, 4], [0, 0, 1]]) for name in "ab"],
    [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]] * 2, [[0, 0, 0], [1, 0, 0]], "m")
rig.triangulate(rig.project([0, 0, 3]))
mc.read_rig, mc.write, mc.evaluate
assert not {"torch", "cv2"} & set(sys.modules), sorted(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", mocap_calib.__all__)
def test_every_name_resolves(name):
    value = getattr(mocap_calib, name)
    assert value.__name__ == name
    assert value.__doc__, "what users see first says what it is"
    assert name in dir(mocap_calib)


@pytest.mark.parametrize(
    ("function", "needed"),
    [
        (mocap_calib.calibrate, ["recording"]),
        (mocap_calib.match, ["recording", "rig"]),
        (mocap_calib.triangulate, ["recording", "rig", "matches"]),
        (mocap_calib.evaluate, ["rig", "reference"]),
        (mocap_calib.simulate, []),
        (mocap_calib.read_recording, ["keypoints"]),
        (mocap_calib.write, ["thing", "path"]),
    ],
)
def test_functions_need_nothing_but_data(function, needed):
    parameters = inspect.signature(function).parameters.values()
    assert [each.name for each in parameters if each.default is each.empty] == needed


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'frobnicate'"):
        _ = mocap_calib.frobnicate


# --- reading


def test_a_recording_is_read_with_the_options_of_the_command():
    parameters = inspect.signature(mocap_calib.read_recording).parameters
    reading = set(READING) - {"mirrored", "sides", "rotated", "resized", "exchanged"}
    assert {*reading, "skeleton", "model", "mends"} <= set(parameters)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with keypoints/ and cameras of a small scene, and 3D poses."""
    folder = tmp_path_factory.mktemp("files")
    made = scene(cameras=3, people=2, frames=30)
    mocap_calib.write(made.files, folder / "keypoints", format="coco")
    mocap_calib.write(made.rig, folder / "rig.toml")
    mocap_calib.write(_poses(), folder / "poses.npz")
    return folder


def _poses() -> mocap_calib.Poses3D:
    quality = np.ones((2, 1, 1))
    positions = np.arange(6.0).reshape(2, 1, 1, 3)
    return mocap_calib.Poses3D(["a"], [0, 1], positions, quality, quality, quality, "m")


def test_files_cameras_and_records_make_the_same_recording(files):
    """By path and by text; cameras of a file, a rig or a list; files or records."""
    read = mocap_calib.read_recording(str(files / "keypoints"), str(files / "rig.toml"))
    rig = mocap_calib.read_rig(str(files / "rig.toml"))
    names = [f"{name}={files / 'keypoints' / name}.json" for name in rig.names]
    assert read == mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    assert read == mocap_calib.read_recording(names, rig)
    assert read == mocap_calib.read_recording(names, mocap_calib.read_cameras(files / "rig.toml"))
    views = mocap_calib.read_keypoints(str(files / "keypoints"))
    assert read == mocap_calib.Recording.from_keypoints(views, rig)
    assert read.model == "people"
    assert read != mocap_calib.read_recording(names, rig, frame_offset={"cam1": 1})


def test_a_rig_takes_the_keypoints_of_its_cameras_alone(files):
    rig = mocap_calib.read_rig(files / "rig.toml").select(["cam3", "cam1"])
    recording = mocap_calib.read_recording(files / "keypoints", rig)
    assert recording.names == ("cam3", "cam1")
    with pytest.raises(mocap_calib.MismatchError, match="a camera of the same name"):
        mocap_calib.read_recording(files / "keypoints", rig.cameras)


def test_options_are_those_of_the_command(files):
    """What texts are for the command is plain data here."""
    read = mocap_calib.read_recording(
        files / "keypoints",
        files / "rig.toml",
        format="coco",
        camera_regex="cam[0-9]",
        crop_offset={"cam1": (10.0, 0.0)},
        model="none",
    )
    plain = mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    seen = plain.seen[0]
    moved = (read.positions[0] - plain.positions[0])[seen]
    np.testing.assert_allclose(moved, np.broadcast_to([10, 0], moved.shape), atol=1e-4)
    assert (read.model, set(read.vocabulary)) == ("none", {-1})
    with pytest.raises(mocap_calib.MismatchError, match=r"regular expression, found \(cam"):
        mocap_calib.read_recording(files / "keypoints", files / "rig.toml", camera_regex="(cam")
    with pytest.raises(mocap_calib.MismatchError, match="body_25"):
        mocap_calib.read_recording(files / "keypoints", files / "rig.toml", layout="body_99")


def test_without_cameras_their_intrinsics_are_a_guess_that_is_estimated(files, monkeypatch):
    """Image sizes are those of the files, or said for all cameras or for each."""
    read = mocap_calib.read_recording(files / "keypoints")
    assert {type(camera) for camera in read.cameras} == {AssumedCamera}
    assert read.cameras[0].focal == 1536
    asked = []

    def stop(sample, lifted, config, **others):  # noqa: ARG001
        asked.append(config.intrinsics.refine)
        raise mocap_calib.DegenerateError("", "", "", "")

    monkeypatch.setattr(pipeline, "calibrate_view_graph", stop)
    given = mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    for recording, refine in ((read, None), (read, "focal"), (given, None), (given, "focal")):
        with pytest.raises(mocap_calib.DegenerateError):
            mocap_calib.calibrate(recording, refine=refine)
    assert asked == ["focal+k1", "focal", "none", "focal"]
    with pytest.raises(mocap_calib.MismatchError, match="nothing is known of the intrinsics"):
        mocap_calib.calibrate(read, refine="none")
    with pytest.raises(mocap_calib.MismatchError, match="refine: expected one of none, focal"):
        mocap_calib.calibrate(read, refine="k1")


def test_messages_name_arguments(tmp_path):
    """What the command calls `--image-size` is `image_size=` here."""
    view = replace(scene().files[0], tracked=True)
    views = [
        replace(view, camera=name, positions=view.positions + shift)
        for name, shift in (("a", 0.0), ("b", 7.5))
    ]
    mocap_calib.write(views, tmp_path / "keypoints", format="deeplabcut-csv")
    read = partial(mocap_calib.read_recording, tmp_path / "keypoints")
    with pytest.raises(mocap_calib.MismatchError) as raised:
        read()
    assert "use image_size={'a': (WIDTH, HEIGHT)}, or give the intrinsics with cameras=" in str(
        raised.value
    )
    assert read(image_size={"a": (1280, 720), "b": (720, 1280)}).cameras[1].size == (720, 1280)
    for suffixes in ("top,bot", ("top", "bot")):
        with pytest.raises(
            mocap_calib.MismatchError, match=r"_top or _bot, found .*; change views="
        ):
            read(views=suffixes)
    with pytest.raises(TypeError, match=r"cameras: expected a path, a CameraRig, .* got int"):
        read(42)
    with pytest.raises(TypeError, match=r"cameras: expected a path, a CameraRig, .* got list"):
        read(["cam1.yaml"])


@pytest.mark.parametrize("device", ["xyz", "meta", "cuda:99"])
def test_a_device_that_is_not_there(device, files):
    recording = mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    with pytest.raises(mocap_calib.MismatchError, match=f"device.*{device}.*; use cpu"):
        mocap_calib.calibrate(recording, device=device)


# --- writing


def test_what_is_written_is_read_again(files, tmp_path):
    """The ending says the format; texts as paths."""
    rig = mocap_calib.read_rig(files / "rig.toml")
    assert mocap_calib.write(rig, str(tmp_path / "rig.yaml")) == ()
    assert mocap_calib.read_rig(str(tmp_path / "rig.yaml")) == rig
    poses = mocap_calib.read_poses(str(files / "poses.npz"))
    assert poses == _poses()
    mocap_calib.write(poses, str(tmp_path / "poses.c3d"), fps=50, individuals=["ann"])
    assert load_poses(str(tmp_path / "poses.c3d")).rate == 50
    view = mocap_calib.read_keypoints(files / "keypoints" / "cam1.json")[0]
    mocap_calib.write(view, str(tmp_path / "cam1.json"))
    (again,) = mocap_calib.read_keypoints(tmp_path / "cam1.json")
    assert replace(again, source=view.source) == view
    lost = mocap_calib.write([view], str(tmp_path / "openpose"), format="openpose")
    assert any("name" in what for what in lost)


@pytest.mark.parametrize("ending", ["toml", "yaml"])
def test_the_file_of_a_rig_holds_the_verdict_of_its_result(ending, tmp_path):
    """Also of some of the cameras, and in another unit; a file of other cameras does not."""
    result = replace(calibrated_result(), left_out=("cam9",))
    rig = result.groups[0].rig
    path = tmp_path / f"a.{ending}"
    mocap_calib.write(rig.select(["cam1", "cam2"]).scale(100, "cm"), path, verdict=result)
    assert path.read_text("utf-8").startswith("# mocap-calib: this rig is well determined\n")
    found = load_cameras(path).judgement
    assert (found["adjusted"], found["verdict"]) == (True, "well determined")
    assert "cameras left out: cam9" in found["remarks"]
    mocap_calib.write(rig, path)
    assert load_cameras(path).judgement == {}
    other = mocap_calib.CameraRig(rig.cameras[:1], rig.rotation[:1], rig.translation[:1])
    other = replace(other, cameras=(replace(rig.cameras[0], name="elsewhere"),))
    with pytest.raises(ValueError, match="verdict: expected the result that the rig is from"):
        mocap_calib.write(other, path, verdict=result)


def calibrated_result() -> mocap_calib.CalibrationResult:
    """A result with one group."""
    group = calibrated()
    clocks = Clocks.of_one(group.recording)
    return mocap_calib.CalibrationResult((group,), (), (), clocks=clocks)


def test_what_cannot_be_written_is_said_in_a_line(files, tmp_path):
    rig = mocap_calib.read_rig(files / "rig.toml")
    view = mocap_calib.read_keypoints(files / "keypoints")[0]
    with pytest.raises(mocap_calib.MismatchError, match="or format= and one of"):
        mocap_calib.write(rig, tmp_path / "rig.txt")
    with pytest.raises(
        mocap_calib.MismatchError, match="say format='deeplabcut-csv' or format='csv'"
    ):
        mocap_calib.write(view, tmp_path / "view.csv")
    with pytest.raises(mocap_calib.MismatchError, match=r"found none; say it with fps=$"):
        mocap_calib.write(_poses(), tmp_path / "poses.trc")
    with pytest.raises(mocap_calib.MismatchError, match=r"in Python scale\(1, 'm'\)"):
        mocap_calib.write(replace(rig, unit="arbitrary"), tmp_path / "a.toml", format="pose2sim")
    matches = mocap_calib.Matches([[[0]]])
    recording = mocap_calib.Recording.from_keypoints(scene().files, scene().rig)
    for thing in ("rig", rig["cam1"], recording, matches, scene(), None, [], [rig]):
        with pytest.raises(TypeError, match=f"CameraRig, Poses3D, .* got {type(thing).__name__}"):
            mocap_calib.write(thing, tmp_path / "thing.toml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fps": 0}, "fps: expected a number above 0, got 0"),
        ({"fps": float("nan")}, "fps: expected a number above 0, got nan"),
        ({"individuals": ["a", "a"]}, "individuals: expected each name once"),
        ({"individuals": "a"}, "individuals: expected a list of names, got the text 'a'"),
        ({"individuals": ["a", "b"]}, "individuals: expected 1 names, got 2"),
    ],
)
def test_what_is_said_of_poses_is_checked(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        mocap_calib.write(_poses(), tmp_path / "poses.trc", **{"fps": 50, **arguments})
    assert not list(tmp_path.iterdir())


def test_arguments_that_say_nothing_are_refused(files, tmp_path):
    rig = mocap_calib.read_rig(files / "rig.toml")
    result = mocap_calib.CalibrationResult((), (), (), clocks=Clocks.of_one(scenes.recording()))
    for thing, arguments in (
        (rig, {"fps": 50}),
        (rig, {"individuals": ["ann"]}),
        (scene().files, {"fps": 50}),
        (result, {"individuals": ["ann"]}),
    ):
        with pytest.raises(ValueError, match=f"expected {next(iter(arguments))}= with 3D poses"):
            mocap_calib.write(thing, tmp_path / "out.toml", **arguments)
    with pytest.raises(
        mocap_calib.MismatchError, match=r"^format=: expected one of .* found 'trk'"
    ):
        mocap_calib.write(result, tmp_path / "out", format="trk")
    with pytest.raises(mocap_calib.MismatchError, match=r"in m, .*after .scale\(factor, unit\)"):
        mocap_calib.write(result, tmp_path / "out", format="pose2sim")
    assert not list(tmp_path.iterdir())


# --- a run


@pytest.mark.slow
def test_a_run_in_python_is_that_of_the_command(done, small, tmp_path):
    """Five lines write the files of `mocap-calib run`; only what says how they came differs."""
    recording = mocap_calib.read_recording(small / "keypoints", small / "intrinsics.toml")
    result = mocap_calib.calibrate(recording)
    (lost,) = mocap_calib.write(result, tmp_path / "out", format="colmap")
    assert lost.startswith("colmap does not hold frame, individual and keypoint of a point")
    for name in ("matches.csv", "poses3d_0.csv", "poses3d_1.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (done[0] / name).read_bytes()
    rig = mocap_calib.read_rig(done[0] / "cameras.yaml")
    assert result.groups[0].rig == rig
    assert load_cameras(done[0] / "cameras.yaml").judgement["verdict"] == result.groups[0].verdict
    assert (tmp_path / "out" / "colmap").is_dir()
    own, command = (
        json.loads((folder / "run.json").read_text("utf-8"))
        for folder in (tmp_path / "out", done[0])
    )
    assert own["verdict"] == command["verdict"]
    assert own["verdict"]["rig"] == result.groups[0].verdict
    assert (own["fingerprint"], own["inputs"]) == (None, {})
    same = mocap_calib.match(recording, result.groups[0].rig)
    assert same == result.groups[0].matches
    again = mocap_calib.triangulate(recording, result.groups[0].rig, same)
    np.testing.assert_allclose(again.positions, result.groups[0].poses.raw, atol=1e-10)


def test_a_rig_of_other_cameras_is_refused(files):
    rig = mocap_calib.read_rig(files / "rig.toml")
    recording = mocap_calib.read_recording(files / "keypoints", rig)
    turned = rig.select(["cam2", "cam1", "cam3"])
    nobody = mocap_calib.Matches(np.full(recording.positions.shape[:3], -1))
    for call in (
        lambda: mocap_calib.match(recording, turned),
        lambda: mocap_calib.triangulate(recording, turned, nobody),
    ):
        with pytest.raises(mocap_calib.MismatchError, match=r"rig.select\(recording.names\)"):
            call()


# --- the model


def test_the_model_of_a_recording_is_the_one_it_was_read_for(files):
    recording = mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    same, lifter = choose_model(recording, "auto")
    assert same is recording
    assert lifter.config.joints == len(PEOPLE.keypoints)
    assert choose_model(recording, lifter) == (recording, lifter)


def test_another_model_has_other_joints(files):
    """By name and by file; keypoints are matched to its joints."""
    recording = mocap_calib.read_recording(files / "keypoints", files / "rig.toml")
    dogs = load_skeleton("quadruped")
    for_dogs, lifter = choose_model(recording, "quadruped")
    assert for_dogs.model == "quadruped"
    nose = recording.keypoints.index("nose")
    assert dogs.keypoints[for_dogs.vocabulary[nose]] == "nose"
    alone, _ = choose_model(recording, "none")
    assert set(alone.vocabulary) == {-1}
    weights = Path(mocap_calib.__file__).parent / "weights" / "quadruped.safetensors"
    by_file, _ = choose_model(recording, weights)
    np.testing.assert_array_equal(by_file.vocabulary, for_dogs.vocabulary)
    wrong = replace(recording, vocabulary=recording.vocabulary + lifter.config.joints)
    with pytest.raises(mocap_calib.MismatchError, match="expected a network of the"):
        choose_model(wrong, lifter)
    with pytest.raises(mocap_calib.FormatError, match="found neither"):
        choose_model(recording, "unicorn")
