"""What a rig is called, from how far it may be off and from the checks."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs import uncertainty
from scenes import calibrated

from mocap_calib.config import Config, VerdictConfig
from mocap_calib.types import Check, GroupResult, Matches
from mocap_calib.verdict.checks import check_rig
from mocap_calib.verdict.reasons import MEANING, _stands_still, explain
from mocap_calib.verdict.verdict import judge_group, judge_rig, no_better_than

LIMITS = VerdictConfig()
SOUND = (Check("bones", 0.1, 0.3),)
FAILED = (Check("bones", 0.4, 0.3),)
STRANGER = (
    Check("bridge", 2.5, 1.4),
    Check("pair score", 0.1, 0.0),
    Check("unmatched", 0.5, 0.3),
    Check("errors", 0.12, 0.1),
)


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
def test_the_worst_camera_decides(degrees, word):
    assert judge_rig(uncertainty(degrees), SOUND, LIMITS, reversible=False) == word


@pytest.mark.parametrize(
    ("found", "checks", "reversible", "word"),
    [
        (uncertainty(0.1), FAILED, False, "usable"),
        (uncertainty(0.1, focal=True), SOUND, False, "usable"),
        (uncertainty(0.1, outliers=(2,)), SOUND, False, "weak"),
        (uncertainty(0.1), SOUND, True, "weak"),
        (uncertainty(0.9), (Check("flat", 0.5, 0.4),), False, "weak"),
        (uncertainty(1.1), (Check("flat", 0.5, 0.4),), False, "not determined"),
        (uncertainty(0.1), (*FAILED, Check("convergence", 1.0, 0.0)), False, "weak"),
        (uncertainty(0.1), (Check("bridge", 1.5, 1.4),), False, "weak"),
        (uncertainty(0.1), (*FAILED, Check("bridge", 1.5, 1.4)), False, "not determined"),
        (uncertainty(0.1, views=2), (Check("pair score", 0.1, 0.0),), False, "weak"),
        (uncertainty(0.1), (Check("pair score", 0.1, 0.0),), False, "usable"),
        (uncertainty(0.1), 3 * (Check("lens", 5.0, 4.0),), False, "usable"),
        (uncertainty(0.1), 4 * (Check("lens", 5.0, 4.0),), False, "weak"),
        (uncertainty(0.1), 5 * (Check("lens", 5.0, 4.0),), False, "not determined"),
        (uncertainty(0.1), STRANGER, False, "not determined"),
        (uncertainty(0.1), STRANGER[1:], False, "usable"),
        (uncertainty(0.1), (*STRANGER[1:3], Check("convergence", 1.0, 0.0)), False, "weak"),
        (uncertainty(0.1, outliers=(0, 2)), SOUND, False, "not determined"),
        (uncertainty(20.0), FAILED, False, "not determined"),  # a fault makes nothing better
    ],
)
def test_what_speaks_against_a_rig_limits_its_verdict(found, checks, reversible, word):
    assert judge_rig(found, checks, LIMITS, reversible=reversible) == word


def test_a_check_without_a_value_does_not_fail():
    assert Check("held-out frames", np.nan, 1.15).passed
    assert not Check("held-out frames", 1.2, 1.15).passed


def values(group: GroupResult) -> dict[str, Check]:
    """Return the checks of a group by name."""
    return {check.name: check for check in check_rig(group, Config())}


def test_each_check_has_a_row_on_the_page():
    page = (Path(__file__).parents[2] / "docs" / "how-good.md").read_text("utf-8")
    table = page.split("## The checks")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\w -]+?) \|", table, re.MULTILINE)
    assert rows[1:] == list(MEANING)


@pytest.mark.slow
def test_a_sound_recording_passes_all_checks_and_none_is_without_words():
    group = calibrated()
    checks = values(group)
    assert checks.keys() == MEANING.keys()
    assert all(check.passed for check in checks.values()), checks
    assert checks["held-out frames"].value == pytest.approx(1, abs=0.05)
    assert checks["flat"].value < 0.1
    assert checks["errors"].value < 0.05
    assert checks["bones"].value < 0.15
    judged = judge_group(group, Config())
    assert judged.verdict == "well determined"
    assert judged.reasons == ()
    # a rig that is hardly determined accuses nobody, nor do two halves accuse each other; but that
    # cameras contradict each other is said
    for degrees, of_all, odd, verdict, accused in (
        (20.0, 0.0, (1,), "not determined", []),
        (0.5, 5.0, (1,), "weak", []),
        (0.5, 0.0, (1, 3), "weak", []),
        (5.0, 0.0, (1,), "weak", [1]),
    ):
        known = uncertainty(degrees, views=4, outliers=odd)
        turns = np.zeros((1, 4, 6))
        turns[..., 0] = np.deg2rad(of_all)
        known = replace(known, covariance=known.covariance.with_changes(turns))
        judged = replace(group, uncertainty=known)
        judged = judge_group(judged, Config())
        assert judged.verdict == verdict
        assert np.flatnonzero(judged.uncertainty.outlier_cameras).tolist() == accused
        assert any(group.rig.names[1] in reason for reason in judged.reasons)


@pytest.mark.slow
def test_images_tell_who_stands_still():
    """Whatever the rig says: one that is wrong places bodies anywhere."""
    group = calibrated()
    assert not _stands_still(group)
    seen, labels = group.recording.positions, group.matches.labels
    still = replace(
        group,
        recording=replace(group.recording, positions=np.repeat(seen[:, :1], seen.shape[1], axis=1)),
        matches=Matches(np.repeat(labels[:, :1], labels.shape[1], axis=1)),
    )
    assert _stands_still(still)


@pytest.mark.slow
def test_checks_see_what_is_wrong():
    """Half of the poses stretched, a camera blind to who is who, errors in one stretch."""
    group = calibrated()
    frames = len(group.recording.frames)
    stretched = group.poses.positions.copy()
    stretched[::2] *= 2.0
    poses = replace(group.poses, positions=stretched)
    assert not values(replace(group, poses=poses))["bones"].passed
    labels = group.matches.labels.copy()
    labels[2, : frames // 2] = -1
    found = values(replace(group, matches=replace(group.matches, labels=labels)))["unmatched"]
    assert not found.passed
    assert found.camera == group.rig.names[2]
    positions = group.recording.positions.copy()
    positions[1, : frames // 5] += 40.0
    shaken = replace(group, recording=replace(group.recording, positions=positions))
    found = values(shaken)["over time"]
    assert not found.passed
    assert found.camera == group.rig.names[1]


@pytest.mark.slow
def test_reasons_name_the_camera_the_size_and_the_remedy():
    group = replace(calibrated(), uncertainty=uncertainty(4.2, views=4), checks=FAILED)
    first, second = explain(group, Config())
    assert first.startswith(f"camera {group.rig.names[3]} may be turned by 4.2 deg")
    assert "vary by 40%" in second
    focal = replace(group.uncertainty, intrinsics_turn=np.deg2rad([0, 0, 0, 4.0]))
    first, _ = explain(replace(group, uncertainty=focal), Config())
    assert "focal" in first


@pytest.mark.slow
def test_two_cameras_that_face_each_other_want_a_third():
    """Only where no third sees what both do: the last camera loses all that others see as well."""
    group = replace(calibrated(), uncertainty=uncertainty(4.2, views=4), checks=SOUND)
    opposite = group.rig.rotation.copy()
    opposite[3] = np.diag([-1.0, 1, -1]) @ opposite[0]
    adjusted = replace(group.adjusted, rig=replace(group.rig, rotation=opposite))
    labels = group.matches.labels.copy()
    labels[1:3, ::2] = -1
    labels[3, 1::2] = -1
    facing = replace(group, adjusted=adjusted, matches=Matches(labels))
    (said,) = explain(facing, Config())
    assert "cam4 and cam1 face each other, and no third camera sees what both do" in said
    opposite[1] = opposite[0]
    two = replace(group.adjusted, rig=replace(group.rig, rotation=opposite))
    labels = labels.copy()
    labels[1] = group.matches.labels[1]
    for other in (
        replace(facing, matches=group.matches),
        replace(facing, adjusted=group.adjusted),
        replace(facing, adjusted=two, matches=Matches(labels)),
    ):
        (said,) = explain(other, Config())
        assert "face each other" not in said


@pytest.mark.slow
def test_a_verdict_is_only_ever_lowered():
    group = calibrated()
    lowered = no_better_than(group, "weak", "an estimate")
    assert lowered.verdict == "weak"
    assert lowered.reasons[-1] == "an estimate"
    assert no_better_than(lowered, "usable", "another").verdict == "weak"
