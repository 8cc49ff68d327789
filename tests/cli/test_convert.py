"""`convert` and `filter`, and which files are read: real files, real pipes, one line for what
cannot be.
"""

import json
import re
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conversion_samples import DLC, rig
from rigs import assert_same

import mocap_calib as mc
from mocap_calib.io.kinds import FORMATS

ROOT = Path(__file__).parents[2]


def poses(individuals: int = 2, frames: int = 4) -> mc.Poses3D:
    """Random points in metres."""
    positions = np.random.default_rng(0).normal(size=(frames, individuals, 3, 3))
    quality = np.ones(positions.shape[:3])
    views = quality.astype(np.int64)
    return mc.Poses3D(
        ("x", "y", "z"), np.arange(frames), positions, quality, views, quality, unit="m"
    )


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
    """Keypoints beside a calibration; SLEAP's analysis of three frames, which looks like 3D."""
    (tmp_path / "both").mkdir()
    (tmp_path / "both" / "a.csv").write_text(DLC + "2,12,22,0.5\n")
    mc.write(rig(), tmp_path / "both" / "calibration.toml")
    for source, target, *more in (
        ("both", "x.json"),
        ("both/a.csv", "three.h5", "--to", "sleap"),
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
        ("a.toml b.what", 1, "--to"),
        ("a.toml b --from anipose --to trc", 1, "expected a format of cameras"),
        ("a.toml - --to colmap", 1, "one file for stdout"),
        ("- a.toml b.toml --from anipose", 2, "stdin: expected it alone"),
        ("a.toml a.toml b.yaml", 2, "one file or folder of cameras"),
        ("a.toml b.yaml --input-unit mm", 1, "as the file says"),
        ("twice.toml b.yaml", 1, "twice"),
        ("dlc.csv x.h5", 1, "--to deeplabcut-h5"),
        ("dlc.csv x.nc --from coco", 1, "name another format, or none"),
        ("frames x.toml", 1, "and one of coco, openpose"),
        ("dlc.csv x.nc --unit m", 2, "--unit"),
        ("a.toml b.yaml --up z", 2, "--up: expected an option of cameras"),
        ("p.npz x.h5 --frame-offset a:1", 2, "--frame-offset: expected an option of poses"),
        ("p.npz x.h5 --image-size 8x8", 2, "--image-size"),
        ("a.toml b.yaml --image-size 8x8", 1, "leave it out"),
        ("a.toml b.yaml --image-size a:8x8", 2, "expected one size for all cameras, found that"),
        ("a.mat b --to pose2sim", 1, "expected the image size"),
    ],
)
def test_what_cannot_be_is_one_line(tool, tmp_path, line, status, reason):
    """More of it is in tests/golden/refusals.py."""
    for name in ("a.toml", "a.mat"):
        mc.write(rig(), tmp_path / name, "dannce" if name == "a.mat" else "anipose")
    mc.write(poses(), tmp_path / "p.npz")
    (tmp_path / "dlc.csv").write_text(DLC)
    mc.write(mc.read_keypoints(tmp_path / "dlc.csv"), tmp_path / "frames", "openpose")
    (tmp_path / "twice.toml").write_text((tmp_path / "a.toml").read_text().replace('"b"', '"a"'))
    done = tool("convert", *line.split(), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (status, "")
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert status == 2 or done.stderr.count("\n") == 1
    assert not any((tmp_path / name).exists() for name in ("b", "b.yaml", "x.csv", "x.h5", "x.nc"))


def test_an_image_size_can_be_said(tool, tmp_path):
    mc.write(rig(), tmp_path / "a.mat", "dannce")
    words = ("--to", "pose2sim", "--image-size", "1280x720")
    assert tool("convert", "a.mat", "b", *words, cwd=tmp_path).returncode == 0
    assert_same(rig(), mc.read_rig(tmp_path / "b"))


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


POINTS = "frame,individual,keypoint,x,y\n0,anna,nose,3,4\n"
YOLO = "0 0.5 0.5 0.1 0.1 0.4 0.4 0.6 0.6\n"


def cameras_of(tool, folder: Path, *more: object) -> list[str] | str:
    """The cameras whose keypoints are found in a folder, or what is wrong."""
    done = tool("convert", "in", "out.csv", "--to", "csv", *more, cwd=folder)
    if done.returncode:
        return done.stderr
    return sorted(view.camera for view in mc.read_keypoints(folder / "out.csv"))


def test_an_h5_is_preferred_to_the_csv_beside_it_and_that_is_said(tool, tmp_path):
    """So is a filtered file to the raw one. What is named alone is read."""
    for camera in "ab":
        write_folder(tmp_path, **{f"in__{camera}_csv": DLC})
        words = ("convert", f"in/{camera}.csv", f"in/{camera}.h5", "--to", "deeplabcut-h5")
        assert tool(*words, cwd=tmp_path).returncode == 0

    def said_of(*inputs: str) -> tuple[int, str]:
        out = f"out{len(list(tmp_path.iterdir()))}"
        done = tool("convert", *inputs, out, "--to", "openpose", cwd=tmp_path)
        return done.returncode, done.stderr

    left_out = "left out, the .h5 or the filtered file beside it is read: in/a.csv, in/b.csv\n"
    assert left_out in said_of("in")[1]
    status, said = said_of("in/a.csv", "in/b.h5")
    assert (status, "beside" in said) == (0, False)
    status, said = said_of("in/a.csv", "in/a.h5", "in/b.h5")
    assert (status, "file beside it is read: in/a.csv\n" in said) == (0, True)
    for name in ("in/a_filtered.h5", "in/b_filtered.csv"):
        (tmp_path / name).write_bytes((tmp_path / name.replace("_filtered", "")).read_bytes())
    both = "in/a.csv, in/a.h5, in/b.csv, in/b.h5\n"
    assert both in said_of("in")[1]  # raw beside filtered
    assert both in said_of(*(f"in/{each.name}" for each in sorted((tmp_path / "in").iterdir())))[1]


def test_what_is_no_keypoints_beside_camera_folders_is_left_alone(tool, tmp_path):
    (tmp_path / "in" / "videos").mkdir(parents=True)
    others = dict.fromkeys(("in__notes_txt", "in__params_json", "in__points_csv"), "[1, 2]")
    write_folder(tmp_path, in__left__0_csv=POINTS, in__right__0_csv=POINTS, **others)
    assert cameras_of(tool, tmp_path) == ["left", "right"]
    write_folder(tmp_path, in__top_csv=POINTS)
    assert "params.json" in cameras_of(tool, tmp_path)  # now files are meant
    for name in ("params.json", "points.csv"):
        (tmp_path / "in" / name).unlink()
    assert cameras_of(tool, tmp_path) == ["left", "right", "top"]


def test_results_below_the_files_and_texts_without_a_number_are_left_alone(tool, tmp_path):
    write_folder(tmp_path, in__left_csv=POINTS, in__out__run_json="{}")
    write_folder(tmp_path, in__out__poses3d_csv="nose_x,nose_y\n1,2\n")
    assert cameras_of(tool, tmp_path) == ["left"]
    shutil.rmtree(tmp_path / "in")
    write_folder(
        tmp_path, in__left__0_txt=YOLO, in__left__1_txt=YOLO, in__left__classes_txt="cat\n"
    )
    assert cameras_of(tool, tmp_path, "--layout", "a,b", "--image-size", "100x100") == ["left"]
    assert mc.read_keypoints(tmp_path / "out.csv")[0].frames.tolist() == [0, 1]


def test_the_size_of_one_camera_is_that_of_its_files_alone(tool, tmp_path):
    for camera in ("a", "b:c"):
        write_folder(tmp_path / "in" / camera, **{"0_txt": YOLO, "1_txt": YOLO})
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


def write_folder(folder: Path, **files: str) -> None:
    """Write files by their paths, of which `__` is the slash and `_` the dot."""
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
