"""What goes wrong with keypoint files in the field: mended and said, or refused in one line."""

import json
import os
import pickle
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from keypoint_files import coco, coco_bytes, dlc_columns, dlc_csv, dlc_h5_table, dlc_values
from samples2d import FRAMES, LAYOUT, NAMES, SAMPLES, SIZE, recording, write_sample

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.types import Camera
from mocap_calib_cli.commands.inspect import command

CAMERA = Camera(
    "a", SIZE, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5), False
)
ENOUGH = (*NAMES, "right_ear")  # for a calibration
OTHERS = ["run", "pairwise", "match", "adjust", "triangulate"]


def detections(keypoints):
    """`[frame, 1, keypoint, 2]` positions and `[frame, 1, keypoint]` confidences, all there."""
    positions = np.random.default_rng(0).uniform(5, 400, (len(FRAMES), 1, keypoints, 2))
    return positions, np.full(positions.shape[:3], 0.8)


def write_coco(folder, cameras, frames=FRAMES, **changes):
    """A COCO file per camera, each with its own random detections."""
    for k, name in enumerate(cameras):
        own = frames[name] if isinstance(frames, dict) else frames
        positions = np.random.default_rng(k).uniform(5, 400, (len(own), 1, len(ENOUGH), 2))
        (folder / f"{name}.json").write_bytes(
            coco_bytes(own, ENOUGH, positions, np.full(positions.shape[:3], 0.8), SIZE, **changes)
        )
    return folder


def inspected(*arguments):
    """Exit status and report of `inspect --json`."""
    done = CliRunner().invoke(command, [*map(str, arguments), "--json"])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, json.loads(done.output)


def said(report, level):
    return [entry["message"] for entry in report["findings"] if entry["level"] == level]


def message(error, path):
    text = str(error.value)
    assert "\n" not in text
    assert str(path) in text
    assert "expected" in text
    assert ";" in text, "no remedy"
    return text


def test_1_cameras_of_different_length_are_aligned_by_number(tmp_path):
    write_coco(tmp_path, "ab", {"a": range(30), "b": range(5, 60)})
    views = read_keypoints([tmp_path])
    recording_ = make_recording(
        views, (CAMERA, replace(CAMERA, name="b")), load_skeleton("people"), {}
    )
    np.testing.assert_array_equal(recording_.frames, range(5, 30))
    status, report = inspected(tmp_path)
    assert status == 0
    assert any("a 0-29, b 5-59" in text for text in said(report, "WARNING"))
    write_coco(tmp_path, "ab", {"a": range(30), "b": range(100, 130)})
    status, report = inspected(tmp_path)
    assert status == 1
    assert any("--frame-offset" in text for text in said(report, "CRITICAL"))


def test_2_frames_that_are_absent_are_gaps(tmp_path):
    frames = (0, 1, 5, 6, 20)
    entries = [
        {"image_id": f"{f}.jpg", "keypoints": [5.0, 6, 1] * 3, "score": 1, "box": []}
        for f in frames
    ]
    (tmp_path / "a.json").write_text(json.dumps(entries))
    _, report = inspected(tmp_path / "a.json", "--layout", ",".join(NAMES))
    camera = report["cameras"][0]
    assert camera["frames"] == {"count": 5, "first": 0, "last": 20, "gaps": [[2, 4], [7, 19]]}
    assert "frames without a detection are not in the file" in camera["remarks"]
    assert any("16 frame numbers" in text for text in said(report, "WARNING"))


def test_3_frame_numbers_are_kept_and_clocks_can_be_moved(tmp_path):
    write_coco(tmp_path, "ab", {"a": range(42150, 42180), "b": range(42151, 42181)})
    assert read_keypoints([tmp_path])[0].frames[0] == 42150
    _, report = inspected(tmp_path)
    assert any("--frame-offset b:-1" in text for text in said(report, "WARNING"))
    moved = read_keypoints([tmp_path], options=ReadOptions(frame_offset={"b": -1}))
    np.testing.assert_array_equal(moved[0].frames, moved[1].frames)
    _, report = inspected(tmp_path, "--frame-offset", "b:-1")
    assert not [text for text in said(report, "WARNING") if "start" in text]
    for wrong in ({"c": 1}, {"a": -50000}):
        with pytest.raises(MismatchError):
            read_keypoints([tmp_path], options=ReadOptions(frame_offset=wrong))


def test_4_every_custom_of_a_missing_point_is_counted(tmp_path):
    positions, confidence = np.full((5, 1, 3, 2), 50.0), np.full((5, 1, 3), 0.7)
    data = coco(FRAMES, NAMES, positions, confidence, SIZE)
    for annotation, odd in zip(
        data["annotations"],
        ([0, 0, 0], [0, 0, 0.5], [-1, -1, -1], [float("nan"), 3, 1], [7, 8, 0]),
        strict=True,
    ):
        annotation["keypoints"][:3] = odd
    (tmp_path / "a.json").write_text(json.dumps(data))
    _, report = inspected(tmp_path / "a.json")
    counts = {name: entry["points"] for name, entry in report["cameras"][0]["missing"].items()}
    assert counts == {"(0, 0)": 2, "(-1, -1)": 1, "empty or NaN": 1, "confidence 0": 1}
    assert report["cameras"][0]["missing"]["(0, 0)"]["share"] == pytest.approx(2 / 15)


@pytest.mark.parametrize("name", ["label3d", "caliscope"])
def test_5_files_without_scores_say_so(tmp_path, name):
    (view,) = read_keypoints(
        write_sample(name, tmp_path, *recording(scores=False)), None, SAMPLES[name][2]
    )
    assert set(np.unique(view.confidence)) == {0.0, 1.0}
    assert any("no scores" in remark for remark in view.remarks)


def test_6_scores_beyond_1_are_kept_scaled_and_warned_of(tmp_path):
    positions, confidence = detections(len(ENOUGH))
    for name in "ab":
        (tmp_path / f"{name}.json").write_bytes(
            coco_bytes(FRAMES, ENOUGH, positions + (name == "b"), 6 * confidence, SIZE)
        )
    status, report = inspected(tmp_path)
    assert status == 0
    assert report["cameras"][0]["confidence"]["most"] == pytest.approx(6 * confidence.max())
    typical = np.percentile(6 * confidence[confidence > 0], 99)
    assert (
        f"a: some scores are above 1 (up to {6 * confidence.max():.2f}), so all will be divided by "
        f"{typical:.3g}, the 99th percentile, and cut off at 1; "
        "nothing to do if the detector writes such"
    ) in said(report, "WARNING")
    assert sum("some scores are above 1" in text for text in said(report, "WARNING")) == 2
    views = read_keypoints([tmp_path])
    made = make_recording(views, (CAMERA, replace(CAMERA, name="b")), load_skeleton("people"), {})
    assert made.confidence.max() == 1.0


def test_7_nobody_is_taken_silently(tmp_path):
    """All people are kept, as detections in any order; who is who is the program's work."""
    positions, confidence = recording(2, missing=0)
    (tmp_path / "cam_json").mkdir()
    for k in FRAMES:
        order = [0, 1] if k % 2 else [1, 0]
        people = [
            {
                "pose_keypoints_2d": np.column_stack([positions[k, i], confidence[k, i]])
                .ravel()
                .tolist()
            }
            for i in order[: 1 + k % 3]
        ]
        (tmp_path / "cam_json" / f"v_{k:012d}_keypoints.json").write_text(
            json.dumps({"people": people})
        )
    (view,) = read_keypoints([tmp_path], None, ReadOptions(layout=NAMES))
    assert not view.tracked
    assert np.isfinite(view.positions).any((2, 3)).sum(1).tolist() == [1, 2, 2, 1, 2]
    for k, row in enumerate(view.positions):
        wanted = [positions[k, i] for i in ([0, 1] if k % 2 else [1, 0])[: 1 + k % 3]]
        np.testing.assert_array_equal(row[: len(wanted)], wanted)


def test_8_unique_body_parts_are_nobody_and_that_is_said(tmp_path):
    positions, confidence = recording(2, missing=0)
    columns = [
        *dlc_columns(NAMES, ("m1", "m2")),
        *(("net", "single", "corner", coord) for coord in ("x", "y", "likelihood")),
    ]
    values = np.concatenate([dlc_values(positions, confidence), np.ones((len(FRAMES), 3))], axis=1)
    (tmp_path / "a.csv").write_text(dlc_csv(FRAMES, columns, values))
    (view,) = read_keypoints([tmp_path])
    np.testing.assert_array_equal(view.positions, positions)
    assert any("corner" in remark for remark in view.remarks)


def test_9_names_are_matched_by_meaning_and_differences_listed(tmp_path):
    positions, confidence = detections(5)
    for camera, names in (
        ("a", ("Nose", "LEar", "REar", "Neck", "tail")),
        ("b", ("nose", "left_ear", "right_ear", "neck", "horn")),
    ):
        (tmp_path / f"{camera}.json").write_bytes(
            coco_bytes(FRAMES, names, positions + len(names[0]), confidence, SIZE)
        )
        positions = positions + 1
    status, report = inspected(tmp_path)
    assert status == 0
    assert report["pairs"][0]["joints"] == 4
    assert any(
        "tail (a), horn (b)" in text and "--skeleton" in text for text in said(report, "WARNING")
    )
    (tmp_path / "b.json").write_bytes(
        coco_bytes(FRAMES, ("x1", "x2", "x3", "x4", "x5"), positions, confidence, SIZE)
    )
    (tmp_path / "a.json").write_bytes(
        coco_bytes(FRAMES, ("y1", "y2", "y3", "y4", "y5"), positions + 2, confidence, SIZE)
    )
    status, report = inspected(tmp_path)
    assert status == 1
    assert any("no two cameras share" in text for text in said(report, "CRITICAL"))


@pytest.mark.parametrize(
    ("count", "layouts"), [(25, ("body_25", "body_25b")), (17, ("coco_17", "h36m_17"))]
)
def test_10_layouts_of_one_length_are_asked_for(tmp_path, count, layouts):
    (tmp_path / "a_json").mkdir()
    (tmp_path / "a_json" / "0.json").write_text(
        json.dumps({"people": [{"pose_keypoints_2d": [5.0, 6.0, 0.5] * count}]})
    )
    with pytest.raises(FormatError) as error:
        read_keypoints([tmp_path])
    assert all(layout in message(error, tmp_path / "a_json") for layout in layouts)
    status, report = inspected(tmp_path, "--layout", layouts[0])
    assert len(report["cameras"][0]["keypoints"]) == count
    assert status == 1  # a single camera


def test_10_openpose_s_other_lengths_are_known(tmp_path):
    (tmp_path / "a_json").mkdir()
    (tmp_path / "a_json" / "0.json").write_text(
        json.dumps({"people": [{"pose_keypoints_2d": [5.0, 6.0, 0.5] * 18}]})
    )
    assert read_keypoints([tmp_path])[0].keypoints[1] == "Neck"


def write_shares(folder, least=0.0):
    """OpenPose's files with keypoint_scale 3, or 4 where the least is -1."""
    for camera in "ab":
        (folder / f"{camera}_json").mkdir()
        people = [
            {"pose_keypoints_2d": np.random.default_rng(ord(camera)).uniform(least, 1, 54).tolist()}
        ]
        (folder / f"{camera}_json" / "0.json").write_text(json.dumps({"people": people}))
    return folder


def test_11_normalised_positions_are_refused(tmp_path, tool):
    status, report = inspected(write_shares(tmp_path))
    assert status == 1
    assert sum("expected positions in pixels" in text for text in said(report, "CRITICAL")) == 2
    done = tool("convert", tmp_path, tmp_path / "out", "--to", "coco")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "--image-size" in done.stderr
    assert not (tmp_path / "out").exists()
    with pytest.raises(MismatchError, match="pixels"):
        make_recording(
            read_keypoints([tmp_path]),
            (CAMERA, replace(CAMERA, name="b")),
            load_skeleton("people"),
            {},
        )


def test_11_the_image_size_makes_pixels_of_shares_in_any_format(tmp_path, tool):
    """The remedy that `run`, `inspect` and `convert` name works in each: they read alike."""
    shares, pixels = (
        read_keypoints([path], options=options)
        for path, options in (
            (write_shares(tmp_path), None),
            (tmp_path, ReadOptions(image_size=SIZE)),
        )
    )
    for share, pixel in zip(shares, pixels, strict=True):
        np.testing.assert_allclose(pixel.positions, share.positions * SIZE)
        assert pixel.image_size == SIZE
    assert not any(
        "pixels" in text
        for text in said(inspected(tmp_path, "--image-size", "640x480")[1], "CRITICAL")
    )
    done = tool("convert", tmp_path, tmp_path / "out", "--to", "coco", "--image-size", "640x480")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(read_keypoints([tmp_path / "out"])[0].positions, pixels[0].positions)


def test_11_an_image_size_leaves_pixels_alone_and_is_kept_where_the_file_has_none(tmp_path):
    (tmp_path / "a.csv").write_text("frame,keypoint,x,y\n0,nose,12.5,300\n")
    (view,) = read_keypoints([tmp_path], options=ReadOptions(image_size=SIZE))
    assert (view.positions.ravel().tolist(), view.image_size) == ([12.5, 300], SIZE)
    (view,) = read_keypoints(
        [write_coco(tmp_path, "b") / "b.json"], options=ReadOptions(image_size=(8, 8))
    )
    assert view.image_size == SIZE


def test_11_another_scale_or_another_image_size_than_the_file_s_is_refused(tmp_path):
    with pytest.raises(MismatchError, match="from 0 to 1"):
        read_keypoints([write_shares(tmp_path, least=-1.0)], options=ReadOptions(image_size=SIZE))
    (tmp_path / "b.json").write_bytes(
        coco_bytes([0], ["nose"], np.full((1, 1, 1, 2), 0.5), np.ones((1, 1, 1)), SIZE)
    )
    with pytest.raises(
        MismatchError, match="expected images of 640x480, as the file says, found --image-size 8x8"
    ):
        read_keypoints([tmp_path / "b.json"], options=ReadOptions(image_size=(8, 8)))


def test_11_shares_of_the_image_need_its_size_and_pixels_are_no_shares(tmp_path):
    paths = write_sample("ultralytics", tmp_path, *recording())
    with pytest.raises(FormatError, match="--image-size"):
        read_keypoints(paths, None, ReadOptions(layout=NAMES))
    label = tmp_path / "cam" / "labels" / "video_0.txt"
    label.write_text("0 0.5 0.5 0.2 0.2 320 240 1 10 20 1 30 40 1")
    with pytest.raises(FormatError, match="letterboxed"):
        read_keypoints(paths, None, SAMPLES["ultralytics"][2])


def test_11_crops_are_moved_back_and_points_outside_the_image_said(tmp_path):
    write_coco(tmp_path, "ab")
    plain, moved = (
        read_keypoints([tmp_path], options=ReadOptions(crop_offset=offset))
        for offset in ({}, {"b": (300.0, 20.5)})
    )
    np.testing.assert_array_equal(moved[1].positions, plain[1].positions + [300.0, 20.5])
    np.testing.assert_array_equal(moved[0].positions, plain[0].positions)
    _, report = inspected(tmp_path, "--crop-offset", "b:500,20.5")
    assert any("outside its image" in text for text in said(report, "WARNING"))


def test_12_cameras_are_named_by_hand_by_pattern_or_by_folder(tmp_path):
    write_coco(tmp_path, ["2019_Cam-A_fly", "2019_Cam-B_fly"])
    files = sorted(tmp_path.iterdir())
    assert [view.camera for view in read_keypoints([f"left={files[0]}", f"right={files[1]}"])] == [
        "left",
        "right",
    ]
    assert [
        view.camera
        for view in read_keypoints([tmp_path], options=ReadOptions(camera_pattern=r"Cam-[AB]"))
    ] == ["Cam-A", "Cam-B"]
    assert [
        view.camera
        for view in read_keypoints([tmp_path], options=ReadOptions(camera_pattern=r"Cam-(.)_fly"))
    ] == ["A", "B"]
    with pytest.raises(FormatError, match="--camera-regex"):
        read_keypoints(files, options=ReadOptions(camera_pattern="view[0-9]"))
    with pytest.raises(MismatchError, match="name=path"):
        read_keypoints([files[0], f"2019_Cam-A_fly={files[1]}"])
    with pytest.raises(MismatchError, match="rename one side"):
        make_recording(
            read_keypoints(files), (CAMERA, replace(CAMERA, name="b")), load_skeleton("people"), {}
        )


def test_12_all_cameras_in_one_coco_file(tmp_path):
    positions, confidence = recording(missing=0)
    data = coco(FRAMES, NAMES, positions, confidence, SIZE)
    images, annotations = [], []
    for k, camera in enumerate(("cam1", "cam2")):
        images += [
            i
            | {
                "id": f"{k}-{i['id']}",
                "file_name": f"day1/{camera}/color/{FRAMES[i['id']]:06d}.png",
            }
            for i in data["images"]
        ]
        annotations += [a | {"image_id": f"{k}-{a['image_id']}"} for a in data["annotations"]]
    (tmp_path / "all.json").write_text(
        json.dumps(data | {"images": images, "annotations": annotations})
    )
    for pattern in ("", "cam[12]"):
        views = read_keypoints([tmp_path / "all.json"], options=ReadOptions(camera_pattern=pattern))
        assert [view.camera for view in views] == ["cam1", "cam2"]
        np.testing.assert_array_equal(views[1].frames, FRAMES)
        np.testing.assert_array_equal(views[1].positions, positions)
    with pytest.raises(MismatchError, match="without a name"):
        read_keypoints([f"cam1={tmp_path / 'all.json'}"])


def test_12_views_in_one_file_are_split_by_the_ends_of_names(tmp_path):
    positions, confidence = recording(missing=0)
    names = ("nose_top", "tail_top", "nose_bot")
    (tmp_path / "a.csv").write_text(
        dlc_csv(FRAMES, dlc_columns(names), dlc_values(positions, confidence))
    )
    top, bot = read_keypoints([tmp_path], options=ReadOptions(views=("top", "bot")))
    assert (top.camera, top.keypoints, bot.camera, bot.keypoints) == (
        "top",
        ("nose", "tail"),
        "bot",
        ("nose",),
    )
    np.testing.assert_array_equal(bot.positions[:, :, 0], positions[:, :, 2])
    with pytest.raises(MismatchError, match="--views"):
        read_keypoints([tmp_path], options=ReadOptions(views=("top",)))


def _write_intrinsics(path, cameras, size=SIZE):
    lines = [
        f'[cam_{k}]\nname = "{name}"\nsize = {list(size)}\n'
        "matrix = [[500.0,0,320],[0,500,240],[0,0,1]]\ndistortions = [0,0,0,0,0]\n"
        for k, name in enumerate(cameras)
    ]
    path.write_text("\n".join(lines))
    return path


def test_13_a_calibration_of_another_image_size_is_refused(tmp_path):
    (tmp_path / "keypoints").mkdir()
    write_coco(tmp_path / "keypoints", "ab")
    status, report = inspected(
        tmp_path / "keypoints",
        "--cameras",
        _write_intrinsics(tmp_path / "small.toml", "ab", (480, 640)),
    )
    assert status == 1
    assert any("640 x 480" in text and "480 x 640" in text for text in said(report, "CRITICAL"))


def test_14_a_camera_twice_and_a_camera_without_keypoints_are_named(tmp_path):
    (tmp_path / "keypoints").mkdir()
    folder = write_coco(tmp_path / "keypoints", "ab")
    status, report = inspected(
        folder, "--cameras", _write_intrinsics(tmp_path / "more.toml", "abc")
    )
    assert status == 0
    assert any(text.startswith("c: no keypoints") for text in said(report, "WARNING"))
    (folder / "b.json").write_bytes((folder / "a.json").read_bytes())
    status, report = inspected(folder)
    assert status == 1
    assert any(
        text.startswith("a and b have the same detections") for text in said(report, "CRITICAL")
    )


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("kept", [0.0, 0.4, 0.97])
def test_15_a_file_that_is_cut_is_refused(tmp_path, name, kept):
    """Tables of text that end at a whole line cannot be told from short ones."""
    paths = write_sample(name, tmp_path, *recording(scores=SAMPLES[name][4]))
    victim = min(path for path in tmp_path.rglob("*") if path.is_file())
    content = victim.read_bytes()
    victim.write_bytes(content[: int(kept * len(content))].rstrip(b"\r\n0123456789.,"))
    if name == "ultralytics" and kept == 0.0:
        assert (
            0 in read_keypoints(paths, None, SAMPLES[name][2])[0].frames
        )  # an empty label is an image without animals
        return
    with pytest.raises(FormatError) as error:
        read_keypoints(paths, None, SAMPLES[name][2])
    message(error, victim.parent if kept == 0.0 and victim.parent != tmp_path else victim)


def test_15_empty_people_empty_lists_and_null_are_missing(tmp_path):
    frames = [
        [],
        [{"pose_keypoints_2d": []}],
        [{"pose_keypoints_2d": [None, None, None, 5.0, 6.0, 0.5, 1, 2, 1]}],
    ]
    (tmp_path / "a_json").mkdir()
    for k, people in enumerate(frames):
        (tmp_path / "a_json" / f"{k}.json").write_text(json.dumps({"people": people}))
    (view,) = read_keypoints([tmp_path], None, ReadOptions(layout=NAMES))
    assert np.isfinite(view.positions[..., 0]).sum((1, 2)).tolist() == [0, 0, 2]


def test_15_an_empty_file_among_the_frames_is_named(tmp_path):
    for name in ("openpose", "mmpose-images"):
        paths = write_sample(name, tmp_path / name, *recording())
        victim = sorted(path for path in (tmp_path / name).rglob("*.json"))[2]
        victim.write_bytes(b"")
        with pytest.raises(FormatError, match="found an empty file") as error:
            read_keypoints(paths, None, LAYOUT)
        message(error, victim)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (b"\x1f\x8b\x08", "gunzip"),
        (b"PK\x03\x04", "unpack"),
        (b"MATLAB 7.3 MAT-file", "-v7"),
        (b"CDF\x01\x00", "netCDF 4"),
    ],
)
def test_15_what_wraps_the_wanted_file_is_named_with_what_to_do(tmp_path, start, words):
    (tmp_path / "a.bin").write_bytes(start + b"\x00" * 200)
    for format in (None, "sleap", "csv"):
        with pytest.raises(FormatError, match=f"; .*{words}"):
            read_keypoints([tmp_path / "a.bin"], format)


def test_16_double_lines_and_double_frames_name_both(tmp_path):
    paths = write_sample("ultralytics", tmp_path, *recording(missing=0))
    label = tmp_path / "cam" / "labels" / "video_3.txt"
    label.write_text(label.read_text() + "\n" + label.read_text())
    with pytest.raises(FormatError, match=r"line 4: .*line 2"):
        read_keypoints(paths, None, SAMPLES["ultralytics"][2])
    folder = tmp_path / "cam_json"
    folder.mkdir()
    for name in ("one_0001.json", "two_0001.json"):
        (folder / name).write_text(
            json.dumps({"people": [{"pose_keypoints_2d": [5.0, 6.0, 0.5] * 18}]})
        )
    with pytest.raises(FormatError, match=r"one_0001\.json and two_0001\.json"):
        read_keypoints([folder])
    (tmp_path / "a.csv").write_text(
        "camera,frame,individual,keypoint,x,y\n" + "a,1,m,nose,5,6\n" * 4
    )
    with pytest.raises(FormatError, match="individual 0, nose 4 times, in rows 2, 3, 4; remove"):
        read_keypoints([tmp_path / "a.csv"])
    positions, confidence = recording()
    (tmp_path / "b.csv").write_text(
        dlc_csv([3, 4, 3, 5, 6], dlc_columns(NAMES), dlc_values(positions, confidence))
    )
    with pytest.raises(FormatError, match=r"frame 3 twice, at row 4 \(3\) and row 6 \(3\)"):
        read_keypoints([tmp_path / "b.csv"])


@pytest.mark.parametrize(
    ("row", "count", "what"),
    [
        ("c{},0,a,nose,1,2", 201, "200 cameras in a file"),
        ("c,0,a,k{},1,2", 60_000, "5000 keypoints"),
    ],
)
def test_another_column_taken_for_cameras_or_keypoints_is_refused_at_once(
    tmp_path, row, count, what
):
    """Image names among the cameras are refused quickly. Measured: 0.4 s.

    Two thousand of them took `inspect` minutes, and sixty thousand keypoints a minute.
    """
    lines = ["camera,frame,individual,keypoint,x,y", *map(row.format, range(count))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    begun = time.process_time()
    with pytest.raises(FormatError, match=f"at most {what}, found {count}"):
        read_keypoints([tmp_path / "a.csv"])
    assert time.process_time() - begun < 10


def test_an_h5_that_unpacks_to_a_giant_is_refused_before_it_is_read(tmp_path):
    """160 MB are claimed, and a quarter of it is there, in 40 kB: deflate packs a thousandfold.

    800 MB took 1.6 GB of memory.
    """
    with h5py.File(tmp_path / "a.h5", "w") as file:
        tracks = file.create_dataset(
            "tracks", (1, 2, 10, 1_000_000), "f8", chunks=(1, 2, 10, 50_000), compression="gzip"
        )
        for start in range(0, 250_000, 50_000):
            tracks[..., start : start + 50_000] = 1.0
        file["node_names"], file["track_names"] = (
            np.array([f"n{k}" for k in range(10)], dtype="S"),
            np.array([b"t"]),
        )
    with pytest.raises(FormatError, match=r"at most 10\d MB of `/tracks`.*found 160 MB"):
        read_keypoints([tmp_path / "a.h5"])


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (os.mkdir, (self.path,))


@pytest.mark.parametrize(
    "attribute", ["info", "values_block_0_kind", "non_index_axes", "index_kind", "of no use"]
)
def test_17_a_doctored_h5_runs_nothing(tmp_path, attribute):
    """No attribute is unpickled into anything but plain values.

    pandas.read_hdf runs what stands in `info` and others.
    """
    positions, confidence = recording()
    dlc_h5_table(
        tmp_path / "a.h5", list(FRAMES), dlc_columns(NAMES), dlc_values(positions, confidence)
    )
    trap = np.bytes_(pickle.dumps(Trap(tmp_path / "trap"), 0))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        group = file["df_with_missing"]
        (group if attribute in ("info", "non_index_axes") else group["table"]).attrs[attribute] = (
            trap
        )
    with pytest.raises(FormatError, match="do not trust this file"):
        read_keypoints([tmp_path / "a.h5"])
    assert not (tmp_path / "trap").exists()
    pickle.loads(bytes(trap))
    assert (tmp_path / "trap").exists(), "the trap works"


def test_17_pickles_and_arrays_of_objects_are_refused(tmp_path):
    trap = pickle.dumps(Trap(tmp_path / "trap"))
    for name, content in (
        ("a.pickle", trap),
        ("b.npy", b"\x93NUMPY" + trap),
        ("c.json", trap),
        ("d.h5", trap),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FormatError) as error:
            read_keypoints([tmp_path / name])
        message(error, tmp_path / name)
    assert not (tmp_path / "trap").exists()


def test_18_literals_marks_and_line_ends(tmp_path):
    data = [
        {
            "bodyparts": [[[1.5, 2.5, 0.5], [float("nan"), 3, 0.5], [float("inf"), 3, 0.5]]],
            "bboxes": [],
            "bbox_scores": [],
        }
    ]
    text = json.dumps(data)
    assert "NaN" in text
    assert "Infinity" in text
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf" + text.replace(",", ",\r\n").encode())
    (view,) = read_keypoints([tmp_path / "a.json"], None, ReadOptions(layout=NAMES))
    assert np.isfinite(view.positions[..., 0]).ravel().tolist() == [True, False, False]
    (tmp_path / "b.csv").write_bytes("\ufeffframe,keypoint,x,y\r\n3,nose,1.5,2.5\r\n".encode())
    assert read_keypoints([tmp_path / "b.csv"])[0].positions.ravel().tolist() == [1.5, 2.5]
    for wrong in (
        "frame,keypoint,x,y\n3,nose,1,5,2,5\n",
        'frame,keypoint,x,y\n3,nose,"1,5","2,5"\n',
    ):
        (tmp_path / "b.csv").write_text(wrong)
        with pytest.raises(FormatError, match="row 2"):
            read_keypoints([tmp_path / "b.csv"])
    (tmp_path / "b.csv").write_text("frame;keypoint;x;y\n3;nose;1,5;2,5\n")
    with pytest.raises(FormatError, match="commas"):
        read_keypoints([tmp_path / "b.csv"])
    table = dlc_csv(FRAMES, dlc_columns(NAMES), dlc_values(*recording(missing=0)))
    (tmp_path / "b.csv").write_text(table.replace(".", ","))
    with pytest.raises(FormatError, match=r"row 4.*commas in its numbers"):
        read_keypoints([tmp_path / "b.csv"])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
@pytest.mark.parametrize("name", ["coco", "deeplabcut-csv"])
def test_18_powershell_s_utf_16_is_read(tmp_path, name, encoding):
    paths = write_sample(name, tmp_path, *recording())
    (plain,) = read_keypoints(paths)
    paths[0].write_bytes(
        ("\ufeff" * (encoding == "utf-16-be") + paths[0].read_text()).encode(encoding)
    )
    (view,) = read_keypoints(paths)
    np.testing.assert_array_equal(view.positions, plain.positions)
    paths[0].write_bytes(paths[0].read_bytes()[:-1])
    with pytest.raises(FormatError):
        read_keypoints(paths)


def test_20_cameras_without_a_valid_point_are_named_and_stop_a_run_of_two(tmp_path):
    positions, confidence = detections(len(ENOUGH))
    for name, scores in (("a", confidence), ("b", np.zeros_like(confidence))):
        (tmp_path / f"{name}.json").write_bytes(coco_bytes(FRAMES, ENOUGH, positions, scores, SIZE))
    status, report = inspected(tmp_path)
    assert status == 1
    assert any(text.startswith("b: no valid point") for text in said(report, "WARNING"))
    assert any("found those of 1 (a)" in text for text in said(report, "CRITICAL"))
    (tmp_path / "b.json").write_bytes(
        coco_bytes(FRAMES, ENOUGH, positions + 1, confidence / 100, SIZE)
    )
    status, report = inspected(tmp_path)
    assert status == 0
    assert any(text.startswith("b: half of the scores") for text in said(report, "WARNING"))


@pytest.mark.parametrize(
    "option",
    [("--image-size", text) for text in ("wide", "-640x480", "0x480")]
    + [
        ("--frame-offset", "3"),
        ("--frame-offset", "a:x"),
        ("--crop-offset", "a:1"),
        ("--camera-regex", "("),
    ],
)
def test_options_that_make_no_sense_are_usage_errors(tmp_path, option):
    done = CliRunner().invoke(command, [str(write_coco(tmp_path, "ab")), *option])
    assert done.exit_code == 2
    assert "expected" in done.output


@pytest.mark.parametrize("name", OTHERS)
def test_all_commands_that_read_keypoints_take_the_options(tool, name):
    helped = tool(name, "--help").stdout
    assert all(
        flag in helped for flag in ("--format", "--layout", "--camera-regex", "--frame-offset")
    )


def test_run_reads_another_format_by_its_options(tmp_path, small, tool):
    """The small recording, written as OpenPose does, calibrates as its COCO files do."""
    views = read_keypoints([small / "keypoints"])
    write_keypoints(tmp_path / "openpose", views, "openpose")
    write_keypoints(tmp_path / "all.csv", views, "csv")
    rigs = []
    for k, arguments in enumerate(
        ([tmp_path / "openpose", "--layout", "coco_17"], [tmp_path / "all.csv", "--format", "csv"])
    ):
        done = tool(
            "pairwise",
            *arguments,
            "--cameras",
            small / "intrinsics.toml",
            "-o",
            tmp_path / f"{k}.json",
        )
        assert done.returncode == 0, done.stderr
        rigs.append((tmp_path / f"{k}.json").read_text())
    assert rigs[0] == rigs[1]
