"""Detections that a file has twice in one frame."""

from dataclasses import replace

import numpy as np
from scenes import scene

from mocap_calib.inspection.finding import InspectConfig
from mocap_calib.inspection.problems import _find_weaknesses
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.synchronise import find_repeated, make_recording
from mocap_calib.types import Keypoints2D


def with_copies(view: Keypoints2D) -> Keypoints2D:
    """Return a view in whose file each detection of the even frames stands again, behind all."""
    again = np.where(
        np.arange(len(view.frames))[:, None, None, None] % 2 == 0, view.positions, np.nan
    )
    sure = np.where(np.isfinite(again[..., 0]), view.confidence, 0.0)
    return replace(
        view,
        positions=np.concatenate([view.positions, again], axis=1),
        confidence=np.concatenate([view.confidence, sure], axis=1),
    )


def test_copies_are_found_and_the_first_is_not_one():
    positions = np.random.default_rng(0).uniform(0, 100, (5, 3, 6, 2))
    positions[:, :, 5] = np.nan
    positions[2, 2], positions[3, 1], positions[3, 2] = (
        positions[2, 0],
        positions[3, 0],
        positions[3, 0],
    )
    expected = np.zeros((5, 3), dtype=bool)
    expected[2, 2] = expected[3, 1] = expected[3, 2] = True
    np.testing.assert_array_equal(find_repeated(positions), expected)


def test_nearly_the_same_is_another_body():
    """One keypoint that differs, one that is missing, or so few that chance may do it."""
    one = np.random.default_rng(0).uniform(0, 100, (6, 2))
    moved, partly, few = one.copy(), one.copy(), np.full((6, 2), np.nan)
    moved[3, 1] += 1e-3
    partly[2] = np.nan
    few[:2] = one[:2]
    assert not find_repeated(np.stack([one, moved, partly, few, few])[None]).any()


def test_a_recording_with_copies_is_the_one_without():
    """All that is computed follows from its arrays."""
    made, people = scene(people=2), load_skeleton("people")
    copied = make_recording(
        [with_copies(view) for view in made.files], made.rig.cameras, people, {}
    )
    whole = make_recording(made.files, made.rig.cameras, people, {})
    instances = whole.positions.shape[2]
    np.testing.assert_array_equal(copied.positions[:, :, :instances], whole.positions)
    np.testing.assert_array_equal(copied.confidence[:, :, :instances], whole.confidence)
    assert not copied.seen[:, :, instances:].any()


def test_inspect_counts_them():
    view = with_copies(scene(people=2).files[0])
    seen = np.isfinite(view.positions[..., 0]).any(-1)
    said = [finding.message for finding in _find_weaknesses(view, InspectConfig())]
    expected = f"{seen[:, 2:].sum()} of {seen.sum()} detections repeat another one of their frame"
    assert any(expected in text for text in said)
