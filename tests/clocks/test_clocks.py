"""Clocks that differ by a part of a frame: scenes with truth, and where nothing must be found."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scenes import PEOPLE, adjust_twice, calibrate_group, rotation_errors_deg, scene

from mocap_calib.adjust.residuals import Residuals, State, motion_between
from mocap_calib.clocks.subframe import find_time_offsets, resample, smoothness
from mocap_calib.config import Config
from mocap_calib.recording.sampling import take_sample, usual_step
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import Matches
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.synthetic import Scene, simulate
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.types import CameraRig, Floats, Recording

FINER = 20  # frames of the simulation for each frame of a camera
FRAMES = 60
NOISE_PX = 1.0  # at 2 px, offsets found in so few frames are too near to zero by 0.03 on average
OFFSETS = (0.0, 0.3, -0.45, 0.0)
IN_STEP = (0.0, 0.0, 0.0, 0.0)


@lru_cache
def finer_scene(people: int = 1) -> Scene:
    """A scene that is seen 500 times a second: 25 frames a second and parts of them."""
    frames = FINER * (FRAMES + 2)
    return simulate(
        SimulateConfig(people=people, frames=frames, fps=25.0 * FINER, noise_px=NOISE_PX)
    )


@lru_cache
def off(offsets: tuple[float, ...] = OFFSETS, people: int = 1) -> tuple[Recording, Matches]:
    """What cameras whose clocks are off by parts of a frame see of it, and who is who."""
    made = finer_scene(people)
    whole = make_recording(made.files, made.rig.cameras, PEOPLE, {})
    taken = [FINER * np.arange(1, FRAMES + 1) + round(FINER * tau) for tau in offsets]
    part = replace(
        whole,
        frames=np.arange(FRAMES),
        positions=np.stack([whole.positions[view, t] for view, t in enumerate(taken)]),
        confidence=np.stack([whole.confidence[view, t] for view, t in enumerate(taken)]),
    )
    labels = np.stack([made.identity[view, t] for view, t in enumerate(taken)])
    return part, Matches(labels.astype(np.int64))


def adjusted(recording: Recording, matches: Matches) -> CameraRig:
    """The rig that fits as long as nobody asks for clocks."""
    start = finer_scene().rig
    return adjust_twice(take_sample(recording, slice(None)), start, matches, Config())


def error_of_poses(recording: Recording, rig: CameraRig, matches: Matches, people: int) -> float:
    """Median distance of triangulated joints from where they are at the first camera's clock."""
    made = finer_scene(people)
    joints = [made.joints.index(name) for name in recording.keypoints]
    true = made.poses[FINER * np.arange(1, FRAMES + 1)][:, :, joints]
    found = triangulate(recording, rig, matches).positions
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


def test_cameras_in_step_stay_as_they_are():
    recording, matches = off(IN_STEP)
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert rig is start
    assert not found.used.any()
    assert np.abs(found.tau).max() < 0.03


def test_one_camera_ahead_of_all_others_is_the_first():
    """Offsets are those from the first camera, whichever is the odd one."""
    recording, matches = off((-0.3, 0.0, 0.0, 0.0))
    found, _ = find_time_offsets(recording, adjusted(recording, matches), matches, Config())
    assert np.abs(found.tau - [0, 0.3, 0.3, 0.3]).max() < 0.05
    assert found.used.tolist() == [False, True, True, True]


def test_offsets_of_whole_frames_are_left_to_others():
    """A clock that is two frames off is beyond what is known of the motion."""
    recording, matches = off()
    late = np.roll(np.arange(FRAMES), 2)
    positions, confidence, labels = (
        array.copy() for array in (recording.positions, recording.confidence, matches.labels)
    )
    for array in (positions, confidence, labels):
        array[1] = array[1, late]
    recording = replace(recording, positions=positions, confidence=confidence)
    start = finer_scene().rig
    found, rig = find_time_offsets(recording, start, Matches(labels), Config())
    assert rig is start
    assert not found.used.any()


def not_determined(recording: Recording, matches: Matches) -> bool:
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    return rig is start and bool(np.isnan(found.tau).all()) and not found.used.any()


def test_frames_that_do_not_follow_each_other_tell_nothing():
    recording, matches = off()
    shuffled = np.random.default_rng(0).permutation(FRAMES)
    recording = replace(
        recording,
        positions=recording.positions[:, shuffled],
        confidence=recording.confidence[:, shuffled],
    )
    assert not_determined(recording, matches.select(frames=shuffled))


def test_frames_far_apart_tell_nothing():
    """The numbers say that no frame follows another: 0, 1, 10, 11, 20, 21, ..."""
    recording, matches = off()
    numbers = np.arange(FRAMES) // 2 * 10 + np.arange(FRAMES) % 2
    assert not_determined(replace(recording, frames=numbers), matches)


def test_a_body_at_rest_tells_nothing():
    """Its joints differ from frame to frame by the noise of the detector alone."""
    recording, matches = off()
    rng = np.random.default_rng(0)
    made = finer_scene()
    joints = [made.joints.index(name) for name in recording.keypoints]
    still = made.rig.project(np.broadcast_to(made.poses[0, 0][joints], (FRAMES, len(joints), 3)))
    positions = np.full_like(recording.positions, np.nan)
    positions[:, :, 0] = still + rng.normal(0, 2, still.shape)
    labels = np.full_like(matches.labels, -1)
    labels[:, :, 0] = 0
    confidence = np.isfinite(positions[..., 0]).astype(recording.confidence.dtype)
    recording = replace(recording, positions=positions, confidence=confidence)
    start = made.rig
    found, rig = find_time_offsets(recording, start, Matches(labels), Config())
    assert rig is start
    assert np.isnan(found.tau).all()


def test_nothing_is_looked_for_where_that_is_switched_off():
    recording, matches = off()
    config = Config()
    config = replace(config, sync=replace(config.sync, subframe=False))
    start = finer_scene().rig
    found, rig = find_time_offsets(recording, start, matches, config)
    assert rig is start
    assert np.isnan(found.tau).all()


def test_detections_of_nobody_are_not_moved():
    recording, matches = off(people=2)
    some = Matches(np.where(matches.labels == 1, -1, matches.labels))
    moved = resample(recording, finer_scene().rig, some, np.array(OFFSETS), Config().triangulate)
    change = np.abs(moved.positions - recording.positions)
    assert np.nanmax(change[some.labels < 0]) == 0
    assert np.nanmax(change[[0, 3]]) == 0  # their clocks are the first one's
    assert np.nanmedian(change[1][some.labels[1] >= 0]) > 0.1
    np.testing.assert_array_equal(np.isnan(moved.positions), np.isnan(recording.positions))


# Laws


def timed_problem() -> tuple[State, Residuals]:
    """Two cameras, fifty moving points, and offsets."""
    rng = np.random.default_rng(0)
    rig = scene(cameras=2).rig
    points = rng.uniform(-1, 1, (3, 50)) + np.array([[0], [0], [1.0]])
    rays = rig.rotation @ points + rig.translation[:, :, None]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    metric = rng.normal(size=(2, 2, 3, 50))
    motion = np.stack([rng.normal(0, 0.1, (3, 50)), rng.normal(0, 0.05, (3, 50))])
    state = State(rig.rotation, rig.translation, points, np.array([[0.2], [-0.4]]))
    return state, Residuals(rays, np.ones((2, 50)), metric, motion=motion)


def residual(state: State, seen: Residuals, tau: Floats) -> Floats:
    no_loss = 1e6
    state = replace(state, intrinsics=tau)
    return seen.linearise(state, no_loss, steps=0).residual


def test_slopes_by_the_offset_are_differences():
    state, seen = timed_problem()
    nudge = 1e-6
    tau = state.intrinsics
    difference = residual(state, seen, tau + nudge) - residual(state, seen, tau - nudge)
    slopes = seen.linearise(state, 1e6, steps=0).by_intrinsics
    np.testing.assert_allclose(slopes[:, :, 0], difference / (2 * nudge), rtol=1e-5, atol=1e-7)


def test_motion_goes_through_the_neighbours():
    rng = np.random.default_rng(0)
    before, here, after = rng.normal(size=(3, 3, 7))
    velocity, acceleration = motion_between(here - before, after - here, 2)
    time = np.array([-2.0, 0.0, 2.0])[:, None, None]
    moved = time * velocity + time**2 / 2 * acceleration
    np.testing.assert_allclose(here + moved, [before, here, after], atol=1e-12)


def test_smoothness_is_one_on_a_line_and_none_by_chance():
    rng = np.random.default_rng(0)
    line = np.arange(3)[:, None, None] * rng.normal(size=(3, 500))
    chance = rng.normal(size=(3, 3, 500))
    assert smoothness(*line) > 1 - 1e-12
    assert abs(smoothness(*chance)) < 0.1
    assert smoothness(*chance[..., :0]) == 0


def test_the_usual_step_is_that_of_most_frames():
    assert usual_step(np.array([0, 2, 4, 9, 11])) == 2
    assert usual_step(np.array([5])) == 1


@pytest.mark.slow
def test_a_run_uses_the_offsets():
    """From detections alone; reprojection errors are those of what was brought in step."""
    recording, _ = off(people=2)
    config = Config()
    without = replace(config, sync=replace(config.sync, subframe=False))
    found, blind = (calibrate_group(recording, config=each) for each in (config, without))
    assert np.abs(found.time_offsets.tau - OFFSETS).max() < 0.05
    assert list(found.clock_offsets) == ["cam2", "cam3"]
    assert not blind.clock_offsets
    # measured 0.84
    assert np.nanmedian(found.poses.error) < 0.92 * np.nanmedian(blind.poses.error)
