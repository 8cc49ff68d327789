"""A rig against a reference, and a calibration that was given against keypoints."""

import json
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scenes import moved, rotation_errors_deg, scene, turn_camera

import mocap_calib as mc
from mocap_calib.config import Config, SyncConfig
from mocap_calib.verdict.verdict import expected_error

# --- against a reference


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_the_same_rig_in_any_world_unit_and_order_has_no_error(cameras, seed):
    """Also where all centres are on a line, which leave the turn about it to the cameras' axes."""
    rng, rig = np.random.default_rng(seed), scene(cameras=cameras).rig
    line = np.outer(np.arange(cameras), [1.0, 0.2, 0.1]) + [0, 0, 2]
    for true in (rig, rig.stand(rig.rotation, line)):
        other, _, _ = moved(true.select(rng.permutation(cameras)), rng)
        found = mc.evaluate(replace(other, unit="arbitrary"), true)
        assert np.degrees(found.rotation_error).max() < 1e-5
        assert np.degrees(found.translation_error).max() < 1e-5
        assert np.degrees(found.camera_rotation).max() < 1e-5
        assert found.centre_error.max() < 1e-6
        assert (found.unit, found.missing) == ("m", ())


def test_a_known_turn_is_the_error_of_its_pairs():
    rig = scene(cameras=4).rig
    found = mc.evaluate(turn_camera(rig, 2, 7.0), rig)
    for pair, error in zip(found.pairs, np.degrees(found.rotation_error), strict=True):
        assert error == pytest.approx(7.0 if "cam3" in pair else 0.0, abs=1e-6)
    # metres; in the alignment the cameras' axes weigh a millionth of their centres
    assert found.centre_error.max() < 1e-6


def test_a_known_shift_is_the_error_of_the_centre():
    """0.3 m; the alignment spreads a part of it over the other cameras (measured 0.25)."""
    rig = scene(cameras=6).rig
    found = mc.evaluate(turn_camera(rig, 0, 0.0, shift=(0.3, 0.0, 0.0)), rig)
    assert found.centre_error.max() == pytest.approx(0.25, abs=0.06)


def test_figures_of_the_command_are_shares_of_pairs(tool, tmp_path):
    """One pair is exact, two are off by 10.5 deg, and three of a missing camera by 180.

    The curve is a third up to 10 deg, then one; a missing camera is as wrong as can be.
    """
    rig = scene(cameras=3).rig
    mc.write(turn_camera(rig, 2, 10.5), tmp_path / "found.yaml")
    mc.write(rig, tmp_path / "true.yaml")
    words = ("evaluate", tmp_path / "found.yaml", "--json", "--reference")
    figures = json.loads(tool(*words, tmp_path / "true.yaml").stdout)
    assert figures["rra"] == pytest.approx({"5": 1 / 3, "10": 1 / 3, "20": 1, "30": 1})
    assert figures["auc"]["10"] == pytest.approx(1 / 3)
    assert figures["auc"]["20"] == pytest.approx(2 / 3)
    assert figures["rotation_error_deg"] == pytest.approx({"median": 10.5, "max": 10.5})
    more = scene(cameras=4).rig
    mc.write(more, tmp_path / "more.yaml")
    mc.write(more.select(["cam1", "cam3", "cam4"]), tmp_path / "found.yaml")
    figures = json.loads(tool(*words, tmp_path / "more.yaml").stdout)
    assert figures["missing"] == ["cam2"]
    assert figures["rotation_error_deg"]["max"] == 180
    assert figures["rra"]["30"] == 0.5


def test_rigs_without_common_names_are_refused():
    rig = scene(cameras=3).rig
    others = tuple(replace(each, name=f"x{each.name}") for each in rig.cameras)
    with pytest.raises(mc.MismatchError, match="cam1, cam2, cam3"):
        mc.evaluate(replace(rig, cameras=others), rig)


# --- against keypoints


def verify(rig: mc.CameraRig, **changes) -> mc.Verification:
    """Verify a rig of a scene's cameras, or of some of them, by the scene."""
    files = [file for file in scene(**changes).files if file.camera in rig.names]
    return mc.verify(mc.Recording.from_keypoints(files, rig), rig)


def elsewhere(rig: mc.CameraRig) -> mc.CameraRig:
    """Return the rig in other coordinates, and in millimetres."""
    other, _, factor = moved(rig, np.random.default_rng(0))
    return replace(other.scale(1000 / factor, "mm"))


def test_the_truth_passes_in_any_world_and_unit():
    """Measured: turns of at most 0.05 deg."""
    rig = scene().rig
    for given in (rig, elsewhere(rig)):
        found = verify(given)
        assert found.passes
        assert not found.named
        assert not found.reasons
        assert found.verdict == "well determined"
        assert max(np.rad2deg(camera.turn) for camera in found.cameras) < 0.2
        assert found.rig == given  # nothing is changed, not a bit


def test_a_calibration_may_be_off_as_a_rig_of_its_keypoints_and_as_it_differs_from_that():
    """A quarter of a degree is no move; measured: 0.03 deg without it, 0.23 with it."""
    true = scene().rig
    found = verify(turn_camera(true, 2, 0.25))
    assert not found.named
    causes = found.assessment.causes
    assert {cause.name for cause in causes} >= {"covariance", "principal point", "errors"}
    differences = {each.camera: each.error_deg for each in causes if each.name == "difference"}
    assert max(differences, key=lambda name: differences[name]) == true.names[2]
    assert 0.15 < differences[true.names[2]] < 0.3
    assert found.assessment.error_deg == pytest.approx(expected_error(true.names, causes))
    assert found.assessment.error_deg > verify(true).assessment.error_deg


@pytest.mark.parametrize("degrees", [1.0, 5.0, 30.0])
def test_a_turned_camera_and_no_other_is_named_and_refitted(degrees):
    """Of 30 degrees it matches nobody any more. Measured: the turn to within 0.03 deg."""
    true = scene().rig
    found = verify(turn_camera(true, 2, degrees))
    (name,) = found.named
    assert name == true.names[2]
    camera = found[name]
    assert camera.word == "moved"
    assert not found.passes
    assert abs(np.rad2deg(camera.turn) - degrees) < 5 * np.rad2deg(camera.turn_sigma) < 1.0
    assert camera.refitted_px < 5.0 < camera.error_px
    assert name in str(found.reasons[0])
    assert rotation_errors_deg(found.rig, true).max() < 0.2


def test_the_refit_keeps_coordinates_and_unit_and_the_other_cameras():
    """A camera is shifted by 0.3 m; measured: found to 2 mm."""
    true = elsewhere(scene().rig)
    found = verify(turn_camera(true, 1, 0.0, shift=(300.0, 0.0, 0.0)))
    assert found.named == (true.names[1],)
    assert found.rig.unit == "mm"
    kept = [0, 2, 3]
    assert found.rig.select(kept) == true.select(kept)
    assert np.linalg.norm(found.rig.centres[1] - true.centres[1]) < 30.0
    assert found.cameras[1].shift == pytest.approx(300.0, abs=30.0)


def test_a_wrong_focal_length_is_no_move():
    """Measured: the factor to 0.3 %."""
    true = scene().rig
    zoom = np.diag([np.exp(0.1), np.exp(0.1), 1.0])
    zoomed = replace(true.cameras[1], matrix=true.cameras[1].matrix @ zoom)
    found = verify(replace(true, cameras=(true.cameras[0], zoomed, *true.cameras[2:])))
    (name,) = found.named
    assert (name, found[name].word) == (true.names[1], "focal")
    assert found[name].focal_change == pytest.approx(-0.1, abs=0.02)
    assert found.rig.cameras[1].focal == pytest.approx(true.cameras[1].focal, rel=0.02)


def test_two_cameras_that_moved_are_both_named():
    true = scene(cameras=6).rig
    found = verify(turn_camera(turn_camera(true, 1, 3.0), 4, -2.0), cameras=6)
    assert found.named == (true.names[1], true.names[4])


def test_of_two_cameras_both_are_named():
    """Nothing shows which one moved; where they agree on no body they are refused."""
    true = scene().rig.select([0, 1])
    assert verify(true).passes
    assert verify(turn_camera(true, 1, 2.0)).named == true.names
    with pytest.raises(mc.DegenerateError):
        verify(turn_camera(true, 1, 20.0))


@pytest.mark.parametrize("seed", [0, 1])
def test_in_a_calibration_of_other_cameras_none_is_named(seed):
    """Few cameras stand where it is said. Some may agree on strangers by chance."""
    wrong, rng = scene().rig, np.random.default_rng(seed)
    for view in range(4):
        shift = 1.5 * rng.normal(size=3)
        wrong = turn_camera(wrong, view, rng.uniform(20, 40) * rng.choice([-1, 1]), shift=shift)
    with suppress(mc.DegenerateError):
        found = verify(wrong)
        assert found.verdict == "not determined"
        assert not found.named


@pytest.mark.slow
def test_sound_rigs_are_not_accused():
    """Five small scenes, each with the truth; the chance of a wrong name is 0.003 in each."""
    for seed in range(5):
        changes = {"seed": seed, "cameras": 3 + seed % 3, "people": 1 + seed % 2, "frames": 40}
        found = verify(scene(**changes).rig, **changes)
        assert not found.named, (changes, found.reasons)


@pytest.mark.slow
def test_a_late_clock_is_corrected_before_cameras_are_named():
    """Frame numbers of a camera are 4 too large; 3 are found here, 4 in another scene."""
    made = scene(frames=200)
    late = made.rig.names[1]
    files = [replace(file, frames=file.frames + 4 * (file.camera == late)) for file in made.files]
    given = mc.Recording.from_keypoints(files, made.rig)
    found = mc.verify(given, turn_camera(made.rig, 0, 2.0))
    assert found.named == (made.rig.names[0],)
    clock = found.clocks.cameras[1]
    assert clock.kind == "clock"
    assert abs(clock.offset - 4) <= 1
    as_given = mc.verify(given, made.rig, config=Config(sync=SyncConfig(mode="check")))
    causes = [each.camera for each in as_given.assessment.causes if each.name == "clock"]
    assert causes == [late]


def test_other_cameras_are_refused():
    turned = scene().rig.select([1, 0, 2, 3])
    with pytest.raises(mc.MismatchError, match="select"):
        mc.verify(mc.Recording.from_keypoints(scene().files, scene().rig), turned)
