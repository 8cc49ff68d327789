"""`import mocap_calib`: quick, and what it reads, writes and refuses."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import calibrated, scene

import mocap_calib as mc
from mocap_calib.errors import argument
from mocap_calib.results import Clocks
from mocap_calib.types import AssumedCamera, EstimatedCamera

EXAMPLE = Path(__file__).parents[1] / "examples" / "three_people"
HEAVY = {"numpy", "torch", "scipy", "cv2", "h5py", "yaml", "rich", "mocap_calib.config"}
# what is run in a Python of its own, and which modules it must not import
LIGHT = {
    "import": ("import mocap_calib", HEAVY),
    "--help": (
        "import sys\nsys.argv = ['mocap-calib', '--help']\n"
        "from mocap_calib_cli.main import main\n"
        "try: main()\nexcept SystemExit as end: assert end.code == 0",
        HEAVY - {"mocap_calib.config"},
    ),
    # importing numba takes most of a second, which reading a file does not need
    "reading": (
        "import mocap_calib as mc\n"
        "mc.read_keypoints('keypoints'), mc.read_rig('reference.toml'), mc.Config",
        {"numba", "torch", "cv2", "scipy"},
    ),
    # rigs are read, project, triangulate and are written without the network
    "cameras": (
        "import mocap_calib as mc\n"
        "cameras = [mc.Camera(name, (9, 9), [[9, 0, 4], [0, 9, 4], [0, 0, 1]]) for name in 'ab']\n"
        "turns = [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]] * 2\n"
        "rig = mc.CameraRig(cameras, turns, [[0, 0, 0], [1, 0, 0]], 'm')\n"
        "rig.triangulate(rig.project([0, 0, 3]))\n"
        "mc.read_rig, mc.write, mc.evaluate",
        {"torch", "cv2"},
    ),
}


@pytest.mark.parametrize(("code", "heavy"), LIGHT.values(), ids=LIGHT)
def test_what_needs_no_heavy_module_imports_none(code, heavy):
    said = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint('modules', *sys.modules)"],
        check=True,
        capture_output=True,
        text=True,
        cwd=EXAMPLE,
    ).stdout
    assert not heavy & set(said.splitlines()[-1].split(" ")[1:])


@pytest.mark.parametrize("name", mc.__all__)
def test_every_name_resolves(name):
    value = getattr(mc, name)
    assert value.__name__ == name
    assert value.__doc__, "what users see first says what it is"
    assert name in dir(mc)


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'frobnicate'"):
        _ = mc.frobnicate


# --- reading


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with keypoints/ and cameras of a small scene, and 3D poses."""
    folder = tmp_path_factory.mktemp("files")
    made = scene(cameras=3, people=2, frames=30)
    mc.write(made.files, folder / "keypoints", format="coco")
    mc.write(made.rig, folder / "rig.toml")
    mc.write(poses(), folder / "poses.npz")
    return folder


def poses() -> mc.Poses3D:
    quality = np.ones((2, 1, 1))
    positions = np.arange(6.0).reshape(2, 1, 1, 3)
    return mc.Poses3D(["a"], [0, 1], positions, quality, quality, quality, "m")


def test_files_cameras_and_records_make_the_same_recording(files):
    """By path and by text; cameras of a file, a rig or a list; files or records."""
    read = mc.read_recording(str(files / "keypoints"), str(files / "rig.toml"))
    rig = mc.read_rig(str(files / "rig.toml"))
    names = [f"{name}={files / 'keypoints' / name}.json" for name in rig.names]
    assert read == mc.read_recording(files / "keypoints", files / "rig.toml")
    assert read == mc.read_recording(names, rig)
    assert read == mc.read_recording(names, mc.read_cameras(files / "rig.toml"))
    assert read == mc.Recording.from_keypoints(mc.read_keypoints(str(files / "keypoints")), rig)
    assert read.model == "people"
    assert read != mc.read_recording(names, rig, frame_offset={"cam1": 1})


def test_a_rig_takes_the_keypoints_of_its_cameras_alone(files):
    rig = mc.read_rig(files / "rig.toml").select(["cam3", "cam1"])
    recording = mc.read_recording(files / "keypoints", rig)
    assert recording.names == ("cam3", "cam1")
    with pytest.raises(mc.MismatchError, match="a camera of the same name"):
        mc.read_recording(files / "keypoints", rig.cameras)
    turned = rig.select(["cam1", "cam3"])
    nobody = mc.Matches(np.full(recording.positions.shape[:3], -1))
    for call in (
        lambda: mc.match(recording, turned),
        lambda: mc.triangulate(recording, turned, nobody),
    ):
        with pytest.raises(mc.MismatchError, match="select"):
            call()


def test_options_are_those_of_the_command(files):
    """What texts are for the command is plain data here."""
    options = {"format": "coco", "camera_regex": "cam[0-9]", "model": "none"}
    options["crop_offset"] = {"cam1": (10.0, 0.0)}
    read = mc.read_recording(files / "keypoints", files / "rig.toml", **options)
    plain = mc.read_recording(files / "keypoints", files / "rig.toml")
    seen = plain.seen[0]
    moved = (read.positions[0] - plain.positions[0])[seen]
    np.testing.assert_allclose(moved, np.broadcast_to([10, 0], moved.shape), atol=1e-4)
    assert (read.model, set(read.vocabulary)) == ("none", {-1})


@pytest.mark.parametrize(
    ("refine", "kind", "known"),
    [
        (None, EstimatedCamera, False),
        ("focal", EstimatedCamera, False),
        (None, mc.Camera, True),
        ("focal", EstimatedCamera, True),
    ],
)
def test_intrinsics_are_estimated_where_none_are_known_or_it_is_asked_for(
    files, refine, kind, known
):
    given = mc.read_recording(files / "keypoints", *([files / "rig.toml"] if known else []))
    assert known or {type(camera) for camera in given.cameras} == {AssumedCamera}
    (group,) = mc.calibrate(given, refine=refine).groups
    assert {type(camera) for camera in group.recording.cameras} == {kind}


# --- writing


def test_what_is_written_is_read_again(files, tmp_path):
    """The ending says the format; texts as paths."""
    rig = mc.read_rig(files / "rig.toml")
    assert mc.write(rig, str(tmp_path / "rig.yaml")) == ()
    assert mc.read_rig(str(tmp_path / "rig.yaml")) == rig
    read = mc.read_poses(str(files / "poses.npz"))
    assert read == poses()
    mc.write(read, str(tmp_path / "poses.c3d"), fps=50, individuals=["ann"])
    np.testing.assert_allclose(
        mc.read_poses(tmp_path / "poses.c3d").positions, 1000 * read.positions, rtol=1e-6
    )
    view = mc.read_keypoints(files / "keypoints" / "cam1.json")[0]
    lost = mc.write([view], str(tmp_path / "openpose"), format="openpose")
    assert any("name" in what for what in lost)


def result_of_one_group(**fields) -> mc.CalibrationResult:
    group = calibrated()
    made = {"left_out": (), "clocks": Clocks.of_one(group.recording), **fields}
    return mc.CalibrationResult((group,), unused_pairs=(), **made)


@pytest.mark.parametrize("ending", ["toml", "yaml"])
def test_the_file_of_a_rig_holds_the_verdict_of_its_result(ending, tmp_path):
    """Also of some of the cameras, and in another unit; a file of other cameras does not."""
    result, path = result_of_one_group(left_out=("cam9",)), tmp_path / f"a.{ending}"
    rig = result.groups[0].rig
    mc.write(rig.select(["cam1", "cam2"]).scale(100, "cm"), path, verdict=result)
    text = path.read_text("utf-8")
    assert text.startswith("# mocap-calib: this rig is well determined\n")
    assert "cameras left out: cam9" in text
    mc.write(rig, path)
    assert "well determined" not in path.read_text("utf-8")
    one = replace(rig.select(["cam1"]), cameras=(replace(rig.cameras[0], name="elsewhere"),))
    with pytest.raises(ValueError, match="verdict: expected the result that the rig is from"):
        mc.write(one, path, verdict=result)


# --- refusals: one line each, with the names of arguments


READ = mc.read_recording
RIG = scene().rig
REFUSED_INPUT = {
    "(cam": lambda f, _: READ(f / "keypoints", f / "rig.toml", camera_regex="(cam"),
    "body_25": lambda f, _: READ(f / "keypoints", f / "rig.toml", layout="body_99"),
    "_top or _bot": lambda f, _: READ(f / "keypoints", f / "rig.toml", views=("top", "bot")),
    "views=": lambda f, _: READ(f / "keypoints", f / "rig.toml", views="top,bot"),
    "refine": lambda f, _: mc.calibrate(READ(f / "keypoints"), refine="k1"),
    "intrinsics": lambda f, _: mc.calibrate(READ(f / "keypoints"), refine="none"),
    "device": lambda f, _: mc.calibrate(READ(f / "keypoints"), device="cuda:99"),
    "meta": lambda f, _: mc.calibrate(READ(f / "keypoints"), device="meta"),
    "unicorn": lambda f, _: mc.calibrate(READ(f / "keypoints"), model="unicorn"),
    "format=": lambda _, out: mc.write(RIG, out / "rig.txt"),
    "deeplabcut-csv": lambda _, out: mc.write(scene().files[0], out / "view.csv"),
    "fps=": lambda _, out: mc.write(poses(), out / "poses.trc"),
    "scale(": lambda _, out: mc.write(
        replace(RIG, unit="arbitrary"), out / "a.toml", format="pose2sim"
    ),
    "trk": lambda _, out: mc.write(result_of_one_group(), out / "out", format="trk"),
    ".scale": lambda _, out: mc.write(result_of_one_group(), out / "out", format="pose2sim"),
}


@pytest.mark.parametrize(("word", "call"), REFUSED_INPUT.items(), ids=REFUSED_INPUT)
def test_what_cannot_be_is_refused_in_a_line_that_names_arguments(files, tmp_path, word, call):
    with pytest.raises(mc.MocapCalibError, match=r"expected .*found .*; ") as raised:
        call(files, tmp_path)
    said = str(raised.value)
    assert word in said
    assert "\n" not in said
    assert " --" not in re.sub("`[^`]*`", "", said)  # options are the command's
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fps": 0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"individuals": ["a", "a"]}, "individuals"),
        ({"individuals": "a"}, "individuals: expected a list of names"),
        ({"individuals": ["a", "b"]}, "individuals"),
    ],
)
def test_what_is_said_of_poses_is_checked(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        mc.write(poses(), tmp_path / "poses.trc", **{"fps": 50, **arguments})
    assert not list(tmp_path.iterdir())


def test_things_and_arguments_that_say_nothing_are_refused(tmp_path):
    for thing, name, value in (
        (RIG, "fps", 50),
        (RIG, "individuals", ["ann"]),
        (scene().files, "fps", 50),
        (result_of_one_group(), "individuals", ["ann"]),
    ):
        with pytest.raises(ValueError, match=f"{name}= with 3D poses"):
            mc.write(thing, tmp_path / "out.toml", **{name: value})
    recording = mc.Recording.from_keypoints(scene().files, RIG)
    for thing in ("rig", RIG["cam1"], recording, mc.Matches([[[0]]]), scene(), None, [], [RIG]):
        with pytest.raises(TypeError, match=f"CameraRig, Poses3D, .* {type(thing).__name__}"):
            mc.write(thing, tmp_path / "thing.toml")
    for cameras in (42, ["cam1.yaml"]):
        with pytest.raises(TypeError, match=f"cameras: .* {type(cameras).__name__}"):
            mc.read_recording(tmp_path, cameras)
    assert not list(tmp_path.iterdir())


def test_image_sizes_are_asked_for_by_camera_as_python_has_them(tmp_path):
    view = replace(scene().files[0], tracked=True)
    views = [
        replace(view, camera="a"),
        replace(view, camera="b", positions=view.positions + 7.5),
    ]
    mc.write(views, tmp_path / "keypoints", format="deeplabcut-csv")
    with pytest.raises(mc.MismatchError) as raised:
        mc.read_recording(tmp_path / "keypoints")
    assert "image_size={'a': (" in str(raised.value)
    sizes = {"a": (1280, 720), "b": (720, 1280)}
    read = mc.read_recording(tmp_path / "keypoints", image_size=sizes)
    assert read.cameras[1].size == (720, 1280)


# --- a run


@pytest.mark.slow
def test_a_run_in_python_is_that_of_the_command(done, small, tmp_path):
    """Five lines write the files of `mocap-calib run`; only what says how they came differs."""
    recording = mc.read_recording(small / "keypoints", small / "intrinsics.toml")
    result = mc.calibrate(recording)
    (lost,) = mc.write(result, tmp_path / "out", format="colmap")
    assert lost.startswith("colmap does not hold frame, individual and keypoint of a point")
    for name in ("matches.csv", "poses3d_0.csv", "poses3d_1.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (done[0] / name).read_bytes()
    assert result.groups[0].rig == mc.read_rig(done[0] / "cameras.yaml")
    assert (tmp_path / "out" / "colmap").is_dir()
    own, command = (
        json.loads((folder / "run.json").read_text("utf-8"))
        for folder in (tmp_path / "out", done[0])
    )
    assert own["verdict"] == command["verdict"]
    assert own["verdict"]["rig"] == result.groups[0].verdict
    assert (own["fingerprint"], own["inputs"]) == (None, {})
    same = mc.match(recording, result.groups[0].rig)
    assert same == result.groups[0].matches
    again = mc.triangulate(recording, result.groups[0].rig, same)
    np.testing.assert_allclose(again.positions, result.groups[0].poses.raw, atol=1e-10)


def test_a_long_argument_in_a_refusal_is_shortened_without_its_marks():
    refused = mc.MismatchError(argument("align", 400 * "a"), "landmarks", "none", "add some")
    assert re.match("align='a{200,}[^\ue000-\ue002]*expected landmarks, found none", str(refused))
