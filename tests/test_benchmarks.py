"""Benchmarks: tables from results to the page, cases with a truth, and what publishers have.

Nothing here needs a recording.
"""

import json
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from scenes import moved, scene, turn_camera
from scipy.io import savemat

import mocap_calib as mc
from benchmarks.paper import __main__ as paper
from benchmarks.paper import cells, tables

ROOT = Path(__file__).parents[1]


@pytest.fixture
def script(monkeypatch):
    """Imports a script of benchmarks/, beside which it finds others."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return import_module


# --- the paper's tables


def committed():
    text = paper.RESULTS.read_text("utf-8")
    return [json.loads(line) for line in text.splitlines()]


def test_the_page_has_the_tables_of_the_committed_results():
    text = paper.PAGE.read_text("utf-8")
    assert tables.insert_tables(text, committed()) == text
    marked = [found[2] for found in tables.MARKED.finditer(text)]
    assert sorted(marked) == sorted(tables.TABLES)


def test_the_auc_and_its_interval():
    """Half of the pairs perfect and half wrong: 0.5, and 1.96 sqrt(1/4 / 400) on both sides."""
    errors = np.repeat([0.0, 180.0], 200)
    assert tables.auc(errors, 0 * errors, 20) == pytest.approx(0.5)
    assert tables.auc_interval(errors, errors, 20) == pytest.approx((0.451, 0.549), abs=0.006)
    assert tables.auc(np.full(3, 9.5), np.zeros(3), 20) == pytest.approx(11 / 20)


def line(size, error, **changes):
    cell = {"group": "pairs", "what": "dog", "scenario": "4x1", "method": "ours", "size": size}
    found = {"rotation": [error] * size, "translation": [error] * size, "matched": 4, "right": 3}
    return cell | found | {"seconds": 0.25, "processor_s": 1.0, "machine": "one"} | changes


def test_a_cell_has_the_largest_measurement_and_slow_methods_do_not_compete():
    lines = [line(9, 1.5), line(7, 90.0), line(9, 0.5, method="gone"), line(5, 3.0, what="rat")]
    lines += [line(9, 9.5, method="magsac"), line(6, 0.5, method="paper-factorised")]
    magsac, slow, ours = (
        [cell.strip() for cell in row.strip("| ").split("|")]
        for row in tables.TABLES["four"](tables.Results(lines)).splitlines()[2:]
    )
    assert (magsac[0], magsac[2]) == ("magsac", "0.550")
    assert (slow[0], slow[2]) == ("paper-factorised", "1.000")
    assert (ours[0], ours[2], ours[5]) == ("ours", "**0.950**", "**0.850**")
    full = tables.full_table(tables.Results(lines))
    assert "| pairs/dog/4x1/ours | 9 | 1.00 | 1.00 | 0.950 [0.95, 0.95] |" in full


def test_cells_and_tables_need_no_data(monkeypatch, capsys, tmp_path):
    """All else does, and says so before anything is measured."""
    monkeypatch.delenv("MOCAP_CALIB_RECORDINGS", raising=False)
    results, page = tmp_path / "results.jsonl", tmp_path / "page.md"
    results.write_text(json.dumps(line(9, 1.5)) + "\n")
    page.write_text("<!-- table: four -->\nstale\n<!-- end of table -->\n")
    given = ["paper.py", "dog/4x1/ours", "--results", str(results), "--page", str(page)]
    monkeypatch.setattr(sys, "argv", [*given, "--list"])
    paper.main()
    assert capsys.readouterr().out.startswith("pairs/dog/4x1/ours 100\n")
    for options, status in ((["--tables"], 0), ([], 2)):
        monkeypatch.setattr(sys, "argv", [*given, *options])
        with pytest.raises(SystemExit) as ended:
            paper.main()
        assert ended.value.code == status
    assert "expected --poses and --recordings" in capsys.readouterr().err
    assert "stale" not in page.read_text()
    assert "| ours | - | **0.950** |" in page.read_text()


def test_ours_is_measured_wherever_the_others_are():
    """Also where it is behind: among misplaced points."""
    measured = cells.plan(cells.WHOLE, quick=False)
    scenarios = {(each.what, each.scenario) for each in measured if each.method}
    ours = {(each.what, each.scenario) for each in measured if each.method == "ours"}
    assert ours == scenarios
    assert ("people", cells.WRONG) in ours


# --- stated uncertainties


def test_errors_know_no_similarity_and_are_turns_and_shifts(script):
    errors = script("certainty")
    rig = scene(cameras=4, people=1).rig
    same, _, _ = moved(rig, np.random.default_rng(0))
    assert np.abs(errors.rig_error(same, rig)).max() < 1e-9
    wrong = turn_camera(same, 2, 2.0)
    found = np.degrees(np.linalg.norm(errors.rig_error(wrong, rig), axis=1))
    # the best similarity takes a share of it: one camera of four, 2 deg before
    assert 1.0 < found[2] < 2.0
    assert found[2] > 2 * np.delete(found, 2).max()


def test_distances_of_draws_from_a_covariance_are_those_of_three_degrees_of_freedom(script):
    errors = script("certainty")
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(3, 3))
    covariance = np.zeros((500, 3, 500, 3))
    covariance[np.arange(500), :, np.arange(500), :] = factor @ factor.T
    distance = errors.mahalanobis(rng.normal(size=(500, 3)) @ factor.T, covariance)
    assert 2.6 < np.mean(distance) < 3.4  # 3, and a standard error of 0.11


# --- recordings of publishers


ONE = {"cameras": 3, "people": 1, "false_detections": 0.0}


@pytest.fixture
def run(script, monkeypatch, tmp_path):
    made = scene(**ONE)
    mc.write(made.rig, tmp_path / "rig.toml")

    def run(*words):
        words = [tmp_path / "out", "--cameras", tmp_path / "rig.toml", *words]
        monkeypatch.setattr(sys, "argv", ["x", *map(str, words)])
        script("recording_of_publisher").main()
        return tmp_path / "out", made

    return run


def points_of(keypoints):
    return {file.camera: file.positions for file in mc.read_keypoints(keypoints)}


def test_arrays_of_two_animals_and_chosen_cameras(run, tmp_path):
    bodies = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 9, 4, 3)) + [0, 0, 1]
    for number, body in enumerate(bodies):
        np.savez(tmp_path / f"{number}.npz", a=body)
    sources = [f"{tmp_path}/{number}.npz:a" for number in range(2)]
    words = ["--bodies", *sources, "--joints", "a,b,c,d", "--every", "2", "--kind", "rodent"]
    words += ["--noise", "0"]
    with pytest.raises(SystemExit, match="cam3, found 'nobody'"):
        run(*words, "--views", "nobody")
    names = scene(**ONE).rig.names
    folder, _ = run(*words, "--views", f"{names[2]},{names[0]}")
    truth = np.load(folder / "truth.npz")
    assert truth["ids"].shape == (2, 5, 2)
    assert list(truth["kinds"]) == ["rodent", "rodent"]
    np.testing.assert_allclose(truth["poses3d"][:, 1], bodies[1][::2], atol=1e-6)
    rig = mc.read_rig(folder / "reference.toml")
    assert rig.names == (names[2], names[0])
    points = points_of(folder / "keypoints")
    for ids, camera, seen in zip(truth["ids"], rig, rig.project(truth["poses3d"]), strict=True):
        frame, instance = np.nonzero(ids >= 0)
        gap = points[camera.name][frame, instance] - seen[frame, ids[frame, instance]]
        assert np.nanmax(np.abs(gap)) < 0.051  # 0.1 px in the file


def test_detections_of_one_subject_stay_as_they_are(run, tmp_path):
    made = scene(**ONE)
    found = tmp_path / "found"
    found.mkdir()
    for file in made.files:
        mc.write(file, found / f"{file.camera}.json", format="coco")
    folder, _ = run("--detections", found)
    ids = np.load(folder / "truth.npz")["ids"]
    points, before = points_of(folder / "keypoints"), points_of(found)
    for view, name in enumerate(made.rig.names):
        np.testing.assert_allclose(points[name], before[name], atol=0.051)  # 0.1 px in the file
        seen = np.isfinite(before[name]).all(-1).any(-1)
        assert (ids[view][seen] == 0).all()
        assert (ids[view] >= 0).sum() == seen.sum()
    several = scene(cameras=3, people=2).files[0]
    mc.write(several, found / "cam1.json", format="coco")
    with pytest.raises(SystemExit, match="expected one detection in a frame, found several"):
        run("--detections", found)


# --- poses of publishers


# a person of straight bones, in a stance: name, parent, direction, length, turn of its axes
LEG = [("femur", "hipjoint", (0.34202, -0.939693, 0), 7, 20), ("tibia", "femur", (0, -1, 0), 7, 0)]
LEG += [("foot", "tibia", (0, -0.6, 0.8), 2, 0), ("toes", "foot", (0, 0, 1), 1, 0)]
ARM = [("clavicle", "thorax", (0.8, 0.6, 0), 3, 0), ("humerus", "clavicle", (1, 0, 0), 5, 0)]
ARM += [("radius", "humerus", (1, 0, 0), 4, 0), ("hand", "radius", (1, 0, 0), 1, 0)]
SPINE = ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"]


def described():
    bones = [(name, parent, (0, 1, 0), 2, 0) for parent, name in pairwise(SPINE)]
    for side, sign in (("l", 1), ("r", -1)):
        bones.append((f"{side}hipjoint", "root", (sign * 0.8, -0.6, 0), 2, 0))
        for name, parent, (x, y, z), length, turn in LEG + ARM:
            own = parent if parent == "thorax" else side + parent
            bones.append((side + name, own, (sign * x, y, z), length, sign * turn))
    return bones


def write_subject(folder, motion):
    lines = [":version 1.10", ":units", "  mass 1.0", "  length 0.45", "  angle deg"]
    lines += [":root", "  order TX TY TZ RX RY RZ", ":bonedata"]
    for number, (name, _, direction, length, turn) in enumerate(described()):
        lines += ["  begin", f"    id {number}", f"    name {name}"]
        lines += [f"    direction {' '.join(map(str, direction))}", f"    length {length}"]
        lines += [f"    axis 0 0 {turn}  XYZ", "    dof rx ry rz", "    limits (-9 9)"]
        lines += ["           (-9 9)", "  end"]
    lines += [":hierarchy", "  begin"]
    lines += [f"    {parent} {name}" for name, parent, *_ in described()] + ["  end"]
    folder.mkdir()
    (folder / f"{folder.name}.asf").write_text("\n".join(lines))
    (folder / f"{folder.name}_01.amc").write_text("#!OML\n:DEGREES\n" + motion)


MOTION = """1
root 3 20 5 0 0 0
ltibia 0 0 0
2
root 9 20 -4 0 90 0
ltibia 0 0 0
3
root 3 20 5 0 0 0
ltibia 90 0 0
"""


def test_a_person_stands_turns_and_bends_a_knee(script, tmp_path):
    """Frames: the stance, the same turned by 90 deg about the vertical elsewhere, a knee bent."""
    people = script("poses_of_people")
    write_subject(tmp_path / "07", MOTION)
    metres, bones = people.read_skeleton(tmp_path / "07" / "07.asf")
    motion = people.read_motion(tmp_path / "07" / "07_01.amc", 1)
    joints = people.joints_of(bones, *people.place(bones, motion, metres))
    assert metres == pytest.approx(0.0254 / 0.45)
    assert set(joints) == set(scene().joints)
    still = {name: place[0] for name, place in joints.items()}
    assert np.allclose(still["mid_hip"][:2], 0)
    thigh = np.linalg.norm(still["left_knee"] - still["left_hip"])
    assert thigh == pytest.approx(7 * metres, rel=1e-5)
    for name in ("eye", "ear", "shoulder", "hip", "small_toe"):  # left is +x; people look along -y
        assert still[f"left_{name}"][0] > 0 > still[f"right_{name}"][0]
    assert still["nose"][1] < still["neck"][1] - 0.05
    assert still["head_top"][2] > still["nose"][2] > still["neck"][2] > still["spine"][2]
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for name, place in joints.items():
        np.testing.assert_allclose(place[1], turn @ place[0], atol=1e-9, err_msg=name)
    shank = joints["left_ankle"] - joints["left_knee"]
    assert shank[2] @ shank[0] == pytest.approx(0, abs=1e-9)
    assert shank[2][1] > 0.3  # metres: a knee that bends by +x about the left takes the foot back
    assert joints["left_heel"][:2, 2].min() >= -1e-9


def test_arrays_of_any_order_become_a_set(script, tmp_path):
    arrays = script("poses_of_arrays")
    poses = np.random.default_rng(0).normal(size=(7, 4, 3))
    rows = [{"data": poses.reshape(7, 12)}]
    savemat(tmp_path / "a.mat", {"pred": poses.transpose(0, 2, 1), "label": {"own": rows}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tracks"] = poses[:, None]
    np.savez(tmp_path / "a.npz", poses=poses.transpose(2, 1, 0))
    for source in ("a.mat:pred", "a.h5:tracks", "a.npz:poses", "a.mat:label.own.data"):
        np.testing.assert_array_equal(arrays.read_clip(f"{tmp_path}/{source}", 4), poses)
    with pytest.raises(mc.FormatError, match="expected poses of 5 points, found shape"):
        arrays.as_poses(poses, 5, tmp_path)
    with pytest.raises(mc.FormatError, match="expected an array pred"):
        arrays.read_array(tmp_path / "a.h5", "pred")
    (tmp_path / "names.yaml").write_text("model: {KP_NAMES: [a, b]}")
    assert arrays.names_of(str(tmp_path / "names.yaml"), "model.KP_NAMES") == ["a", "b"]
    with pytest.raises(mc.FormatError, match="expected a list of names at model"):
        arrays.names_of(str(tmp_path / "names.yaml"), "model")
