"""What is particular to one keypoint format: small inputs, and the numbers that they hold.

Files that `convert` reads or refuses without options are in tests/golden/corpus.

A row of a table has what writes the files, what is read of them (or a pattern of the refusal), and
what the user says beside.
"""

import json
import os
import pickle
import random
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest
from conformance import CORPUS, FRAMES, NAMES, SIZE, recording
from golden.damage import change_store

import mocap_calib as mc

NAN = np.nan
P, C = recording(1)  # of one individual
P2, C2 = recording(2)  # of two, as in the corpus
LAYOUT = mc.ReadOptions(layout=NAMES)
SHARES = mc.ReadOptions(layout=NAMES, image_size=SIZE)
Make = Callable[[Path], object]


class Case(NamedTuple):
    """make: of a folder. expected: fields of each camera, or a pattern of the refusal.

    paths: what is read, "" is the folder.
    """

    make: Make
    expected: str | Mapping[str, Any] | list[Mapping[str, Any]]
    options: mc.ReadOptions = mc.ReadOptions()
    paths: str = ""


def text(content: object, name: str = "cam.json") -> Make:
    """Return what writes a text, or JSON, or bytes, into a file."""
    as_text = content if isinstance(content, str | bytes) else json.dumps(content)
    as_bytes = as_text if isinstance(as_text, bytes) else as_text.encode()

    def make(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(as_bytes)

    return make


def stored(entry: str, changes: Mapping[str, object] | Callable[[h5py.File], object]) -> Make:
    """Return what copies a file of the corpus, and changes it."""

    def make(folder: Path) -> None:
        (path,) = (CORPUS / "keypoints" / entry).iterdir()
        copy = Path(shutil.copy(path, folder))
        if callable(changes):
            with h5py.File(copy, "a") as file:
                changes(file)
        else:
            change_store(copy, changes)

    return make


def check(case: Case, folder: Path) -> None:
    """Read the case, and compare it with what is expected."""
    case.make(folder)
    paths = case.paths.format(folder) or folder
    if isinstance(case.expected, str):
        with pytest.raises((mc.FormatError, mc.MismatchError), match=case.expected) as refused:
            mc.read_keypoints(paths, None, case.options)
        assert "\n" not in str(refused.value)
        return
    wanted = case.expected if isinstance(case.expected, list) else [case.expected]
    for view, fields in zip(mc.read_keypoints(paths, None, case.options), wanted, strict=True):
        for name, value in fields.items():
            found = getattr(view, name)
            if name == "remarks":
                assert any(value in remark for remark in found)
            elif isinstance(found, np.ndarray):
                expected = np.broadcast_to(value, found.shape)
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
            else:
                assert found == value


# --- COCO and tables


def images(*names: str, expected: Any, pattern: str = "", paths: str = "") -> Case:
    """Return a case of the first frames of the COCO file of the corpus, under other names."""
    data = json.loads((CORPUS / "keypoints" / "coco" / "cam.json").read_text("utf-8"))
    data["images"], data["annotations"] = data["images"][:3], data["annotations"][:6]
    for image, name in zip(data["images"], names, strict=True):
        image["file_name"] = name
    return Case(text(data), expected, mc.ReadOptions(camera_pattern=pattern), paths)


def row(content: str, expected: Any, **options: Any) -> Case:
    return Case(text(content, "cam.csv"), expected, mc.ReadOptions(**options))


PEOPLE = [
    {"image_id": 10**10 + 10**7 * k + f, "category_id": 1, "keypoints": [5.0, 6, 1] * 3}
    for k in (1, 2)
    for f in (4, 9)
]
CROWD = {
    "images": [{"id": 0, "file_name": "0.png"}],
    "annotations": [{"image_id": 0, "category_id": 1, "keypoints": [1, 2, 1]}] * 1001,
    "categories": [{"id": 1, "keypoints": ["nose"]}],
}
IMAGES = [("labeled-data", "clip", f"img{frame:04d}.png") for frame in FRAMES]
LEVELS = {
    f"predictions/axis1_level{k}": np.array([path[k] for path in IMAGES], "S") for k in range(3)
} | {f"predictions/axis1_label{k}": np.arange(5) for k in range(3)}
PATHS = {"predictions/axis1": np.array(["/".join(path) for path in IMAGES], "S")}
FOUND, ANY_ORDER = {"frames": FRAMES, "positions": P2}, {"tracked": False, "positions": P2}
OF_VIEWS = "scorer,n,n,n,n\nbodyparts,a_top,a_top,b_bot,b_bot\ncoords,x,y,x,y\n0,1,2,3,4\n"
HEAD, LITTLE = "camera,frame,individual,keypoint,x,y\n", "frame,keypoint,x,y\n"
TABLES = {  # with options, of HDF5, or too large to keep; others are in tests/golden/corpus
    "the user knows better": images(
        *("left/i3.png", "right/i5.png", "left/i9.png"),
        expected={"camera": "cam", "frames": [3, 5, 9]},
        paths="cam={}/cam.json",
    ),
    "results of two cameras": Case(
        text(PEOPLE),
        [{"camera": camera, "frames": [4, 9]} for camera in ("001", "002")],
        mc.ReadOptions(layout=NAMES, camera_pattern=r"1(?P<camera>\d{3})(?P<frame>\d{7})"),
    ),
    "cameras by a pattern": images(
        *("day1/cam2/color/0.png", "day1/cam1/color/4.png", "day1/cam2/color/6.png"),
        expected=[{"camera": "cam2", "frames": [0, 6]}, {"camera": "cam1", "frames": [4]}],
        pattern="cam[12]",
    ),
    "two cameras under one name": images(
        *("cam1/0.png", "cam2/0.png", "cam1/1.png"),
        expected="without a name|twice",
        paths="a={}/cam.json",
    ),
    "a crowd": Case(text(CROWD), "at most 1000"),
    "paths as levels in .h5": Case(
        stored("deeplabcut-h5-fixed", {"predictions/axis1": None} | LEVELS), FOUND
    ),
    "paths in .h5": Case(stored("deeplabcut-h5-fixed", PATHS), FOUND),
    "two views in names": row(
        OF_VIEWS,
        [
            {"camera": "top", "keypoints": ("a",), "positions": [1, 2]},
            {"camera": "bot", "keypoints": ("b",), "positions": [3, 4]},
        ],
        views=("top", "bot"),
    ),
    "Argus counts y from the bottom": row(
        "nose_cam_2_x,nose_cam_2_y\n10,20\n",
        {"camera": "cam2", "positions": [10, 460], "image_size": SIZE},
        image_size=SIZE,
    ),
    "Argus without a height": row("nose_cam_2_x,nose_cam_2_y\n10,20\n", "image_size="),
    "DLTdv before 8": row(
        "pt1_cam1_X,pt1_cam1_Y\n10,20\n", {"positions": [10, 20], "remarks": "it points up"}
    ),
    "JARVIS without names": row(
        "x,y,confidence,x,y,confidence\n1,2,9,3,4,9\n",
        {"keypoints": ("a", "b"), "positions": [[1, 2], [3, 4]]},
        layout=("a", "b"),
    ),
    "videos by a pattern": row(
        "frame_idx,node,x,y,video_path\n0,a,1,2,/d/1_left.mp4\n0,a,3,4,/d/1_right.mp4\n",
        [{"camera": "left", "positions": [1, 2]}, {"camera": "right", "positions": [3, 4]}],
        camera_pattern="left|right",
    ),
    "a view that is none": row(OF_VIEWS, "views=", views=("top",)),
    "a quote without end": row(OF_VIEWS + '"' + "x," * 200_000, "expected"),
    "pixels with an image size": row(
        LITTLE + "0,nose,12.5,300\n",
        {"positions": [12.5, 300], "image_size": SIZE},
        image_size=SIZE,
    ),
    "a crowd of keypoints": row(
        HEAD + "".join(f"c,0,a,k{k},1,2\n" for k in range(60_000)), "at most 5000 keypoints"
    ),
    "fewer names than points": Case(
        lambda folder: shutil.copy(CORPUS / "keypoints/caliscope/xy.csv", folder),
        r"row 4: .*below 1",
        mc.ReadOptions(layout=("nose",)),
    ),
}


# --- a file a frame, and JSON of detectors


def people(*frames: list[object], folder: str = "cam_json") -> Make:
    """Return what writes OpenPose's people, a file a frame."""

    def make(place: Path) -> None:
        for k, points in enumerate(frames):
            found = {"people": [{"pose_keypoints_2d": each} for each in points]}
            text(found, f"{folder}/v_{k:012d}_keypoints.json")(place)

    return make


def in_one_file(people: str, points: str) -> Make:
    """Return what writes OpenPose's people as AlphaPose does, all frames in one file."""
    files = sorted((CORPUS / "keypoints" / "openpose" / "cam_json").iterdir())
    found = [json.loads(path.read_text("utf-8"))["people"] for path in files]
    return text(
        {
            f"{frame}.jpg": {people: [{points: each["pose_keypoints_2d"]} for each in of_frame]}
            for frame, of_frame in enumerate(found)
        }
    )


def of_program(program: str, count: int) -> Make:
    """Return what writes one body of so many points."""
    points = [5.0, 5.0, 0.5] * count
    entry = {"image_id": "0.jpg", "score": 2.0, "box": [1, 2, 3, 4], "idx": [0.0]}
    named = {"keypoints": [[5.0, 5.0]] * count, "keypoint_scores": [0.5] * count}
    contents = {
        "alphapose": [entry | {"category_id": 1, "keypoints": points}],
        "mmpose": [{"frame_id": 0, "instances": [named]}],
        "openpose": {"people": [{"pose_keypoints_2d": points}]},
    }
    return text(contents[program], "0.json")


def shares(*cells: object) -> Make:
    """Return what writes one of Ultralytics' lines."""
    return text(" ".join(map(str, [0, 0.5, 0.5, 0.2, 0.2, *cells])), "cam/labels/video_0.txt")


IN_FILE = "{}/cam.json"
FEET = ("left_big_toe", "left_small_toe", "left_heel")
ONE = [5.0, 6.0, 0.5]
LINE = " ".join(["0"] + ["0.5"] * 13)
LINE_TWICE = text(f"{LINE}\n{LINE}", "cam/video_3.txt")
PER_FRAME = {
    "people in any order": Case(
        people([ONE * 3, [7.0, 8, 1] * 3], [[7.0, 8, 1] * 3]),
        {
            "tracked": False,
            "positions": [[[[5, 6]] * 3, [[7, 8]] * 3], [[[7, 8]] * 3, [[NAN] * 2] * 3]],
        },
        LAYOUT,
    ),
    "no people, no points and null": Case(
        people([], [[]], [[None, None, None, 5.0, 6.0, 0.5, 1, 2, 1]]),
        {"positions": [[[[NAN] * 2] * 3]] * 2 + [[[[NAN] * 2, [5, 6], [1, 2]]]]},
        LAYOUT,
    ),
    "AlphaPose's people": Case(
        in_one_file("people", "pose_keypoints_2d"), ANY_ORDER, LAYOUT, IN_FILE
    ),
    "AlphaPose's bodies": Case(in_one_file("bodies", "joints"), ANY_ORDER, LAYOUT, IN_FILE),
    "18 points": Case(of_program("openpose", 18), {"frames": [0]}, paths="cam={}/0.json"),
    "25 points": Case(of_program("openpose", 25), "body_25 or body_25b", paths="cam={}/0.json"),
    "17 points": Case(of_program("openpose", 17), "coco_17 or h36m_17", paths="cam={}/0.json"),
    "2 numbers": Case(people([[1.0, 2.0]]), "found 2 numbers", LAYOUT),
    "no list": Case(people([{"x": 1}]), "found an object", LAYOUT),
    "literals that are no numbers": Case(
        text(
            b"\xef\xbb\xbf"
            + b'[{"bodyparts": [[[1.5, 2.5, 0.5],\r\n[NaN, 3, 0.5],\r\n[Infinity, 3, 0.5]]]}]',
        ),
        {"positions": [[1.5, 2.5], [NAN] * 2, [NAN] * 2]},
        LAYOUT,
    ),
    **{
        f"shares with {scores} scores and {len(behind)} behind": Case(
            shares(*[0.25, 0.5, *[0.7] * scores] * 3, *behind),
            {"positions": [160, 240], "confidence": 0.7 if scores else 1.0},
            SHARES,
        )
        for scores in (0, 1)
        for behind in ((), (0.87,), (0.87, 3))
    },
    "shares of the edge and of nothing": Case(
        shares(0, 0.5, 1, 0.5, 0, 1, 0, 0, 1),
        {"positions": [[0, 240], [320, 0], [NAN, NAN]], "confidence": [1, 1, 0]},
        SHARES,
    ),
    "shares without a size": Case(shares(*[0.5] * 9), "image_size=", LAYOUT),
    "shares that are pixels": Case(shares(320, 240, 1, 10, 20, 1, 3, 4, 1), "letterboxed", SHARES),
    "a line twice": Case(LINE_TWICE, "line 2: .*line 1", SHARES),
    **{
        f"shares of {count} numbers": Case(
            shares(*["0.5"] * count),
            f"found {count} numbers after the box; .*{words}",
            mc.ReadOptions(image_size=SIZE),
        )
        for count, words in (
            *((35, "coco_17"), (51, "coco_17"), (52, "body_25 or")),
            (500, "with names separated by commas"),
        )
    },
}


@pytest.mark.parametrize("program", ["alphapose", "openpose", "mmpose"])
@pytest.mark.parametrize(("count", "feet"), [(133, (17, 18, 19)), (136, (20, 22, 24))])
def test_whole_bodies_are_known_by_their_number_of_points(tmp_path, program, count, feet):
    of_program(program, count)(tmp_path)
    names = mc.read_keypoints([f"cam={tmp_path / '0.json'}"])[0].keypoints
    assert len(set(names)) == count
    assert names[-42] == "left_hand_root"
    assert tuple(names[k] for k in feet) == FEET


@pytest.mark.parametrize(
    ("layout", "count"),
    [
        *(("coco_17", 17), ("body_25", 25), ("body_25b", 25), ("coco_18", 18), ("halpe_26", 26)),
        *(("h36m_17", 17), ("mpii_16", 16), ("nose,left_eye", 2)),
    ],
)
def test_a_layout_names_each_point_and_the_model_of_people_knows_them(tmp_path, layout, count):
    for x, camera in enumerate("ab"):
        people([[10.0 + x, 20.0, 0.5] * count], folder=f"{camera}_json")(tmp_path)
    made = mc.read_recording(tmp_path, layout=layout, image_size=SIZE, model="people")
    assert len(set(made.keypoints)) == len(made.keypoints) >= count - 2


# --- HDF5 of SLEAP, movement and NWB

SESSION = {
    "calibration": {"cam_0": {"name": "right"}, "cam_1": {"name": "left"}, "metadata": {}},
    "camcorder_to_video_idx_map": {"0": "1", "1": "0"},
}
POSES = "processing/behavior/PoseEstimation"


def videos(expected: Any, names: list[object], pattern: str = "", **changes: object) -> Case:
    """Return a case of a SLEAP project of two videos, each with the frames of the corpus'."""

    def doubled(rows: np.ndarray) -> np.ndarray:
        more = rows.copy()
        more["video"], more["frame_id"] = 1, more["frame_id"] + len(rows)
        return np.concatenate([rows, more])

    backends = [json.dumps({"backend": name}) for name in names]
    two = {"frames": doubled, "videos_json": np.array(backends, "S")}
    options = mc.ReadOptions(camera_pattern=pattern)
    return Case(stored("sleap-slp", two | changes), expected, options)


NAMED = [{"filename": f"D:\\data\\{name}_cam.mp4"} for name in ("left", "right")]
INSIDE = [{"filename": ".", "dataset": f"video{k}/video"} for k in (0, 1)]
BY_VIDEO = [{"camera": f"{name}_cam", "positions": P2} for name in ("left", "right")]
BY_NAME = [{"camera": "left"}, {"camera": "right"}]
SOURCES = {f"video{k}/source_video/a": 0 for k in (0, 1)} | {
    f"video{k}/source_video@json": json.dumps({"backend": each}) for k, each in enumerate(NAMED)
}


def corrected(rows: np.ndarray) -> np.ndarray:
    """Return instances of which the second corrects the first by hand."""
    rows["track"] = -1
    for field in ("instance_type", "from_predicted", "point_id_start"):
        rows[1][field] = 0
    rows[1]["point_id_end"] = 3
    return rows


def sleap(expected: Any, **changes: object) -> Case:
    return Case(stored("sleap", changes), expected)


def times(expected: Any, name: str, value: object, **rate: float) -> Case:
    """Return a case of NWB whose series have these times."""
    changes: dict[str, object] = {}
    for joint in NAMES:
        changes |= {f"{POSES}/{joint}/timestamps": None, f"{POSES}/{joint}/{name}": value}
        changes |= {f"{POSES}/{joint}/{name}@{key}": each for key, each in rate.items()}
    return Case(stored("nwb", changes), expected)


def giant(kind: str, frames: int, chunk: int, filled: int) -> Make:
    """Return what claims so many frames, some of them there: deflate packs a thousandfold."""

    def make(file: h5py.File) -> None:
        del file["tracks"]
        shape, chunks = (1, 2, 10, frames), (1, 2, 10, chunk)
        tracks = file.create_dataset("tracks", shape, kind, chunks=chunks, compression="gzip")
        for start in range(0, filled, chunk):
            tracks[..., start : start + chunk] = 1

    return stored("sleap", make)


def filtered(file: h5py.File) -> None:
    """Write a chunk under blosc's filter number, which h5py does not have."""
    del file["predictions/block0_values"]
    given = {"chunks": (5, 9), "compression": 32001, "allow_unknown_filter": True}
    values = file.create_dataset("predictions/block0_values", (5, 9), "f8", **given)
    values.id.write_direct_chunk((0, 0), b"\0" * 40)


NO_TRACKS = dict.fromkeys(("point_scores", "track_occupancy"))
AXES = {
    "tracks": P2[:2].transpose(2, 3, 0, 1),
    "tracks@dims": json.dumps(["node", "xy", "frame", "track"]),
    "point_scores": C2[:2].transpose(2, 0, 1),
    "track_occupancy": None,
}
BY_HAND = {
    "instances": corrected,
    "points": lambda points: np.array([(7.0, 8.0, True, True)] * 3, dtype=points.dtype),
}
STORES = {
    "before SLEAP 1.1": Case(
        stored("sleap-slp", {"metadata@format_id": 1.0}), {"positions": P2 - 0.5}
    ),
    "SLEAP 1.1": Case(stored("sleap-slp", {"metadata@format_id": 1.1}), {"positions": P2}),
    "videos of a project": videos(BY_VIDEO, NAMED),
    "a part of a video's name": videos(BY_NAME, NAMED, "(left|right)_"),
    "a package without names": videos("found none; export an analysis", INSIDE),
    "a package of named videos": videos(BY_VIDEO, INSIDE, **SOURCES),
    "a package of a session": videos(
        BY_NAME, [{"filename": "."}] * 2, sessions_json=np.array([json.dumps(SESSION)], "S")
    ),
    "a correction by hand": Case(stored("sleap-slp", BY_HAND), {"tracked": False}),
    "SLEAP's axes as numpy has them": sleap({"positions": P2}, tracks=P2, point_scores=C2),
    "axes that fit two orders": sleap(
        "fits 2 orders", **NO_TRACKS, track_names=None, tracks=np.zeros((2, 2, 3, 2))
    ),
    "axes by the number of tracks": sleap(
        {"positions": P[:2]},
        **NO_TRACKS,
        track_names=np.array(["one"], "S"),
        tracks=P[:2].transpose(1, 3, 2, 0),
    ),
    "axes that are named": sleap({"positions": P2[:2], "confidence": C2[:2]}, **AXES),
    "axes of nothing": sleap("a whole SLEAP analysis", **AXES | {"tracks@dims": "[" * 100_000}),
    "tracks without names": sleap(
        {"tracked": False, "confidence": np.isfinite(P2[..., 0])},
        track_names=np.zeros(0),
        point_scores=None,
    ),
    "poses of two cameras": Case(
        stored("nwb", lambda file: file.copy(POSES, file["processing/behavior"], name="right")),
        [{"camera": name, "remarks": "NWB has times"} for name in ("PoseEstimation", "right")],
    ),
    "a rate": times({"frames": [30, 31, 32, 33, 34]}, "starting_time", 1.0, rate=30.0),
    "times that jitter": times(
        {"frames": [0, 1, 2, 6, 7]}, "timestamps", [0.0, 0.0334, 0.0665, 0.2001, 0.2332]
    ),
    "late times": times(
        {"frames": [500, 501, 502, 503, 504]}, "timestamps", [10.0, 10.02, 10.04, 10.06, 10.08]
    ),
    "a time twice": times("times that increase", "timestamps", [0.0, 0.1, 0.1, 0.2, 0.3]),
    "a time that is none": times("times that incr", "timestamps", [0.0, 0.1, NAN, 0.2, 0.3]),
    "a rate of zero": times("times that increase", "starting_time", 1.0, rate=0.0),
    "times of another rate": Case(stored("movement", {"@fps": 30.0}), "whole frames"),
    "times of two axes": Case(stored("movement", {"time": np.zeros((5, 1))}), "whole frames"),
    "axes x and z": Case(
        stored("movement", {"space": np.array(["x", "z"], dtype="S")}), "2D positions"
    ),
    "a giant": Case(
        giant("f8", 1_000_000, 50_000, 250_000), r"at most 10\d MB of `/tracks`.*found 160 MB"
    ),
    "a crowd": Case(
        giant("i1", 25_000_000, 1_000_000, 25_000_000),
        r"at most .* MB of `/tracks`.*found 50\d MB",
    ),
    "an unknown compression": Case(stored("deeplabcut-h5-fixed", filtered), "32001"),
    "two tables": Case(
        stored("deeplabcut-h5", lambda file: file.copy("df_with_missing", "one")), "df_w.*, one"
    ),
    "labels that are no pickle": Case(
        stored("deeplabcut-h5", {"df_with_missing/table@values_block_0_kind": np.bytes_(b"no")}),
        "expected .*, found ",
    ),
    "another store": sleap("tracks", tracks=[0.0] * 3),
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name)
        for kind in (TABLES, PER_FRAME, STORES)
        for name, case in kind.items()
    ],
)
def test_a_detail_is_read_or_refused(case, tmp_path):
    check(case, tmp_path)


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> tuple:
        return (os.mkdir, (self.path,))


@pytest.mark.parametrize(
    "place", ["@info", "/table@values_block_0_kind", "@non_index_axes", "/table@of no use"]
)
def test_a_doctored_h5_runs_nothing(tmp_path, place):
    """pandas.read_hdf runs what stands in `info` and others."""
    trap = np.bytes_(pickle.dumps(Trap(tmp_path / "trap"), 0))
    doctored = stored("deeplabcut-h5", {f"df_with_missing{place}": trap})
    check(Case(doctored, "do not trust this file"), tmp_path)
    assert not (tmp_path / "trap").exists()
    pickle.loads(bytes(trap))
    assert (tmp_path / "trap").exists(), "the trap works"


FOREIGN = {
    "zip": (b"PK\x03\x04" + bytes(200), "unpack"),
    "MATLAB 7.3": (b"MATLAB 7.3 MAT-file" + bytes(200), "-v7"),
    "a pickle": (pickle.dumps(Trap(Path("trap"))), "expected .*found"),
    "a pickle of numpy": (b"\x93NUMPY" + pickle.dumps(Trap(Path("trap"))), "expected .*found"),
    "deep": (b'{"images":' + b"[" * 100_000, "expected JSON"),
}


@pytest.mark.parametrize(("content", "words"), FOREIGN.values(), ids=FOREIGN)
@pytest.mark.parametrize("ending", ["json", "h5"])
def test_another_file_is_named_with_what_to_do(tmp_path, monkeypatch, content, words, ending):
    monkeypatch.chdir(tmp_path)
    check(Case(text(content, f"a.{ending}"), words), tmp_path)
    assert not (tmp_path / "trap").exists()


def test_numbers_of_a_table_are_those_of_python_however_it_is_read(tmp_path):
    """To the last bit: texts of 1 to 19 digits, plain or, for the careful reader, quoted."""
    rng = random.Random(0)
    texts = [repr(rng.uniform(1, 2000)) for _ in range(600)]
    texts += [f"{rng.uniform(1, 2000):.18e}" for _ in range(600)]
    texts += [f"{rng.randrange(1, 10**9)}e{rng.randrange(-9, 3)}" for _ in range(600)]
    header = "scorer,s,s\nbodyparts,a,a\ncoords,x,y\n"
    lines = [f"{k},{x},{y}\n" for k, (x, y) in enumerate(zip(texts[::2], texts[1::2], strict=True))]
    first = lines[0].replace(texts[0], f'"{texts[0]}"')
    wanted = np.array([float(each) for each in texts]).reshape(900, 1, 1, 2)
    for name, rows in (("plain", lines), ("careful", [first, *lines[1:]])):
        text(header + "".join(rows), f"{name}.csv")(tmp_path)
        (view,) = mc.read_keypoints(tmp_path / f"{name}.csv")
        np.testing.assert_array_equal(view.positions, wanted)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_empty_cells_of_a_long_table_are_missing_points_in_their_places(tmp_path, end):
    wanted = np.random.default_rng(0).uniform(1, 99, (4000, 1, 2, 2))
    wanted[::3, :, 0] = wanted[1::7, :, 1] = NAN
    rows = [",".join(map(repr, row.ravel().tolist())).replace("nan", "") for row in wanted]
    header = ["bodyparts,a,a,b,b", "coords,x,y,x,y"]
    lines = [*header, *(f"{number},{row}" for number, row in enumerate(rows))]
    text(end.join(lines), "a.csv")(tmp_path)
    np.testing.assert_array_equal(mc.read_keypoints(tmp_path / "a.csv")[0].positions, wanted)
    text(end.join([*lines, "4000,1,,x,1"]), "a.csv")(tmp_path)
    with pytest.raises(mc.FormatError, match=r"row 4003.*a number"):
        mc.read_keypoints(tmp_path / "a.csv")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
@pytest.mark.parametrize("path", ["coco/cam.json", "deeplabcut-csv/cam.csv"])
def test_powershell_s_utf_16_is_read(tmp_path, path, encoding):
    mark = "\ufeff" * (encoding == "utf-16-be")
    content = (mark + (CORPUS / "keypoints" / path).read_text()).encode(encoding)
    text(content, "a")(tmp_path)
    np.testing.assert_array_equal(mc.read_keypoints(tmp_path / "a")[0].positions, P2)
    text(content[:-1], "a")(tmp_path)
    with pytest.raises(mc.FormatError):
        mc.read_keypoints(tmp_path / "a")


def test_sleap_refuses_to_write_a_clock_that_starts_far_away(tmp_path):
    options = mc.ReadOptions(frame_offset={"cam": 42150})
    late = mc.read_keypoints(CORPUS / "keypoints" / "csv", None, options)
    with pytest.raises(mc.MismatchError, match="near 0"):
        mc.write(late, tmp_path / "out", "sleap")
    assert not (tmp_path / "out").exists()
