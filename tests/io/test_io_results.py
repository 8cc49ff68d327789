"""Results: what is written comes back, the same input gives the same bytes, other people's columns
are right.
"""

import csv
import io
import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.atomic import write_pieces
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.hashing import hash_files
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.poses.poses3d_h5 import parse
from mocap_calib.io.registry import find_format
from mocap_calib.io.results import csv_text
from mocap_calib.io.results.csv_text import format_lines
from mocap_calib.io.results.further_formats import check_recording, write_formats
from mocap_calib.io.results.group import read_outputs, remove_earlier_outputs
from mocap_calib.io.results.matches_csv import matches_csv, read_matches_csv
from mocap_calib.io.results.pairs_json import pairs_from_json, pairs_to_json
from mocap_calib.io.results.poses_csv import check_poses_csv, poses_csv, write_poses_csv
from mocap_calib.io.results.poses_h5 import parse_poses_h5, poses_to_h5, write_poses_h5
from mocap_calib.results import Matches, PairwiseCalibration, Poses3D
from mocap_calib.types import Camera, CameraRig, Recording

NAMES = ("left", "right, far", "3")
FRAMES = np.array([2, 5, 40, 41])


def camera(name):
    return Camera(
        name,
        (640, 480),
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        np.array([0.1, 0, 0, 0, 1e-7]),
        False,
    )


def recording(seed=0, instances=3, keypoints=2):
    rng = np.random.default_rng(seed)
    positions = rng.uniform(1, 400, (len(NAMES), len(FRAMES), instances, keypoints, 2))
    positions[rng.random(positions.shape[:3]) < 0.4] = np.nan
    positions[rng.random(positions.shape[:4]) < 0.2] = np.nan
    confidence = np.isfinite(positions[..., 0]).astype(float)
    cameras = tuple(map(camera, NAMES))
    return Recording(
        cameras,
        tuple("ab"[:keypoints]),
        FRAMES,
        positions,
        confidence,
        np.zeros(len(NAMES), bool),
        np.full(keypoints, -1),
    )


def matches(of, seed=0):
    """Random identities: each individual once per view and frame, some detections nobody's."""
    rng = np.random.default_rng(seed)
    labels = np.argsort(rng.random(of.positions.shape[:3]), axis=-1)
    labels[rng.random(labels.shape) < 0.3] = -1
    return Matches(np.where(of.seen.any(-1), labels, -1))


def matches_text(of, labels):
    return b"".join(matches_csv(of, labels)).decode()


def poses_text(given_, individual):
    return b"".join(poses_csv(given_, individual)).decode()


# --- matches


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_matches_come_back(seed):
    of = recording(seed)
    labels = matches(of, seed)
    np.testing.assert_array_equal(
        read_matches_csv(matches_text(of, labels), of).labels, labels.labels
    )


def test_matches_have_a_row_per_detection(tmp_path):
    of = recording()
    write_pieces(tmp_path / "matches.csv", matches_csv(of, matches(of)))
    with open(tmp_path / "matches.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["camera", "frame", "instance", "individual"]
    assert len(rows) == of.seen.any(-1).sum()
    for row in rows:
        v, f, i = (
            of.names.index(row["camera"]),
            FRAMES.tolist().index(int(row["frame"])),
            int(row["instance"]),
        )
        assert matches(of).labels[v, f, i] == int(row["individual"])
    np.testing.assert_array_equal(
        read_matches_csv(tmp_path / "matches.csv", of).labels, matches(of).labels
    )


def test_matches_in_any_order_with_any_line_end_and_gaps(tmp_path):
    of = recording()
    head, *rows = matches_text(of, matches(of)).splitlines()
    (tmp_path / "m.csv").write_bytes(
        b"\xef\xbb\xbf" + "\r\n".join([head, *rows[::-1], ""]).encode()
    )
    np.testing.assert_array_equal(
        read_matches_csv(tmp_path / "m.csv", of).labels, matches(of).labels
    )
    assert (read_matches_csv(head + "\n", of).labels == -1).all()


HEAD = "camera,frame,instance,individual\n"


@pytest.mark.parametrize(
    "row", ["middle,2,0,0", "left,3,0,0", "left,99,0,0", "left,2,9,0", "left,2,-1,0", "left,-5,0,0"]
)
def test_matches_of_another_recording_are_refused(row):
    with pytest.raises(MismatchError, match=r"expected .* found"):
        read_matches_csv(f"{HEAD}{row}\n", recording())


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a,b\n1,2\n",
        *(
            f"{HEAD}left,2,{rest}\n"
            for rest in ("0", "0,x", "0,-2", "0,999", "0,1,2", "0," + "9" * 40)
        ),
    ],
)
def test_bad_matches_are_refused(text):
    with pytest.raises(FormatError) as caught:
        read_matches_csv(text, recording())
    assert "\n" not in str(caught.value)


def test_matches_that_contradict_themselves_are_refused():
    of = recording()
    labels = np.full(of.positions.shape[:3], -1)
    lines = matches_text(of, Matches(labels)).splitlines()
    with pytest.raises(FormatError, match="each detection once"):
        read_matches_csv("\n".join([*lines, lines[-1]]), of)
    v, f = np.argwhere(of.seen.any(-1).sum(-1) >= 2)[0]
    labels[v, f] = 0
    with pytest.raises(FormatError, match="each individual once"):
        read_matches_csv(matches_text(of, Matches(labels)), of)


# --- poses


def poses(frames=5, individuals=2, keypoints=("nose", "tail, base"), seed=0):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(frames, individuals, len(keypoints), 3))
    missing = rng.random(positions.shape[:3]) < 0.3
    positions[missing] = np.nan
    error = np.where(missing, np.nan, rng.random(missing.shape))
    views = np.where(missing, 0, rng.integers(2, 6, missing.shape))
    covariance = np.where(missing[..., None], np.nan, rng.random((*missing.shape, 6)))
    return Poses3D(
        keypoints,
        np.arange(frames) * 3 + 7,
        positions,
        error,
        views,
        np.where(missing, np.nan, rng.random(missing.shape)),
        "mm",
        covariance.astype(np.float32),
    )


@pytest.mark.parametrize("sizes", [(5, 2), (1, 1), (0, 2), (4, 0)])
def test_poses_come_back_from_h5(tmp_path, sizes):
    given_ = poses(*sizes)
    write_poses_h5(tmp_path / "poses.h5", given_, {"seed": 0})
    back = parse_poses_h5((tmp_path / "poses.h5").read_bytes(), "poses.h5")
    assert (back.keypoints, back.unit) == (given_.keypoints, given_.unit)
    for name in ("frames", "positions", "error", "views", "confidence", "covariance"):
        np.testing.assert_array_equal(getattr(back, name), getattr(given_, name))
    assert back.covariance.dtype == np.float32


def test_a_file_without_covariances_is_read(tmp_path):
    given_ = replace(poses(), covariance=np.zeros(0))
    write_poses_h5(tmp_path / "poses.h5", given_, {})
    with h5py.File(tmp_path / "poses.h5") as file:
        assert "covariance" not in file
    back = parse_poses_h5((tmp_path / "poses.h5").read_bytes(), "poses.h5")
    assert back == given_
    assert back.covariance.shape == (5, 2, 2, 6)
    assert np.isnan(back.covariance).all()


def test_the_same_poses_are_the_same_bytes(tmp_path):
    for name in ("a.h5", "b.h5"):
        write_poses_h5(tmp_path / name, poses(500), {"seed": 0, "inputs": {"a": "0f"}})
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_an_h5_says_what_it_holds(tmp_path):
    write_poses_h5(tmp_path / "poses.h5", poses(), {"seed": 7})
    with h5py.File(tmp_path / "poses.h5") as file:
        assert file.attrs["unit"] == "mm"
        assert file.attrs["dimensions"] == "frame, individual, keypoint, coordinate"
        assert json.loads(file.attrs["provenance"]) == {"seed": 7}


def test_every_dataset_of_an_h5_says_its_axes_its_unit_and_its_meaning(tmp_path):
    edges = ((0, 1),)
    write_poses_h5(tmp_path / "poses.h5", poses(), {}, edges=edges, fps=50.0)
    with h5py.File(tmp_path / "poses.h5") as file:
        said = {name: dict(dataset.attrs) for name, dataset in file.items()}
        assert file["edges"][:].tolist() == [[0, 1]]
        assert (file.attrs["fps"], file["frames"].attrs["fps"]) == (50.0, 50.0)
        for dataset in file.values():
            assert dataset.attrs["axes"].split(" (")[0].count(",") == dataset.ndim - 1
    assert {name: attributes["unit"] for name, attributes in said.items()} == {
        "position": "mm",
        "error": "pixel",
        "views": "views",
        "confidence": "0 to 1",
        "covariance": "mm^2",
        "source": "code",
        "frames": "frame number",
        "keypoint_names": "name",
        "edges": "index of a keypoint",
    }
    assert said["position"]["axes"] == "frame, individual, keypoint, coordinate (x, y, z)"
    assert all(attributes["meaning"] for attributes in said.values())
    with h5py.File(io.BytesIO(poses_to_h5(poses(), {}))) as file:
        assert "edges" not in file
        assert "fps" not in file.attrs


@pytest.mark.parametrize("name", ["poses-h5", "npz"])
def test_triangulated_points_and_sources_come_back(name):
    given_ = poses()
    better = replace(
        given_,
        positions=given_.positions + 0.5,
        raw=given_.positions,
        source=np.where(np.isfinite(given_.error), 2, 0).astype(np.int8),
    )
    known = find_format(POSE_FORMATS, name)
    content = known.writer()(PoseFile(better), "").content
    back = known.read(content, "poses").poses
    assert back == better
    assert back.raw is not back.positions
    # of triangulated points alone there is no second copy
    alone = known.read(known.writer()(PoseFile(given_), "").content, "poses").poses
    assert alone.raw is alone.positions


@pytest.mark.parametrize(
    ("edges", "said"),
    [
        ([[0, 2]], "found 0 to 2"),
        ([[-1, 0]], "found -1 to 0"),
        ([[0.5, 1]], "whole numbers"),
        ([0, 1], "edges: expected shape"),
    ],
)
def test_edges_of_other_keypoints_are_refused(edges, said):
    content = io.BytesIO(poses_to_h5(poses(), {}))
    with h5py.File(content, "a") as file:
        file["edges"] = edges
    with pytest.raises(FormatError, match=said):
        parse(content.getvalue(), "file")


def test_a_csv_has_no_signed_zero():
    given_ = poses()
    given_.positions[:] = -0.0
    assert "-" not in poses_text(given_, 0).split("\n", 1)[1]


def test_a_bad_poses_file_is_refused(tmp_path):
    good, bad = tmp_path / "poses.h5", tmp_path / "bad.h5"
    write_poses_h5(good, poses(), {})
    content = good.read_bytes()
    for size in (0, 100, len(content) // 2):
        bad.write_bytes(content[:size])
        with pytest.raises(FormatError, match="mocap-calib poses"):
            parse_poses_h5(bad.read_bytes(), "bad.h5")
    for name, shape in (
        ("views", None),
        ("frames", (2,)),
        ("error", (5, 2, 9)),
        ("position", (5, 2, 2)),
    ):
        bad.write_bytes(content)
        with h5py.File(bad, "a") as file:
            del file[name]
            if shape:
                file[name] = np.zeros(shape)
        with pytest.raises(FormatError, match=r"mocap-calib poses|a dataset `views`|whole numbers"):
            parse_poses_h5(bad.read_bytes(), "bad.h5")


def test_anipose_columns():
    given_ = poses(9000)  # more than one piece
    rows = list(csv.DictReader(io.StringIO(poses_text(given_, 1))))
    assert list(rows[0])[:7] == [
        "nose_x",
        "nose_y",
        "nose_z",
        "nose_error",
        "nose_ncams",
        "nose_score",
        "tail, base_x",
    ]
    assert list(rows[0])[12:] == [f"M_{i}{j}" for i in range(3) for j in range(3)] + [
        "center_0",
        "center_1",
        "center_2",
        "fnum",
    ]
    assert [int(row["fnum"]) for row in rows] == given_.frames.tolist()
    assert [[float(rows[0][f"M_{i}{j}"]) for j in range(3)] for i in range(3)] == np.eye(3).tolist()
    columns = {
        "x": given_.positions[..., 0],
        "z": given_.positions[..., 2],
        "error": given_.error,
        "ncams": given_.views,
        "score": given_.confidence,
    }
    for k, name in enumerate(given_.keypoints):
        for field, array in columns.items():
            cells = [float(row[f"{name}_{field}"] or "nan") for row in rows]
            np.testing.assert_array_equal(cells, array[:, 1, k])


def test_missing_poses_are_empty_cells_also_of_a_keypoint_named_nan():
    given_ = poses(keypoints=("nan", "banana"))
    text = poses_text(given_, 0)
    assert text.startswith("nan_x,nan_y,")
    assert "nan" not in text.split("\n", 1)[1]


# --- pairs


def pair(a, b, seed):
    rng = np.random.default_rng(seed)
    matched = rng.integers(0, 9, (seed % 4, 3))
    return PairwiseCalibration(
        a,
        b,
        rng.normal(size=(3, 3)),
        rng.normal(size=3),
        matched,
        9,
        rng.random(),
        rng.random(),
        float("nan"),
        "lifted",
    )


def same_pair(first, second):
    for name in ("a", "b", "frames", "score", "residual", "source"):
        assert getattr(first, name) == getattr(second, name)
    assert np.isnan(second.in_front) == np.isnan(first.in_front)
    for name in ("rotation", "translation", "matches"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_pairs_come_back_with_their_cameras_and_alternatives():
    cameras = tuple(map(camera, NAMES))
    pairs = (
        replace(pair(0, 1, 1), alternatives=(pair(0, 1, 2), pair(0, 1, 5))),
        pair(0, 2, 4),
        pair(1, 2, 7),
    )
    text = pairs_to_json(pairs, cameras)
    json.loads(text, parse_constant=pytest.fail)  # strict JSON: no NaN
    back, back_cameras = pairs_from_json(text, "text")
    assert [c.name for c in back_cameras] == list(NAMES)
    np.testing.assert_array_equal(back_cameras[0].distortion, cameras[0].distortion)
    for old, new in zip(pairs, back, strict=True):
        for first, second in zip(old.hypotheses, new.hypotheses, strict=True):
            same_pair(first, second)


def test_pairs_without_alternatives_are_read():
    """The key may be absent."""
    back, _ = pairs_from_json(TEXT.replace(', "alternatives": []', ""), "text")
    same_pair(back[0], pair(0, 1, 3))
    assert back[0].alternatives == ()


TEXT = pairs_to_json((pair(0, 1, 3),), tuple(map(camera, NAMES)))


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            "[]",
            "{}",
            "[" * 100_000,
            TEXT[:-40],
            TEXT.replace('"version": 1', '"version": 2'),
            TEXT.replace('"a": "left"', '"a": "nobody"'),
        ),
        *(
            TEXT.replace('"frames": 9', '"frames": "x"'),
            TEXT.replace('"score"', '"skore"'),
            TEXT.replace('"rotation": [[', '"rotation": [[['),
        ),
        TEXT.replace('"alternatives": []', '"alternatives": [3]'),
        *(
            TEXT.replace(f'"{key}": [', f'"{key}": [3, ')
            for key in ("translation", "pairs", "cameras", "matches")
        ),
    ],
)
def test_bad_pairs_are_refused_in_one_line(text):
    with pytest.raises(FormatError) as caught:
        pairs_from_json(text, "pairs.json")
    assert str(caught.value).startswith("pairs.json")
    assert "\n" not in str(caught.value)


def test_what_an_earlier_run_wrote_is_removed_unless_it_is_kept_or_changed(tmp_path):
    names = ("poses3d.nc", "colmap/sparse/images.txt", "poses3d.trc", "matches.csv")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name, "utf-8")
    earlier = hash_files(tmp_path) | {"../outside.csv": "0", "gone.csv": "0"}
    (tmp_path / "run.json").write_text(json.dumps({"outputs": earlier}), "utf-8")
    (tmp_path / "poses3d.trc").write_text("edited", "utf-8")
    remove_earlier_outputs(tmp_path, read_outputs(tmp_path), kept={"matches.csv"})
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"matches.csv", "poses3d.trc", "run.json"}


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"outputs": 3}'])
def test_a_damaged_report_lists_no_outputs(tmp_path, content):
    (tmp_path / "run.json").write_text(content, "utf-8")
    assert read_outputs(tmp_path) == {}
    assert read_outputs(tmp_path / "nowhere") == {}


def test_poses_csv_leaves_no_file_that_passes_for_a_further_individual(tmp_path):
    """Neither the file of one beside those of several, nor those of several beside that of one."""
    path = tmp_path / "p.csv"
    nobody = np.full((2, 2, 2), np.nan)
    poses = Poses3D(
        ("a", "b"), np.arange(2), nobody[..., None] * np.ones(3), nobody, nobody == 0, nobody, "m"
    )
    with pytest.raises(
        MismatchError, match=r"p\.csv: expected at least one individual, found none"
    ):
        check_poses_csv(path, 0)
    check_poses_csv(path, 2)
    write_poses_csv(path, poses)
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["p_0.csv", "p_1.csv"]
    check_poses_csv(path, 2)
    with pytest.raises(MismatchError, match=r"p_0\.csv: expected no file of a further individual"):
        check_poses_csv(path, 1)
    path.touch()
    with pytest.raises(MismatchError, match=r"p\.csv: expected no file of a further individual"):
        check_poses_csv(path, 2)


def test_a_format_that_cannot_hold_the_poses_is_left_out(tmp_path):
    """The others are written: c3d asks for a unit of length, which a run does not know."""
    positions = np.arange(12.0).reshape(2, 1, 2, 3)
    known = np.ones((2, 1, 2))
    frames, views = np.arange(2), known.astype(int)
    poses = Poses3D(("a", "b"), frames, positions, known, views, known, "arbitrary")
    rotation = np.stack([np.eye(3)] * 2)
    rig = CameraRig(tuple(map(camera, "ab")), rotation, np.eye(3)[:2], "arbitrary")
    files = write_formats(tmp_path, rig, PoseFile(poses, 30.0), ("c3d", "sleap-anipose"), {})
    assert [path.name for path in tmp_path.iterdir()] == ["points3d.h5"]
    assert ["unit" in str(error) for error in files.refused.values()] == [True]
    assert files.notes
    assert all(note.startswith("sleap-anipose does not hold ") for note in files.notes)


@pytest.mark.parametrize(
    ("format", "change", "said"),
    [
        ("colmap", {"name": "cam 1"}, "'cam 1'; rename the camera, or write colmap-binary"),
        ("opencv", {"name": "cam/1"}, "characters that a file name may have, found 'cam/1'"),
        ("nerfstudio", {"distortion": np.ones(8)}, "5 distortion coefficients"),
        ("openmvg", {"size": (0, 0)}, "expected the image size of camera left, found none"),
    ],
)
def test_what_a_format_cannot_hold_of_the_cameras_is_said_before_a_run(format, change, said):
    """And what it can hold passes, whatever the format."""
    formats = (*CAMERA_FORMATS, *POSE_FORMATS)
    every = [each.name for each in formats if each.write and not (each.unit or each.packages)]
    every.remove("bvh")  # asks for keypoints that a skeleton joins
    of = replace(recording(), cameras=tuple(map(camera, ("left", "right", "3"))))
    check_recording(every, of, 30.0)
    unfit = replace(of, cameras=(replace(of.cameras[0], **change), *of.cameras[1:]))
    with pytest.raises(MismatchError) as caught:
        check_recording([format], unfit, None)
    assert said in str(caught.value)


def test_lines_of_csv_have_the_digits_of_repr():
    """Floats of any bits, whole numbers of any size, and texts beside them."""
    rng = np.random.default_rng(0)
    bits = rng.integers(-(2**63), 2**63, (2000, 3)).view(np.float64)
    usual = np.exp(rng.normal(0, 8, (20_000, 3))) * rng.choice([-1, 1], (20_000, 1))
    short = rng.integers(-(10**6), 10**6, (2000, 3)) / 10.0 ** rng.integers(-12, 25, (2000, 1))
    halves = np.ldexp(1.0, np.arange(-1073, 1024)).reshape(-1, 3)
    odd = np.array([[np.nan, np.inf, 5e-324], [0.0, -0.0, -np.inf], [1e-4, 9.9e-5, 1e16]])
    cells = np.concatenate([bits, usual, short, halves, odd, odd[:, ::-1]])
    numbers = np.stack([np.arange(len(cells)), -1 - np.arange(len(cells))], axis=-1)
    numbers[:2] = [[2**63 - 1, -(2**63) + 1], [0, 1234567890123456789]]
    expected = "".join(
        f"café,{','.join('' if np.isnan(x) else repr(x) for x in row)};{whole},{other}\n"
        for row, (whole, other) in zip(cells.tolist(), numbers.tolist(), strict=True)
    )
    assert format_lines("café,", cells, ";", numbers) == expected.encode()
    whole = f"a,b,{2**63 - 1}\na,b,0\n"
    assert format_lines("a", cells[:2, :0], ",b,", numbers[:2, :1]) == whole.encode()
    assert format_lines("a", cells[:0], "b", numbers[:0]) == b""
    single = np.asfortranarray(usual[:9], np.float32)
    expected = "".join(
        ",".join("" if np.isnan(x) else repr(x) for x in row) + ",7\n" for row in single.tolist()
    )
    assert format_lines("", single, ",", np.full((9, 1), 7, np.int32)) == expected.encode()


def test_tables_of_many_pieces_are_those_of_one(monkeypatch):
    """In order, whichever thread is first."""
    poses = Poses3D(
        keypoints=("a", "b"),
        frames=np.arange(5, 905),
        positions=np.random.default_rng(0).normal(size=(900, 1, 2, 3)),
        error=np.ones((900, 1, 2)),
        views=np.full((900, 1, 2), 3),
        confidence=np.ones((900, 1, 2)),
        unit="m",
    )
    whole = b"".join(poses_csv(poses, 0))
    monkeypatch.setattr(csv_text, "_PIECE", 100)
    pieces = list(poses_csv(poses, 0))
    assert len(pieces) > 100
    assert b"".join(pieces) == whole
    assert [line.rsplit(",", 1)[1] for line in whole.decode().splitlines()[1:]] == [
        str(frame) for frame in poses.frames
    ]
