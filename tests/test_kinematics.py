"""Numbers that follow from poses: laws of known motions, gaps, and what cannot be known."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from scenes import scene

from mocap_calib.io.poses.common import PoseFile, bare_poses
from mocap_calib.io.poses.write import write_poses
from mocap_calib.io.results.kinematics_csv import bones_csv, kinematics_csv, write_kinematics
from mocap_calib.kinematics import (
    average_around,
    bone_lengths,
    define,
    find_contacts,
    frame_velocity,
    joint_angle,
    leg_lengths,
    measure,
)
from mocap_calib.recording.joints import SHIPPED, choose_skeleton, load_section, load_skeleton
from mocap_calib.types import World

FLOOR = World("floor", up=np.array([0.0, 0, 1]), floor=np.zeros(3))
LEG = ("left_hip", "left_knee", "left_ankle")


def poses(keypoints, positions, frames=None, unit="m"):
    frames = np.arange(len(positions)) if frames is None else np.array(frames)
    return bare_poses(keypoints, frames, np.asarray(positions, float), unit=unit)


def walkers(noise=0.0):
    made = scene(people=2, frames=150)
    moved = made.poses + noise * np.random.default_rng(0).normal(size=made.poses.shape)
    return replace(poses(made.joints, moved), world=FLOOR)


@pytest.mark.parametrize("degrees", [0.0, 30, 90, 179, 180])
def test_an_angle_is_the_included_one(degrees):
    turn = np.radians(degrees)
    ends = np.array([2.0, 0, 0]), np.array([3 * np.cos(turn), 3 * np.sin(turn), 0])
    assert joint_angle(ends[0], np.zeros(3), ends[1]) == pytest.approx(degrees, abs=1e-9)
    assert np.isnan(joint_angle(ends[0], ends[0], ends[1]))


def test_velocity_knows_frame_numbers_and_gaps():
    frames = np.array([0, 2, 4, 10, 12, 20])
    along = frames[:, None] * np.array([3.0, 0, 0])
    found = frame_velocity(frames, along)
    np.testing.assert_allclose(found[:5], [[3.0, 0, 0]] * 5)
    assert np.isnan(found[5]).all()  # nothing before or behind
    along[1] = np.nan
    assert np.isnan(frame_velocity(frames, along)[:3]).all()
    assert np.isnan(frame_velocity(frames[:1], along[:1])).all()


def test_averages_stay_within_their_reach():
    frames = np.array([0, 1, 2, 10])
    values = np.array([1.0, np.nan, 5, 7])
    np.testing.assert_allclose(average_around(frames, values, 2), [3, np.nan, 3, 7])
    np.testing.assert_allclose(average_around(frames, values, 0), values)


def test_bones_have_the_lengths_that_they_have():
    rng = np.random.default_rng(1)
    ends = np.zeros((500, 1, 2, 3))
    ends[:, 0, 1, 0] = 0.4 + 0.02 * rng.normal(size=500)
    ends[7, 0, 1] = np.nan
    mean, deviation, frames = bone_lengths(ends, ((0, 1),))
    assert (mean[0, 0], deviation[0, 0]) == pytest.approx((0.4, 0.02), rel=0.1)
    assert frames[0, 0] == 499
    mean, deviation, frames = bone_lengths(ends[:1], ((0, 1),))
    assert np.isfinite(mean).all()
    assert np.isnan(deviation).all()


LEGGED = [name for name in SHIPPED if "leg" in load_section(name, "kinematics")]


@pytest.mark.parametrize("name", LEGGED)
def test_each_shipped_skeleton_says_what_is_measured(name):
    """Angles of both limbs on both sides, at three different joints each; a trunk, and feet."""
    skeleton = load_skeleton(name)
    found = define(skeleton.keypoints, skeleton)
    sided = [angle for angle in found.angles if angle.startswith("left_")]
    assert {f"right_{angle.removeprefix('left_')}" for angle in sided} <= set(found.angles)
    assert len(sided) >= 3
    assert all(len(set(joints)) == 3 for joints in found.angles.values())
    assert len(found.trunk) >= 4
    assert len(found.legs) == 2
    assert {"left_", "right_"} == {f"{foot.split('_')[0]}_" for foot in found.feet}


def test_what_a_recording_lacks_is_replaced_or_left_out():
    people = load_skeleton("people")
    found = define(("LHip", "LKnee", "mein_fuss"), people, {"mein_fuss": "left_ankle"})
    assert found.angles == {"left_knee": (0, 1, 2)}
    assert found.feet == {"left_foot": (2,)}
    nothing = define(("a", "b"), people)
    assert (nothing.edges, dict(nothing.angles), nothing.feet) == ((), {}, {})


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_walkers_stand_on_a_foot_most_of_the_time(noise):
    """Measured: 0.7 to 0.9 of the time on each foot, always on one; slowly, and low."""
    found = measure(walkers(noise), 30.0)
    assert set(found.contacts) == {"left_foot", "right_foot"}
    share = np.array([np.nanmean(each, 0) for each in found.contacts.values()])
    assert ((share > 0.55) & (share < 0.97)).all()
    both = found.contacts["left_foot"] + found.contacts["right_foot"]
    assert np.nanmean(both >= 1) > 0.95
    assert found.notes == ()


def test_contacts_need_a_floor_a_rate_feet_and_legs():
    paws = tuple(f"{side}_{paw}" for side in ("left", "right") for paw in ("forepaw", "hindpaw"))
    mouse = ("nose", "tail_base", *paws)
    for changed, rate, reason in (
        (replace(walkers(), world=World()), 30.0, "where the floor is"),
        (walkers(), None, "--fps"),
        (replace(poses(("a", "b"), np.zeros((3, 1, 2, 3))), world=FLOOR), 30.0, "no feet"),
        (replace(poses(mouse, np.zeros((3, 1, 6, 3))), world=FLOOR), 30.0, "no whole leg"),
    ):
        found = measure(changed, rate)
        assert found.contacts == {}
        assert reason in found.notes[0]


def test_a_body_that_hangs_has_no_contacts():
    leg = np.array([1.0])
    high = np.full((20, 1, 1), 0.5)
    assert not find_contacts(high, np.zeros_like(high), leg).any()
    assert find_contacts(0.1 + 0 * high, np.zeros_like(high), leg).all()
    assert np.isnan(find_contacts(high, np.zeros_like(high), np.array([np.nan]))).all()
    still = np.zeros((3, 1, 3, 3))
    still[..., 1, 2], still[..., 2, 2] = 0.4, 0.9
    assert leg_lengths(still, ((0, 1, 2),)) == pytest.approx([0.9])


def test_speed_is_per_second_where_the_rate_is_known():
    """A trunk whose joints come and go does not jump."""
    names = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    still = np.array([[0, 1, 2], [0, -1, 2], [0, 1, 0], [0, -1, 0.0]])
    moving = (still + np.arange(30)[:, None, None] * np.array([0.1, 0, 0]))[:, None]
    moving[np.random.default_rng(0).random((30, 1, 4)) < 0.3] = np.nan
    for fps, speed in ((None, 0.1), (20.0, 2.0)):
        found = measure(poses(names, moving), fps).speeds
        np.testing.assert_allclose(found["body"][np.isfinite(found["body"])], speed)
        assert np.isfinite(found["body"]).mean() > 0.9


@pytest.mark.parametrize("shape", [(1, 1), (0, 1), (3, 0), (4, 2)])
def test_whatever_is_missing_makes_tables(shape, tmp_path):
    empty = replace(poses(LEG, np.full((*shape, 3, 3), np.nan)), world=FLOOR)
    found = measure(empty, 30.0)
    write_kinematics(tmp_path, found, [f"i{k}" for k in range(shape[1])])
    assert len((tmp_path / "kinematics.csv").read_text().splitlines()) == 1
    assert len((tmp_path / "bones.csv").read_text().splitlines()) == 1 + 2 * shape[1]
    unknown = measure(poses(("a", "b"), np.zeros((*shape, 2, 3))))
    assert unknown.bones == ()
    assert "nan" not in "".join(kinematics_csv(unknown, [f"i{k}" for k in range(shape[1])]))


def test_tables_hold_what_was_measured():
    found = measure(walkers(), 30.0)
    rows = list(csv.DictReader("".join(kinematics_csv(found, ["anna", "b,c"])).splitlines()))
    assert len(rows) == 2 * 150
    row = rows[150 + 9]
    assert (row["individual"], row["frame"], row["time_s"]) == ("b,c", "9", "0.300000")
    knee = found.angles["left_knee"][9, 1]
    assert float(row["left_knee_angle_deg"]) == pytest.approx(knee, rel=1e-5)
    assert float(row["body_speed_m_per_s"]) == pytest.approx(found.speeds["body"][9, 1], rel=1e-5)
    assert row["left_foot_contact"] in ("0", "1")
    bones = list(csv.DictReader("".join(bones_csv(found, ["anna", "b,c"])).splitlines()))
    thigh = next(row for row in bones if row["bone"] == "left_hip-left_knee")
    assert 0.3 < float(thigh["mean"]) < 0.6
    assert float(thigh["sd"]) < 1e-6
    assert (thigh["frames"], thigh["unit"]) == ("150", "m")


def test_the_command_writes_both_tables(tool, tmp_path):
    """Of a folder of a run, of TRC files of one individual each, and refuses what is no poses."""
    made = walkers()
    write_poses(tmp_path / "poses3d.h5", PoseFile(made, 30.0), "poses-h5")
    done = tool("kinematics", tmp_path, "-o", tmp_path / "out")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "2 individuals in 150 frames: 28 bones" in done.stderr
    table = (tmp_path / "out" / "kinematics.csv").read_text()
    assert table.startswith("individual,frame,time_s,left_wrist_angle_deg")
    done = tool("kinematics", tmp_path / "out" / "bones.csv", "-o", tmp_path / "no")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "no").exists()


def test_animals_are_measured_by_their_own_tables():
    made = scene(people=0, animals=(("quadruped", 1),))
    keep = np.isfinite(made.poses).all((0, 1, 3))
    names = tuple(name for name, there in zip(made.joints, keep, strict=True) if there)
    assert choose_skeleton(names).name == "quadruped"
    found = measure(poses(names, made.poses[:, :, keep]))
    assert {"left_elbow", "right_knee", "spine", "tail"} <= set(found.angles)
    assert all(0 <= np.nanmin(a) <= np.nanmax(a) <= 180 for a in found.angles.values())
