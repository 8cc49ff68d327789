"""`convert` and `filter`, and which files are read: real files, real pipes, one line for what
cannot be.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import TOOL
from conversion_samples import DLC, rig
from rigs import assert_same

import mocap_calib as mc
from mocap_calib.io.kinds import FORMATS

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "three_people"
NAMES = [each.name for formats in FORMATS.values() for each in formats]


def poses(individuals: int = 2, frames: int = 4) -> mc.Poses3D:
    """Random points in metres."""
    positions = np.random.default_rng(0).normal(size=(frames, individuals, 3, 3))
    quality = np.ones(positions.shape[:3])
    views = quality.astype(np.int64)
    return mc.Poses3D(
        ("x", "y", "z"), np.arange(frames), positions, quality, views, quality, unit="m"
    )


@pytest.mark.slow
def test_cameras_go_round_through_files_and_folders(tool, tmp_path):
    at = tmp_path / "a.toml"
    mc.write(rig(), at)
    names = ("colmap", "opencv", "easymocap", "multiview-calib", "pose2sim", "nerfstudio")
    for k, name in enumerate(names):
        done = tool("convert", at, tmp_path / f"out{k}", "--to", name)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        assert f"2 cameras, lengths in m, as {name}" in done.stderr
        at = tmp_path / f"out{k}"
    done = tool("convert", at, tmp_path / "back.yaml")
    assert done.returncode == 0, done.stderr
    assert_same(rig(), mc.read_rig(tmp_path / "back.yaml"))


def test_files_go_through_pipes(tool, tmp_path):
    mc.write(rig(), tmp_path / "a.toml")
    content = (tmp_path / "a.toml").read_text()
    chain = ("anipose", "nerfstudio", "openmvg", "voxelpose", "mocap-calib")
    for source, target in pairwise(chain):
        words = ("convert", "-", "-", "--from", source, "--to", target, "-q")
        done = tool(*words, stdin=content)
        assert (done.returncode, done.stderr) == (0, "")
        content = done.stdout
    (tmp_path / "b.yaml").write_text(content)
    assert_same(rig(), mc.read_rig(tmp_path / "b.yaml"), sizes=False, scale=1000)
    keypoints = next((EXAMPLE / "keypoints").glob("*.json")).read_bytes()
    command = [TOOL, "convert", "-", "-", "--from", "coco", "--to", "csv"]
    done = subprocess.run(command, input=keypoints, capture_output=True, check=True)
    assert done.stdout.startswith(b"camera,frame,instance,keypoint,x,y,score")


def test_poses_go_round(tool, tmp_path):
    mc.write(poses(), tmp_path / "a.h5", "poses-h5", fps=25)
    for source, target in (
        ("a.h5", "b.c3d"),
        ("b.c3d", "c.nc"),
        ("c.nc", "d/p.trc"),
        ("d", "e.npz"),
    ):
        done = tool("convert", source, target, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    found = mc.read_poses(tmp_path / "e.npz")
    np.testing.assert_allclose(found.positions, poses().positions * 1000, rtol=2e-7)
    said = tool("convert", "a.h5", "b.c3d", cwd=tmp_path).stderr
    assert "c3d does not hold reprojection errors" in said
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["p_0.trc", "p_1.trc"]


def test_the_rate_the_unit_and_the_axis_that_points_up_can_be_said(tool, tmp_path):
    mc.write(poses(1), tmp_path / "a.csv", "anipose-csv")
    words = ("convert", tmp_path / "a.csv", tmp_path / "a.trc")
    done = tool(*words)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "--fps" in done.stderr
    done = tool(*words, "--fps", 25, "--input-unit", "m", "--up", "z")
    assert done.returncode == 0, done.stderr
    found = mc.read_poses(tmp_path / "a.trc")
    # Pose2Sim's (X, Y, Z) -> (Y, Z, X)
    np.testing.assert_array_equal(found.positions, poses(1).positions[..., [1, 2, 0]])
    assert found.unit == "m"
    assert "\n25.0\t25.0\t4\t" in (tmp_path / "a.trc").read_text()


@pytest.mark.slow
def test_keypoints_go_round(tool, tmp_path):
    keypoints = EXAMPLE / "keypoints"
    names = mc.read_keypoints(keypoints)[0].keypoints
    for source, target, more in (
        (keypoints, tmp_path / "a", ("openpose",)),
        (tmp_path / "a", tmp_path / "b", ("coco", "--layout", ",".join(names))),
    ):
        done = tool("convert", source, target, "--to", *more)
        assert done.returncode == 0, done.stderr
    before, after = mc.read_keypoints(keypoints), mc.read_keypoints(tmp_path / "b")
    for one, other in zip(before, after, strict=True):
        assert one.camera == other.camera
        assert np.isfinite(one.positions).sum() == np.isfinite(other.positions).sum()


def test_what_is_remarked_and_lost_of_keypoints_is_said(tool, tmp_path):
    (tmp_path / "in").mkdir()
    for camera in "ab":
        (tmp_path / "in" / f"{camera}.csv").write_text(
            "frame,individual,keypoint,x,y\n0,anna,nose,3,4\n0,bert,nose,5,6\n1,anna,nose,7,8\n"
        )
    words = ("convert", tmp_path / "in", tmp_path / "out", "--to", "openpose")
    done = tool(*words)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [
        "a, b: no scores in the file: every point counts fully",
        "2 cameras, 4 frames as openpose",
        "openpose does not hold the names of keypoints; who is who from frame to frame; that there "
        "are no scores: each point gets 1",
    ]
    assert tool(*words, "-q").stderr == ""


def test_a_file_that_would_pass_for_a_further_individual_is_refused_and_stays(tool, tmp_path):
    """It may be another recording of that name, or the input itself."""
    for count in (2, 1):
        mc.write(poses(count), tmp_path / f"{count}.npz", fps=25)
    assert tool("convert", "2.npz", "st.trc", cwd=tmp_path).returncode == 0
    assert sorted(file.name for file in tmp_path.glob("*.trc")) == ["st_0.trc", "st_1.trc"]
    before = (tmp_path / "st_0.trc").read_bytes()
    done = tool("convert", "1.npz", "st.trc", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "st_0.trc: expected no file of a further individual" in done.stderr
    assert (tmp_path / "st_0.trc").read_bytes() == before
    (tmp_path / "st_0.trc").unlink()
    assert tool("convert", "1.npz", "st.trc", cwd=tmp_path).returncode == 0


@pytest.mark.slow
def test_the_content_says_the_kind_and_the_remedy_works(tool, tmp_path):
    """Endings that poses have too; a calibration beside the keypoints; SLEAP's analysis of three
    frames, which looks like 3D.
    """
    (tmp_path / "both").mkdir()
    (tmp_path / "both" / "a.csv").write_text(DLC)
    (tmp_path / "three.csv").write_text(DLC + "2,12,22,0.5\n")
    mc.write(rig(), tmp_path / "both" / "calibration.toml")
    for source, target, *more in (
        ("both", "x.json"),
        ("both/a.csv", "x.csv", "--to", "deeplabcut-csv"),
        ("both/a.csv", "x.h5", "--to", "sleap"),
        ("three.csv", "three.h5", "--to", "sleap"),
        ("three.h5", "three.json"),
    ):
        done = tool("convert", source, target, *more, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        found = mc.read_keypoints(tmp_path / target)[0].positions[:2, 0, 0]
        assert found.tolist() == [[10, 20], [11, 21]]
    assert tool("convert", "both", "x.yaml", cwd=tmp_path).returncode == 0
    assert mc.read_rig(tmp_path / "x.yaml").names == ("a", "b")


@pytest.mark.parametrize(
    ("line", "status", "reason"),
    [
        ("nothing.toml b.yaml", 1, "expected a file or folder, found none"),
        ("a.toml b.what", 1, "--to"),
        ("a.toml b --to zip", 1, "expected a format"),
        ("a.toml b --to kalibr", 1, "only read"),
        ("a.toml b --from anipose --to trc", 1, "expected a format of cameras"),
        ("a.toml b --to trc", 1, "expected a format of cameras, which INPUT holds"),
        ("a.toml - --to colmap", 1, "one file for stdout"),
        ("- b.toml", 2, "--from"),
        ("- a.toml b.toml --from anipose", 2, "stdin: expected it alone"),
        ("a.toml a.toml b.yaml", 2, "one file or folder of cameras"),
        ("a.toml b.yaml --input-unit mm", 1, "as the file says"),
        ("broken.json b.toml", 1, "broken.json: expected JSON"),
        ("intrinsics.toml b.yaml", 1, "extrinsics"),
        ("empty b.yaml", 1, "empty"),
        ("twice.toml b.yaml", 1, "twice"),
        ("dlc.csv x.csv", 1, "--to deeplabcut-csv"),
        ("dlc.csv x.h5", 1, "--to deeplabcut-h5"),
        ("dlc.csv x.nc --from coco", 1, "name another format, or none"),
        ("frames x.toml", 1, "and one of coco, openpose"),
        ("dlc.csv x.nc --unit m", 2, "--unit"),
        ("dlc.csv x.nc --fps 30", 2, "--fps"),
        ("a.toml b.yaml --up z", 2, "--up: expected an option of cameras"),
        ("a.toml b.yaml --layout coco_17", 2, "--layout"),
        ("p.npz x.h5 --frame-offset a:1", 2, "--frame-offset: expected an option of poses"),
        ("p.npz x.h5 --image-size 8x8", 2, "--image-size"),
        ("a.toml b.yaml --image-size 8x8", 1, "leave it out"),
        ("a.toml b.yaml --image-size a:8x8", 2, "expected one size for all cameras, found that"),
        ("dlc.csv x.nc --image-size 0x8", 2, "above 0"),
    ],
)
def test_what_cannot_be_is_one_line(tool, tmp_path, line, status, reason):
    mc.write(rig(), tmp_path / "a.toml")
    mc.write(poses(), tmp_path / "p.npz")
    (tmp_path / "dlc.csv").write_text(DLC)
    mc.write(mc.read_keypoints(tmp_path / "dlc.csv"), tmp_path / "frames", "openpose")
    (tmp_path / "broken.json").write_text('{"frames": [')
    (tmp_path / "empty").write_text("")
    (tmp_path / "twice.toml").write_text((tmp_path / "a.toml").read_text().replace('"b"', '"a"'))
    shutil.copy(EXAMPLE / "intrinsics.toml", tmp_path)
    done = tool("convert", *line.split(), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (status, "")
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert status == 2 or done.stderr.count("\n") == 1
    assert not any((tmp_path / name).exists() for name in ("b.yaml", "x.csv", "x.h5", "x.nc"))


def test_a_camera_without_a_place_is_left_out_and_said(tool, tmp_path):
    mc.write(rig(), tmp_path / "cams", "easymocap")
    intri = (tmp_path / "cams/intri.yml").read_text()
    more = intri[intri.index("K_b") :].replace("_b", "_c")
    (tmp_path / "cams/intri.yml").write_text(intri.replace('  - "b"', '  - "b"\n  - "c"') + more)
    done = tool("convert", tmp_path / "cams", tmp_path / "b.yaml")
    assert done.returncode == 0
    assert "nothing says where they stand: c" in done.stderr
    assert mc.read_rig(tmp_path / "b.yaml").names == ("a", "b")
    assert len(mc.read_cameras(tmp_path / "cams")) == 3


def test_an_image_size_can_be_said(tool, tmp_path):
    mc.write(rig(), tmp_path / "a.mat", "dannce")
    words = ("convert", tmp_path / "a.mat", tmp_path / "b", "--to", "pose2sim")
    assert "expected the image size" in tool(*words).stderr
    assert tool(*words, "--image-size", "1280x720").returncode == 0
    assert_same(rig(), mc.read_rig(tmp_path / "b"))


@pytest.mark.parametrize(
    ("output", "options"),
    [
        ("out.h5", ("--fps", 60, "--cutoff", 5)),
        ("out.npz", ("--method", "median", "--window", 5)),
        ("out.npz", ("--method", "savgol")),
    ],
)
def test_poses_are_filtered(tool, tmp_path, output, options):
    given = replace(poses(frames=60), keypoints=("a", "b", "c"))
    mc.write(given, tmp_path / "noisy.npz")
    said = tool("filter", tmp_path / "noisy.npz", "-o", tmp_path / output, *options)
    assert said.returncode == 0, said.stderr
    found = mc.read_poses(tmp_path / output)
    method = dict(zip(options[::2], options[1::2], strict=True)).get("--method", "butterworth")
    own = {"fps": 60, "cutoff": 5} if method == "butterworth" else {}
    expected = mc.filter(given, method, **own, **({"window": 5} if method == "median" else {}))
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-6)
    assert found.positions.std() < 0.8 * given.positions.std()
    assert found.keypoints == given.keypoints


def test_a_filter_that_needs_the_rate_says_so(tool, tmp_path):
    mc.write(poses(), tmp_path / "p.npz")
    said = tool("filter", tmp_path / "p.npz", "-o", tmp_path / "out.h5")
    assert (said.returncode, said.stderr.count("\n")) == (1, 1)
    assert "--fps" in said.stderr
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.slow
def test_run_writes_what_is_asked_for(tool, small, tmp_path):
    """Further formats are results like the others: `run.json` lists them."""
    formats = ("colmap", "nerfstudio", "movement-3d", "sleap-anipose")
    asked = [word for name in formats for word in ("--write", name)]
    out, cameras = tmp_path / "out", ("--cameras", small / "intrinsics.toml")
    done = tool("run", small / "keypoints", *cameras, "-o", out, "--fps", 30, *asked)
    assert done.returncode == 0, done.stderr
    names = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert {"cameras.yaml", "calibration.toml", "poses3d.h5", "run.json"} <= names
    assert {"colmap/images.txt", "nerfstudio/transforms.json", "poses3d.nc", "points3d.h5"} <= names
    assert_same(mc.read_rig(out / "cameras.yaml"), mc.read_rig(out / "colmap"))
    bodies = mc.read_poses(out / "poses3d.h5")
    lines = (out / "colmap" / "points3D.txt").read_text().splitlines()
    rows = [line.split() for line in lines if not line.startswith("#")]
    points = np.array([[float(number) for number in row[1:4]] for row in rows])
    known = np.isfinite(bodies.raw[..., 0])
    # the points are triangulated in the world of the results, the bodies were moved to it
    np.testing.assert_allclose(points, bodies.raw[known], atol=1e-10)
    report = json.loads((out / "run.json").read_text())
    assert report["unit"] == "arbitrary"
    assert names == {"run.json", *report["outputs"]}


# --- which files are read


def write_frames(folder: Path, name: str, text: str, count: int = 2) -> None:
    """Write a file for each frame of a camera."""
    (folder / name).mkdir(parents=True)
    for frame in range(count):
        (folder / name / f"{frame}.txt").write_text(text)


POINTS = "frame,individual,keypoint,x,y\n0,anna,nose,3,4\n"
YOLO = "0 0.5 0.5 0.1 0.1 0.4 0.4 0.6 0.6\n"


def cameras_of(tool, folder: Path, *more: object) -> list[str] | str:
    """The cameras whose keypoints are found in a folder, or what is wrong."""
    done = tool("convert", "in", "out.csv", "--to", "csv", *more, cwd=folder)
    if done.returncode:
        return done.stderr
    return sorted(view.camera for view in mc.read_keypoints(folder / "out.csv"))


def test_an_h5_is_preferred_to_the_csv_beside_it_and_that_is_said(tool, tmp_path):
    """Files that are named are read, and two of one camera are refused."""
    (tmp_path / "in").mkdir()
    for camera in "ab":
        (tmp_path / f"{camera}.csv").write_text(DLC)
        words = ("convert", f"{camera}.csv", f"in/{camera}.h5", "--to", "deeplabcut-h5")
        assert tool(*words, cwd=tmp_path).returncode == 0
        shutil.copy(tmp_path / f"{camera}.csv", tmp_path / "in")
    words = ("out", "--to", "openpose")
    said = tool("convert", "in", *words, cwd=tmp_path).stderr
    assert "left out, the .h5 beside it is read: in/a.csv, in/b.csv\n" in said
    said = tool("convert", "in/a.csv", "in/b.h5", *words, cwd=tmp_path)
    assert (said.returncode, "beside" in said.stderr) == (0, False)
    said = tool("convert", "in/a.csv", "in/a.h5", *words, cwd=tmp_path)
    assert (said.returncode, "one keypoint file per camera" in said.stderr) == (1, True)
    (tmp_path / "in" / "a.json").write_text("{}")
    said = tool("convert", "in", *words, cwd=tmp_path)
    assert (said.returncode, "one keypoint file per camera" in said.stderr) == (1, True)


def test_what_is_no_keypoints_beside_camera_folders_is_left_alone(tool, tmp_path):
    folder = tmp_path / "in"
    for camera in ("left", "right"):
        (folder / camera).mkdir(parents=True)
        (folder / camera / "0.csv").write_text(POINTS)
    for name in ("notes.txt", "params.json", "points.csv"):
        (folder / name).write_text("[1, 2]")
    (folder / "videos").mkdir()
    assert cameras_of(tool, tmp_path) == ["left", "right"]
    (folder / "top.csv").write_text(POINTS)
    assert "params.json" in cameras_of(tool, tmp_path)  # now files are meant
    for name in ("params.json", "points.csv"):
        (folder / name).unlink()
    assert cameras_of(tool, tmp_path) == ["left", "right", "top"]


def test_results_below_the_files_and_texts_without_a_number_are_left_alone(tool, tmp_path):
    folder = tmp_path / "in"
    (folder / "out").mkdir(parents=True)
    (folder / "left.csv").write_text(POINTS)
    (folder / "out" / "run.json").write_text("{}")
    (folder / "out" / "poses3d.csv").write_text("nose_x,nose_y\n1,2\n")
    assert cameras_of(tool, tmp_path) == ["left"]
    shutil.rmtree(folder)
    write_frames(folder, "left", YOLO)
    (folder / "left" / "classes.txt").write_text("person\n")
    more = ("--layout", "a,b", "--image-size", "100x100")
    assert cameras_of(tool, tmp_path, *more) == ["left"]
    assert mc.read_keypoints(tmp_path / "out.csv")[0].frames.tolist() == [0, 1]


def test_the_size_of_one_camera_is_that_of_its_files_alone(tool, tmp_path):
    for camera in ("a", "b:c"):
        write_frames(tmp_path / "in", camera, YOLO)
    sizes = ("--layout", "a,b", "--image-size", "100x100", "--image-size", "b:c:50X10")
    sizes += ("--image-size", "80x80")  # the last one counts
    assert cameras_of(tool, tmp_path, *sizes) == ["a", "b:c"]
    first, second = mc.read_keypoints(tmp_path / "out.csv")
    assert first.positions[0, 0, 0].tolist() == [32, 32]
    assert second.positions[0, 0, 0].tolist() == [20, 4]
    assert "found one of d" in cameras_of(tool, tmp_path, *sizes, "--image-size", "d:1x1")


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil", "..", "a\\b", ""])
def test_a_camera_s_name_leads_nowhere(name, tool, tmp_path):
    table = "camera,frame,instance,keypoint,x,y,score\n{},0,0,nose,3,4,1\nc,0,0,nose,3,4,1\n"
    (tmp_path / "in.csv").write_text(table.format(name))
    (tmp_path / "a").mkdir()
    for format in ("coco", "openpose", "sleap", "deeplabcut-csv"):
        done = tool("convert", "in.csv", "a/out", "--to", format, cwd=tmp_path)
        assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "in.csv"]


# --- what is written of formats


def test_names_of_formats_are_one_kind_each_but_for_caliscope():
    """caliscope has both keypoints and cameras of that name; the content tells."""
    assert {name for name in NAMES if NAMES.count(name) > 1} <= {"caliscope"}


@pytest.mark.parametrize(
    ("kind", "title"),
    [("keypoints", "Keypoint files"), ("cameras", "Camera files"), ("poses", "3D files")],
)
def test_every_format_is_documented(kind, title):
    text = (ROOT / "docs" / "formats.md").read_text("utf-8")
    section = re.split(r"\n###? ", text.split(f"\n## {title}\n")[1])[0]
    rows = re.findall(r"^\| `(?!--)([^`]+)` \|", section, re.M)
    assert sorted(rows) == sorted(each.name for each in FORMATS[kind])
    page = (ROOT / "docs" / "formats-checks.md").read_text("utf-8")
    names = [each.name for each in FORMATS[kind] if each.read]
    assert [name for name in names if f"`{name}`" not in page] == []
