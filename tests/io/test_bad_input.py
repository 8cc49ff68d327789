"""What goes wrong with keypoint files in the field: corrected and reported, or refused in one line.

`inspect` reports it; `read_keypoints` and `read_recording` read or refuse.
"""

import json
import os
import re
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from conformance import CAMERAS, CORPUS, KEYPOINTS, POSES, READ_ONLY, SIZE
from golden.command import call
from platforms import linux

import mocap_calib as mc

NAMES = ("nose", "left_ear", "tail", "right_ear")
MATRIX = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
VIDEO = b"\x00\x00\x00\x20ftypisom\x00\x00\x02\x00" + bytes(range(256))


def camera(name: str, size: tuple[int, int] = SIZE) -> mc.Camera:
    return mc.Camera(name, size, MATRIX, np.zeros(5), False)


def write_coco(
    folder: Path, cameras: Any, names=NAMES, scores: Any = 0.8, seed: int | None = None
) -> Path:
    """Write a file per camera: `cameras` are its names, or name -> frames; return the folder."""
    for k, name in enumerate(cameras):
        frames = cameras[name] if isinstance(cameras, dict) else range(5)
        rng = np.random.default_rng(k if seed is None else seed)
        points = rng.uniform(5, 400, (len(frames), 1, len(names), 2))
        given = scores[name] if isinstance(scores, dict) else scores
        confidence = np.full(points.shape[:3], given) * (1 + np.arange(len(names))) / len(names)
        mc.write(view(name, points, confidence, frames, names), folder / "new", "coco")
        (folder / "new" / f"{name}.json").replace(folder / f"{name}.json")
        (folder / "new").rmdir()
    return folder


def view(name: str, points: Any, confidence: Any, frames=None, names=NAMES) -> mc.Keypoints2D:
    frames = np.arange(len(points)) if frames is None else np.array(frames)
    points = np.where(confidence[..., None] > 0, points, np.nan)
    return mc.Keypoints2D(name, names, frames, points, confidence, True, SIZE, "made")


def names_of_two(folder: Path, first: Any, second: Any) -> None:
    """Write two cameras whose joints are called differently."""
    write_coco(folder, "a", names=first)
    write_coco(folder, "b", names=second, seed=1)


def shares(folder: Path, least: float = 0.0) -> Path:
    """Write OpenPose's files with keypoint_scale 3, or 4 where the least is -1."""
    for name in "ab":
        (folder / f"{name}_json").mkdir()
        points = np.random.default_rng(ord(name)).uniform(least, 1, 54).tolist()
        content = json.dumps({"people": [{"pose_keypoints_2d": points}]})
        (folder / f"{name}_json" / "0.json").write_text(content)
    return folder


def with_intrinsics(folder: Path, cameras: str, size: tuple[int, int] = SIZE) -> None:
    write_coco(folder, "ab")
    placed = [np.stack([np.eye(3)] * len(cameras)), np.eye(3)[: len(cameras)]]
    rig = mc.CameraRig(tuple(camera(name, size) for name in cameras), *placed, "m")
    mc.write(rig, folder.parent / "cameras.toml")


class Finding(NamedTuple):
    """make: of the folder. words: of `inspect`. status: 1 where a run could not work.

    pattern: parts of the finding, which is critical then, else a warning; "" = no such.
    """

    make: Callable[[Path], object]
    status: int
    parts: tuple[str, ...]
    words: tuple[str, ...] = ()


LATE = {"a": range(30), "b": range(100, 130)}
NEAR = {"a": range(42150, 42180), "b": range(42151, 42181)}
GIVEN = ("--cameras", "cameras.toml")
FINDINGS = {
    "other lengths": Finding(
        partial(write_coco, cameras={"a": range(30), "b": range(5, 60)}), 0, ("a 0-29, b 5-59",)
    ),
    "no common frame": Finding(partial(write_coco, cameras=LATE), 1, ("--frame-offset",)),
    "another start": Finding(partial(write_coco, cameras=NEAR), 0, ("--frame-offset b:-1",)),
    "absent frames": Finding(
        partial(write_coco, cameras=dict.fromkeys("ab", (0, 1, 5, 6, 20))), 0, ("16 frame numbers",)
    ),
    "high scores": Finding(
        partial(write_coco, scores=6.0, cameras="ab"), 0, ("a: some scores are above 1 (up to 6",)
    ),
    "low scores": Finding(
        partial(write_coco, scores={"a": 0.8, "b": 0.008}, cameras="ab"),
        0,
        ("b: half of the scores",),
    ),
    "no valid point": Finding(
        partial(write_coco, scores={"a": 0.8, "b": 0.0}, cameras="ab"), 1, ("found those of 1 (a)",)
    ),
    "joints of one camera": Finding(
        partial(
            names_of_two,
            first=("Nose", "LEar", "REar", "Neck", "tail"),
            second=("nose", "left_ear", "right_ear", "neck", "horn"),
        ),
        0,
        ("tail (a), horn (b)", "--skeleton"),
    ),
    "no common joint": Finding(
        partial(names_of_two, first=("x1", "x2", "x3", "x4"), second=("y1", "y2", "y3", "y4")),
        1,
        ("no two cameras share",),
    ),
    "shares of the image": Finding(shares, 1, ("expected positions in pixels", "--image-size")),
    "outside the image": Finding(
        partial(write_coco, cameras="ab"),
        0,
        ("outside its image",),
        ("--crop-offset", "b:500,20.5", "--image-size", "b:640x480"),
    ),
    "keypoints in a corner": Finding(
        partial(write_coco, cameras="ab"),
        0,
        ("a: the keypoints lie in the lower right quarter", "--crop-offset a:X,Y"),
        ("--crop-offset", "a:700,500", "--image-size", "a:1280x960"),
    ),
    "images of another size": Finding(
        partial(with_intrinsics, cameras="ab", size=(480, 640)),
        *(0, ("images of 640 x 480, intrinsics for 480 x 640", "--rotated a:90"), GIVEN),
    ),
    "a camera without keypoints": Finding(
        partial(with_intrinsics, cameras="abc"), 0, ("c: no keypoints",), GIVEN
    ),
    "one camera twice": Finding(
        partial(write_coco, cameras="ab", seed=0), 1, ("a and b have the same detections",)
    ),
    "no longer shares": Finding(shares, 0, (), ("--image-size", "640x480")),
    "a clock that was moved": Finding(
        partial(write_coco, cameras=NEAR), 0, (), ("--frame-offset", "b:-1")
    ),
}


@pytest.mark.parametrize("name", FINDINGS)
def test_inspect_finds_what_would_go_wrong(tmp_path, name):
    case = FINDINGS[name]
    (tmp_path / "keypoints").mkdir()
    case.make(tmp_path / "keypoints")
    done = call("inspect", "keypoints", "--json", *case.words, folder=tmp_path)
    assert done.status == case.status
    level = "CRITICAL" if case.status else "WARNING"
    found = json.loads(done.stdout)["findings"]
    said = [each["message"] for each in found if each["level"] == level]
    if case.parts:
        assert any(all(part in message for part in case.parts) for message in said), said
    else:
        assert not [each for each in said if "pixels" in each or "start" in each]


def test_a_missing_point_is_counted_however_it_is_written(tmp_path):
    """And a gap, by the numbers of the frames."""
    frames, points = (0, 1, 5, 6, 20), np.full((5, 1, 4, 2), 50.0)
    mc.write(view("a", points, np.full((5, 1, 4), 0.7), frames), tmp_path, "coco")
    data = json.loads((tmp_path / "a.json").read_text())
    odd = ([0, 0, 0], [0, 0, 0.5], [-1, -1, -1], [float("nan"), 3, 1], [7, 8, 0])
    for annotation, triple in zip(data["annotations"], odd, strict=True):
        annotation["keypoints"][:3] = triple
    (tmp_path / "a.json").write_text(json.dumps(data))
    (found,) = json.loads(call("inspect", "a.json", "--json", folder=tmp_path).stdout)["cameras"]
    counts = {name: entry["points"] for name, entry in found["missing"].items()}
    assert counts == {"(0, 0)": 2, "(-1, -1)": 1, "empty or NaN": 1, "confidence 0": 1}
    assert found["missing"]["(0, 0)"]["share"] == pytest.approx(2 / 20)
    assert found["frames"] == {"count": 5, "first": 0, "last": 20, "gaps": [[2, 4], [7, 19]]}


# --- reading


def test_recordings_of_other_lengths_are_aligned_by_number(tmp_path):
    write_coco(tmp_path, {"a": range(30), "b": range(5, 60)}, scores=6.0)
    made = mc.read_recording(tmp_path, [camera("a"), camera("b")])
    np.testing.assert_array_equal(made.frames, range(5, 30))
    assert made.confidence.max() == 1.0


def test_an_image_size_makes_pixels_of_shares(tmp_path):
    """The remedy that `run`, `inspect` and `convert` name works in each: they read alike."""
    done = call("convert", shares(tmp_path), "out", "--to", "coco", folder=tmp_path)
    assert (done.status, len(done.stderr), (tmp_path / "out").exists()) == (1, 1, False)
    assert "--image-size" in done.stderr[0]
    with pytest.raises(mc.MismatchError, match=r"pixels.*image_size="):
        mc.read_recording(tmp_path, [camera("a"), camera("b")])
    plain = mc.read_keypoints(tmp_path)
    pixels = mc.read_keypoints(tmp_path, options=mc.ReadOptions(image_size=SIZE))
    size = ("--image-size", "640x480")
    assert call("convert", ".", "out", "--to", "coco", *size, folder=tmp_path).status == 0
    for share, pixel, back in zip(plain, pixels, mc.read_keypoints(tmp_path / "out"), strict=True):
        np.testing.assert_allclose(pixel.positions, share.positions * SIZE)
        np.testing.assert_allclose(back.positions, pixel.positions)
        assert pixel.image_size == SIZE


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (partial(shares, least=-1.0), {"image_size": SIZE}, "from 0 to 1"),
        (partial(write_coco, cameras="ab"), {"frame_offset": {"c": 1}}, "c"),
        (partial(write_coco, cameras="ab"), {"frame_offset": {"a": -50000}}, "a"),
        (partial(write_coco, cameras="ab"), {"camera_pattern": "view[0-9]"}, "camera_regex="),
        (str, {}, "found none"),
    ],
)
def test_what_the_user_says_of_other_files_is_refused(tmp_path, make, options, words):
    (tmp_path / "in").mkdir()
    make(tmp_path / "in")
    with pytest.raises((mc.MismatchError, mc.FormatError), match=words):
        mc.read_keypoints(tmp_path / "in", options=mc.ReadOptions(**options))


def test_another_image_size_than_the_file_s_is_refused(tmp_path):
    mc.write(view("b", np.full((1, 1, 4, 2), 0.5), np.ones((1, 1, 4))), tmp_path, "coco")
    with pytest.raises(mc.MismatchError, match=r"640x480, as the file says.*8x8"):
        mc.read_keypoints(tmp_path / "b.json", options=mc.ReadOptions(image_size=(8, 8)))


def test_crops_and_clocks_are_moved(tmp_path):
    write_coco(tmp_path, "ab")
    options = mc.ReadOptions(crop_offset={"b": (300.0, 20.5)}, frame_offset={"a": 7})
    plain, moved = mc.read_keypoints(tmp_path), mc.read_keypoints(tmp_path, options=options)
    np.testing.assert_array_equal(moved[1].positions, plain[1].positions + [300.0, 20.5])
    np.testing.assert_array_equal(moved[0].positions, plain[0].positions)
    np.testing.assert_array_equal(moved[0].frames, plain[0].frames + 7)


def test_cameras_are_named_by_hand_by_pattern_or_by_folder(tmp_path):
    write_coco(tmp_path, ["2019_Cam-A_fly", "2019_Cam-B_fly"])
    files = sorted(tmp_path.iterdir())
    for paths, pattern, names in (
        ([f"left={files[0]}", f"right={files[1]}"], "", ["left", "right"]),
        (tmp_path, r"Cam-[AB]", ["Cam-A", "Cam-B"]),
        (tmp_path, r"Cam-(.)_fly", ["A", "B"]),
    ):
        found = mc.read_keypoints(paths, options=mc.ReadOptions(camera_pattern=pattern))
        assert [view.camera for view in found] == names
    with pytest.raises(mc.MismatchError, match="name=path"):
        mc.read_keypoints([files[0], f"2019_Cam-A_fly={files[1]}"])
    with pytest.raises(mc.MismatchError, match="rename one side"):
        mc.read_recording(files, [camera("left"), camera("right")])
    for k, path in enumerate(files):
        (tmp_path / f"cam{k}").mkdir()
        path.rename(tmp_path / f"cam{k}" / "points.json")
    assert [view.camera for view in mc.read_keypoints(tmp_path)] == ["cam0", "cam1"]


def test_files_stay_in_order_and_each_that_is_wrong_is_reported(tmp_path):
    """HDF5 files are read side by side, others one at a time."""
    names = "abcdef"
    (tmp_path / "in").mkdir()
    for k, name in enumerate(names):
        made = view(name, np.full((3, 1, 4, 2), 10.0 + k), np.ones((3, 1, 4)))
        mc.write(made, tmp_path / name, "coco" if k == 2 else "deeplabcut-h5")
        (path,) = (tmp_path / name).iterdir()
        path.rename(tmp_path / "in" / path.name)
    found = mc.read_keypoints(sorted((tmp_path / "in").iterdir()))
    assert [each.camera for each in found] == list(names)
    assert [each.positions.flat[0] for each in found] == [10, 11, 12, 13, 14, 15]
    for name in "be":
        path = tmp_path / "in" / f"{name}.h5"
        path.write_bytes(path.read_bytes()[:3000])
    done = call("inspect", "in", "--json", folder=tmp_path)
    report = json.loads(done.stdout)
    assert done.status == 1
    assert [each["name"] for each in report["cameras"]] == ["a", "c", "d", "f"]
    wrong = [each["message"] for each in report["findings"] if each["level"] == "CRITICAL"]
    assert ["in/b.h5: expected" in wrong[0], "in/e.h5: expected" in wrong[1]] == [True, True]


# --- files of another kind

READERS = {
    "read_keypoints": mc.read_keypoints,
    "read_cameras": mc.read_cameras,
    "read_poses": mc.read_poses,
}


NOTHING = [b"", b"{}", b"[]", b"[cameras]", b"null", b"- 1\n", b"a: 1\n", b"%YAML:1.0\n---\n"]
NOTHING += [b"MATLAB 5.0", b"\x89HDF\r\n\x1a\n", b"\x00" * 600, bytes(range(256)), b"hello"]
NOTHING += [b"PK\x03\x04", b"PathFileType\n", b"\x02\x50" + bytes(600)]
NAMED = {
    "read_keypoints": {each.format or name for name, each in KEYPOINTS.items()},
    "read_cameras": {*CAMERAS, *READ_ONLY, "kalibr", "opencap", "ros"},
    "read_poses": {*POSES, "nwb-3d", "bvh", "blender", "rerun"},
}


@pytest.mark.parametrize(
    ("read", "name"), [(read, name) for read, names in NAMED.items() for name in sorted(names)]
)
def test_a_format_that_is_named_refuses_what_is_not_it(read, name, tmp_path):
    np.savez(tmp_path / "x.npz", positions=np.array([{}], dtype=object))  # a pickle
    for content in [*NOTHING, (tmp_path / "x.npz").read_bytes()]:
        (tmp_path / "x").write_bytes(content)
        if content == b"" and name == "ultralytics":  # an image without animals
            continue
        with pytest.raises((mc.FormatError, mc.MismatchError), match=r"expected|only written"):
            READERS[read](tmp_path / "x", name)


@pytest.mark.parametrize("name", ["cam1.mp4", "a.AVI", "b.mov", "c.mkv", "frame.png", "f.JPG"])
@pytest.mark.parametrize("read", ["read_keypoints", "read_cameras"])
def test_a_video_needs_a_pose_estimator_first(tmp_path, name, read):
    (tmp_path / name).write_bytes(VIDEO)
    found = "an image" if name.lower().endswith(("png", "jpg")) else "a video"
    with pytest.raises(mc.FormatError, match=f"{name}: expected .*found {found}; ") as refused:
        READERS[read](tmp_path / name)
    assert read != "read_keypoints" or "DeepLabCut, SLEAP" in str(refused.value)


@linux
def test_a_video_is_not_opened(tmp_path):
    """It may be larger than memory; this one cannot be read at all."""
    (tmp_path / "cam1.mp4").symlink_to("/proc/self/mem")
    with pytest.raises(mc.FormatError, match="found a video"):
        mc.read_keypoints(tmp_path / "cam1.mp4")


def test_a_folder_of_videos_is_refused_unless_it_has_keypoints_too(tmp_path):
    folder = tmp_path / "cam1.mp4"  # and one that is called like a video is a folder
    folder.mkdir()
    for name in ("cam2.mp4", "cam1.mp4"):
        (folder / name).write_bytes(VIDEO)
    for place in (folder, tmp_path):
        with pytest.raises(mc.FormatError, match=r"found videos \(.*cam1.mp4, cam2.mp4\)"):
            mc.read_keypoints(place)
    (folder / "a.csv").write_text("frame,keypoint,x,y\n0,nose,1,2\n")
    assert mc.read_keypoints(folder)[0].camera == "a"


@pytest.mark.parametrize("read", READERS)
def test_what_is_not_there_is_said_without_the_words_of_the_system(tmp_path, read):
    with pytest.raises(
        mc.FormatError, match=r"nothing.csv: expected .*, found none; check the path"
    ):
        READERS[read](tmp_path / "nothing.csv")


def test_files_of_another_kind_are_shown_by_their_beginning(tmp_path):
    with_intrinsics(tmp_path, "ab")
    path = (tmp_path.parent / "cameras.toml").rename(tmp_path / "cameras.toml")
    for read, name, words in (
        (mc.read_keypoints, path.name, r"text that begins with '\[cam_0\] name = "),
        (mc.read_cameras, "a.json", "a JSON object with info, categories, images, "),
        (mc.read_poses, "a.json", "one of: poses-h5"),
    ):
        with pytest.raises(mc.FormatError, match=words):
            read(tmp_path / name)


# --- names with accents: macOS takes them apart in names of files, people type them composed

NAME = "łódź1"
APART = unicodedata.normalize("NFD", NAME)


@pytest.mark.parametrize("argument", [f"{APART}.json", f"{APART}=other.json"])
def test_names_are_compared_composed(argument, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_coco(tmp_path, "a")
    Path("a.json").rename(argument.split("=")[-1])
    for typed in (NAME, APART):
        options = mc.ReadOptions(frame_offset={typed: 7}, crop_offset={typed: (1.0, 2.0)})
        (view,) = mc.read_keypoints([argument], options=options)
        assert (view.camera, view.frames[0]) == (NAME, 7)
    other = write_coco(tmp_path, "b", seed=3) / "b.json"
    assert (
        mc.read_recording([argument, other], [camera(APART), camera("b")]).positions.shape[0] == 2
    )


def test_names_in_a_camera_file_are_compared_composed(tmp_path):
    with_intrinsics(tmp_path, "ab")
    path = tmp_path.parent / "cameras.toml"
    path.write_text(path.read_text().replace('"a"', f'"{APART}"'), "utf-8")
    assert [each.name for each in mc.read_cameras(path)] == [NAME, "b"]
    path.write_text(path.read_text("utf-8").replace('"b"', f'"{NAME}"'), "utf-8")
    with pytest.raises(mc.FormatError, match=f"each camera name once, found {NAME} twice"):
        mc.read_cameras(path)


def test_files_that_are_written_again_are_no_others(tmp_path):
    (tmp_path / f"{APART}.json").write_bytes(b"")
    view = mc.read_keypoints([f"{NAME}={write_coco(tmp_path.parent, 'a') / 'a.json'}"])
    mc.write(view, tmp_path, "coco")
    (tmp_path / "other.json").write_bytes(b"")
    with pytest.raises(mc.MismatchError, match="a new folder or one with the same files"):
        mc.write(view, tmp_path, "coco")


@pytest.mark.parametrize("name", ["a\0b", "a\ud800"])
@pytest.mark.parametrize("kind", ["keypoint", "camera", "pose keypoint"])
def test_a_name_that_no_file_can_hold_is_refused_where_it_is_read(kind, name, tmp_path):
    """And is escaped in the line."""
    write_coco(tmp_path, "ab")
    for path in tmp_path.glob("*.json"):
        path.write_text(path.read_text().replace('"tail"', json.dumps(name)))
    read = partial(mc.read_recording, tmp_path)
    if kind == "camera":
        text = (CORPUS / "cameras" / "panoptic" / "calibration.json").read_text()
        (tmp_path / "rig.json").write_text(
            re.sub(r'(?<="name": )".*?"', lambda _: json.dumps(name), text, count=1)
        )
        read = partial(mc.read_cameras, tmp_path / "rig.json")
    if kind == "pose keypoint":
        header = f"fnum,{name}_x,{name}_y,{name}_z,{name}_error,{name}_ncams,{name}_score"
        content = f"{header}\n0,1,2,3,0,2,1\n".encode(errors="surrogatepass")
        read = partial(mc.read_poses, content)
    with pytest.raises(mc.FormatError) as refused:
        read()
    assert str(refused.value).isprintable()
    assert re.search("without NUL, found .*; rename|expected UTF-8 text", str(refused.value))


FAR = {"border": 2560.0, "beyond": 2561.0, "below": -1921.0, "huge": 1e300, "infinite": np.inf}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [SIZE, (0, 0)], ids=["size", "no size"])
@pytest.mark.parametrize("case", FAR)
def test_points_far_outside_of_images_are_missing_and_counted(case, size, tmp_path):
    """More than three sizes of 640 pixels; where the size is not known, what no 32 bits hold."""
    is_far = case != "border" if any(size) else abs(FAR[case]) > 1e299
    views, cleared = [], []
    for name in "ab":
        points = np.random.default_rng(ord(name)).uniform(5, 400, (20, 1, 4, 2))
        made = replace(view(name, points, np.full((20, 1, 4), 0.5)), image_size=size)
        points[3:6, 0, 1, 0] = FAR[case]
        views.append(replace(made, positions=points.copy()))
        score = np.full((20, 1, 4), 0.5)
        if is_far:
            points[3:6, 0, 1], score[3:6, 0, 1] = np.nan, 0.0
        cleared.append(replace(made, positions=points, confidence=score))
    cameras = [camera(name, size) for name in "ab"]
    found = mc.Recording.from_keypoints(views, cameras)
    assert found == mc.Recording.from_keypoints(cleared, cameras)
    if any(size) and case == "huge":
        mc.write(views, tmp_path / "k", "csv")
        done = call("run", "k", "--image-size", "640x480", "-o", "out", folder=tmp_path)
        said = "keypoints more than three image sizes outside of its images, taken as missing"
        assert {f"{name}: 3 {said}" for name in "ab"} <= set(done.stderr)
        done = call("inspect", "k", "--image-size", "640x480", folder=tmp_path)
        assert b"missing by far outside of the image: 3" in done.stdout


def test_positions_of_another_image_are_refused_not_missing():
    """Where most of them lie far outside, they are of another size."""
    views = [
        replace(
            view(
                name,
                points := np.random.default_rng(k).uniform(3e3, 9e3, (20, 1, 4, 2)),
                np.full(points.shape[:3], 0.5),
            ),
            image_size=(0, 0),
        )
        for k, name in enumerate("ab")
    ]
    with pytest.raises(mc.MismatchError, match=r"found (detections|keypoints) at"):
        mc.Recording.from_keypoints(views, [camera(name) for name in "ab"])


@linux
def test_a_file_name_that_is_not_utf8_is_no_camera_but_can_be_given_one(tmp_path):
    write_coco(tmp_path, "a")
    path = (tmp_path / "a.json").rename(tmp_path / os.fsdecode(b"c\xff4.json"))
    with pytest.raises(
        mc.FormatError, match=r"expected a camera name in UTF-8 without NUL, found .*; "
    ):
        mc.read_keypoints(path)
    assert mc.read_keypoints([f"cam4={path}"])[0].camera == "cam4"
