"""Reading keypoint files: one recording in every format, marks of missing points, bad files."""

import json
import os
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keypoint_files import (
    coco,
    coco_bytes,
    dlc_columns,
    dlc_csv,
    dlc_h5_fixed,
    dlc_h5_table,
    dlc_values,
)

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.file import frame_number
from mocap_calib.io.keypoints.read import read_keypoints

SHARED = Path(__file__).parents[3] / "shared"
NAMES = ("nose", "tail base", "left_ear")
FRAMES = [3, 4, 10]


def scene(individuals=1, seed=0, missing=0.0):
    rng = np.random.default_rng(seed)
    positions = (
        rng.uniform(1, 400, (len(FRAMES), individuals, len(NAMES), 2))
        .astype(np.float32)
        .astype(np.float64)
    )
    confidence = rng.uniform(0.1, 0.99, positions.shape[:3]).astype(np.float32).astype(np.float64)
    gone = rng.random(confidence.shape) < missing
    positions[gone], confidence[gone] = np.nan, 0.0
    return positions, confidence


def read(tmp_path, content, name="file"):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_keypoints([f"cam={path}"])[0]


def refused(tmp_path, content):
    with pytest.raises(FormatError) as caught:
        read(tmp_path, content)
    message = str(caught.value)
    assert message.startswith(str(tmp_path))
    assert "\n" not in message
    assert "expected" in message
    assert "found" in message
    return message


def write_all_formats(folder, positions, confidence, individuals):
    """Path by format, of the same detections."""
    columns, values = dlc_columns(NAMES, individuals), dlc_values(positions, confidence)
    (folder / "coco").write_bytes(coco_bytes(FRAMES, NAMES, positions, confidence))
    (folder / "csv").write_text(dlc_csv(FRAMES, columns, values))
    dlc_h5_table(folder / "table", FRAMES, columns, values)
    dlc_h5_fixed(folder / "fixed", FRAMES, columns, values)
    return {name: folder / name for name in ("coco", "csv", "table", "fixed")}


@pytest.mark.parametrize("individuals", [("",), ("mouse1", "mouse2")])
@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_the_same_recording_in_every_format_loads_equal(tmp_path, individuals, missing):
    positions, confidence = scene(len(individuals), missing=missing)
    for name, path in write_all_formats(tmp_path, positions, confidence, individuals).items():
        loaded = read_keypoints([f"cam={path}"])[0]
        assert (loaded.camera, loaded.keypoints, loaded.source) == ("cam", NAMES, str(path))
        assert loaded.tracked == (name != "coco")
        assert loaded.image_size == ((640, 480) if name == "coco" else (0, 0))
        np.testing.assert_array_equal(loaded.frames, FRAMES)
        np.testing.assert_array_equal(loaded.positions, positions)
        np.testing.assert_array_equal(loaded.confidence, confidence)


@settings(max_examples=25, deadline=None)
@given(st.permutations(range(len(FRAMES))), st.integers(0, 100))
def test_the_order_of_images_in_the_file_does_not_matter(tmp_path_factory, order, seed):
    positions, confidence = scene(2, seed)
    data = coco(FRAMES, NAMES, positions, confidence)
    data["images"] = [data["images"][k] for k in order]
    loaded = read(tmp_path_factory.mktemp("coco"), json.dumps(data))
    np.testing.assert_array_equal(loaded.frames, FRAMES)
    np.testing.assert_array_equal(loaded.positions, positions)


@settings(max_examples=50, deadline=None)
@given(st.permutations(range(6)))
def test_instances_follow_the_order_of_annotations(tmp_path_factory, order):
    positions, confidence = scene(2)
    data = coco(FRAMES, NAMES, positions, confidence)
    annotations = data["annotations"]
    data["annotations"] = [annotations[k] for k in order]
    loaded = read(tmp_path_factory.mktemp("coco"), json.dumps(data))
    for row in range(len(FRAMES)):
        wanted = [k % 2 for k in order if k // 2 == row]
        np.testing.assert_array_equal(loaded.positions[row], positions[row, wanted])


# --- frame numbers


@pytest.mark.parametrize(
    ("name", "number"),
    [
        *(
            ("a/b_007.png", 7),
            ("000017", 17),
            ("42150", 42150),
            ("3.0", 3),
            ("frame.0012.jpg", 12),
            ("C:\\x9\\img4.mp4", 4),
            ("img-5.png", 5),
        ),
        *(
            ("clip.mp4", -1),
            ("a7b.png", -1),
            ("-5", -1),
            ("1.5", -1),
            ("", -1),
            ("x" + "9" * 25, -1),
            ("9" * 40, -1),
        ),
    ],
)
def test_frame_number(name, number):
    assert frame_number(name) == number


def test_coco_frame_numbers_come_from_where_all_images_have_one(tmp_path):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for k, image in enumerate(data["images"]):
        image |= {"file_name": ["a1.png", "b.png", "c3.png"][k], "frame_id": 20 + k}
    np.testing.assert_array_equal(read(tmp_path, json.dumps(data)).frames, [20, 21, 22])
    for image in data["images"]:
        del image["frame_id"], image["file_name"]
    np.testing.assert_array_equal(read(tmp_path, json.dumps(data)).frames, [0, 1, 2])
    for image in data["images"]:
        image["id"] = f"x{image['id']}"
    refused(tmp_path, json.dumps(data))


@pytest.mark.parametrize(
    ("names", "fields", "numbers"),
    [
        (("a7/000005_cam1.jpg", "a7/000006_cam1.jpg", "a7/000009_cam1.jpg"), {}, [5, 6, 9]),
        (
            ("000005_cam1.jpg", "000006_cam1.jpg", "000009_cam1.jpg"),
            {"frame": (31, 32, 33)},
            [31, 32, 33],
        ),
        (
            ("5_cam1.jpg", "6_cam1.jpg", "9_cam1.jpg"),
            {"frame": (3, 3, 3), "frame_id": (7, 8, 9)},
            [7, 8, 9],
        ),
        (("5_left.jpg", "6_left.jpg", "9_left.jpg"), {}, [5, 6, 9]),
        (("day1_x_cam1.jpg", "day1_y_cam1.jpg", "day1_z_cam1.jpg"), {}, [0, 1, 2]),
    ],
    ids=["first integer", "frame", "frame_id", "no last integer", "id"],
)
def test_coco_frame_numbers_that_repeat_come_from_the_next_place(tmp_path, names, fields, numbers):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for k, image in enumerate(data["images"]):
        image.update({"file_name": names[k]} | {key: values[k] for key, values in fields.items()})
    loaded = read(tmp_path, json.dumps(data))
    np.testing.assert_array_equal(loaded.frames, numbers)
    np.testing.assert_array_equal(loaded.positions, positions)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            ("cam1_000.png", "cam1_001.png", "cam2_000.png"),
            "frame 0 twice, at cam1_000.png and cam2_000.png",
        ),
        (
            ("000_cam1.png", "001_cam1.png", "000_cam2.png"),
            "twice, at 000_cam1.png and 001_cam1.png",
        ),
        (("d1/a/0.png", "d2/b/1.png", "d2/a/2.png"), "folders that tell the cameras"),
    ],
)
def test_images_of_two_cameras_are_not_lined_up_by_id(tmp_path, names, expected):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for image, name in zip(data["images"], names, strict=True):
        image["file_name"] = name
    (tmp_path / "all.json").write_text(json.dumps(data))
    with pytest.raises(FormatError, match=expected) as found:
        read_keypoints([tmp_path / "all.json"])
    assert "--camera-regex" in str(found.value)


def test_folders_are_cameras_also_where_no_number_repeats(tmp_path):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for image, name in zip(
        data["images"], ("left/img3.png", "right/img5.png", "left/img9.png"), strict=True
    ):
        image["file_name"] = name
    (tmp_path / "all.json").write_text(json.dumps(data))
    assert [
        (view.camera, view.frames.tolist()) for view in read_keypoints([tmp_path / "all.json"])
    ] == [("left", [3, 9]), ("right", [5])]
    (view,) = read_keypoints([f"cam={tmp_path / 'all.json'}"])  # the user knows better
    assert (view.camera, view.frames.tolist()) == ("cam", [3, 5, 9])


def test_what_roboflow_adds_to_names_is_no_number(tmp_path):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for image, name in zip(
        data["images"],
        (
            "a_0003_png.rf.91b7584a2265b1f5.jpg",
            "a_0004_png.rf.1027c4d1c386bbc4.jpg",
            "a_0005_jpg.rf.0000000000000002.jpg",
        ),
        strict=True,
    ):
        image["file_name"] = name
    assert read(tmp_path, json.dumps(data)).frames.tolist() == [3, 4, 5]


def test_images_without_annotations_are_frames(tmp_path):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    data["annotations"] = data["annotations"][:1]
    loaded = read(tmp_path, json.dumps(data))
    assert np.isfinite(loaded.positions).any((1, 2, 3)).tolist() == [True, False, False]


def test_dlc_rows_may_be_image_paths_in_one_or_three_columns(tmp_path):
    positions, confidence = scene()
    columns, values = dlc_columns(NAMES), dlc_values(positions, confidence)
    paths = [("labeled-data", "clip", f"img{frame:04d}.png") for frame in FRAMES]
    contents = [
        dlc_csv(["/".join(p) for p in paths], columns, values),
        dlc_csv([",".join(p) for p in paths], columns, values, index_columns=3),
    ]
    dlc_h5_fixed(tmp_path / "levels.h5", paths, columns, values)
    dlc_h5_fixed(tmp_path / "paths.h5", ["/".join(p) for p in paths], columns, values)
    dlc_h5_table(tmp_path / "table.h5", ["/".join(p) for p in paths], columns, values)
    for content in contents + [path.read_bytes() for path in sorted(tmp_path.glob("*.h5"))]:
        loaded = read(tmp_path, content)
        np.testing.assert_array_equal(loaded.frames, FRAMES)
        np.testing.assert_array_equal(loaded.positions, positions)


# --- customs


@pytest.mark.parametrize(
    "triple",
    [
        (0, 0, 0),
        (0, 0, 0.9),
        (12, 8, 0),
        (-1, -1, -1),
        (float("nan"), 3, 0.5),
        (4, 3, float("nan")),
        (4, None, 0.5),
    ],
)
def test_every_custom_of_a_missing_point(tmp_path, triple):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    data["annotations"][0]["keypoints"][:3] = triple
    loaded = read(tmp_path, json.dumps(data))
    assert np.isnan(loaded.positions[0, 0, 0]).all()
    assert loaded.confidence[0, 0, 0] == 0
    np.testing.assert_array_equal(loaded.positions[0, 0, 1:], positions[0, 0, 1:])


@pytest.mark.parametrize(
    ("third", "expected"),
    [
        ((0, 1, 2), (0, 0.5, 1)),
        ((0, 1, 1), (0, 1, 1)),
        ((0.5, 1, 2), (0.5, 1, 2)),
        ((1, 2, -1), (0.5, 1, 0)),
    ],
)
def test_visibility_flags_are_told_from_confidences(tmp_path, third, expected):
    positions, confidence = scene()
    confidence[:] = third
    np.testing.assert_array_equal(
        read(tmp_path, coco_bytes(FRAMES, NAMES, positions, confidence)).confidence[:, 0],
        [expected] * len(FRAMES),
    )


def test_an_empty_keypoint_list_keeps_its_place(tmp_path):
    positions, confidence = scene(2)
    positions[0, 0], confidence[0, 0] = np.nan, 0.0
    np.testing.assert_array_equal(
        read(tmp_path, coco_bytes(FRAMES, NAMES, positions, confidence)).positions, positions
    )


def test_ids_may_be_text_and_other_categories_do_not_count(tmp_path):
    positions, confidence = scene()
    data = coco(FRAMES, NAMES, positions, confidence)
    for annotation in data["annotations"]:
        annotation |= {"image_id": str(annotation["image_id"]), "category_id": "1"}
    data["categories"].append({"id": 2, "name": "ball", "keypoints": []})
    data["annotations"].insert(0, {"id": 99, "image_id": 0, "category_id": 2, "bbox": [0, 0, 1, 1]})
    np.testing.assert_array_equal(read(tmp_path, json.dumps(data)).positions, positions)


def test_labels_without_likelihood_have_confidence_1(tmp_path):
    positions, confidence = scene(missing=0.4)
    loaded = read(
        tmp_path,
        dlc_csv(
            FRAMES,
            dlc_columns(NAMES, likelihood=False),
            dlc_values(positions, confidence, likelihood=False),
        ),
    )
    np.testing.assert_array_equal(loaded.positions, positions)
    np.testing.assert_array_equal(loaded.confidence, confidence > 0)


@pytest.mark.parametrize("layout", ["csv", "table", "fixed"])
def test_unique_body_parts_are_nobody(tmp_path, layout):
    positions, confidence = scene(2)
    corners = [("net", "single", "corner", coord) for coord in ("x", "y", "likelihood")]
    columns = dlc_columns(NAMES, ("m1", "m2")) + corners
    values = np.concatenate([dlc_values(positions, confidence), np.ones((len(FRAMES), 3))], axis=1)
    shuffled = np.random.default_rng(1).permutation(len(columns))
    columns, values = [columns[k] for k in shuffled], values[:, shuffled]
    if layout == "csv":
        (tmp_path / layout).write_text(dlc_csv(FRAMES, columns, values))
    else:
        (dlc_h5_table if layout == "table" else dlc_h5_fixed)(
            tmp_path / layout, FRAMES, columns, values
        )
    loaded = read_keypoints([f"cam={tmp_path / layout}"])[0]
    individuals = list(dict.fromkeys(labels[1] for labels in columns if labels[1] != "single"))
    order = [["m1", "m2"].index(who) for who in individuals]
    assert set(loaded.keypoints) == set(NAMES)
    np.testing.assert_array_equal(
        loaded.positions[:, :, [loaded.keypoints.index(name) for name in NAMES]],
        positions[:, order],
    )


def test_csv_may_have_a_mark_carriage_returns_short_scorers_and_short_empty_rows(tmp_path):
    positions, confidence = scene()
    positions[1], confidence[1] = np.nan, 0.0
    lines = dlc_csv(FRAMES, dlc_columns(NAMES), dlc_values(positions, confidence)).splitlines()
    lines[0], lines[4] = "scorer,net", f"{FRAMES[1]},,"
    loaded = read(tmp_path, b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\r\n\r\n")
    np.testing.assert_array_equal(loaded.positions, positions)


# --- bad files


def changed(**changes):
    return json.dumps(coco(FRAMES, NAMES, *scene()) | changes)


def broken_coco():
    data = coco(FRAMES, NAMES, *scene())
    annotation = data["annotations"][0]
    return {
        "no images": changed(images=[]),
        "images no list": changed(images={"a": 1}),
        "images of numbers": changed(images=[1, 2]),
        "no categories": changed(categories=[]),
        "category without names": changed(categories=[{"id": 1}]),
        "two vocabularies": changed(
            categories=[{"id": 1, "keypoints": ["a"]}, {"id": 2, "keypoints": ["b"]}]
        ),
        "a name twice": changed(categories=[{"id": 1, "keypoints": ["a", "b", "a"]}]),
        "wrong length": changed(annotations=[annotation | {"keypoints": [1, 2, 1]}]),
        "text for numbers": changed(annotations=[annotation | {"keypoints": ["null"] * 9}]),
        "nested lists": changed(annotations=[annotation | {"keypoints": [[1, 2, 3]] * 9}]),
        "keypoints an object": changed(annotations=[annotation | {"keypoints": {"x": 1}}]),
        "huge numbers": changed(annotations=[annotation | {"keypoints": [10**400] * 9}]),
        "stranger image": changed(annotations=[annotation | {"image_id": 77}]),
        "image id twice": changed(
            images=[data["images"][0] | {"file_name": f"{k}.png"} for k in range(2)]
        ),
        "two sizes": changed(images=[data["images"][0], data["images"][1] | {"width": 12}]),
        "size of text": changed(images=[data["images"][0] | {"width": "wide"}]),
        "all in one image": changed(annotations=[annotation] * 1001),
        "a list": "[]",
        "OpenPose": '{"version": 1.3, "people": []}',
        "cut": changed()[:-100],
        "deep": '{"images":' + "[" * 100_000,
        "not UTF-8": b'{"images": "\xff\xfe"}',
    }


def broken_csv():
    columns, values = dlc_columns(NAMES), dlc_values(*scene())
    good = dlc_csv(FRAMES, columns, values)
    lines = good.splitlines()
    three_d = [
        tuple("z" if label == "likelihood" else label for label in labels) for labels in columns
    ]
    return {
        "cut": good[: -len(lines[-1]) // 2],
        "3D": dlc_csv(FRAMES, three_d, values),
        "semicolons": good.replace(",", ";"),
        "no data": "\n".join(lines[:3]),
        "no coords": "\n".join([*lines[:2], *lines[3:]]),
        "no body parts": "\n".join([lines[0], *lines[2:]]),
        "only a header cell": "scorer,",
        "empty heading": "\n".join([lines[0], lines[1].replace("nose", "", 1), *lines[2:]]),
        "a column twice": dlc_csv(FRAMES, [columns[0], *columns[:-1]], values),
        "text": good.replace(lines[3].split(",")[2], "abc"),
        "no frame number": good.replace(f"\n{FRAMES[0]},", "\nfirst,", 1),
        "frame twice": good.replace(f"\n{FRAMES[0]},", f"\n{FRAMES[1]},", 1),
        "quote without end": good + '"' + "x," * 200_000,
        "x without y": dlc_csv(
            FRAMES, [labels for labels in columns if labels[-1] == "x"], values[:, ::3]
        ),
        "other coordinate": dlc_csv(
            FRAMES, [(*labels[:-1], labels[-1] * 2) for labels in columns], values
        ),
    }


ANYTHING = {
    "empty": b"",
    "blank": b" \n",
    "binary": bytes(range(256)),
    "words": b"hello, world",
    "null": b"null",
}
BROKEN = {
    f"{kind}: {name}": content
    for kind, files in (("COCO", broken_coco()), ("csv", broken_csv()), ("any", ANYTHING))
    for name, content in files.items()
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_bad_file_is_refused_in_one_line(tmp_path, name):
    refused(tmp_path, BROKEN[name])


def test_two_images_of_one_frame_are_named(tmp_path):
    data = coco(FRAMES, NAMES, *scene())
    data["images"][0]["file_name"], data["images"][1]["file_name"] = "cam1/8.png", "8.png"
    message = refused(tmp_path, json.dumps(data))
    assert "cam1/8.png" in message
    assert "at 8.png" in message or "and 8.png" in message


def test_a_3d_file_is_called_so(tmp_path):
    assert "3D" in refused(tmp_path, BROKEN["csv: 3D"])


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(FormatError, match="expected a file or folder, found none"):
        read_keypoints([tmp_path / "nothing"])
    with pytest.raises(MismatchError, match="found none"):
        read_keypoints([tmp_path])


class Malicious:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (self.path,))


def test_a_pickle_that_runs_code_is_refused_and_not_run(tmp_path):
    columns, values = dlc_columns(NAMES), dlc_values(*scene())
    trap = tmp_path / "trap"
    dlc_h5_table(
        tmp_path / "bad.h5", FRAMES, columns, values, labels=pickle.dumps(Malicious(str(trap)), 0)
    )
    assert "mkdir" in refused(tmp_path, (tmp_path / "bad.h5").read_bytes())
    assert not trap.exists()


def test_what_can_be_wrong_with_an_h5(tmp_path):
    columns, values = dlc_columns(NAMES), dlc_values(*scene())
    path = tmp_path / "bad.h5"
    with h5py.File(path, "w") as file:
        file.create_group("df_with_missing").attrs["pandas_type"] = np.bytes_(b"frame_table")
    assert "aborted write" in refused(tmp_path, path.read_bytes())
    path.unlink()
    for key in ("one", "two"):
        dlc_h5_table(path, FRAMES, columns, values, key=key)
    assert "one, two" in refused(tmp_path, path.read_bytes())
    with h5py.File(path, "w") as file:
        file["tracks"] = np.zeros(3)
    assert "tracks" in refused(tmp_path, path.read_bytes())
    path.unlink()
    dlc_h5_table(path, FRAMES, columns, values, labels=b"no pickle")
    refused(tmp_path, path.read_bytes())
    path.unlink()
    dlc_h5_table(path, FRAMES, columns, values, labels=pickle.dumps(columns[:-1], 0))
    refused(tmp_path, path.read_bytes())


def test_compression_that_is_not_installed_is_refused(tmp_path):
    """A chunk under blosc's filter number, which h5py does not have."""
    path = tmp_path / "blosc.h5"
    dlc_h5_fixed(path, FRAMES, dlc_columns(NAMES), dlc_values(*scene()))
    with h5py.File(path, "a") as file:
        group = file["predictions"]
        del group["block0_values"]
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((3, 9))
        plist.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, ())
        values = h5py.h5d.create(
            group.id, b"block0_values", h5py.h5t.IEEE_F64LE, h5py.h5s.create_simple((3, 9)), plist
        )
        values.write_direct_chunk((0, 0), b"\0" * 40)
    assert "32001" in refused(tmp_path, path.read_bytes())


@pytest.mark.parametrize("name", ["coco", "csv", "table", "fixed"])
def test_damaged_files_load_or_are_refused(tmp_path, name):
    """Cut anywhere, or with bytes changed: never anything but FormatError."""
    good = write_all_formats(tmp_path, *scene(2), ("m1", "m2"))[name].read_bytes()
    rng = np.random.default_rng(0)
    outcomes = set()
    for cut in range(80):
        content = bytearray(good[: rng.integers(len(good))] if cut % 2 else good)
        for _ in range(rng.integers(0, 4)):
            content[rng.integers(len(content))] = rng.integers(256)
        try:
            read(tmp_path, bytes(content))
        except FormatError as error:
            outcomes.add(str(error).count("\n"))
    assert outcomes == {0}


# --- the project's own recordings and samples, where they lie beside the checkout

FOLDERS = [
    "recordings/*/keypoints",
    *(
        f"formats/samples/{name}"
        for name in ("dlc_csv", "dlc_h5_single", "dlc_h5_generated", "dlc_labels")
    ),
]
OTHERS = sorted(path for folder in FOLDERS for path in SHARED.glob(f"{folder}/*"))


@pytest.mark.skipif(not OTHERS, reason="no ../shared here")
def test_real_files_load_or_are_refused():
    refusals = []
    for path in OTHERS:
        try:
            loaded = read_keypoints([path])[0]
            assert np.isfinite(loaded.positions).any()
        except FormatError as error:
            refusals.append((path.name, str(error)))
    assert sorted({name for name, _ in refusals}) == [
        "SOURCE.txt",
        "wide_table_pd135.h5",
        "wide_table_pd3.h5",
    ]


@pytest.mark.skipif(not OTHERS, reason="no ../shared here")
def test_real_csv_and_h5_of_one_recording_agree():
    for path in (p for p in OTHERS if p.suffix == ".csv"):
        for twin in (
            p
            for p in OTHERS
            if p.suffix == ".h5" and p.parent == path.parent and p.stem == path.stem
        ):
            first, second = read_keypoints([f"cam={path}"])[0], read_keypoints([f"cam={twin}"])[0]
            assert first.keypoints == second.keypoints
            np.testing.assert_array_equal(first.frames, second.frames)
            np.testing.assert_allclose(first.positions, second.positions, rtol=1e-12)
