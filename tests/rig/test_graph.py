"""Alternatives, loops, and groups of cameras: laws on exact pairs, then scenes with truth."""

import json
import sys
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from report_pages import page_data
from scenes import PEOPLE, calibrate_all, lifted, precision, recording, rotation_errors_deg, scene

from mocap_calib.config import AveragingConfig, PairwiseConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.io.cameras.own import format_cameras_yaml
from mocap_calib.io.hashing import hash_files
from mocap_calib.io.keypoints.coco_writer import format_coco
from mocap_calib.pairs.solve import calibrate_pairs
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig.averaging import average, camera_groups, pairs_among, usable_cameras
from mocap_calib.rig.view_graph import alternative_taken, select_hypotheses
from mocap_calib.types import Camera, CameraRig, Keypoints2D, silent

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


def pairs_of(
    rig: CameraRig, wrong: set[tuple[int, int]], seed: int = 0
) -> tuple[PairwiseCalibration, ...]:
    """Return pairs with a right and a wrong hypothesis each.

    The right one has the better score, but for the `wrong` pairs.
    """
    rng = np.random.default_rng(seed)
    pairs = []
    for a, b in combinations(range(len(rig.cameras)), 2):
        wrong_is_best = (a, b) in wrong
        right = hypothesis(rig, a, b, 0.7 if wrong_is_best else 0.8)
        nonsense = hypothesis(rig, a, b, 0.8 if wrong_is_best else 0.7, rng)
        best, other = (nonsense, right) if wrong_is_best else (right, nonsense)
        pairs.append(replace(best, alternatives=(other,)))
    return tuple(pairs)


def errors_deg(pairs: tuple[PairwiseCalibration, ...], rig: CameraRig) -> np.ndarray:
    errors = [angle_between(pair.rotation, rig.relative(pair.a, pair.b)[0]) for pair in pairs]
    return np.degrees(errors)


def rotations(pairs: tuple[PairwiseCalibration, ...]) -> list[bytes]:
    return [pair.rotation.tobytes() for pair in pairs]


# which hypothesis


@pytest.mark.parametrize("cameras", [3, 4, 6])
def test_a_wrong_best_hypothesis_is_put_right_by_the_loop(cameras):
    """Whichever pair it is, and that pair alone is named."""
    rig = scene(cameras=cameras).rig
    for pair in combinations(range(cameras), 2):
        found = select_hypotheses(pairs_of(rig, {pair}), CONFIG)
        assert errors_deg(found, rig).max() < 1e-5
        assert [(p.a, p.b) for p in found if alternative_taken(p)] == [pair]
        assert rotation_errors_deg(average(rig.cameras, found, CONFIG).rig, rig).max() < 1e-4


def test_a_third_of_the_pairs_may_be_wrong():
    """Five of fifteen: without the loops the rig is far off."""
    rig = scene(cameras=6).rig
    wrong = pairs_of(rig, {(0, 1), (1, 2), (2, 5), (0, 4), (3, 4)})
    assert errors_deg(select_hypotheses(wrong, CONFIG), rig).max() < 1e-5
    assert (errors_deg(wrong, rig) > 20).sum() == 5


def test_no_hypothesis_is_lost_or_changed():
    rig = scene(cameras=4).rig
    before = pairs_of(rig, {(0, 2)})
    after = select_hypotheses(before, CONFIG)
    for old, new in zip(before, after, strict=True):
        assert sorted(rotations(old.hypotheses)) == sorted(rotations(new.hypotheses))
        assert not any(other.alternatives for other in new.alternatives)
    assert rotations(select_hypotheses(after, CONFIG)) == rotations(after)


def test_the_order_of_pairs_and_of_views_does_not_matter():
    rig = scene(cameras=5).rig
    pairs = pairs_of(rig, {(0, 3), (1, 2)})
    forward = select_hypotheses(pairs, CONFIG)
    backward = select_hypotheses(pairs[::-1], CONFIG)
    assert rotations(backward[::-1]) == rotations(forward)

    swapped = select_hypotheses(tuple(map(swap_views, pairs)), CONFIG)
    assert list(map(alternative_taken, swapped)) == list(map(alternative_taken, forward))
    assert errors_deg(swapped, rig).max() < 1e-5


def swap_views(pair: PairwiseCalibration) -> PairwiseCalibration:
    """Return the same relative pose as that of (b, a)."""
    return replace(
        pair,
        a=pair.b,
        b=pair.a,
        rotation=pair.rotation.T,
        translation=-pair.rotation.T @ pair.translation,
        alternatives=tuple(map(swap_views, pair.alternatives)),
    )


@pytest.mark.parametrize("swapped", [(), (0,), (1,), (2,), (0, 2)])
def test_a_loop_tells_baselines_that_point_the_other_way(swapped):
    """Also where some pairs are those of (b, a): rotations alone are the same."""
    rig = scene(cameras=3).rig
    pairs = [hypothesis(rig, a, b, 0.7) for a, b in combinations(range(3), 2)]
    other_way = replace(pairs[1], translation=-pairs[1].translation, score=0.8)
    pairs[1] = replace(other_way, alternatives=(pairs[1],))
    for k in swapped:
        pairs[k] = swap_views(pairs[k])
    assert [pair.score for pair in select_hypotheses(tuple(pairs), CONFIG)] == [0.7] * 3


def turned(pair: PairwiseCalibration, degrees: float) -> PairwiseCalibration:
    """Return the relative pose with its rotation so far off, and the same translation."""
    turn = matrix_from_vector(np.radians([0.0, degrees, 0.0]))
    return replace(pair, rotation=turn @ pair.rotation)


@pytest.mark.parametrize(("degrees", "overruled"), [(10.6, False), (20.8, True)])
def test_loops_are_weighed_against_the_squares_of_scores(degrees, overruled):
    """A score twice as good counts four times: it stands at a closure of 0.3, not at 0.1."""
    rig = scene(cameras=3).rig
    pairs = [hypothesis(rig, a, b, 0.8) for a, b in combinations(range(3), 2)]
    other = replace(pairs[1], score=0.4)
    pairs[1] = replace(turned(pairs[1], degrees), alternatives=(other,))
    found = select_hypotheses(tuple(pairs), CONFIG)
    assert [alternative_taken(pair) for pair in found] == [False, overruled, False]


def test_without_a_loop_the_score_decides():
    """Two views, and a chain of three."""
    for cameras in (2, 3):
        pairs = pairs_of(scene(cameras=cameras).rig, {(0, 1)})
        chain = tuple(pair for pair in pairs if pair.b == pair.a + 1)
        assert [pair.score for pair in select_hypotheses(chain, CONFIG)] == [0.8] * len(chain)


def test_a_hypothesis_below_the_least_score_is_not_taken():
    pairs = []
    for pair in pairs_of(scene(cameras=4).rig, {(0, 1)}):
        (other,) = pair.alternatives
        poor = replace(other, score=0.5 * CONFIG.least_score)
        pairs.append(replace(pair, alternatives=(poor,)))
    assert not any(map(alternative_taken, select_hypotheses(tuple(pairs), CONFIG)))


def calls_to_select(cameras: int) -> int:
    """Count the functions that are called to choose among the hypotheses of a rig's pairs."""
    rig = scene(cameras=cameras, frames=2).rig
    pairs = pairs_of(rig, {(0, 1), (2, 9), (3, 11)})
    calls = Counter()
    sys.setprofile(lambda _frame, event, _argument: calls.update([event]))
    try:
        found = select_hypotheses(pairs, CONFIG)
    finally:
        sys.setprofile(None)
    assert errors_deg(found, rig).max() < 1e-5
    return calls["call"] + calls["c_call"]


def test_work_on_loops_grows_with_the_pairs_not_with_the_triangles():
    """Of 31 cameras and of 16: 3.9 times the pairs, 8.0 times the triangles; measured 3.7."""
    assert calls_to_select(31) < 4.2 * calls_to_select(16)


def test_a_pair_that_explains_nothing_keeps_the_only_hypothesis_it_has():
    """Beside pairs of several: what it lacks would close the loops better."""
    rig = scene(cameras=6).rig
    first, *others = pairs_of(rig, set())
    turned = matrix_from_vector(np.array([0.0, np.pi, 0.0])) @ first.rotation
    nothing = replace(
        first, rotation=turned, translation=1e3 * np.ones(3), score=0.0, alternatives=()
    )
    assert select_hypotheses((nothing, *others), CONFIG)[0] == nothing


def test_hypotheses_of_a_single_frame():
    """One frame of one person, six cameras, measured without the loops and with them.

    The best hypothesis of a pair is 105 degrees off, the alternative that its loops confirm 19.
    The rig is 7 degrees off.
    """
    changes = {"people": 1, "frames": 1, "cameras": 6, "seed": 205}
    rig = scene(**changes).rig
    pairs = calibrate_pairs(
        recording(**changes),
        lifted(**changes),
        PairwiseConfig(),
        rng=np.random.default_rng(0),
        progress=silent,
    )
    found = select_hypotheses(pairs, CONFIG)
    assert errors_deg(pairs, rig).max() > 90
    assert errors_deg(found, rig).max() < 60
    assert any(map(alternative_taken, found))
    after = average(rig.cameras, found, CONFIG).rig
    assert rotation_errors_deg(after, rig).max() < 20


def test_alternatives_are_renumbered_with_their_pair():
    pairs = pairs_among(pairs_of(scene(cameras=4).rig, set()), np.array([1, 3]))
    assert [(m.a, m.b) for m in pairs[0].hypotheses] == [(0, 1), (0, 1)]


# which cameras


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
