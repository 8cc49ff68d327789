"""Laws of the comparison of a rig with a reference."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import rotation_errors_deg, scene

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import CameraRig
from mocap_calib.verdict.evaluation import (
    accuracy,
    area_under_curve,
    evaluate,
    evaluation_to_dict,
)


def elsewhere(rig: CameraRig, scale: float = 3.0) -> CameraRig:
    """Return the same rig in another world."""
    turn = matrix_from_vector(np.array([0.3, -1.0, 0.5]))
    shift = np.array([4.0, 5.0, -6.0])
    rotation = rig.rotation @ turn.T
    return replace(
        rig,
        rotation=rotation,
        translation=scale * rig.translation - np.einsum("vij,j->vi", rotation, shift),
        unit="arbitrary",
    )


def without(rig: CameraRig, name: str) -> CameraRig:
    """Return the rig of all cameras but this one."""
    return rig.select(np.array([k for k, other in enumerate(rig.names) if other != name]))


@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_the_same_rig_in_any_world_has_no_error(cameras):
    rig = scene(cameras=cameras).rig
    figures = evaluation_to_dict(evaluate(elsewhere(rig), rig))
    for key in (
        "rotation_error_deg",
        "translation_error_deg",
        "camera_rotation_error_deg",
        "centre_error",
    ):
        assert figures[key]["max"] == pytest.approx(0, abs=1e-6)
    assert figures["rra"] == figures["rta"] == {"5": 1, "10": 1, "20": 1, "30": 1}
    assert figures["auc"]["5"] == 1
    assert figures["unit"] == "m"


def test_cameras_on_a_line_are_turned_by_their_axes():
    """The centres alone leave the turn about the line open; measured below 1e-8 degrees."""
    rig = scene(cameras=4).rig
    centres = np.outer(np.arange(4), [1.0, 0.2, 0.1]) + [0, 0, 2]
    line = rig.stand(rig.rotation, centres)
    found = evaluate(elsewhere(line), line)
    assert np.degrees(found.camera_rotation).max() < 1e-6
    assert found.centre_error.max() < 1e-6


def test_a_known_turn_is_the_error_of_its_pairs():
    rig = scene(cameras=4).rig
    rotation = rig.rotation.copy()
    rotation[2] = matrix_from_vector(np.radians([0, 7.0, 0])) @ rotation[2]
    found = rig.stand(rotation, rig.centres)
    figures = evaluation_to_dict(evaluate(found, rig))
    for pair in figures["pairs"]:
        expected = 7.0 if "cam3" in (pair["a"], pair["b"]) else 0.0
        assert pair["rotation_error_deg"] == pytest.approx(expected, abs=1e-6)
    assert figures["rra"] == {"5": 0.5, "10": 1, "20": 1, "30": 1}
    # metres; in the alignment the cameras' axes weigh a millionth of their centres
    assert figures["centre_error"]["max"] == pytest.approx(0, abs=1e-6)


def test_a_known_shift_is_the_error_of_the_centre():
    """0.3 m; the alignment spreads a part of it over the other cameras (measured 0.25)."""
    rig = scene(cameras=6).rig
    centres = rig.centres.copy()
    centres[0] += [0.3, 0.0, 0.0]
    found = rig.stand(rig.rotation, centres)
    assert evaluate(found, rig).centre_error.max() == pytest.approx(0.25, abs=0.06)


def test_a_missing_camera_counts_as_wrong_as_can_be():
    rig = scene(cameras=4).rig
    figures = evaluation_to_dict(evaluate(without(rig, "cam2"), rig))
    assert figures["missing"] == ["cam2"]
    assert figures["rotation_error_deg"]["max"] == 180
    assert figures["rra"]["30"] == 0.5


def test_agrees_with_an_independent_computation():
    rig, rng = scene(cameras=5).rig, np.random.default_rng(0)
    found = replace(rig, rotation=matrix_from_vector(rng.normal(0, 0.2, (5, 3))) @ rig.rotation)
    np.testing.assert_allclose(
        np.sort(np.degrees(evaluate(found, rig).rotation_error)),
        np.sort(rotation_errors_deg(found, rig)),
        atol=1e-6,
    )


def test_area_under_the_curve():
    """One pair exact, one with 10.5 degrees: the curve is a half up to 10, then one."""
    rotation, translation = np.radians([0.0, 10.5]), np.radians([0.0, 3.0])
    assert area_under_curve(rotation, translation, 10) == 0.5
    assert area_under_curve(rotation, translation, 20) == 0.75
    assert accuracy(rotation, 10.5) == 0.5


def test_rigs_without_common_names_are_refused():
    rig = scene(cameras=3).rig
    other = replace(rig, cameras=tuple(replace(c, name=f"x{k}") for k, c in enumerate(rig.cameras)))
    with pytest.raises(MismatchError, match="cam1, cam2, cam3"):
        evaluate(other, rig)
