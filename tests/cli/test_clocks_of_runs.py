"""Clocks that differ, from the command line: found, mended, said, and kept in all files."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import mocap_calib as mc


@pytest.fixture(scope="module")
def made(tool, tmp_path_factory):
    """Return a folder with a simulated recording in step."""
    folder = tmp_path_factory.mktemp("clocks")
    words = ("--cameras", 3, "--people", 1, "--frames", 150, "--fps", 12)
    assert tool("simulate", "-o", folder, *words).returncode == 0
    return folder


def run(tool, made, out, *options):
    """Calibrate the recording in a folder; return how that ended."""
    done = tool(
        "run", made / "keypoints", "--cameras", made / "intrinsics.toml", "-o", made / out, *options
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def in_step(made, tool):
    """Return how a run ended to which a clock was said; its results are in `made / in_step`."""
    return run(tool, made, "in_step", "--frame-offset", "cam2:5", "--frame-offset", "cam2:0")


@pytest.mark.slow
@pytest.mark.usefixtures("in_step")
def test_a_late_camera_is_put_on_the_clock_of_the_others(made, tool):
    """Measured: the rig differs by 0.02 deg from that of cameras in step."""
    late = ("--frame-offset", "cam2:5")
    done = run(tool, made, "late", *late)
    assert "cam2: its clock is 5 frames late; corrected in this run" in done.stderr
    assert "--frame-offset cam2:-5" in done.stderr
    report = json.loads((made / "late" / "run.json").read_text("utf-8"))
    assert [camera["faults"] for camera in report["cameras"]] == [[], ["clock"], []]
    clocks = {clock["camera"]: clock for clock in report["clocks"]}
    assert [clocks[name]["offset_frames"] for name in ("cam1", "cam2", "cam3")] == [0, 5, 0]
    assert clocks["cam2"]["applied"]
    cameras = yaml.safe_load((made / "late" / "cameras.yaml").read_text("utf-8"))["cameras"]
    assert [camera.get("clock_offset_frames") for camera in cameras] == [None, 5, None]
    rigs = [mc.read_rig(made / out / "cameras.yaml") for out in ("in_step", "late")]
    assert np.rad2deg(mc.evaluate(*rigs).rotation_error.max()) < 0.2

    poses = made / "again.h5"
    arguments = ("--rig", made / "late" / "cameras.yaml", "--matches", made / "late/matches.csv")
    done = tool("triangulate", made / "keypoints", *arguments, "-o", poses, *late)
    assert done.returncode == 0, done.stderr
    again, before = (mc.read_poses(path) for path in (poses, made / "late" / "poses3d.h5"))
    np.testing.assert_array_equal(again.frames, before.frames)
    np.testing.assert_allclose(again.positions, before.raw, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_check_changes_nothing(made, tool):
    late = ("--frame-offset", "cam2:5")
    unsure = ("--smooth", "off", "--accept", "not-determined")  # 5 frames off and not corrected
    done = run(tool, made, "checked", "--sync", "check", *unsure, *late)
    assert "cam2: its clock is 5 frames late" in done.stderr
    assert "mended" not in done.stderr
    run(tool, made, "late_off", "--sync", "off", *unsure, *late)
    checked, off = (made / out / "matches.csv" for out in ("checked", "late_off"))
    assert checked.read_bytes() == off.read_bytes()
    given = ("--cameras", made / "intrinsics.toml")
    seen = tool("inspect", made / "keypoints", *given, "--sync", *late)
    assert "cam2: its clock is 5 frames late; say --frame-offset cam2:-5" in seen.stdout


def test_a_camera_of_half_the_frame_rate(small, tool, tmp_path):
    """Its frames are every second frame of the others."""
    first, second, third = mc.read_keypoints(small / "keypoints")
    halves = {name: getattr(second, name)[::2] for name in ("positions", "confidence")}
    second = replace(second, frames=second.frames[:15], **halves)
    mc.write((first, second, third), tmp_path / "keypoints", format="coco")
    words = ("--cameras", small / "intrinsics.toml", "-o", tmp_path / "out", "--smooth", "off")
    rates = ("--fps", 30, "--fps", "cam2:15")
    done = tool("run", tmp_path / "keypoints", *words, *rates, "--accept", "not-determined")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))
    assert [clock["rate"] for clock in report["clocks"]] == [1, 0.5, 1]
