"""benchmarks/poses_of_*.py: bodies stand as their publishers' formats say, and train reads them."""

from importlib import import_module
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from mocap_calib.errors import FormatError
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.training.poses import load_poses

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
# a person of straight bones, in a stance: name, parent, direction, length, turn of its axes
LEG = [("femur", "hipjoint", (0.34202, -0.939693, 0), 7, 20), ("tibia", "femur", (0, -1, 0), 7, 0)]
LEG += [("foot", "tibia", (0, -0.6, 0.8), 2, 0), ("toes", "foot", (0, 0, 1), 1, 0)]
ARM = [("clavicle", "thorax", (0.8, 0.6, 0), 3, 0), ("humerus", "clavicle", (1, 0, 0), 5, 0)]
ARM += [("radius", "humerus", (1, 0, 0), 4, 0), ("hand", "radius", (1, 0, 0), 1, 0)]
SPINE = ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"]


@pytest.fixture
def people(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("poses_of_people")


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


def test_a_person_stands_turns_and_bends_a_knee(people, tmp_path):
    """Frames: the stance, the same turned by 90 deg about the vertical elsewhere, a knee bent."""
    write_subject(tmp_path / "07", MOTION)
    metres, bones = people.read_skeleton(tmp_path / "07" / "07.asf")
    motion = people.read_motion(tmp_path / "07" / "07_01.amc", 1)
    joints = people.joints_of(bones, *people.place(bones, motion, metres))
    assert metres == pytest.approx(0.0254 / 0.45)
    assert set(joints) == set(load_skeleton("people").keypoints)
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


def test_the_file_trains_and_holds_subjects_out(people, tmp_path):
    for name in ("01", "02", "07"):
        write_subject(tmp_path / name, MOTION.replace("ltibia 90 0 0", ""))
    with pytest.raises(FormatError, match="expected an Acclaim motion"):
        people.collect(tmp_path, 1)  # the last frame lacks a bone
    for name in ("01", "02", "07"):
        (tmp_path / name / f"{name}_01.amc").write_text("1\nroot 0 20 0 0 0 0\n" * 4)
    np.savez(tmp_path / "made.npz", **people.collect(tmp_path, 2))
    for split in ("test", "val", "train"):
        read = load_poses(tmp_path / "made.npz", load_skeleton("people"), split)
        assert read.poses.shape == (2, 29, 3)
        assert np.isfinite(read.poses).all()
    with pytest.raises(FormatError, match=r"expected motions such as .*, found none"):
        people.collect(tmp_path / "07", 1)


def test_arrays_of_any_order_become_a_set(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    arrays = import_module("poses_of_arrays")
    poses = np.random.default_rng(0).normal(size=(7, 4, 3))
    rows = [{"data": poses.reshape(7, 12)}]
    savemat(tmp_path / "a.mat", {"pred": poses.transpose(0, 2, 1), "label": {"own": rows}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tracks"] = poses[:, None]
    np.savez(tmp_path / "a.npz", poses=poses.transpose(2, 1, 0))
    for source in ("a.mat:pred", "a.h5:tracks", "a.npz:poses", "a.mat:label.own.data"):
        np.testing.assert_array_equal(arrays.read_clip(f"{tmp_path}/{source}", 4), poses)
    with pytest.raises(FormatError, match="expected poses of 5 points, found shape"):
        arrays.as_poses(poses, 5, tmp_path)
    with pytest.raises(FormatError, match="expected an array pred"):
        arrays.read_array(tmp_path / "a.h5", "pred")
    (tmp_path / "names.yaml").write_text("model: {KP_NAMES: [a, b]}")
    assert arrays.names_of(str(tmp_path / "names.yaml"), "model.KP_NAMES") == ["a", "b"]
    with pytest.raises(FormatError, match="expected a list of names at model"):
        arrays.names_of(str(tmp_path / "names.yaml"), "model")
