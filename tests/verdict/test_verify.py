"""A calibration that was given, judged by keypoints: which camera moved since."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scenes import lifted, recording, rotation_errors_deg, scene

import mocap_calib as mc
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError, MismatchError
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.recording.sampling import take_sample, with_cameras
from mocap_calib.results import Verification, VerifiedCamera
from mocap_calib.types import CameraRig, silent
from mocap_calib.verdict.verify import describe_move, verify_rig

AXIS = np.array([0.48, 0.6, 0.64])


def judge(rig: CameraRig, **changes) -> Verification:
    """Judge a rig of a scene's cameras, or of the first ones of them, by the scene."""
    views = np.arange(len(rig))
    sample = with_cameras(recording(**changes).select(views=views), rig.cameras)
    return verify_rig(sample, lifted(**changes).select(views), rig, Config(), progress=silent)


def move(rig: CameraRig, view: int, degrees: float, shift=(0.0, 0.0, 0.0)) -> CameraRig:
    """Turn a camera about its centre, and shift that."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view] = matrix_from_vector(np.deg2rad(degrees) * AXIS) @ rotation[view]
    translation[view] = -rotation[view] @ (rig.centres[view] + shift)
    return replace(rig, rotation=rotation, translation=translation)


def elsewhere(rig: CameraRig) -> CameraRig:
    """Describe the same rig in other coordinates, and in millimetres."""
    turn = matrix_from_vector(2.0 * AXIS)
    centres = 1000 * (rig.centres @ turn.T + [3.0, -40.0, 7.0])
    rotation = rig.rotation @ turn.T
    return replace(rig, unit="mm").stand(rotation, centres)


def test_the_truth_passes_in_any_world_and_unit():
    """Measured: turns of at most 0.05 deg."""
    rig = scene().rig
    for given in (rig, elsewhere(rig)):
        found = judge(given)
        assert found.passes
        assert not found.named
        assert not found.reasons
        assert found.verdict == "well determined"
        assert max(np.rad2deg(camera.turn) for camera in found.cameras) < 0.2
        assert found.rig == given  # nothing is changed, not a bit


@pytest.mark.parametrize("degrees", [1.0, 5.0, 30.0])
def test_a_turned_camera_and_no_other_is_named_and_refitted(degrees):
    """Of 30 degrees it matches nobody any more. Measured: the turn to within 0.03 deg."""
    true = scene().rig
    found = judge(move(true, 2, degrees))
    (name,) = found.named
    assert name == true.names[2]
    camera = found[name]
    assert camera.word == "moved"
    assert not found.passes
    assert abs(np.rad2deg(camera.turn) - degrees) < 5 * np.rad2deg(camera.turn_sigma) < 1.0
    assert camera.refitted_px < 5.0 < camera.error_px
    assert name in found.reasons[0]
    assert "turned by" in found.reasons[0]
    assert rotation_errors_deg(found.rig, true).max() < 0.2


def test_the_refit_keeps_coordinates_and_unit_and_the_other_cameras():
    """A camera is shifted by 0.3 m; measured: found to 2 mm."""
    true = elsewhere(scene().rig)
    found = judge(move(true, 1, 0.0, shift=(300.0, 0.0, 0.0)))
    assert found.named == (true.names[1],)
    assert found.rig.unit == "mm"
    kept = [0, 2, 3]
    assert found.rig.select(kept) == true.select(kept)
    assert np.linalg.norm(found.rig.centres[1] - true.centres[1]) < 30.0
    assert found.cameras[1].shift == pytest.approx(300.0, abs=30.0)


def test_a_wrong_focal_length_is_no_move():
    """Measured: the factor to 0.3 %."""
    true = scene().rig
    zoomed = change_intrinsics(true.cameras[1], log_focal=0.1, k1=0.0)
    found = judge(replace(true, cameras=(true.cameras[0], zoomed, *true.cameras[2:])))
    (name,) = found.named
    assert found[name].word == "focal"
    assert name == true.names[1]
    assert found[name].focal_change == pytest.approx(-0.1, abs=0.02)
    assert found.rig.cameras[1].focal == pytest.approx(true.cameras[1].focal, rel=0.02)


@pytest.mark.slow
def test_two_cameras_that_moved_are_both_named():
    true = scene(cameras=6).rig
    found = judge(move(move(true, 1, 3.0), 4, -2.0), cameras=6)
    assert found.named == (true.names[1], true.names[4])


def test_of_two_cameras_nobody_can_say_which_one_moved():
    true = scene().rig.select([0, 1])
    assert judge(true).passes
    found = judge(move(true, 1, 2.0))
    assert found.named == true.names
    assert "nobody can say which" in found.reasons[0]


@pytest.mark.parametrize("seed", [0, 1])
def test_in_a_calibration_of_other_cameras_none_is_named(seed):
    """Hardly a camera stands where it is said. Some may agree on strangers by chance."""
    wrong, rng = scene().rig, np.random.default_rng(seed)
    for view in range(4):
        shift = 1.5 * rng.normal(size=3)
        wrong = move(wrong, view, rng.uniform(20, 40) * rng.choice([-1, 1]), shift=shift)
    with suppress(DegenerateError):
        found = judge(wrong)
        assert found.verdict == "not determined"
        assert not found.named


def test_two_cameras_that_agree_on_nobody_are_refused():
    wrong = move(scene().rig, 1, 20.0).select([0, 1])
    with pytest.raises(DegenerateError, match="calibrate anew"):
        judge(wrong)


@pytest.mark.slow
def test_sound_rigs_are_not_accused():
    """Five small scenes, each with the truth; the chance of a wrong name is 0.003 in each."""
    for seed in range(5):
        changes = {"seed": seed, "cameras": 3 + seed % 3, "people": 1 + seed % 2, "frames": 40}
        found = judge(scene(**changes).rig, **changes)
        assert not found.named, (changes, found.reasons)


@pytest.mark.slow
def test_from_a_recording_and_its_clock_is_put_right():
    """The whole function, with a camera whose frame numbers are 4 too large.

    Bodies show it to a frame: 3 are found here, 4 in another scene.
    """
    made = scene(frames=200)
    late = made.rig.names[1]
    files = [replace(file, frames=file.frames + 4 * (file.camera == late)) for file in made.files]
    found = mc.verify(mc.Recording.from_keypoints(files, made.rig), move(made.rig, 0, 2.0))
    assert found.named == (made.rig.names[0],)
    clock = found.clocks.cameras[1]
    assert clock.kind == "clock"
    assert abs(clock.offset - 4) <= 1


def test_a_move_is_told_as_far_as_it_is_sure():
    """A tenth of the rig to within a fifth of that; a turn of half its sigma is none."""
    camera = VerifiedCamera(
        name="cam1",
        word="moved",
        turn=np.radians(0.5),
        turn_sigma=np.radians(1.0),
        shift=0.3,
        shift_sigma=0.06,
        relative_shift=0.1,
        focal_change=0.0,
        error_px=9.0,
        refitted_px=2.0,
    )
    shifted = "shifted by 10.0% +- 2.0% of the rig's size"
    assert describe_move(camera) == f"is {shifted}"
    turned = replace(camera, turn=np.radians(7.0))
    assert describe_move(turned) == f"is turned by 7.00 +- 1.00 deg and {shifted}"
    assert describe_move(replace(camera, shift_sigma=0.3)) == "is elsewhere"


def test_other_cameras_are_refused():
    sample = take_sample(recording(), slice(None))
    with pytest.raises(MismatchError, match="select"):
        mc.verify(sample, scene().rig.select([1, 0, 2, 3]))
