"""What is particular to one keypoint format.

Orders of axes, many videos in a file, old versions, several writers of one format.
"""

import json
from dataclasses import replace

import h5netcdf
import h5py
import numpy as np
import pytest
import samples2d
from keypoint_files import dlc_columns, dlc_csv, dlc_h5_fixed, dlc_values
from samples2d import FRAMES, NAMES, SIZE, recording, triples, write_sample

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.layouts import LAYOUTS, parse_layout
from mocap_calib.io.keypoints.per_frame import triples as per_frame_triples
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.recording.joints import load_skeleton, match_names

LAYOUT = ReadOptions(layout=NAMES)


def test_layouts_name_each_point_once_and_the_models_know_them():
    people = load_skeleton("people")
    for name, names in LAYOUTS.items():
        assert len(set(names)) == len(names), name
        if name.rpartition("_")[2].rstrip("b").isdigit():
            assert len(names) == int(name.rpartition("_")[2].rstrip("b"))
    for name in ("coco_17", "body_25", "body_25b", "coco_18", "halpe_26", "h36m_17", "mpii_16"):
        assert (match_names(LAYOUTS[name], people) >= 0).sum() >= len(LAYOUTS[name]) - 2, name
    for whole, body in (
        ("coco_wholebody_133", LAYOUTS["coco_17"]),
        ("halpe_136", LAYOUTS["halpe_26"]),
    ):
        assert LAYOUTS[whole][: len(body)] == body
        assert (match_names(LAYOUTS[whole], people) >= 0).sum() >= 23, whole
        assert LAYOUTS[whole][-42] == "left_hand_root"
    assert LAYOUTS["coco_wholebody_133"][17:24] == (
        *("left_big_toe", "left_small_toe", "left_heel"),
        *("right_big_toe", "right_small_toe", "right_heel"),
        "face_0",
    )
    assert parse_layout("a, b") == ("a", "b")
    with pytest.raises(MismatchError, match="coco_17"):
        parse_layout("body_26")


@pytest.mark.parametrize("layout", ["coco_wholebody_133", "halpe_136"])
@pytest.mark.parametrize("program", ["alphapose", "openpose", "mmpose"])
def test_whole_bodies_are_known_by_their_number_of_points(tmp_path, program, layout):
    count = len(LAYOUTS[layout])
    points, scores = np.random.default_rng(0).uniform(5, 400, (count, 2)), np.full(count, 0.5)
    content = {
        "alphapose": [
            {
                "image_id": "0.jpg",
                "category_id": 1,
                "keypoints": triples(points, scores),
                "score": 2.0,
                "box": [1, 2, 3, 4],
                "idx": [0.0],
            }
        ],
        "openpose": {"people": [{"pose_keypoints_2d": triples(points, scores)}]},
        "mmpose": [
            {
                "frame_id": 0,
                "instances": [{"keypoints": points.tolist(), "keypoint_scores": scores.tolist()}],
            }
        ],
    }
    (tmp_path / "0.json").write_text(json.dumps(content[program]))
    (view,) = read_keypoints([f"cam={tmp_path / '0.json'}"])
    assert view.keypoints == LAYOUTS[layout]


@pytest.mark.parametrize(
    ("people", "points"), [("people", "pose_keypoints_2d"), ("bodies", "joints")]
)
def test_alphapose_writes_openpose_with_all_frames_in_one_file(tmp_path, people, points):
    positions, confidence = recording(2)
    frames = {
        f"{f}.jpg": {
            "version": "AlphaPose v0.3",
            people: [
                {points: triples(x, s)} for x, s in zip(positions[k], confidence[k], strict=True)
            ],
        }
        for k, f in enumerate(FRAMES)
    }
    (tmp_path / "cam.json").write_text(json.dumps(frames))
    (view,) = read_keypoints([tmp_path / "cam.json"], None, LAYOUT)
    np.testing.assert_array_equal(view.frames, FRAMES)
    np.testing.assert_array_equal(view.positions, positions)


def test_all_cameras_of_a_slp_are_called_by_their_videos(tmp_path):
    positions, confidence = recording(2)
    samples2d._slp(tmp_path, positions, confidence, videos=("left_cam", "right_cam"))
    views = read_keypoints([tmp_path / "cam.slp"])
    assert [view.camera for view in views] == ["left_cam", "right_cam"]
    for view in views:
        np.testing.assert_array_equal(view.positions, positions)
    assert [
        view.camera
        for view in read_keypoints([tmp_path], None, ReadOptions(camera_pattern="(left|right)_"))
    ] == ["left", "right"]


def test_a_package_s_cameras_are_called_by_the_videos_its_images_are_of(tmp_path):
    positions, confidence = recording(2)
    samples2d._slp(tmp_path, positions, confidence, videos=("left_cam", "right_cam"))
    with h5py.File(tmp_path / "cam.slp", "a") as file:
        listed = [json.loads(entry) for entry in file["videos_json"]]
        del file["videos_json"]
        inside = [
            json.dumps(
                {"backend": {"filename": ".", "dataset": f"video{k}/video"}, "filename": "."}
            )
            for k in range(2)
        ]
        file["videos_json"] = np.array(inside, dtype="S")
    with pytest.raises(FormatError, match=r"found none; export an analysis \.h5"):
        read_keypoints([tmp_path])
    with h5py.File(tmp_path / "cam.slp", "a") as file:
        for k, video in enumerate(listed):
            file.create_group(f"video{k}/source_video").attrs["json"] = json.dumps(video)
    assert [view.camera for view in read_keypoints([tmp_path])] == ["left_cam", "right_cam"]


def test_a_package_s_cameras_are_called_by_its_session(tmp_path):
    """The order of cameras and videos is that of a package by SLEAP.

    Its 3D through its own calibration is then 3 px from its points, not 240.
    """
    positions, confidence = recording(2)
    samples2d._slp(tmp_path, positions, confidence, videos=("left_cam", "right_cam"))
    session = {
        "calibration": {"cam_0": {"name": "right"}, "cam_1": {"name": "left"}, "metadata": {}},
        "camcorder_to_video_idx_map": {"0": "1", "1": "0"},
    }
    with h5py.File(tmp_path / "cam.slp", "a") as file:
        del file["videos_json"]
        file["videos_json"] = np.array([json.dumps({"backend": {"filename": "."}})] * 2, dtype="S")
        file["sessions_json"] = np.array([json.dumps(session)], dtype="S")
    assert [view.camera for view in read_keypoints([tmp_path])] == ["left", "right"]


def test_lightning_pose_says_last_what_a_frame_was_used_for(tmp_path):
    positions, confidence = recording()
    lines = dlc_csv(FRAMES, dlc_columns(NAMES), dlc_values(positions, confidence)).splitlines()
    used = ["set", "", "", "train", "validation", "unlabeled", "", "test"]
    (tmp_path / "predictions.csv").write_text(
        "\n".join(f"{line},{last}" for line, last in zip(lines, used, strict=True))
    )
    (view,) = read_keypoints([tmp_path / "predictions.csv"])
    assert view.keypoints == NAMES
    np.testing.assert_array_equal(view.positions, positions)


def test_an_ensemble_kalman_smoother_writes_its_spread_beside(tmp_path):
    positions, confidence = recording()
    coords = (
        "x",
        "y",
        "likelihood",
        "x_ens_median",
        "y_ens_median",
        "x_ens_var",
        "y_ens_var",
        "x_posterior_var",
        "y_posterior_var",
    )
    columns = [("ensemble-kalman_tracker", name, coord) for name in NAMES for coord in coords]
    values = np.concatenate(
        [positions, confidence[..., None], np.full((*confidence.shape, 6), 7.0)], -1
    ).reshape(len(FRAMES), -1)
    (tmp_path / "eks.csv").write_text(dlc_csv(FRAMES, columns, values))
    (view,) = read_keypoints([tmp_path / "eks.csv"])
    np.testing.assert_array_equal(view.positions, positions)
    np.testing.assert_array_equal(view.confidence, confidence)


@pytest.mark.parametrize(
    "behind", [(), (0.87,), (0.87, 3)], ids=["nothing", "confidence", "confidence and track"]
)
@pytest.mark.parametrize("scores", [False, True])
def test_ultralytics_points_with_and_without_scores_before_what_may_follow(
    tmp_path, behind, scores
):
    positions, _ = recording(missing=0)
    (tmp_path / "cam").mkdir()
    for frame, points in zip(FRAMES, positions[:, 0] / SIZE, strict=True):
        cells = np.column_stack([points, np.full((len(points), int(scores)), 0.5)]).ravel().tolist()
        (tmp_path / "cam" / f"{frame}.txt").write_text(
            " ".join(map(repr, [0, 0.5, 0.5, 0.2, 0.2, *cells, *behind]))
        )
    (view,) = read_keypoints([tmp_path], None, ReadOptions(layout=NAMES, image_size=SIZE))
    np.testing.assert_allclose(view.positions, positions, rtol=0, atol=1e-9)
    assert set(np.unique(view.confidence)) == {0.5 if scores else 1.0}


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (2 * 17 + 1, "coco_17"),
        (3 * 17, "coco_17"),
        (2 * 25 + 2, "body_25 or"),
        (500, "with names separated by commas"),
    ],
)
def test_ultralytics_without_a_layout_asks_for_one_that_fits(tmp_path, count, words):
    (tmp_path / "0.txt").write_text(" ".join(["0", *["0.5"] * (4 + count)]))
    with pytest.raises(
        FormatError, match=f"found {count} numbers after the box; say --layout .*{words}"
    ):
        read_keypoints([f"cam={tmp_path / '0.txt'}"], None, ReadOptions(image_size=SIZE))


def test_a_slp_before_1_1_is_half_a_pixel_off(tmp_path):
    positions, confidence = recording(1)
    samples2d._slp(tmp_path, positions, confidence)
    with h5py.File(tmp_path / "cam.slp", "a") as file:
        file["metadata"].attrs["format_id"] = 1.0
    np.testing.assert_array_equal(read_keypoints([tmp_path])[0].positions, positions - 0.5)


def test_a_prediction_that_was_corrected_by_hand_does_not_count(tmp_path):
    positions, confidence = recording(2, missing=0)
    samples2d._slp(tmp_path, positions, confidence)
    with h5py.File(tmp_path / "cam.slp", "a") as file:
        rows = file["instances"][...]
        rows["track"] = -1
        rows[1]["instance_type"], rows[1]["from_predicted"] = (
            0,
            0,
        )  # in the first frame, the second corrects the first
        rows[1]["point_id_start"], rows[1]["point_id_end"] = 0, 3
        del file["instances"], file["points"]
        file["instances"] = rows
        file["points"] = np.array(
            [(7.0, 8.0, True, True)] * 3,
            dtype=[("x", "<f8"), ("y", "<f8"), ("visible", "?"), ("complete", "?")],
        )
    (view,) = read_keypoints([tmp_path])
    assert not view.tracked
    assert np.isfinite(view.positions[0, :, 0, 0]).tolist() == [True, False]
    assert view.positions[0, 0].tolist() == [[7.0, 8.0]] * 3
    assert view.confidence[0, 0].tolist() == [1.0] * 3


def test_sleap_s_standard_order_of_axes_is_recognised_and_an_ambiguous_one_refused(tmp_path):
    positions, confidence = recording(2)
    write_sample("sleap", tmp_path, positions, confidence)
    with h5py.File(tmp_path / "cam.analysis.h5", "a") as file:
        del file["tracks"], file["point_scores"]
        file["tracks"], file["point_scores"] = positions, confidence
    np.testing.assert_array_equal(read_keypoints([tmp_path])[0].positions, positions)
    with h5py.File(tmp_path / "cam.analysis.h5", "w") as file:
        file["tracks"], file["node_names"] = np.zeros((2, 2, 3, 2)), np.array(NAMES, dtype="S")
    with pytest.raises(FormatError, match="fits 2 orders"):
        read_keypoints([tmp_path])


def test_sleap_without_names_of_tracks_follows_nobody(tmp_path):
    write_sample("sleap", tmp_path, *recording(2))
    with h5py.File(tmp_path / "cam.analysis.h5", "a") as file:
        del file["track_names"], file["point_scores"]
        file["track_names"] = np.zeros(0)
    (view,) = read_keypoints([tmp_path])
    assert not view.tracked
    assert set(np.unique(view.confidence)) == {0.0, 1.0}


def test_sleap_tracks_that_nobody_follows_have_names_that_say_so(tmp_path):
    """sleap-io opens several tracks only with names, and saves a project only of a named video."""
    (view,) = read_keypoints(write_sample("sleap", tmp_path / "in", *recording(2)))
    for tracked, names in ((True, ["track_0", "track_1"]), (False, ["untracked_0", "untracked_1"])):
        folder = tmp_path / str(tracked)
        write_keypoints(folder, (replace(view, tracked=tracked),), "sleap")
        with h5py.File(folder / "cam.analysis.h5") as file:
            assert [name.decode() for name in file["track_names"]] == names
            assert file["video_path"][()] == b"cam"
        (found,) = read_keypoints([folder])
        assert found.tracked == tracked
        np.testing.assert_array_equal(found.positions, view.positions)


def test_sleap_io_s_names_of_axes_are_taken_at_their_word(tmp_path):
    """Two individuals, three nodes, two frames: lengths alone would fit two orders."""
    positions, confidence = recording(2)
    positions, confidence = positions[:2], confidence[:2]
    write_sample("sleap", tmp_path, *recording(2))
    with h5py.File(tmp_path / "cam.analysis.h5", "a") as file:
        del file["tracks"], file["point_scores"], file["track_occupancy"]
        file["tracks"] = positions.transpose(2, 3, 0, 1)
        file["tracks"].attrs["dims"] = json.dumps(["node", "xy", "frame", "track"])
        file["point_scores"] = confidence.transpose(2, 0, 1)
    (view,) = read_keypoints([tmp_path])
    np.testing.assert_array_equal(view.positions, positions)
    np.testing.assert_array_equal(view.confidence, confidence)
    with h5py.File(tmp_path / "cam.analysis.h5", "a") as file:
        file["tracks"].attrs["dims"] = "[" * 100_000
    with pytest.raises(FormatError, match="a whole SLEAP analysis"):
        read_keypoints([tmp_path])


def test_sleap_counts_from_0_and_refuses_to_write_a_clock_that_starts_far_away(tmp_path):
    (view,) = read_keypoints(write_sample("csv", tmp_path / "in", *recording()))
    late = read_keypoints([tmp_path / "in"], None, ReadOptions(frame_offset={"cam": 42150}))
    with pytest.raises(MismatchError, match="near 0"):
        write_keypoints(tmp_path / "out", late, "sleap")
    assert not (tmp_path / "out").exists()
    write_keypoints(tmp_path / "out", (view,), "sleap")


def test_superanimal_s_animals_are_detections_in_any_order(tmp_path):
    positions, confidence = recording(2)
    columns, values = dlc_columns(NAMES, ("animal0", "animal1")), dlc_values(positions, confidence)
    dlc_h5_fixed(tmp_path / "a.h5", list(FRAMES), columns, values)
    (tmp_path / "b.csv").write_text(dlc_csv(FRAMES, columns, values))
    write_sample("superanimal", tmp_path / "json", positions, confidence)
    for path in (tmp_path / "a.h5", tmp_path / "b.csv", tmp_path / "json"):
        (view,) = read_keypoints([path], None, LAYOUT)
        assert not view.tracked
        np.testing.assert_array_equal(view.positions, positions)


def test_poses_of_several_cameras_in_one_nwb(tmp_path):
    positions, confidence = recording(1)
    write_sample("nwb", tmp_path, positions, confidence)
    with h5py.File(tmp_path / "cam.nwb", "a") as file:
        file.copy("processing/behavior/PoseEstimation", file["processing/behavior"], name="right")
    views = read_keypoints([tmp_path])
    assert [view.camera for view in views] == ["PoseEstimation", "right"]
    assert all("NWB has times" in view.remarks[0] for view in views)


@pytest.mark.parametrize(
    ("times", "frames"),
    [
        ({"rate": 30.0, "start": 1.0}, range(30, 35)),
        (
            {"timestamps": [0.0, 0.0334, 0.0665, 0.2001, 0.2332]},
            [0, 1, 2, 6, 7],
        ),  # a gap of three; rounded and jittered
        ({"timestamps": [10.0, 10.02, 10.04, 10.06, 10.08]}, range(500, 505)),
        ({"timestamps": [0.0, 0.1, 0.1, 0.2, 0.3]}, None),
        ({"timestamps": [0.0, 0.1, np.nan, 0.2, 0.3]}, None),
        ({"rate": 0.0, "start": 1.0}, None),
    ],
)
def test_frames_of_nwb_are_its_times(tmp_path, times, frames):
    positions, confidence = recording(1)
    write_sample("nwb", tmp_path, positions[:5], confidence[:5])
    with h5py.File(tmp_path / "cam.nwb", "a") as file:
        for series in file["processing/behavior/PoseEstimation"].values():
            if isinstance(series, h5py.Group):
                for name in {"timestamps", "starting_time"} & set(series):
                    del series[name]
                if "timestamps" in times:
                    series["timestamps"] = times["timestamps"]
                else:
                    series["starting_time"] = times["start"]
                    series["starting_time"].attrs["rate"] = times["rate"]
    if frames is None:
        with pytest.raises(FormatError, match="times that increase"):
            read_keypoints([tmp_path])
    else:
        assert read_keypoints([tmp_path])[0].frames.tolist() == list(frames)


def test_movement_s_times_must_be_whole_frames_and_its_poses_flat(tmp_path):
    write_sample("movement", tmp_path, *recording())
    with h5py.File(tmp_path / "cam.nc", "a") as file:
        file.attrs["fps"] = 30.0  # the times are those of 25
    with pytest.raises(FormatError, match="whole frames"):
        read_keypoints([tmp_path])
    with h5py.File(tmp_path / "cam.nc", "a") as file:
        file["space"][...] = ["x", "z"]
    with pytest.raises(FormatError, match="2D positions"):
        read_keypoints([tmp_path])


def test_movement_s_times_must_be_a_list(tmp_path):
    write_sample("movement", tmp_path, *recording())
    with h5py.File(tmp_path / "cam.nc", "a") as file:
        times = file["time"][...]
        del file["time"]
        file["time"] = times[:, None]
    with pytest.raises(FormatError, match="whole frames"):
        read_keypoints([tmp_path])


def test_movement_s_file_is_netcdf_with_its_axes(tmp_path):
    """The same bytes each time, and netCDF's own reader finds the axes."""
    write_sample("movement", tmp_path, *recording(2))
    views = read_keypoints([tmp_path / "cam.nc"])
    for name in ("first", "second"):
        write_keypoints(tmp_path / name, views, "movement")
    first, second = (tmp_path / name / "cam.nc" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    with h5netcdf.File(first, "r") as file:
        position, confidence = file.variables["position"], file.variables["confidence"]
        assert position.dimensions == ("time", "space", "keypoint", "individual")
        assert confidence.dimensions == ("time", "keypoint", "individual")
        np.testing.assert_array_equal(position[...].transpose(0, 3, 2, 1), views[0].positions)
        names = [name.decode() for name in file.variables["keypoint"][...]]
        assert tuple(names) == views[0].keypoints
        assert file.attrs["ds_type"] == "poses"


def test_points_without_names_are_numbered_in_label3d_and_caliscope(tmp_path):
    positions, confidence = recording(scores=False)
    write_sample("label3d", tmp_path / "a", positions, confidence)
    write_sample("caliscope", tmp_path / "b", positions, confidence)
    assert read_keypoints([tmp_path / "a"])[0].keypoints == ("point_1", "point_2", "point_3")
    assert set(read_keypoints([tmp_path / "b"])[0].keypoints) == {"0", "1", "2"}
    with pytest.raises(FormatError, match=r"row 3: .*below 1"):
        read_keypoints([tmp_path / "b"], None, ReadOptions(layout=("nose",)))


def test_coco_results_have_cameras_and_frames_in_their_image_ids(tmp_path):
    entries = [
        {
            "image_id": 10_000_000_000 + 10_000_000 * cam + f,
            "category_id": 1,
            "keypoints": [5.0 + f, 6, 1] * 3,
        }
        for cam in (1, 2)
        for f in (4, 9)
    ]
    (tmp_path / "all.json").write_text(json.dumps(entries))
    views = read_keypoints(
        [tmp_path / "all.json"],
        None,
        ReadOptions(layout=NAMES, camera_pattern=r"1(?P<camera>\d{3})(?P<frame>\d{7})"),
    )
    assert [view.camera for view in views] == ["001", "002"]
    assert [view.frames.tolist() for view in views] == [[4, 9], [4, 9]]


def test_the_plain_table_needs_little(tmp_path):
    path = tmp_path / "cam.csv"
    path.write_text("frame,keypoint,x,y\n7,nose,1.5,2.5\n9,,,\n8,tail,3,4\n")
    (view,) = read_keypoints([path])
    assert (view.camera, view.keypoints, view.frames.tolist(), view.tracked) == (
        "cam",
        ("nose", "tail"),
        [7, 8, 9],
        True,
    )
    for text, reason in (
        ("frame,keypoint,x,y,z\n7,nose,1,2,3\n", "columns"),
        ("camera,frame,keypoint,x,y\n,7,nose,1,2\n", "row 2"),
        ("frame,keypoint,x,y\nseven,nose,1,2\n", "frame number"),
        ("frame,instance,keypoint,x,y\n7,anna,nose,1,2\n", "call the column individual"),
        ("frame,instance,keypoint,x,y\n7,999999,nose,1,2\n", "at most 1000"),
        ("frame,keypoint,x,y\n", "rows below"),
    ):
        path.write_text(text)
        with pytest.raises(FormatError, match=reason):
            read_keypoints([path])


def test_a_header_without_a_single_column_is_refused(tmp_path):
    """Found by fuzzing: the row `coords` with nothing but its name."""
    (tmp_path / "a.csv").write_text("scorer,,s\nbodyparts,,nose\ncoords,,\n0,1,2\n")
    with pytest.raises(FormatError, match="a header row `coords`"):
        read_keypoints([tmp_path / "a.csv"])


def test_a_comma_in_the_name_of_a_column_is_part_of_it(tmp_path):
    path = tmp_path / "cam.csv"
    columns = ["track", "frame_idx", "instance.score"]
    columns += [f'"tail,base.{field}"' for field in ("x", "y", "score")]
    path.write_text(f"{','.join(columns)}\n,0,1.0,10.0,20.0,0.5\n")
    (found,) = read_keypoints([path], "sleap-csv")
    assert found.keypoints == ("tail,base",)
    np.testing.assert_array_equal(found.positions, [[[[10.0, 20.0]]]])


@pytest.mark.parametrize(("points", "found"), [([1.0, 2.0], "2 numbers"), ({"x": 1}, "dict")])
def test_what_is_no_list_of_triples_is_said(points, found):
    with pytest.raises(FormatError, match=f"found {found}"):
        per_frame_triples(points, "a.json")
