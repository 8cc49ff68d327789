"""Rival modes, loops, and groups of cameras: laws on exact pairs, then scenes with truth."""

import json
import time
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from scenes import PEOPLE, calibrate_all, lifted, precision, recording, rotation_errors_deg, scene

from mocap_calib.config import AveragingConfig, PairwiseConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.io.cameras.own import format_cameras_yaml
from mocap_calib.io.keypoints.coco_writer import format_coco
from mocap_calib.multi_view.averaging import average
from mocap_calib.multi_view.view_graph import (
    alternative_taken,
    camera_groups,
    pairs_among,
    select_hypotheses,
    usable_cameras,
)
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.two_view.solve import calibrate_pairs
from mocap_calib.types import Camera, CameraRig, Keypoints2D, PairwiseCalibration, silent

CONFIG = AveragingConfig()


def mode(
    rig: CameraRig, a: int, b: int, score: float, wrong: np.random.Generator | None = None
) -> PairwiseCalibration:
    """What a rig says of a pair, or something else."""
    rotation = rig.rotation[b] @ rig.rotation[a].T
    translation = rig.translation[b] - rotation @ rig.translation[a]
    if wrong is not None:
        rotation, translation = (
            matrix_from_vector(wrong.uniform(-2, 2, 3)) @ rotation,
            wrong.normal(size=3) * 4,
        )
    return PairwiseCalibration(
        a, b, rotation, translation, np.zeros((0, 3), int), 10, score, 0.0, 1.0, "lifted"
    )


def pairs_of(
    rig: CameraRig, wrong: set[tuple[int, int]], seed: int = 0
) -> tuple[PairwiseCalibration, ...]:
    """Pairs with a rival each; the best mode of the `wrong` ones is nonsense and the rival right, of the others the other way round."""
    rng = np.random.default_rng(seed)
    pairs = []
    for a, b in combinations(range(len(rig.cameras)), 2):
        right, nonsense = (
            mode(rig, a, b, 0.7 if (a, b) in wrong else 0.8),
            mode(rig, a, b, 0.8 if (a, b) in wrong else 0.7, rng),
        )
        pairs.append(
            replace(nonsense, alternatives=(right,))
            if (a, b) in wrong
            else replace(right, alternatives=(nonsense,))
        )
    return tuple(pairs)


def errors_deg(pairs: tuple[PairwiseCalibration, ...], rig: CameraRig) -> np.ndarray:
    return np.array(
        [
            np.degrees(angle_between(p.rotation, rig.rotation[p.b] @ rig.rotation[p.a].T))
            for p in pairs
        ]
    )


# which mode


@pytest.mark.parametrize("cameras", [3, 4, 6])
def test_a_wrong_best_mode_is_put_right_by_the_loop(cameras):
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


def test_no_mode_is_lost_or_changed():
    rig = scene(cameras=4).rig
    before = pairs_of(rig, {(0, 2)})
    after = select_hypotheses(before, CONFIG)
    for old, new in zip(before, after, strict=True):
        assert sorted(m.rotation.tobytes() for m in old.hypotheses) == sorted(
            m.rotation.tobytes() for m in new.hypotheses
        )
        assert all(not m.alternatives for m in new.alternatives)
    assert [p.rotation.tobytes() for p in select_hypotheses(after, CONFIG)] == [
        p.rotation.tobytes() for p in after
    ]


def test_the_order_of_pairs_and_of_views_does_not_matter():
    rig = scene(cameras=5).rig
    pairs = pairs_of(rig, {(0, 3), (1, 2)})
    forward = select_hypotheses(pairs, CONFIG)
    assert [p.rotation.tobytes() for p in reversed(select_hypotheses(pairs[::-1], CONFIG))] == [
        p.rotation.tobytes() for p in forward
    ]

    def back(p: PairwiseCalibration) -> PairwiseCalibration:
        return replace(
            p,
            a=p.b,
            b=p.a,
            rotation=p.rotation.T,
            translation=-p.rotation.T @ p.translation,
            alternatives=tuple(map(back, p.alternatives)),
        )

    turned = select_hypotheses(tuple(map(back, pairs)), CONFIG)
    assert [alternative_taken(p) for p in turned] == [alternative_taken(p) for p in forward]
    assert errors_deg(turned, rig).max() < 1e-5


def test_without_a_loop_the_score_decides():
    """Two views, and a chain of three."""
    for cameras, absent in ((2, ()), (3, ((0, 2),))):
        pairs = tuple(
            p for p in pairs_of(scene(cameras=cameras).rig, {(0, 1)}) if (p.a, p.b) not in absent
        )
        assert [p.score for p in select_hypotheses(pairs, CONFIG)] == [0.8] * len(pairs)


def test_a_mode_that_is_no_evidence_is_not_taken():
    rig = scene(cameras=4).rig
    pairs = tuple(
        replace(
            p,
            alternatives=tuple(replace(r, score=0.5 * CONFIG.least_score) for r in p.alternatives),
        )
        for p in pairs_of(rig, {(0, 1)})
    )
    assert not any(map(alternative_taken, select_hypotheses(pairs, CONFIG)))


def test_loops_of_a_large_rig_are_quick():
    """31 cameras, 4495 triangles, eight combinations each: measured 0.1 s."""
    rig = scene(cameras=31, frames=2).rig
    pairs = pairs_of(rig, {(0, 1), (7, 20), (3, 30)})
    start = time.perf_counter()
    found = select_hypotheses(pairs, CONFIG)
    assert time.perf_counter() - start < 3.0
    assert errors_deg(found, rig).max() < 1e-5


def test_modes_of_a_moment():
    """One frame of one person, six cameras: the best mode of a pair is 109 degrees off, the rival that its loops confirm 10.

    The rig: 135 degrees off without the loops, 29 with them.
    """
    changes = {"people": 1, "frames": 1, "cameras": 6, "seed": 2}
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
    before, after = (
        rotation_errors_deg(average(rig.cameras, p, CONFIG).rig, rig).max() for p in (pairs, found)
    )
    assert after < 45 < before


def test_rivals_are_renumbered_with_their_pair():
    pairs = pairs_among(pairs_of(scene(cameras=4).rig, set()), np.array([1, 3]))
    assert [(m.a, m.b) for m in pairs[0].hypotheses] == [(0, 1), (0, 1)]


# which cameras


def bridged(score: float, *, right: bool) -> tuple[CameraRig, tuple[PairwiseCalibration, ...]]:
    """Two pairs of cameras that are sure, and pairs between them of some score."""
    rig, rng = scene(cameras=4).rig, np.random.default_rng(1)
    return rig, tuple(
        mode(rig, a, b, 0.9)
        if (a < 2) == (b < 2)
        else mode(rig, a, b, score, None if right else rng)
        for a, b in combinations(range(4), 2)
    )


@pytest.mark.parametrize(
    ("score", "right", "groups"),
    [(0.3, False, 2), (0.3, True, 1), (0.7, False, 1), (0.05, True, 2)],
)
def test_sure_groups_are_joined_by_sure_pairs_or_by_loops(score, right, groups):
    """Never by a weak pair that nothing confirms; a pair below the least score is no evidence at all."""
    rig, pairs = bridged(score, right=right)
    found = camera_groups(rig.cameras, pairs, CONFIG)
    assert [g.tolist() for g in found] == ([[0, 1, 2, 3]] if groups == 1 else [[0, 1], [2, 3]])
    if groups > 1:
        with pytest.raises(DegenerateError, match=r"cam1, cam2 \| cam3, cam4"):
            usable_cameras(rig.cameras, pairs, CONFIG)


def test_a_single_camera_goes_where_its_best_pair_is():
    rig, pairs = bridged(0.3, right=False)
    found = camera_groups(rig.cameras, tuple(p for p in pairs if (p.a, p.b) != (2, 3)), CONFIG)
    assert [g.tolist() for g in found] == [[0, 1, 2, 3]]


@lru_cache
def rooms() -> tuple[tuple[Keypoints2D, ...], tuple[Camera, ...]]:
    """Three cameras in one room and two in another, with other people."""
    parts = [(scene(cameras=4, people=2, seed=1), 3), (scene(cameras=4, people=2, seed=2), 2)]
    cameras = [
        replace(c, name=f"{c.name}{'ab'[k]}")
        for k, (made, count) in enumerate(parts)
        for c in made.rig.cameras[:count]
    ]
    files = [file for made, count in parts for file in made.files[:count]]
    return tuple(replace(f, camera=c.name) for f, c in zip(files, cameras, strict=True)), tuple(
        cameras
    )


@pytest.mark.slow
def test_two_rooms_are_calibrated_separately():
    """The same people walk like others in another room, and pairs between rooms score up to 0.32. Measured: 0.1 degrees in each."""
    files, cameras = rooms()
    found = make_recording(files, cameras, PEOPLE, {})
    result = calibrate_all(found)
    groups = result.groups
    assert [g.rig.names for g in groups] == [("cam1a", "cam2a", "cam3a"), ("cam1b", "cam2b")]
    for group, seed, count in zip(groups, (1, 2), (3, 2), strict=True):
        made = scene(cameras=4, people=2, seed=seed)
        rig = CameraRig(
            made.rig.cameras[:count], made.rig.rotation[:count], made.rig.translation[:count], "m"
        )
        assert rotation_errors_deg(group.rig, rig).max() < 0.5
        assert precision(group.matches.labels, made.identity[:count]) > 0.99
    assert result.left_out == ()
    assert len(result.unused_pairs) == 6


@pytest.mark.slow
def test_run_writes_each_group_and_says_so(tool, tmp_path):
    """And takes away what an earlier run with more groups has left, but nobody else's files."""
    files, cameras = rooms()
    keypoints, intrinsics, out = (
        tmp_path / "keypoints",
        tmp_path / "intrinsics.yaml",
        tmp_path / "out",
    )
    keypoints.mkdir()
    for file in files:
        (keypoints / f"{file.camera}.json").write_text(format_coco(file))
    count = len(cameras)
    intrinsics.write_text(
        format_cameras_yaml(
            CameraRig(cameras, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), "m"), {}
        )
    )
    (out / "group_3").mkdir(parents=True)
    for stale in ("group_3/run.json", "group_3/poses3d.csv", "notes.txt"):
        (out / stale).write_text("{}")
    said = tool("run", keypoints, "--cameras", intrinsics, "-o", out)
    assert said.returncode == 0, said.stderr
    assert "2 groups of cameras" in said.stderr
    assert "cam1a, cam2a, cam3a | cam1b, cam2b" in said.stderr
    plain = {
        "cameras.yaml",
        "calibration.toml",
        "matches.csv",
        "poses3d.h5",
        "poses3d.csv",
        "poses3d_1.csv",
        "run.json",
    }
    assert {file.name for file in out.iterdir()} == plain | {"group_2", "notes.txt"}
    assert {file.name for file in (out / "group_2").iterdir()} == plain
    reports = [json.loads((folder / "run.json").read_text()) for folder in (out, out / "group_2")]
    assert (
        reports[0]["groups"]
        == reports[1]["groups"]
        == [
            {"folder": ".", "cameras": ["cam1a", "cam2a", "cam3a"]},
            {"folder": "group_2", "cameras": ["cam1b", "cam2b"]},
        ]
    )
    assert [camera["name"] for camera in reports[1]["cameras"]] == ["cam1b", "cam2b"]
