"""Joints that were not seen, filled in by the identity rotation."""

import csv
import re
from dataclasses import replace

import numpy as np
from scenes import PEOPLE, lifted, recording, scene

from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.io.cameras.read import load_cameras
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.job.load import KeypointSource, load_recording
from mocap_calib.lift import complete_sample, lift
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.types import silent

PLAIN = {"people": 1, "false_detections": 0.0, "outliers": 0.0, "missing": 0.0}


def test_hidden_limbs_are_found_to_a_third_of_a_body():
    """The left arm and the right leg of a simulated walker are hidden.

    Measured: 0.31 of the visible pose's RMS radius; margin 0.1.
    """
    whole = recording(**PLAIN)
    hidden = np.isin(whole.keypoints, ["left_elbow", "left_wrist", "right_knee", "right_ankle"])
    part = replace(
        whole,
        positions=np.where(hidden[:, None], np.nan, whole.positions),
        confidence=np.where(hidden, 0, whole.confidence),
        rays=np.where(hidden[:, None], np.nan, whole.rays),
    )
    views = complete_sample(part, lift(part, load_lifter()[0], progress=silent), PEOPLE)
    positions = np.stack([view.positions for view in views])
    confidence = np.stack([view.confidence for view in views])
    columns = whole.vocabulary[hidden]
    gap = np.linalg.norm(positions[..., columns, :] - whole.positions[..., hidden, :], axis=-1)
    radius = np.sqrt(
        np.nanmean(
            ((whole.positions - np.nanmean(whole.positions, axis=3, keepdims=True)) ** 2).sum(-1),
            axis=3,
        )
    )
    assert np.nanmedian(gap / radius[..., None]) < 0.42
    assert np.nanmax(confidence[..., columns]) <= 0.5
    kept = whole.vocabulary[~hidden]
    np.testing.assert_array_equal(positions[..., kept, :], part.positions[..., ~hidden, :])


def test_joints_of_another_skeleton_are_near_the_true_ones():
    """COCO has no foot; the big toes of the model are put where those of the walker are.

    Measured: below a tenth of the height.
    """
    made, sample = scene(**PLAIN), recording(**PLAIN)
    views = complete_sample(sample, lifted(**PLAIN), PEOPLE)
    positions = np.stack([view.positions for view in views])
    toes = [name for name in PEOPLE.keypoints if name in made.joints and name.endswith("big_toe")]
    assert len(toes) == 2
    frames = sample.frames - sample.frames[0]
    for view, camera in enumerate(sample.cameras):
        k = made.rig.names.index(camera.name)
        bodies = made.poses[frames, 0][:, [made.joints.index(name) for name in toes]]
        true = pixels_from_points(camera, bodies @ made.rig.rotation[k].T + made.rig.translation[k])
        found = positions[view, :, 0][:, [PEOPLE.keypoints.index(name) for name in toes]]
        extent = np.nanmax(sample.positions[view, :, 0, :, 1], 1) - np.nanmin(
            sample.positions[view, :, 0, :, 1], 1
        )
        assert np.nanmedian(np.linalg.norm(found - true, axis=-1) / extent[:, None]) < 0.1


def check_marks(table, small, views):
    """Hold the table to the points that the completed files have and the given ones have not."""
    rows = list(csv.DictReader(table.splitlines(), delimiter="\t"))
    given = read_keypoints([small / "keypoints"])
    expected = set()
    for before, after in zip(given, views, strict=True):
        seen = np.zeros(after.confidence.shape, bool)
        columns = [after.keypoints.index(name) for name in before.keypoints]
        frames = np.searchsorted(after.frames, before.frames)
        seen[np.ix_(frames, range(before.positions.shape[1]), columns)] = np.isfinite(
            before.positions[..., 0]
        )
        for frame, instance, keypoint in np.argwhere(np.isfinite(after.positions[..., 0]) & ~seen):
            number, name = str(after.frames[frame]), after.keypoints[keypoint]
            expected.add((after.camera, number, str(instance), name))
    assert list(rows[0]) == ["camera", "frame", "instance", "keypoint"]
    assert {tuple(row.values()) for row in rows} == expected
    assert len(rows) == len(expected) > 1000


def test_complete_on_the_command_line(tmp_path, small, tool):
    done = tool(
        "complete",
        small / "keypoints",
        "--cameras",
        small / "intrinsics.toml",
        "-o",
        tmp_path / "out",
    )
    assert done.returncode == 0, done.stderr
    assert "keypoints filled in" in done.stderr
    views = read_keypoints([tmp_path / "out"])
    check_marks((tmp_path / "out" / "filled_in.tsv").read_text("utf-8"), small, views)
    assert [view.keypoints for view in views] == [PEOPLE.keypoints] * 3
    assert all(len(view.frames) == 30 for view in views)
    source = KeypointSource((str(tmp_path / "out"),))
    said = load_recording(source, load_cameras(small / "intrinsics.toml")).summary.filled_in
    assert [line.partition(": ")[0] for line in said] == ["cam1", "cam2", "cam3"]
    inspected = tool("inspect", tmp_path / "out").stdout
    for line in said:
        assert re.fullmatch(r"cam\d: \d+ keypoints filled in by `complete`, not measured", line)
        assert f"WARNING: {line}\n" in inspected
    refused = tool(
        "complete",
        small / "keypoints",
        "--cameras",
        small / "intrinsics.toml",
        "-o",
        tmp_path / "none",
        "--model",
        "none",
    )
    assert refused.returncode == 1
    assert "expected at least 4 joints that a model knows" in refused.stderr
