"""The verdict on a rig: of its uncertainty, the checks of residuals, and what is left open."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scenes import calibrated, with_labels

import mocap_calib as mc
from mocap_calib.config import Config
from mocap_calib.results import Cause, Clocks, RigCovariance, Uncertainty, Verdict
from mocap_calib.types import CameraClock, EstimatedCamera
from mocap_calib.verdict.checks import CHECKS, OPEN_DEG, check_rig
from mocap_calib.verdict.verdict import expected_error, judge

SETTINGS = Config().uncertainty


@cache
def sound() -> mc.GroupResult:
    return calibrated()


def judged(group: mc.GroupResult, **fields) -> mc.GroupResult:
    """Return the group as a result of this group alone is judged."""
    made = {"clocks": Clocks.of_one(group.recording), **fields}
    (found,) = judge(mc.CalibrationResult((group,), (), (), **made)).groups
    return found


def causes_of(group: mc.GroupResult, name: str, **fields) -> list[Cause]:
    return [each for each in judged(group, **fields).assessment.causes if each.name == name]


def check(group: mc.GroupResult, name: str) -> Cause:
    (found,) = (each for each in check_rig(group, Config()) if each.name == name)
    return found


def uncertainty(
    degrees: float, *, views: int = 4, odd: tuple[int, ...] = (), all_turned: float = 0.0
) -> Uncertainty:
    """Return the uncertainty of a rig whose last camera may be turned by so many degrees.

    odd: outlier cameras. all_turned: degrees by which every camera may be turned too.
    """
    matrix = np.zeros((views, 6, views, 6))
    matrix[-1, 0, -1, 0] = np.deg2rad(degrees) ** 2
    turns = np.zeros((1, views, 6))
    turns[..., 0] = np.deg2rad(all_turned)
    none = np.zeros(views, dtype=bool)
    return Uncertainty(
        covariance=RigCovariance(matrix, 1.0).with_changes(turns),
        intrinsics_turn=np.zeros(views),
        outlier_cameras=np.isin(np.arange(views), odd),
        weak_perspective=none,
        focal_change=np.zeros(views),
        focal_sigma=np.ones(views),
        wrong_focal=none,
    )


# --- the word, and what adds to the error


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


def cause(degrees: float, camera: str = "", name: str = "errors") -> Cause:
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
        cause(0.6, "a", "covariance"),
        cause(0.4, "a", "over time"),
    )
    assert Verdict(1.5, causes).reasons == (causes[0], causes[2])
    assert Verdict(0.9, causes).reasons == ()


def test_a_check_without_a_value_does_not_fail():
    assert cause(np.nan).passed
    assert cause(0.9).passed
    assert not cause(1.1).passed


def test_the_sigma_of_a_pair_follows_from_that_of_its_cameras():
    matrix = np.zeros((2, 6, 2, 6))
    matrix[0, 0, 0, 0] = matrix[1, 0, 1, 0] = 4.0
    matrix[0, 4, 0, 4] = 9.0
    found = RigCovariance(matrix=matrix, size=1.0)
    np.testing.assert_allclose(found.pair_rotation_sigma, [[0, np.sqrt(8)], [np.sqrt(8), 0]])
    np.testing.assert_allclose(found.pair_centre_sigma, [[0, 3], [3, 0]])
    together = matrix.copy()  # both turn alike: their relative rotation stays
    together[0, 0, 1, 0] = together[1, 0, 0, 0] = 4.0
    np.testing.assert_allclose(RigCovariance(together, size=1.0).pair_rotation_sigma, 0)
    wider = found.with_changes(np.full((1, 2, 6), 1.0))
    np.testing.assert_allclose(wider.rotation_sigma, np.sqrt(4 + 3))
    assert RigCovariance.unknown(3, 1.0).pair_rotation_sigma.max() == pytest.approx(np.pi)


# --- a rig, and what makes it worse


def test_a_sound_recording_passes_all_checks():
    checks = check_rig(sound(), Config())
    assert max(each.error_deg for each in checks) < 0.5, checks
    found = judged(sound())
    assert (found.verdict, found.reasons) == ("well determined", ())
    assert {each.name for each in found.assessment.causes} >= {"covariance", "principal point"}


@pytest.mark.parametrize(
    ("degrees", "remedy"), [(0.0, "walk about"), (4.0, "focal length"), (1.0, "walk about")]
)
def test_the_covariance_is_a_cause_and_its_reason_names_camera_size_and_remedy(degrees, remedy):
    """The focal lengths are the reason where more than half of the variance is theirs."""
    known = replace(uncertainty(4.2), intrinsics_turn=np.deg2rad([0, 0, 0, degrees]))
    first = str(judged(replace(sound(), uncertainty=known)).reasons[0])
    assert first.startswith(f"{sound().rig.names[3]}: rotation +-4.2 deg")
    assert remedy in first


@pytest.mark.parametrize(
    ("degrees", "of_all", "odd", "named"),
    [
        (20.0, 0.0, (1,), []),
        (0.5, 5.0, (1,), []),
        (0.5, 0.0, (1, 3), []),
        (5.0, 0.0, (1,), [1]),
    ],
)
def test_a_camera_is_inconsistent_only_where_the_others_determine_that(degrees, of_all, odd, named):
    """Not in a rig that is uncertain, nor where half of the cameras stand out."""
    known = uncertainty(degrees, odd=odd, all_turned=of_all)
    found = judged(replace(sound(), uncertainty=known))
    assert np.flatnonzero(found.uncertainty.outlier_cameras).tolist() == named
    assert len(found.reasons) > 0


def test_among_cameras_that_belong_to_no_good_pair_none_is_inconsistent():
    pairs = tuple(replace(pair, score=0.4) for pair in sound().pairs)
    found = judged(replace(sound(), uncertainty=uncertainty(0.5, odd=(1,)), pairs=pairs))
    assert not found.uncertainty.outlier_cameras.any()


@pytest.mark.parametrize(
    ("word", "mend", "verdict"),
    [
        ("mirrored", None, "weak"),
        ("sides", None, "well determined"),
        ("cropped", mc.Cropped("cam1", 0.0, 0.0, 5.0), "usable"),
    ],
)
def test_a_fault_makes_a_rig_weak_where_it_is_not_corrected(word, mend, verdict):
    fault = mc.Fault("cam1", word, "it is wrong", mend=mend)
    found = judged(sound(), faults=(fault,))
    assert found.verdict == verdict
    assert all("it is wrong" in reason.meaning for reason in found.reasons)


def test_a_clock_that_is_not_corrected_makes_a_rig_weak():
    late = [CameraClock("cam1", "clock", 5), *map(CameraClock, sound().rig.names[1:])]
    found = judged(sound(), clocks=Clocks.of_one(sound().recording, late))
    assert found.verdict == "weak"
    assert next(each.name for each in found.assessment.causes) == "clock"


def test_a_rig_that_may_be_reversed_in_depth_is_weak():
    adjusted = replace(sound().adjusted, depth_reversed_rig=sound().rig)
    (found,) = causes_of(replace(sound(), adjusted=adjusted), "depth")
    assert found.error_deg == OPEN_DEG


@pytest.mark.parametrize(
    ("estimated", "beside", "corner", "share"),
    [
        (False, 0.0, None, SETTINGS.given_principal_point),
        (True, 5.0, None, SETTINGS.given_principal_point),  # it was given
        (True, 0.5, None, SETTINGS.principal_point),  # readers differ by half a pixel
        (False, 0.0, 0.024, 0.03),  # of a cropped image: both, in squares
    ],
)
def test_what_is_not_known_of_a_principal_point_turns_its_camera(estimated, beside, corner, share):
    camera = sound().recording.cameras[0]
    matrix, width = camera.matrix.copy(), max(camera.size)
    matrix[:2, 2] = (np.array(camera.size) - 1) / 2 + [beside, 0]
    camera = replace(camera, matrix=matrix)
    if estimated:
        camera = EstimatedCamera.of(camera, focal_sigma=1.0, k1_sigma=0.0)
    rig = replace(sound().rig, cameras=(camera, *sound().rig.cameras[1:]))
    group = replace(sound(), adjusted=replace(sound().adjusted, rig=rig))
    crop = None if corner is None else mc.Cropped("cam1", 0.0, 0.0, corner * width)
    faults = () if crop is None else (mc.Fault("cam1", "cropped", "it is", mend=crop),)
    found = next(
        each for each in causes_of(group, "principal point", faults=faults) if each.camera == "cam1"
    )
    if corner is not None:
        share = np.hypot(corner, SETTINGS.principal_point)
    assert found.error_deg == pytest.approx(np.rad2deg(np.sqrt(2) * share * width / camera.focal))


@pytest.mark.parametrize(("cameras", "given", "open_"), [(2, 0, 1), (2, 1, 0), (3, 0, 0)])
def test_no_third_camera_checks_the_intrinsics_of_two(cameras, given, open_):
    group = calibrated(cameras=cameras, people=1, frames=30)
    estimated = [
        EstimatedCamera.of(each, focal_sigma=1.0, k1_sigma=0.0)
        for each in group.recording.cameras[given:]
    ]
    known = (*group.recording.cameras[:given], *estimated)
    rig = replace(group.rig, cameras=known)
    group = replace(group, adjusted=replace(group.adjusted, rig=rig))
    assert len(causes_of(group, "intrinsics")) == open_


# --- checks


def test_each_check_has_a_row_on_the_page():
    page = (Path(__file__).parents[2] / "docs" / "how-good.md").read_text("utf-8")
    table = page.split("## The checks")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\w -]+?) \| (.*) \|$", table, re.MULTILINE)
    assert rows[1:] == [(kind.name, kind.text) for kind in CHECKS]


def test_detections_that_stay_unassigned_count_by_their_share():
    labels = sound().matches.labels.copy()
    labels[2, : len(sound().recording.frames) // 2] = -1
    found = check(with_labels(sound(), labels), "unmatched")
    assert found.camera == sound().rig.names[2]
    detected = sound().recording.detected
    share = (labels >= 0)[2][detected[2]].mean()
    assert found.error_deg == pytest.approx(OPEN_DEG * (1 - share) ** 2)
    assert not found.passed


def shaken(view: int, frames: slice, offset: np.ndarray | float) -> mc.GroupResult:
    """Return the group whose detections of a camera are moved by so many pixels."""
    positions = sound().recording.positions.copy()
    positions[view, frames] += offset
    return replace(sound(), recording=replace(sound().recording, positions=positions))


def test_detections_to_one_side_in_a_stretch_of_time_are_seen():
    frames = slice(len(sound().recording.frames) // 5)
    found = check(shaken(1, frames, 40.0), "over time")
    turn = np.rad2deg(40.0 / sound().rig.cameras[1].focal)
    assert turn < found.error_deg < 2 * turn  # along both axes of the image
    assert found.camera == sound().rig.names[1]


def test_errors_to_all_sides_are_seen_by_their_median():
    """20 px each; not as errors over time, which they are not."""
    turn = np.random.default_rng(0).uniform(0, 2 * np.pi, sound().recording.positions.shape[1:4])
    group = shaken(1, slice(None), 20.0 * np.stack([np.cos(turn), np.sin(turn)], -1))
    found = check(group, "errors")
    assert found.camera == sound().rig.names[1]
    expected = np.rad2deg(20.0 / sound().rig.cameras[1].focal)
    assert found.error_deg == pytest.approx(expected, rel=0.1)
    assert check(group, "over time").error_deg < 0.3 * expected


def test_a_camera_is_as_good_as_its_best_pair():
    """All pairs of the last one have half of the score that is not weak."""
    weak, last = Config().averaging.weak_score, len(sound().rig) - 1
    pairs = tuple(
        replace(pair, score=0.5 * weak if last in (pair.a, pair.b) else (0.1, 0.9)[pair.a == 0])
        for pair in sound().pairs
    )
    found = check(replace(sound(), pairs=pairs), "pair score")
    assert (found.camera, found.error_deg) == (sound().rig.names[last], pytest.approx(2.5))


def test_a_rig_that_did_not_converge_is_open():
    adjusted = replace(sound().adjusted, converged=False)
    assert check(replace(sound(), adjusted=adjusted), "convergence").error_deg == OPEN_DEG
