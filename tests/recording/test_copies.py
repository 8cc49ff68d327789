"""A file that was given twice is refused, with both names."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PEOPLE, scene

from mocap_calib.errors import MismatchError
from mocap_calib.recording.synchronise import find_copies, make_recording


def views():
    return scene(people=2).files


def meanings(files):
    return {name: name for view in files for name in view.keypoints}


def copy_of(view, other, **changes):
    """The detections of a view under the name of another one."""
    return replace(view, camera=other.camera, source=other.source, **changes)


def test_a_file_given_twice_is_refused_with_both_names():
    first, second, *others = views()
    given = (first, copy_of(first, second), *others)
    with pytest.raises(MismatchError) as refused:
        make_recording(given, scene(people=2).rig.cameras, PEOPLE, {})
    said = str(refused.value)
    assert "\n" not in said
    for name in (first.camera, second.camera, first.source, second.source):
        assert name in said


def test_a_copy_is_found_in_any_order_at_any_shift_and_to_other_digits():
    first, second, *_ = views()
    shuffled = first.positions[:, ::-1]
    rounded = np.round(first.positions, 3)
    for copy, shift in (
        (copy_of(first, second, positions=shuffled), 0),
        (copy_of(first, second, positions=rounded), 0),
        (copy_of(first, second, frames=first.frames + 7), 7),
        (copy_of(first, second, frames=first.frames - 3), -3),
        (copy_of(first, second, positions=first.positions + 1e-4), 0),
    ):
        (says,) = find_copies((first, copy), meanings(views()))
        later = second.camera if shift > 0 else first.camera
        assert ("later" in says) == (shift != 0)
        assert not shift or f"{abs(shift)} frames later in {later}" in says
    part = copy_of(
        first,
        second,
        frames=first.frames[10:],
        positions=first.positions[10:],
        confidence=first.confidence[10:],
    )
    assert len(find_copies((part, first), meanings(views()))) == 1


def test_views_of_one_scene_are_no_copies():
    assert find_copies(views(), meanings(views())) == []


def test_subjects_that_stand_still_before_cameras_side_by_side_are_no_copies():
    """Each detection is within a fraction of a pixel of the other camera's."""
    first, second, *_ = views()
    still = np.repeat(first.positions[:1], len(first.frames), 0)
    rng = np.random.default_rng(0)
    near = [
        copy_of(first, view, positions=still + rng.normal(scale=0.1, size=still.shape))
        for view in (first, second)
    ]
    assert find_copies(near, meanings(views())) == []


def test_of_few_detections_nothing_is_said():
    first, second, *_ = views()
    few = {name: getattr(first, name)[:5] for name in ("frames", "positions", "confidence")}
    pair = (replace(first, **few), copy_of(first, second, **few))
    assert find_copies(pair, meanings(views())) == []
    assert len(find_copies(pair, meanings(views()), least=1)) == 1
