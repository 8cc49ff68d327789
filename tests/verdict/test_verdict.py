"""The verdict on a rig, from how far it may be off and from the checks."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rigs import uncertainty
from scenes import calibrated

from mocap_calib.config import Config
from mocap_calib.recording.corrections import Cropped
from mocap_calib.results import (
    CalibrationResult,
    Cause,
    Clocks,
    Fault,
    GroupResult,
    Verdict,
)
from mocap_calib.types import Camera, CameraClock, EstimatedCamera
from mocap_calib.verdict.checks import CHECKS, check_rig
from mocap_calib.verdict.verdict import _principal_points, assess, expected_error, judge

CONFIG = Config()
UNCERTAINTY = CONFIG.uncertainty


@pytest.mark.parametrize(
    ("degrees", "word"),
    [
        (0.9, "well determined"),
        (1.1, "usable"),
        (2.9, "usable"),
        (3.1, "weak"),
        (9.9, "weak"),
        (10.1, "not determined"),
        (np.nan, "not determined"),
    ],
)
def test_the_expected_error_decides(degrees, word):
    assert Verdict(degrees).word == word


def cause(degrees: float, camera: str = "", name: str = "bones") -> Cause:
    """A cause of so many degrees."""
    return Cause(name, camera, degrees, "it is wrong", "correct it")


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        ((), 0.0),
        ((cause(0.3), cause(0.4)), 0.5),
        ((cause(0.3, "a"), cause(0.4, "b")), 0.4),  # the least certain camera counts
        ((cause(3.0, "a"), cause(4.0, "b"), cause(3.0)), 5.0),
        ((cause(3.0, "b"), cause(4.0, "b@120")), 5.0),  # a camera that was moved
    ],
)
def test_causes_add_in_squares_for_each_camera(causes, expected):
    assert expected_error(("a", "b@120"), causes) == pytest.approx(expected)


def test_of_each_kind_the_largest_cause_is_a_reason():
    causes = (
        cause(1.2, "a"),
        cause(0.9, "b"),
        cause(0.6, "a", "errors"),
        cause(0.4, "a", "over time"),
    )
    found = Verdict(1.5, causes)
    assert found.reasons == (str(causes[0]), str(causes[2]))
    assert Verdict(0.9, causes).reasons == ()
    assert str(causes[0]) == "it is wrong; correct it"


def test_a_check_without_a_value_does_not_fail():
    assert cause(np.nan).passed
    assert cause(0.9).passed
    assert not cause(1.1).passed


@pytest.mark.parametrize(
    ("estimated", "beside", "corner", "share"),
    [
        (False, 0.0, None, 0.005),
        (True, 5.0, None, 0.005),  # it was given
        (True, 0.5, None, 0.018),  # readers differ by half a pixel in where the middle is
        (False, 5.0, 0.024, 0.03),  # a cropped image
    ],
)
def test_what_is_not_known_of_a_principal_point_turns_its_camera(estimated, beside, corner, share):
    matrix = np.diag([500.0, 500.0, 1.0])
    matrix[:2, 2] = 319.5 + beside, 239.5
    camera = Camera("a", (640, 480), matrix, np.zeros(5), False)
    if estimated:
        camera = EstimatedCamera.of(camera, focal_sigma=1.0, k1_sigma=0.0)
    mend = None if corner is None else Cropped("a", 0.0, 0.0, corner * 640)
    group = SimpleNamespace(rig=SimpleNamespace(cameras=(camera,)))
    (found,) = _principal_points(group, (Fault("a", "cropped", "it is", mend=mend),), UNCERTAINTY)
    assert found.error_deg == pytest.approx(np.rad2deg(np.sqrt(2) * share * 640 / 500))
    assert ("it is" in found.meaning) == (corner is not None)


def values(group: GroupResult) -> dict[str, Cause]:
    """Return the checks of a group by name."""
    return {check.name: check for check in check_rig(group, CONFIG)}


def test_each_check_has_a_row_on_the_page():
    page = (Path(__file__).parents[2] / "docs" / "how-good.md").read_text("utf-8")
    table = page.split("## The checks")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\w -]+?) \| (.*) \|$", table, re.MULTILINE)
    assert rows[1:] == [(kind.name, kind.text) for kind in CHECKS]


def result_of(group: GroupResult, **fields) -> CalibrationResult:
    """A result with this group alone."""
    made = {"clocks": Clocks.of_one(group.recording), **fields}
    return CalibrationResult(groups=(group,), left_out=(), unused_pairs=(), **made)


@pytest.mark.slow
def test_a_sound_recording_passes_all_checks():
    group = calibrated()
    checks = values(group)
    assert all(check.passed for check in checks.values()), checks
    assert max(check.error_deg for check in checks.values()) < 0.5, checks
    (judged,) = judge(result_of(group)).groups
    assert judged.verdict == "well determined"
    assert judged.reasons == ()
    names = {each.name for each in judged.assessment.causes}
    assert names >= {"covariance", "principal point"}


@pytest.mark.slow
def test_an_uncertain_rig_names_no_camera():
    """Nor do two halves, or cameras that agree with none; and one not determined names none."""
    group = calibrated()
    for degrees, of_all, odd, named in (
        (20.0, 0.0, (1,), []),
        (0.5, 5.0, (1,), []),
        (0.5, 0.0, (1, 3), []),
        (5.0, 0.0, (1,), [1]),
    ):
        known = uncertainty(degrees, views=4, outliers=odd)
        turns = np.zeros((1, 4, 6))
        turns[..., 0] = np.deg2rad(of_all)
        known = replace(known, covariance=known.covariance.with_changes(turns))
        (judged,) = judge(result_of(replace(group, uncertainty=known))).groups
        assert np.flatnonzero(judged.uncertainty.outlier_cameras).tolist() == named
    strangers = replace(
        group,
        uncertainty=uncertainty(0.5, views=4, outliers=(1,)),
        pairs=tuple(replace(pair, score=0.4) for pair in group.pairs),
    )
    (judged,) = judge(result_of(strangers)).groups
    assert not judged.uncertainty.outlier_cameras.any()


@pytest.mark.slow
def test_faults_and_clocks_that_are_not_corrected_make_a_rig_weak():
    group = calibrated()
    name = group.rig.names[0]
    for word, mend, verdict in (
        ("mirrored", None, "weak"),
        ("sides", None, "well determined"),
        ("cropped", Cropped(name, 0.0, 0.0, 5.0), "usable"),
    ):
        fault = Fault(name, word, "it is wrong", mend=mend)
        (judged,) = judge(result_of(group, faults=(fault,))).groups
        assert judged.verdict == verdict, word
        assert (len(judged.reasons) == 0) == (verdict == "well determined")
        assert all("it is wrong" in reason for reason in judged.reasons)
    late = [CameraClock(name, "clock", 5), *map(CameraClock, group.rig.names[1:])]
    clocks = Clocks.of_one(group.recording, late)
    (judged,) = judge(result_of(group, clocks=clocks)).groups
    assert judged.verdict == "weak"
    assert "on another clock" in judged.reasons[0]


@pytest.mark.slow
def test_checks_see_what_is_wrong():
    """A camera blind to identities, and errors in one stretch."""
    group = calibrated()
    frames = len(group.recording.frames)
    labels = group.matches.labels.copy()
    labels[2, : frames // 2] = -1
    found = values(replace(group, matches=replace(group.matches, labels=labels)))["unmatched"]
    assert not found.passed
    assert found.camera == group.rig.names[2]
    positions = group.recording.positions.copy()
    positions[1, : frames // 5] += 40.0
    shaken = replace(group, recording=replace(group.recording, positions=positions))
    found = values(shaken)["over time"]
    turn = np.rad2deg(40.0 / group.rig.cameras[1].focal)
    assert turn < found.error_deg < 2 * turn  # along both axes of the image
    assert found.camera == group.rig.names[1]


@pytest.mark.slow
def test_reasons_name_the_camera_the_size_and_the_remedy():
    group = replace(calibrated(), uncertainty=uncertainty(4.2, views=4))
    (first,) = assess(group, (), CONFIG).reasons
    assert first.startswith(f"{group.rig.names[3]}: rotation +-4.2 deg; ")
    focal = replace(group.uncertainty, intrinsics_turn=np.deg2rad([0, 0, 0, 4.0]))
    (first,) = assess(replace(group, uncertainty=focal), (), CONFIG).reasons
    assert "focal" in first
