"""Groups of cameras: laws on exact pairs, then scenes with truth."""

import json
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from report_pages import page_data
from scenes import PEOPLE, calibrate_all, precision, rotation_errors_deg, scene

from mocap_calib.config import AveragingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.own import format_cameras_yaml
from mocap_calib.io.hashing import hash_files
from mocap_calib.io.keypoints.coco_writer import format_coco
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig.view_graph import camera_groups, usable_cameras
from mocap_calib.types import Camera, CameraRig, Keypoints2D

CONFIG = AveragingConfig()


def hypothesis(
    rig: CameraRig, a: int, b: int, score: float, wrong: np.random.Generator | None = None
) -> PairwiseCalibration:
    """Return the relative pose of a pair in a rig, or a wrong one drawn at random."""
    rotation, translation = rig.relative(a, b)
    if wrong is not None:
        rotation = matrix_from_vector(wrong.uniform(-2, 2, 3)) @ rotation
        translation = wrong.normal(size=3) * 4
    return PairwiseCalibration(
        a=a,
        b=b,
        rotation=rotation,
        translation=translation,
        matches=np.zeros((0, 3), int),
        frames=10,
        score=score,
        residual=0.0,
        in_front=1.0,
        source="lifted",
    )


def turned(pair: PairwiseCalibration, degrees: float) -> PairwiseCalibration:
    """Return the relative pose with its rotation so far off, and the same translation."""
    turn = matrix_from_vector(np.radians([0.0, degrees, 0.0]))
    return replace(pair, rotation=turn @ pair.rotation)


def bridged(score: float, *, right: bool) -> tuple[CameraRig, tuple[PairwiseCalibration, ...]]:
    """Return a rig of two certain pairs of cameras, with pairs between them of some score."""
    rig, rng = scene(cameras=4).rig, np.random.default_rng(1)
    pairs = []
    for a, b in combinations(range(4), 2):
        if (a < 2) == (b < 2):
            pairs.append(hypothesis(rig, a, b, 0.9))
        else:
            pairs.append(hypothesis(rig, a, b, score, None if right else rng))
    return rig, tuple(pairs)


@pytest.mark.parametrize(
    ("score", "right", "groups"),
    [(0.3, False, 2), (0.3, True, 1), (0.7, False, 1), (0.05, True, 2)],
)
def test_certain_groups_are_joined_by_strong_pairs_or_by_loops(score, right, groups):
    """Never by a weak pair that nothing confirms; a pair below the least score is not used."""
    rig, pairs = bridged(score, right=right)
    found = camera_groups(rig.cameras, pairs, CONFIG)
    assert [g.tolist() for g in found] == ([[0, 1, 2, 3]] if groups == 1 else [[0, 1], [2, 3]])
    if groups > 1:
        with pytest.raises(DegenerateError, match=r"cam1, cam2 \| cam3, cam4"):
            usable_cameras(rig.cameras, pairs, CONFIG)


@pytest.mark.parametrize("right", [0, 3, 15])
def test_certain_groups_are_not_joined_where_triangles_contradict(right):
    """Rooms of 5 and 3 cameras with some right pairs between them, the others wrong, one strong.

    Of a few right ones, weak as they are, chance would do as well; of all they join the rooms.
    """
    rig, rng, pairs = scene(cameras=8).rig, np.random.default_rng(2), []
    between = [(a, b) for a, b in combinations(range(8), 2) if (a < 5) != (b < 5)]
    strong = between[-1]
    for a, b in combinations(range(8), 2):
        if (a, b) not in between:
            pairs.append(hypothesis(rig, a, b, 0.9))
        else:
            wrong = between.index((a, b)) >= right
            score = 0.7 if (a, b) == strong else 0.3
            pairs.append(hypothesis(rig, a, b, score, rng if wrong else None))
    found = camera_groups(rig.cameras, tuple(pairs), CONFIG)
    assert [len(group) for group in found] == ([8] if right == 15 else [5, 3])


@pytest.mark.parametrize(("degrees", "groups"), [(6.5, 1), (7.4, 2)])
def test_a_triangle_closes_to_within_the_scale_of_rotations(degrees, groups):
    """Two certain pairs, and weak ones to one camera of the other: sqrt(3) x 4 degrees is half."""
    rig, pairs = bridged(0.3, right=True)
    kept = [pair for pair in pairs if 3 not in (pair.a, pair.b) or pair.a == 2]
    kept[1] = turned(kept[1], degrees)
    assert [(pair.a, pair.b) for pair in kept] == [(0, 1), (0, 2), (1, 2), (2, 3)]
    assert len(camera_groups(rig.cameras, tuple(kept), CONFIG)) == groups


def test_a_single_camera_goes_where_its_best_pair_is():
    rig, pairs = bridged(0.3, right=False)
    pairs = tuple(pair for pair in pairs if (pair.a, pair.b) != (2, 3))
    found = camera_groups(rig.cameras, pairs, CONFIG)
    assert [g.tolist() for g in found] == [[0, 1, 2, 3]]


@lru_cache
def rooms() -> tuple[tuple[Keypoints2D, ...], tuple[Camera, ...]]:
    """Three cameras in one room and two in another, with other people."""
    files: list[Keypoints2D] = []
    cameras: list[Camera] = []
    for room, seed, count in (("a", 1, 3), ("b", 2, 2)):
        made = scene(cameras=4, people=2, seed=seed)
        for camera, file in zip(made.rig.cameras[:count], made.files[:count], strict=True):
            name = f"{camera.name}{room}"
            cameras.append(replace(camera, name=name))
            files.append(replace(file, camera=name))
    return tuple(files), tuple(cameras)


@pytest.mark.slow
def test_two_rooms_are_calibrated_separately():
    """Pairs between rooms, where people walk alike, score up to 0.32. Measured: 0.1 deg in each."""
    files, cameras = rooms()
    found = make_recording(files, cameras, PEOPLE, {})
    result = calibrate_all(found)
    groups = result.groups
    assert [g.rig.names for g in groups] == [("cam1a", "cam2a", "cam3a"), ("cam1b", "cam2b")]
    for group, seed, count in zip(groups, (1, 2), (3, 2), strict=True):
        made = scene(cameras=4, people=2, seed=seed)
        rig = made.rig.select(np.arange(count))
        assert rotation_errors_deg(group.rig, rig).max() < 0.5
        assert precision(group.matches.labels, made.identity[:count]) > 0.99
    assert result.left_out == ()
    assert len(result.unused_pairs) == 6


@pytest.mark.slow
def test_run_writes_each_group_and_says_so(tool, tmp_path):
    """And takes away what an earlier run with more groups has left, but nobody else's files."""
    files, cameras = rooms()
    keypoints = tmp_path / "keypoints"
    intrinsics = tmp_path / "intrinsics.yaml"
    out = tmp_path / "out"
    keypoints.mkdir()
    for file in files:
        (keypoints / f"{file.camera}.json").write_text(format_coco(file))
    count = len(cameras)
    rig = CameraRig(cameras, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), "m")
    intrinsics.write_text(format_cameras_yaml(rig, {}))
    (out / "group_3").mkdir(parents=True)
    for stale in ("group_3/run.json", "group_3/poses3d_0.csv"):
        (out / stale).write_text("{}")
    (out / "run.json").write_text(json.dumps({"outputs": hash_files(out)}))
    (out / "notes.txt").write_text("mine")
    said = tool("run", keypoints, "--cameras", intrinsics, "-o", out)
    assert said.returncode == 0, said.stderr
    assert "2 groups of cameras" in said.stderr
    assert "cam1a, cam2a, cam3a | cam1b, cam2b" in said.stderr
    plain = {
        "cameras.yaml",
        "calibration.toml",
        "matches.csv",
        "poses3d.h5",
        "poses3d_0.csv",
        "poses3d_1.csv",
        "report.html",
        "run.json",
    }
    assert {file.name for file in out.iterdir()} == plain | {"group_2", "notes.txt"}
    assert {file.name for file in (out / "group_2").iterdir()} == plain
    pages = [folder / "report.html" for folder in (out, out / "group_2")]
    before = [page_data(page.read_text("utf-8")) for page in pages]
    assert tool("report", out).returncode == 0
    for page, of_run in zip(pages, before, strict=True):
        again = page_data(page.read_text("utf-8"))
        assert (again["title"], again["detections"]) == (of_run["title"], of_run["detections"])
    assert before[1]["title"] == "out/group_2"
    first, second = (
        json.loads((folder / "run.json").read_text()) for folder in (out, out / "group_2")
    )
    groups = [
        {"folder": ".", "cameras": ["cam1a", "cam2a", "cam3a"]},
        {"folder": "group_2", "cameras": ["cam1b", "cam2b"]},
    ]
    assert first["groups"] == second["groups"] == groups
    assert [camera["name"] for camera in second["cameras"]] == ["cam1b", "cam2b"]
