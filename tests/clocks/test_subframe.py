"""Clocks that differ by a part of a frame: scenes with truth, and where nothing must be found."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scenes import adjust_twice, calibrate_group, rotation_errors_deg, sample_of

import mocap_calib as mc
from mocap_calib.clocks.subframe import find_time_offsets, resample
from mocap_calib.config import Config

FINER = 20  # frames of the simulation for each frame of a camera
FRAMES = 60
NOISE_PX = 1.0  # at 2 px, offsets found in so few frames are too near to zero by 0.03 on average
OFFSETS = (0.0, 0.3, -0.45, 0.0)
IN_STEP = (0.0, 0.0, 0.0, 0.0)
OFF = replace(Config(), sync=replace(Config().sync, subframe=False))


@lru_cache
def finer_scene(people: int = 1) -> mc.Scene:
    """A scene that is seen 500 times a second: 25 frames a second and parts of them."""
    frames = FINER * (FRAMES + 2)
    return mc.simulate(
        mc.SimulateConfig(people=people, frames=frames, fps=25.0 * FINER, noise_px=NOISE_PX)
    )


@lru_cache
def off(offsets: tuple[float, ...] = OFFSETS, people: int = 1) -> tuple[mc.Recording, mc.Matches]:
    """What cameras whose clocks are off by parts of a frame see of it, and who is who."""
    made = finer_scene(people)
    whole = mc.Recording.from_keypoints(made.files, made.rig)
    taken = [FINER * np.arange(1, FRAMES + 1) + round(FINER * tau) for tau in offsets]
    positions, confidence, labels = (
        np.stack([array[view, frames] for view, frames in enumerate(taken)])
        for array in (whole.positions, whole.confidence, made.identity.astype(np.int64))
    )
    numbers = np.arange(FRAMES)
    part = replace(whole, frames=numbers, positions=positions, confidence=confidence)
    return part, mc.Matches(labels)


def adjusted(recording: mc.Recording, matches: mc.Matches) -> mc.CameraRig:
    """The rig that fits as long as nobody asks for clocks."""
    return adjust_twice(sample_of(recording), finer_scene().rig, matches, Config())


def error_of_poses(
    recording: mc.Recording, rig: mc.CameraRig, matches: mc.Matches, people: int
) -> float:
    """Median distance of triangulated joints from where they are at the first camera's clock."""
    made = finer_scene(people)
    joints = [made.joints.index(name) for name in recording.keypoints]
    true = made.poses[FINER * np.arange(1, FRAMES + 1)][:, :, joints]
    found = mc.triangulate(recording, rig, matches).positions
    return float(np.nanmedian(np.linalg.norm(found - true, axis=-1)))


@pytest.mark.parametrize("people", [1, 2])
def test_offsets_are_found_and_rig_and_poses_get_better(people):
    """0.3 and -0.45 frames at 25 frames a second, to 0.05 (measured 0.04)."""
    recording, matches = off(people=people)
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert np.abs(found.tau - OFFSETS).max() < 0.05
    assert found.used.tolist() == [False, True, True, False]
    assert ((found.sigma[1:] > 0) & (found.sigma[1:] < 0.04)).all()
    true = finer_scene(people).rig
    without, with_offsets = (rotation_errors_deg(each, true).max() for each in (start, rig))
    assert with_offsets < 0.7 * without
    in_step = resample(recording, rig, matches, found.applied, Config().triangulate)
    error = error_of_poses(recording, start, matches, people)
    assert error_of_poses(in_step, rig, matches, people) < 0.85 * error  # measured 0.3, 0.75


@pytest.mark.parametrize(
    ("offsets", "expected"), [(IN_STEP, [0, 0, 0, 0]), ((-0.3, 0.0, 0.0, 0.0), [0, 0.3, 0.3, 0.3])]
)
def test_offsets_are_those_from_the_first_camera_and_none_is_used_where_all_are_in_step(
    offsets, expected
):
    """Whichever camera is the odd one."""
    recording, matches = off(offsets)
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert np.abs(found.tau - expected).max() < 0.05
    assert found.used.tolist() == [each > 0 for each in expected]
    assert (rig is start) == (offsets == IN_STEP)


def of_another_order(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    frames = np.random.default_rng(0).permutation(FRAMES)
    shown = replace(
        given, positions=given.positions[:, frames], confidence=given.confidence[:, frames]
    )
    return shown, matches.select(frames=frames)


def of_far_numbers(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    """The numbers say that no frame follows another: 0, 1, 10, 11, 20, 21, ..."""
    return replace(given, frames=np.arange(FRAMES) // 2 * 10 + np.arange(FRAMES) % 2), matches


def at_rest(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    """Joints differ from frame to frame by the noise of the detector alone."""
    made, rng = finer_scene(), np.random.default_rng(0)
    joints = [made.joints.index(name) for name in given.keypoints]
    still = made.rig.project(np.broadcast_to(made.poses[0, 0][joints], (FRAMES, len(joints), 3)))
    positions = np.full_like(given.positions, np.nan)
    positions[:, :, 0] = still + rng.normal(0, 2, still.shape)
    labels = np.full_like(matches.labels, -1)
    labels[:, :, 0] = 0
    confidence = np.isfinite(positions[..., 0]).astype(given.confidence.dtype)
    return replace(given, positions=positions, confidence=confidence), mc.Matches(labels)


@pytest.mark.parametrize("change", [of_another_order, of_far_numbers, at_rest])
def test_frames_that_do_not_follow_each_other_and_a_body_at_rest_tell_nothing(change):
    recording, matches = change(*off())
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert rig is start
    assert np.isnan(found.tau).all()
    assert not found.used.any()


def test_offsets_of_whole_frames_are_left_to_others_and_none_is_found_where_it_is_switched_off():
    """A clock that is two frames off is beyond what is known of the motion."""
    recording, matches = off()
    start = finer_scene().rig
    found, rig = find_time_offsets(recording, start, matches, OFF)
    assert rig is start
    assert np.isnan(found.tau).all()
    positions, confidence, labels = (
        array.copy() for array in (recording.positions, recording.confidence, matches.labels)
    )
    for array in (positions, confidence, labels):
        array[1] = np.roll(array[1], 2, axis=0)
    late = replace(recording, positions=positions, confidence=confidence)
    found, rig = find_time_offsets(late, start, mc.Matches(labels), Config())
    assert rig is start
    assert not found.used.any()


def test_detections_of_nobody_are_not_moved():
    recording, matches = off(people=2)
    some = mc.Matches(np.where(matches.labels == 1, -1, matches.labels))
    moved = resample(recording, finer_scene().rig, some, np.array(OFFSETS), Config().triangulate)
    change = np.abs(moved.positions - recording.positions)
    assert np.nanmax(change[some.labels < 0]) == 0
    assert np.nanmax(change[[0, 3]]) == 0  # their clocks are the first one's
    assert np.nanmedian(change[1][some.labels[1] >= 0]) > 0.1
    np.testing.assert_array_equal(np.isnan(moved.positions), np.isnan(recording.positions))


@pytest.mark.slow
def test_a_run_uses_the_offsets():
    """From detections alone; reprojection errors are those of what was brought in step."""
    recording, _ = off(people=2)
    found, blind = (calibrate_group(recording, config=each) for each in (Config(), OFF))
    assert np.abs(found.time_offsets.tau - OFFSETS).max() < 0.05
    assert list(found.clock_offsets) == ["cam2", "cam3"]
    assert not blind.clock_offsets
    # measured 0.84
    assert np.nanmedian(found.poses.error) < 0.92 * np.nanmedian(blind.poses.error)
