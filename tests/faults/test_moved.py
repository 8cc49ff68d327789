"""Cameras that were bumped or moved during the recording."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from report_pages import page_data
from scenes import PEOPLE, calibrate_all, recording, rotation_errors_deg, scene

from mocap_calib.adjust.camera_fit import pose_of
from mocap_calib.adjust.resection import Sightings, compare_projections, sightings_of
from mocap_calib.config import DECISIVE_NATS, Config, MovedConfig
from mocap_calib.faults.moved import (
    choose_number,
    find_epochs,
    last_moments,
    segment,
    total_costs,
)
from mocap_calib.geometry.lens import pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.io.cameras.own import format_intrinsics_toml
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.io.poses.read import read_poses
from mocap_calib.recording.corrections import Moved, list_epochs, rig_of_epoch
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.rig.triangulate import choose_frames
from mocap_calib_cli.commands import report as report_command

CONFIG = MovedConfig()
NOISE = 0.003  # radians
LEAST = 1e-4  # focal lengths: noise
FRAMES = 120
POSES = ("trc", "c3d", "bvh")
THIGH = ("left_hip", "left_knee")
CHANGES = {
    "bumped by 2 deg": (2.0, 0.0),
    "bumped by 10 deg": (10.0, 0.0),
    "bumped by 40 deg": (40.0, 0.0),
    "moved by 0.5 m": (0.0, 0.5),
}


def changed(pose: np.ndarray, degrees: float, metres: float) -> np.ndarray:
    """The pose of a camera that turned about its centre, and went aside."""
    turn = matrix_from_vector(np.deg2rad(degrees) * np.array([0.3, 0.9, 0.3]))
    return turn @ (pose + np.outer([metres, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]))


def glance(pose: np.ndarray, seen: Sightings) -> float:
    """The evidence of a change before anything is refined."""
    return choose_number(*total_costs(segment(pose, seen, CONFIG, LEAST), seen), CONFIG)[1]


def rays_of(pose: np.ndarray, bodies: np.ndarray, rng, scale: float = 1.0) -> np.ndarray:
    """What a camera sees of bodies `[frame, body, joint, 3]`, with noise, in any order.

    scale: of angles from the axis, as a wrong focal length has it.
    """
    seen = bodies @ pose[:, :3].T + pose[:, 3]
    seen[..., :2] *= scale
    rays = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
    rays += NOISE * rng.normal(size=rays.shape)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.take_along_axis(
        rays,
        rng.permuted(np.tile(np.arange(bodies.shape[1]), (len(bodies), 1)), axis=1)[
            ..., None, None
        ],
        axis=1,
    )


def sightings(poses: list[np.ndarray], starts: list[int], scale: float = 1.0) -> Sightings:
    """What a camera saw of two people that had these poses, the later ones from these frames on."""
    bodies = scene(frames=FRAMES, people=2).poses
    bodies = bodies[:, :, np.isfinite(bodies).all((0, 1, 3))]
    rng = np.random.default_rng(0)
    rays = np.concatenate(
        [
            rays_of(pose, part, rng, scale)
            for pose, part in zip(poses, np.split(bodies, starts), strict=True)
        ]
    )
    return sightings_of(rays, bodies)


@pytest.mark.parametrize(("degrees", "metres"), CHANGES.values(), ids=CHANGES.keys())
def test_a_change_is_found_to_the_frame_with_both_poses(degrees, metres):
    """Measured: exact frames, poses to 0.1 deg of noise of 0.17 deg."""
    before = pose_of(scene(frames=FRAMES, people=2).rig, 1)
    after = changed(before, degrees, metres)
    seen = sightings([before, after], [71])
    assert glance(before, seen) > 0
    epochs, evidence = find_epochs(before, seen, CONFIG, LEAST)
    assert len(epochs.bounds[1:-1]) == 1
    assert evidence > 2 * DECISIVE_NATS
    assert last_moments(epochs.poses, seen, epochs.tolerance) == (70, 71)
    for found, true in zip(epochs.poses, (before, after), strict=True):
        assert np.degrees(angle_between(found[:, :3], true[:, :3])) < 0.5


@pytest.mark.parametrize(
    ("costs", "changes", "evidence"),
    [
        ([100.0, 99.9], 0, 0.0),
        ([100.0, 40.0], 1, 750.0 - 3.2),
        ([100.0, 40.0, 39.9], 1, 750.0 / 2.506 - 3.2),
        ([100.0, 60.0, 40.0, 39.99], 2, 250.0 - 3.2),
        ([100.0, 80.0, 64.0, 51.0, 41.0], 0, 0.0),
    ],
)
def test_as_many_epochs_are_accepted_as_there_is_evidence_for(costs, changes, evidence):
    """Of 1000 detections; the last drift: each change gains as much as the one before.

    log 25 = 3.2 nats are for the moment: an epoch has at least 4 % of the detections.
    """
    found, nats = choose_number(np.array(costs), 1000, CONFIG)
    assert found == changes
    assert nats == pytest.approx(evidence, rel=1e-2)


def test_two_changes_are_found_and_the_way_back_counts():
    first = pose_of(scene(frames=FRAMES, people=2).rig, 1)
    seen = sightings([first, changed(first, 5.0, 0.0), first], [40, 90])
    epochs, _ = find_epochs(first, seen, CONFIG, LEAST)
    assert seen.frame[epochs.bounds[1:-1]].tolist() == [40, 90]


@pytest.mark.parametrize("scale", [1.0, 1.03, 0.9])
def test_errors_that_drift_with_the_subject_are_no_change(scale):
    """A wrong focal length makes errors that follow where people walk."""
    pose = pose_of(scene(frames=FRAMES, people=2).rig, 1)
    epochs, evidence = find_epochs(pose, sightings([pose], [], scale), CONFIG, LEAST)
    assert evidence == 0
    assert len(epochs.bounds[1:-1]) == 0


def test_errors_that_are_alike_at_all_times_do_not_stand_out(monkeypatch):
    """Noise of 3 degrees: detections cost 0.65 of an outlier, before and after any moment."""
    monkeypatch.setattr(sys.modules[__name__], "NOISE", 0.06)
    pose = pose_of(scene(frames=FRAMES, people=2).rig, 1)
    assert glance(pose, sightings([pose], [])) == 0


def test_a_detection_costs_what_the_nearest_body_says():
    pose = pose_of(scene(frames=FRAMES, people=2).rig, 1)
    seen = sightings([pose], [])
    cost = compare_projections(pose[None], seen, 0.02).cost
    assert cost.shape == (1, 2 * FRAMES)
    assert np.median(cost) < 0.1
    other = changed(pose, 40, 0)[None]
    assert np.median(compare_projections(other, seen, 0.02).cost) > 0.9


# --- whole recordings


def bumped(recording, view: int, start: int, degrees: float):
    """The recording with a camera that was turned about its centre from a frame (index) on."""
    positions = recording.positions.copy()
    rays = rays_from_pixels(recording.cameras[view], positions[view, start:])
    turn = matrix_from_vector(np.deg2rad(degrees) * np.array([0.3, 0.9, 0.3]))
    positions[view, start:] = pixels_from_points(recording.cameras[view], rays @ turn.T)
    return replace(recording, positions=positions), turn


def recorded(**changes):
    """A recording and the truth."""
    made = scene(frames=FRAMES, **changes)
    return make_recording(made.files, made.rig.cameras, PEOPLE, {}), made.rig


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "people", "degrees"), [(3, 1, 5.0), (4, 2, 2.0)])
def test_a_bumped_camera_is_named_and_both_epochs_are_right(cameras, people, degrees):
    """Measured: rotations to 0.3 deg in both epochs, the frame exact."""
    recording, rig = recorded(cameras=cameras, people=people)
    moved, turn = bumped(recording, 1, 70, degrees)
    result = calibrate_all(moved)
    (fault,) = result.faults
    name = rig.names[1]
    assert (fault.camera, fault.word) == (name, "moved")
    assert fault.mend == Moved(name, int(recording.frames[70]))
    assert fault.evidence["angle_deg"] == pytest.approx(degrees, abs=0.5)
    (group,) = result.groups
    epochs = list_epochs(group.rig.names, group.recording.frames)
    rotation = rig.rotation.copy()
    rotation[1] = turn @ rotation[1]
    for epoch, true in zip(epochs, (rig, replace(rig, rotation=rotation)), strict=True):
        assert rotation_errors_deg(rig_of_epoch(group.rig, epoch), true).max() < 1.0
    labels = group.matches.labels[[1, 2]]
    assert (labels[0, 70:] == -1).all()  # not seen by the camera as it stood before
    assert (labels[1, 70:] >= 0).any()
    assert group.verdict == "well determined"


@pytest.mark.slow
def test_of_two_cameras_none_is_named():
    recording, _ = recorded(cameras=2, people=1)
    moved, _ = bumped(recording, 1, 70, 5.0)
    assert calibrate_all(moved).faults == ()


def check_page_made_again(out: Path) -> None:
    """The page shows a camera that was moved as two views, and so does one that is made again."""
    before = page_data((out / "report.html").read_text("utf-8"))
    views = [(each["name"], each["camera"], each["last"]) for each in before["rig"]["cameras"]]
    name = before["rig"]["cameras"][1]["name"]
    assert views[1:3] == [(name, 1, 69), (f"{name}@70", 1, 119)]
    assert CliRunner().invoke(report_command.command, [str(out)]).exit_code == 0
    after = page_data((out / "report.html").read_text("utf-8"))
    assert [each["name"] for each in after["rig"]["cameras"]] == [view[0] for view in views]
    assert after["detections"] == before["detections"]
    assert after["timeline"] == before["timeline"]


def check_poses_of_both_epochs(out: Path, apart: float) -> None:
    """One file of each format has the poses of all frames, as true in length in each epoch.

    apart: of the first and the third camera, in metres, as the run was told. Measured: thighs to
    0.2 %, means over the frames of an epoch.
    """
    for folder in (out, out / "epoch_2"):
        rig = read_rig(folder / "cameras.yaml")
        assert rig.unit == "m"
        assert np.linalg.norm(rig.centres[0] - rig.centres[2]) == pytest.approx(apart, rel=1e-6)
    own = read_poses(out / "poses3d.h5")
    columns = [own.keypoints.index(joint) for joint in THIGH]
    true = scene(frames=FRAMES, people=1)
    bones = true.poses[:, :, [true.joints.index(joint) for joint in THIGH]]
    length = np.linalg.norm(np.diff(bones, axis=2), axis=-1).mean()
    for name, unit, per_metre in (("h5", "m", 1), ("trc", "m", 1), ("c3d", "mm", 1000)):
        found = read_poses(out / f"poses3d.{name}")
        assert (found.unit, len(found.frames)) == (unit, FRAMES)
        thigh = np.linalg.norm(np.diff(found.positions[:, :, columns], axis=2), axis=-1)
        for part in (thigh[:70], thigh[70:]):
            assert part.mean() / per_metre == pytest.approx(length, rel=0.02)
    hierarchy, motion = (out / "poses3d.bvh").read_text().split("MOTION")
    assert f"Frames: {FRAMES}" in motion
    offset = hierarchy.split("JOINT left_knee\n")[1].split("OFFSET")[1].split()[:3]
    assert np.linalg.norm(np.array(offset, float)) == pytest.approx(length, rel=0.02)


@pytest.mark.slow
def test_the_command_writes_a_rig_for_each_epoch(tmp_path, tool):
    recording, rig = recorded(people=1)
    moved, _ = bumped(recording, 1, 70, 8.0)
    (tmp_path / "keypoints").mkdir()
    for view, file in enumerate(scene(frames=FRAMES, people=1).files):
        at = np.searchsorted(recording.frames, file.frames)
        columns = [recording.keypoints.index(name) for name in file.keypoints]
        positions = moved.positions[view][at][:, :, columns][:, : file.positions.shape[1]]
        write_keypoints(
            tmp_path / "keypoints" / f"{file.camera}.json",
            (replace(file, positions=positions),),
            "coco",
        )
    (tmp_path / "intrinsics.toml").write_text(format_intrinsics_toml(rig.cameras))
    out = tmp_path / "out"
    command = ["run", tmp_path / "keypoints", "--cameras", tmp_path / "intrinsics.toml", "-o", out]
    apart = np.linalg.norm(rig.centres[0] - rig.centres[2])
    known = ("--camera-distance", f"{rig.names[0]}-{rig.names[2]}={apart}", "--fps", 50)
    formats = [word for name in ("opencv", *POSES) for word in ("--write", name)]
    said = tool(*command, *known, *formats)
    assert said.returncode == 0, said.stderr
    name = rig.names[1]
    assert f"{name}: moved at frame 70" in said.stderr
    report = json.loads((out / "run.json").read_text())
    assert [camera["name"] for camera in report["cameras"]] == list(rig.names)
    assert report["cameras"][1]["faults"] == ["moved"]
    assert report["epochs"] == [
        {"folder": ".", "first": 0, "last": 69, "moved": []},
        {"folder": "epoch_2", "first": 70, "last": 119, "moved": [name]},
    ]
    first, second = (read_rig(folder / "cameras.yaml") for folder in (out, out / "epoch_2"))
    assert first.names == second.names == rig.names
    turned = angle_between(first.rotation, second.rotation)
    assert np.degrees(turned[1]) == pytest.approx(8.0, abs=0.5)
    assert np.delete(turned, 1).max() < 1e-12
    assert {file.name for file in (out / "epoch_2").iterdir()} == {
        "cameras.yaml",
        "calibration.toml",
        "opencv",
    }
    assert "@" not in (out / "matches.csv").read_text()
    check_poses_of_both_epochs(out, apart)
    check_page_made_again(out)
    # a run on the recording as it should be leaves nothing of the later epoch
    for file in scene(frames=FRAMES, people=1).files:
        write_keypoints(tmp_path / "keypoints" / f"{file.camera}.json", (file,), "coco")
    said = tool(*command, "--sync", "off", "--smooth", "off")
    assert said.returncode == 0, said.stderr
    assert not (out / "epoch_2").exists()


@pytest.mark.parametrize("cameras", [4, 16])
def test_frames_are_chosen_for_their_detections(cameras):
    """So many a view, and half as many of sixteen views as of eight."""
    found = recording(cameras=cameras, people=2, frames=200)
    a_frame = found.seen.any(-1).sum(2).mean()
    count = len(choose_frames(found, round(180 * a_frame), Config()))
    assert count == pytest.approx(180 * 8 / max(cameras, 8), abs=1)
