"""benchmarks/recording_of_publisher.py: what publishers have becomes what the benchmarks read."""

import json
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scenes import scene

from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.io.cameras.own import format_calibration_toml
from mocap_calib.io.cameras.read import read_cameras, read_rig
from mocap_calib.io.formats.coco_writer import format_coco
from mocap_calib.io.keypoints.read import read_keypoints

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
ONE = {"cameras": 3, "people": 1, "false_detections": 0.0}


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("recording_of_publisher")


@pytest.fixture
def run(publisher, monkeypatch, tmp_path):
    made = scene(**ONE)
    (tmp_path / "rig.toml").write_text(format_calibration_toml(made.rig, {}))

    def run(*words):
        words = [tmp_path / "out", "--cameras", tmp_path / "rig.toml", *words]
        monkeypatch.setattr(sys, "argv", ["x", *map(str, words)])
        publisher.main()
        return tmp_path / "out", made

    return run


def points_of(keypoints):
    return {file.camera: file.positions for file in read_keypoints([keypoints])}


def test_panoptics_bodies_are_projected_each_into_its_own_row(run, tmp_path):
    """Two frames; the second person is in the second alone, without a joint."""
    rng = np.random.default_rng(1)
    bodies = rng.uniform(-0.4, 0.4, (2, 19, 3)) + [0, 0, 1]
    source = tmp_path / "hd"
    source.mkdir()
    for frame in range(2):
        rows = np.concatenate([bodies, np.ones((2, 19, 1))], -1)
        rows[1, 4] = -1
        listed = [{"id": 7 + k, "joints19": rows[k].ravel().tolist()} for k in range(frame + 1)]
        (source / f"body3DScene_{frame:08d}.json").write_text(json.dumps({"bodies": listed}))
    folder, made = run("--panoptic", source, "--noise", "0")
    truth = np.load(folder / "truth.npz")
    assert truth["poses3d"].shape == (2, 2, 19, 3)
    assert (truth["ids"][:, 0].max(), truth["ids"][:, 1].max()) == (0, 1)
    rig = read_rig(folder / "reference.toml")
    np.testing.assert_allclose(rig.rotation, made.rig.rotation, atol=1e-9)
    assert [c.name for c in read_cameras(folder / "intrinsics.toml")] == list(rig.names)
    points = points_of(folder / "keypoints")
    for view, camera in enumerate(rig.cameras):
        expected = pixels_from_points(camera, bodies @ rig.rotation[view].T + rig.translation[view])
        expected[1, 4] = np.nan
        found = points[camera.name]
        seen = truth["ids"][view] >= 0
        assert seen.sum() == 3
        who = truth["ids"][view][seen]
        np.testing.assert_allclose(found[seen], expected[who], atol=0.051)  # 0.1 px in the file


def test_arrays_of_two_animals_and_chosen_cameras(run, tmp_path):
    bodies = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 9, 4, 3)) + [0, 0, 1]
    for number, body in enumerate(bodies):
        np.savez(tmp_path / f"{number}.npz", a=body)
    sources = [f"{tmp_path}/{number}.npz:a" for number in range(2)]
    words = ["--bodies", *sources, "--joints", "a,b,c,d", "--every", "2", "--kind", "rodent"]
    with pytest.raises(SystemExit, match="cam3, found 'nobody'"):
        run(*words, "--views", "nobody")
    names = scene(**ONE).rig.names
    folder, _ = run(*words, "--views", f"{names[2]},{names[0]}")
    truth = np.load(folder / "truth.npz")
    assert truth["ids"].shape == (2, 5, 2)
    assert list(truth["kinds"]) == ["rodent", "rodent"]
    np.testing.assert_allclose(truth["poses3d"][:, 1], bodies[1][::2], atol=1e-6)
    assert read_rig(folder / "reference.toml").names == (names[2], names[0])


def test_detections_of_one_subject_stay_as_they_are(run, tmp_path):
    made = scene(**ONE)
    found = tmp_path / "found"
    found.mkdir()
    for file in made.files:
        (found / f"{file.camera}.json").write_text(format_coco(file))
    folder, _ = run("--detections", found)
    ids, points, before = (
        np.load(folder / "truth.npz")["ids"],
        points_of(folder / "keypoints"),
        points_of(found),
    )
    for view, name in enumerate(made.rig.names):
        np.testing.assert_array_equal(points[name], before[name])
        seen = np.isfinite(before[name]).all(-1).any(-1)
        assert (ids[view][seen] == 0).all()
        assert (ids[view] >= 0).sum() == seen.sum()
    with pytest.raises(SystemExit, match="expected bodies in body3DScene"):
        run("--panoptic", found)
    several = scene(cameras=3, people=2).files[0]
    (found / "cam1.json").write_text(format_coco(several))
    with pytest.raises(SystemExit, match="expected one detection in a frame, found several"):
        run("--detections", found)
