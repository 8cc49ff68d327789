"""The command `convert`, and the formats that `run` writes: real files, real pipes, one line for
what cannot be.
"""

import json
import re
import subprocess
from pathlib import Path

import click
import numpy as np
import pytest
from conftest import TOOL
from conversion_samples import DLC, poses, rig
from rigs import assert_same

from mocap_calib.io.cameras.own import format_intrinsics_toml
from mocap_calib.io.cameras.read import load_cameras, make_rig, read_rig
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.io.format import format_names, names_by_ending
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.io.kinds import FORMATS
from mocap_calib.io.poses.read import load_poses
from mocap_calib.io.poses.write import write_poses
from mocap_calib_cli.inputs import calibration_request
from mocap_calib_cli.options import SharedOptions

SAY_WHICH = {
    ending: f"say --to {' or --to '.join(names)}"
    for ending, names in names_by_ending(KEYPOINT_FORMATS).items()
}
EXAMPLE = Path(__file__).parents[2] / "examples" / "three_people"


@pytest.mark.slow
def test_cameras_go_round_through_files_and_folders(tool, tmp_path):
    write_cameras(tmp_path / "a.toml", rig(), "anipose")
    at = tmp_path / "a.toml"
    for k, name in enumerate(
        ("colmap", "opencv", "easymocap", "multiview-calib", "pose2sim", "nerfstudio")
    ):
        done = tool("convert", at, tmp_path / f"out{k}", "--to", name)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        assert f"2 cameras, lengths in m, as {name}" in done.stderr
        at = tmp_path / f"out{k}"
    done = tool("convert", at, tmp_path / "back.yaml")
    assert done.returncode == 0, done.stderr
    assert_same(rig(), read_rig(tmp_path / "back.yaml"))


@pytest.mark.slow
def test_cameras_go_through_pipes(tmp_path):
    write_cameras(tmp_path / "a.toml", rig(), "anipose")
    steps = [
        ["anipose", "nerfstudio"],
        ["nerfstudio", "openmvg"],
        ["openmvg", "dannce"],
        ["dannce", "voxelpose"],
        ["voxelpose", "mocap-calib"],
    ]
    content = (tmp_path / "a.toml").read_bytes()
    for source, target in steps:
        done = subprocess.run(
            [TOOL, "convert", "-", "-", "--from", source, "--to", target, "-q"],
            input=content,
            capture_output=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, b"")
        content = done.stdout
    (tmp_path / "b.yaml").write_bytes(content)
    assert_same(rig(), read_rig(tmp_path / "b.yaml"), sizes=False, scale=1000)


def test_poses_go_round(tool, tmp_path):
    write_poses(tmp_path / "a.h5", poses(), "poses-h5")
    for source, target in (
        ("a.h5", "b.c3d"),
        ("b.c3d", "c.nc"),
        ("c.nc", "d/p.trc"),
        ("d", "e.npz"),
    ):
        done = tool("convert", tmp_path / source, tmp_path / target)
        assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(
        load_poses(tmp_path / "e.npz").poses.positions, poses().poses.positions * 1000, rtol=2e-7
    )
    assert (
        "c3d does not hold reprojection errors"
        in tool("convert", tmp_path / "a.h5", tmp_path / "b.c3d").stderr
    )
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["p_0.trc", "p_1.trc"]


def test_the_rate_the_unit_and_the_axis_that_points_up_can_be_said(tool, tmp_path):
    write_poses(tmp_path / "a.csv", poses(1), "anipose-csv")
    done = tool("convert", tmp_path / "a.csv", tmp_path / "a.trc")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "--fps" in done.stderr
    up = ("--up", "z")
    done = tool(
        "convert", tmp_path / "a.csv", tmp_path / "a.trc", "--fps", 25, "--input-unit", "m", *up
    )
    assert done.returncode == 0, done.stderr
    found = load_poses(tmp_path / "a.trc")
    np.testing.assert_array_equal(
        found.poses.positions, poses(1).poses.positions[..., [1, 2, 0]]
    )  # Pose2Sim's (X, Y, Z) -> (Y, Z, X)
    assert (found.rate, found.poses.unit) == (25.0, "m")


@pytest.mark.slow
def test_keypoints_go_round(tool, tmp_path):
    keypoints = EXAMPLE / "keypoints"
    for source, target, name in (
        (keypoints, tmp_path / "a", "openpose"),
        (tmp_path / "a", tmp_path / "b", "coco"),
    ):
        extra = (
            ["--layout", ",".join(read_keypoints([keypoints])[0].keypoints)]
            if name == "coco"
            else []
        )
        done = tool("convert", source, target, "--to", name, *extra)
        assert done.returncode == 0, done.stderr
    for before, after in zip(
        read_keypoints([keypoints]), read_keypoints([tmp_path / "b"]), strict=True
    ):
        assert before.camera == after.camera
        assert np.isfinite(before.positions).sum() == np.isfinite(after.positions).sum()


def test_what_is_remarked_and_lost_of_keypoints_is_said(tool, tmp_path):
    (tmp_path / "in").mkdir()
    for camera in "ab":
        (tmp_path / "in" / f"{camera}.csv").write_text(
            "frame,individual,keypoint,x,y\n0,anna,nose,3,4\n0,bert,nose,5,6\n1,anna,nose,7,8\n"
        )
    done = tool("convert", tmp_path / "in", tmp_path / "out", "--to", "openpose")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [
        "a, b: no scores in the file: every point counts fully",
        "2 cameras, 4 frames as openpose",
        "openpose does not hold the names of keypoints; who is who from frame to frame; that there "
        "are no scores: each point gets 1",
    ]
    assert (
        tool("convert", tmp_path / "in", tmp_path / "quiet", "--to", "openpose", "-q").stderr == ""
    )


def test_a_file_that_would_pass_for_a_further_individual_is_refused_and_stays(tool, tmp_path):
    """It may be another recording of that name, or the input itself."""
    for count in (2, 1):
        write_poses(tmp_path / f"{count}.npz", poses(count), "npz")
    assert tool("convert", tmp_path / "2.npz", tmp_path / "st.trc").returncode == 0
    assert sorted(file.name for file in tmp_path.glob("*.trc")) == ["st_0.trc", "st_1.trc"]
    before = (tmp_path / "st_0.trc").read_bytes()
    done = tool("convert", tmp_path / "1.npz", tmp_path / "st.trc")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "st_0.trc: expected no file of a further individual" in done.stderr
    assert (tmp_path / "st_0.trc").read_bytes() == before
    (tmp_path / "st_0.trc").unlink()
    assert tool("convert", tmp_path / "1.npz", tmp_path / "st.trc").returncode == 0


@pytest.mark.slow
def test_the_content_says_the_kind_and_the_remedy_works(tool, tmp_path):
    """Endings that poses have too; a calibration beside the keypoints; SLEAP's analysis of three
    frames, which looks like 3D.
    """
    (tmp_path / "both").mkdir()
    (tmp_path / "both" / "a.csv").write_text(DLC)
    write_cameras(tmp_path / "both" / "calibration.toml", rig(), "anipose")
    for source, target, more in (
        ("both", "x.json", []),
        ("both/a.csv", "x.csv", ["--to", "deeplabcut-csv"]),
        ("both/a.csv", "x.h5", ["--to", "sleap"]),
    ):
        done = tool("convert", tmp_path / source, tmp_path / target, *more)
        assert done.returncode == 0, done.stderr
        assert read_keypoints([tmp_path / target])[0].positions[:, 0, 0].tolist() == [
            [10, 20],
            [11, 21],
        ]
    assert tool("convert", tmp_path / "both", tmp_path / "x.yaml").returncode == 0
    assert read_rig(tmp_path / "x.yaml").names == ("a", "b")
    (tmp_path / "three.csv").write_text(DLC + "2,12,22,0.5\n")
    for source, target, more in (
        ("three.csv", "three.h5", ["--to", "sleap"]),
        ("three.h5", "three.json", []),
    ):
        done = tool("convert", tmp_path / source, tmp_path / target, *more)
        assert done.returncode == 0, done.stderr


def test_keypoints_go_through_pipes():
    content = next((EXAMPLE / "keypoints").glob("*.json")).read_bytes()
    done = subprocess.run(
        [TOOL, "convert", "-", "-", "--from", "coco", "--to", "csv"],
        input=content,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"camera,frame,instance,keypoint,x,y,score")


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["nothing.toml", "b.yaml"], 1, "expected a file or folder, found none"),
        (["a.toml", "b.what"], 1, "--to"),
        (["a.toml", "b", "--to", "zip"], 1, "expected a format"),
        (["a.toml", "b", "--to", "kalibr"], 1, "only read"),
        (["a.toml", "b", "--from", "anipose", "--to", "trc"], 1, "expected a format of cameras"),
        (["a.toml", "b", "--to", "trc"], 1, "expected a format of cameras, which INPUT holds"),
        (["a.toml", "-", "--to", "colmap"], 1, "one file for stdout"),
        (["-", "b.toml"], 2, "--from"),
        (["a.toml", "a.toml", "b.yaml"], 2, "one file or folder of cameras"),
        (["a.toml", "b.yaml", "--input-unit", "mm"], 1, "as the file says"),
        (["broken.json", "b.toml"], 1, "broken.json: expected JSON"),
        (["intrinsics.toml", "b.yaml"], 1, "extrinsics"),
        (["empty", "b.yaml"], 1, "empty"),
        (["twice.toml", "b.yaml"], 1, "twice"),
        (["dlc.csv", "x.csv"], 1, SAY_WHICH[".csv"]),
        (["dlc.csv", "x.h5"], 1, SAY_WHICH[".h5"]),
        (["dlc.csv", "x.nc", "--from", "coco"], 1, "name another format, or none"),
        (["frames", "x.toml"], 1, "--to and one of coco, openpose"),
        (["dlc.csv", "x.nc", "--unit", "m"], 2, "--unit"),
        (["dlc.csv", "x.nc", "--fps", "30"], 2, "--fps"),
        (["a.toml", "b.yaml", "--up", "z"], 2, "--up"),
        (["a.toml", "b.yaml", "--layout", "coco_17"], 2, "--layout"),
        (["p.npz", "x.h5", "--frame-offset", "a:1"], 2, "--frame-offset"),
        (["p.npz", "x.h5", "--image-size", "8x8"], 2, "--image-size"),
        (["a.toml", "b.yaml", "--image-size", "8x8"], 1, "leave it out"),
        (["dlc.csv", "x.nc", "--image-size", "0x8"], 2, "above 0"),
    ],
)
def test_what_cannot_be_is_one_line(tool, tmp_path, arguments, status, reason):
    write_cameras(tmp_path / "a.toml", rig(), "anipose")
    (tmp_path / "dlc.csv").write_text(DLC)
    write_keypoints(tmp_path / "frames", read_keypoints([tmp_path / "dlc.csv"]), "openpose")
    write_poses(tmp_path / "p.npz", poses(), "npz")
    (tmp_path / "broken.json").write_text('{"frames": [')
    (tmp_path / "empty").write_text("")
    (tmp_path / "twice.toml").write_text((tmp_path / "a.toml").read_text().replace('"b"', '"a"'))
    (tmp_path / "intrinsics.toml").write_text(format_intrinsics_toml(rig().cameras))
    done = tool("convert", *arguments, cwd=tmp_path)
    assert done.returncode == status
    assert done.stdout == ""
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert status == 2 or done.stderr.count("\n") == 1
    assert not any((tmp_path / name).exists() for name in ("b.yaml", "x.csv", "x.h5", "x.nc"))


def test_a_camera_without_a_place_is_left_out_and_said(tool, tmp_path):
    write_cameras(tmp_path / "cams", rig(), "easymocap")
    intri = (tmp_path / "cams/intri.yml").read_text()
    more = intri[intri.index("K_b") :].replace("_b", "_c")
    (tmp_path / "cams/intri.yml").write_text(intri.replace('  - "b"', '  - "b"\n  - "c"') + more)
    done = tool("convert", tmp_path / "cams", tmp_path / "b.yaml")
    assert done.returncode == 0
    assert "nothing says where they stand: c" in done.stderr
    assert read_rig(tmp_path / "b.yaml").names == ("a", "b")
    assert len(load_cameras(tmp_path / "cams").cameras) == 3


def test_an_image_size_can_be_said(tool, tmp_path):
    write_cameras(tmp_path / "a.mat", rig(), "dannce")
    assert (
        "expected the image size"
        in tool("convert", tmp_path / "a.mat", tmp_path / "b", "--to", "pose2sim").stderr
    )
    assert (
        tool(
            "convert",
            tmp_path / "a.mat",
            tmp_path / "b",
            "--to",
            "pose2sim",
            "--image-size",
            "1280x720",
        ).returncode
        == 0
    )
    assert_same(rig(), make_rig(load_cameras(tmp_path / "b"), "b"))


def test_names_of_formats_are_one_kind_each_but_for_caliscope():
    """caliscope has both keypoints and cameras of that name; the content tells."""
    names = [name for formats in FORMATS.values() for name in format_names(formats)]
    assert {name for name in names if names.count(name) > 1} <= {"caliscope"}


@pytest.mark.slow
def test_run_writes_what_is_asked_for(tool, small, tmp_path):
    """Further formats are results like the others: `run.json` lists them."""
    asked = [
        argument
        for name in ("colmap", "nerfstudio", "movement-3d", "sleap-anipose")
        for argument in ("--write", name)
    ]
    done = tool(
        "run",
        small / "keypoints",
        "--cameras",
        small / "intrinsics.toml",
        "-o",
        tmp_path / "out",
        "--fps",
        30,
        *asked,
    )
    assert done.returncode == 0, done.stderr
    names = {
        str(path.relative_to(tmp_path / "out"))
        for path in (tmp_path / "out").rglob("*")
        if path.is_file()
    }
    assert {"cameras.yaml", "calibration.toml", "poses3d.h5", "run.json"} <= names
    assert {"colmap/images.txt", "nerfstudio/transforms.json", "poses3d.nc", "points3d.h5"} <= names
    assert_same(read_rig(tmp_path / "out/cameras.yaml"), read_rig(tmp_path / "out/colmap"))
    assert load_poses(tmp_path / "out/poses3d.nc").rate == 30.0
    bodies = load_poses(tmp_path / "out/poses3d.h5").poses
    points = load_cameras(tmp_path / "out/colmap").points
    known = np.isfinite(bodies.raw[..., 0])
    # the points are triangulated in the world of the results, the bodies were moved to it
    np.testing.assert_allclose(points.positions, bodies.raw[known], atol=1e-10)
    assert len(points.view) == bodies.views[known].sum()
    report = json.loads((tmp_path / "out/run.json").read_text())
    assert report["unit"] == "arbitrary"
    assert names == {"run.json", *report["outputs"]}


@pytest.mark.parametrize(
    ("formats", "fps", "reason"),
    [
        (["fbx"], (), "--write: expected one of poses-h5, "),
        (["kalibr"], (), "--write: expected one of poses-h5, "),  # only read
        (["movement-3d", "nwb-3d"], ("30",), "nwb-3d: expected the Python package pynwb"),
        (
            ["trc"],
            ("30",),
            "mocap-calib convert OUT/poses3d.h5 NEW --to trc --fps FPS",
        ),
        (["colmap", "pose2sim"], (), "convert OUT/cameras.yaml NEW --to pose2sim"),
    ],
)
def test_run_and_batch_know_before_they_read_what_they_cannot_write(
    formats, fps, reason, monkeypatch
):
    monkeypatch.setattr("mocap_calib.io.format.find_spec", lambda _: None)
    options = SharedOptions(write=tuple(formats), fps=fps)
    with pytest.raises(click.UsageError) as refused:
        calibration_request(options, Path("out"))
    assert reason in refused.value.message


def test_a_format_with_times_needs_their_rate(monkeypatch):
    monkeypatch.setattr("mocap_calib.io.format.find_spec", lambda _: "it is there")
    with pytest.raises(click.UsageError, match="--write nwb-3d: expected the number of frames"):
        calibration_request(SharedOptions(write=("nwb-3d",)), Path("out"))
    options = SharedOptions(write=("nwb-3d",), fps=("30",))
    assert calibration_request(options, Path("out")).fps == 30.0


def test_a_format_that_could_not_be_written_in_the_end_is_wrong_usage(tool, tmp_path):
    """Nothing is read: there are no such files."""
    for command in ("run", "batch"):
        done = tool(
            command, "none", "--cameras", "none.toml", "--write", "trc", "-o", "out", cwd=tmp_path
        )
        assert (done.returncode, done.stdout) == (2, "")
        assert "--write trc: expected a format that leaves the unit of length open" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_every_format_is_documented():
    text = (Path(__file__).parents[2] / "docs" / "formats.md").read_text("utf-8")
    for kind, title in (
        ("keypoints", "Keypoint files"),
        ("cameras", "Camera files"),
        ("poses", "3D files"),
    ):
        section = re.split(r"\n###? ", text.split(f"\n## {title}\n")[1])[0]
        rows = re.findall(r"^\| `(?!--)([^`]+)` \|", section, re.M)
        assert sorted(rows) == sorted(format_names(FORMATS[kind]))
        assert {each.kind for each in FORMATS[kind]} == {kind}


def test_it_is_said_what_each_format_that_is_read_was_tried_on():
    page = (Path(__file__).parents[2] / "docs" / "formats-checks.md").read_text("utf-8")
    names = [each.name for kind in FORMATS for each in FORMATS[kind] if not each.only_written]
    assert [name for name in names if f"`{name}`" not in page] == []
