"""One camera of a synthetic scene is damaged: it is found, named and mended."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import calibrate_all, recording, rotation_errors_deg, scene

from mocap_calib.adjust.camera_fit import CameraFit
from mocap_calib.config import DECISIVE_NATS, Config, DiagnosisConfig, MendConfig
from mocap_calib.faults.hypotheses import (
    describe,
    evidence_of_unknowns,
    list_hypotheses,
    log_bayes_factor,
    mend_of,
    plain_factor,
)
from mocap_calib.faults.leave_one_out import quarter_turn
from mocap_calib.faults.mend import find_exchanged_cameras
from mocap_calib.recording.corrections import Cropped, Exchanged, Resized, Sides
from mocap_calib.types import Recording

ODD = 1
CHANGES = {"people": 1, "cameras": 4, "frames": 120, "false_detections": 0.0}


def plain(**changes) -> Recording:
    sample = recording(**{**CHANGES, **changes})
    fields = ("cameras", "keypoints", "frames", "positions", "confidence", "tracked", "vocabulary")
    return Recording(**{name: getattr(sample, name) for name in fields}, model=sample.model)


def damage(given: Recording, what: str) -> Recording:
    """Change the detections of one camera."""
    name, positions = given.names[ODD], given.positions.copy()
    width, height = given.cameras[ODD].size
    if what == "sides":
        return Sides(name).apply(given)
    if what == "half":
        positions[ODD] /= 2
    if what == "cropped":
        positions[ODD] -= (0.2 * width, 0.15 * height)
    return replace(given, positions=positions)


@pytest.mark.slow
def test_a_cropped_camera_is_named_and_corrected():
    """The median error is 0.5 deg since the crop is an estimate, and the verdict knows of it.

    The other corrections are held by tests/golden/test_golden_scenes.py.
    """
    given = plain()
    result = calibrate_all(damage(given, "cropped"))
    assert [(fault.camera, type(fault.mend)) for fault in result.faults] == [
        (given.names[ODD], Cropped)
    ]
    (group,) = result.groups
    errors = rotation_errors_deg(group.rig, scene(**CHANGES).rig)
    assert np.median(errors) < 3.0
    assert group.verdict != "well determined"
    assert errors.max() < 2 * group.assessment.error_deg


@pytest.mark.slow
@pytest.mark.parametrize("people", [1, 3])
def test_nobody_is_accused_where_all_is_sound(people):
    """Of anything: neither of a fault of all frames, nor of having moved, nor of a clock."""
    result = calibrate_all(plain(people=people))
    assert result.faults == ()


@pytest.mark.slow
def test_two_cameras_that_go_together_are_named_and_corrected():
    """Left and right exchanged in two of five; measured 0.1 deg after both corrections."""
    given = plain(cameras=5)
    damaged = given
    for name in given.names[:2]:
        damaged = Sides(name).apply(damaged)
    result = calibrate_all(damaged)
    assert {(fault.camera, fault.word) for fault in result.faults} == {
        (name, "sides") for name in given.names[:2]
    }
    true = scene(**{**CHANGES, "cameras": 5}).rig
    assert np.median(rotation_errors_deg(result.groups[0].rig, true)) < 1.0


@pytest.mark.slow
def test_of_two_cameras_nobody_is_named():
    given = plain(cameras=2)
    assert calibrate_all(damage(given, "sides")).faults == ()


@pytest.mark.slow
def test_a_fault_is_named_but_not_mended_where_that_is_forbidden():
    given = plain()
    config = Config(mend=MendConfig(apply=False))
    (fault,) = calibrate_all(damage(given, "half"), config=config).faults
    assert (fault.camera, fault.word, fault.mend) == (given.names[ODD], "resized", None)


def test_a_camera_on_its_side_is_seen_beside_upright_ones():
    rig = scene(**CHANGES).rig
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    others = np.delete(rig.rotation, ODD, axis=0)
    # images turned clockwise: what is down lies to the left
    assert quarter_turn(turn @ rig.rotation[ODD], others, DiagnosisConfig()) == 90
    assert quarter_turn(rig.rotation[ODD], others, DiagnosisConfig()) == 0
    others[0] = turn @ others[0]
    assert quarter_turn(turn @ rig.rotation[ODD], others, DiagnosisConfig()) == 0


def test_images_are_resized_by_plain_factors():
    assert plain_factor(np.log(0.53)) == 0.5
    assert plain_factor(np.log(1.95)) == 2.0
    assert plain_factor(np.log(1.1)) is None


def fit_of(unknowns, sigma, keypoints=1000) -> CameraFit:
    return CameraFit(
        pose=np.eye(3, 4),
        unknowns=np.array(unknowns, float),
        covariance=np.diag(np.array(sigma, float) ** 2),
        error=np.ones(keypoints),
    )


def test_a_crop_moves_what_is_seen_to_the_left_and_up_and_hides_the_rest():
    config = DiagnosisConfig()
    given = plain()
    width, height = given.cameras[ODD].size
    by_name = {each.name: each for each in list_hypotheses(damage(given, "cropped"), ODD)}
    cropped = by_name["cropped"]

    def evidence(unknowns) -> float:
        return evidence_of_unknowns(cropped, fit_of(unknowns, [10, 10]), config)

    fit = fit_of([-0.2 * width, -0.15 * height], [10, 10])
    assert evidence(fit.unknowns) > 3 * DECISIVE_NATS
    assert mend_of(cropped, fit) == Cropped(
        given.names[ODD], round(0.2 * width), round(0.15 * height), sigma=10.0
    )
    assert evidence([-0.02 * width, 0]) < 0  # as of sound intrinsics
    assert evidence([0.2 * width, 0]) == -np.inf
    # what is seen reaches beyond what so large a crop would have left
    assert evidence([-0.8 * width, 0]) == -np.inf


def test_evidence_is_the_ratio_of_the_densities_of_the_estimate():
    """Of one unknown, in closed form; of an estimate far more uncertain than both priors, none."""
    sound, faulty, value, sigma = 0.02, 0.4, 0.1, 0.01
    narrow, wide = sound**2 + sigma**2, faulty**2 + sigma**2
    expected = (value**2 / narrow - value**2 / wide + np.log(narrow / wide)) / 2
    priors = np.array([sound]), np.array([faulty])
    found = log_bayes_factor(np.array([value]), np.array([[sigma**2]]), *priors)
    assert found == pytest.approx(expected)
    vague = log_bayes_factor(np.array([3.0]), np.array([[100.0**2]]), *priors)
    assert vague == pytest.approx(0.0, abs=1e-4)


def test_hypotheses_have_names_of_their_own_and_corrections_say_what_is_wrong():
    found = list_hypotheses(plain(), ODD)
    assert found[0].name == "given"
    assert len({each.name for each in found}) == len(found)
    said = [describe(each.mend) for each in found if each.mend is not None]
    assert len(set(said)) == len(said)
    assert describe(Resized("c", 0.5)) == "images resized by 0.5 against its intrinsics"


def group_of(focal, change, sigma=0.007):
    """Return what a group says of focal lengths."""
    cameras = [SimpleNamespace(focal=each) for each in focal]
    known = SimpleNamespace(focal_change=np.array(change), focal_sigma=np.full(len(change), sigma))
    names = tuple(str(view) for view in range(len(focal)))
    return SimpleNamespace(rig=SimpleNamespace(cameras=cameras, names=names), uncertainty=known)


def test_cameras_that_want_the_focal_lengths_of_each_other_may_be_exchanged():
    """Not where one of the two is right, nor where they are equal, nor in rigs of two."""
    focal, change = (766, 688, 724), (-0.107, 0.099, -0.005)
    (found,) = find_exchanged_cameras(group_of(focal, change))
    assert [fault.mend for fault in found.faults] == [Exchanged("0", "1")] * 2
    assert find_exchanged_cameras(group_of(focal, (0.0, 0.099, 0.0))) == []
    assert find_exchanged_cameras(group_of((700, 700, 700), change)) == []
    assert find_exchanged_cameras(group_of(focal[:2], change[:2])) == []
