"""What `inspect` foretells of subjects that stand still, and of cameras that share too little."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PEOPLE, scene

from mocap_calib.config import InspectConfig
from mocap_calib.inspection import find_problems, inspect_views
from mocap_calib.inspection.motion import measure_motion

CONFIG = InspectConfig()


def messages(views) -> list[str]:
    report = inspect_views(views, PEOPLE, {}, CONFIG)
    found = find_problems(views, report, cameras=(), skeleton=PEOPLE, aliases={}, config=CONFIG)
    assert not any(each.critical for each in found)
    return [each.message for each in found]


def frozen(views, noise: float, frames: int = 60):
    """One frame of each view, repeated with noise in pixels."""
    rng = np.random.default_rng(0)
    stay = np.full(frames, 20)
    return [
        replace(
            view,
            frames=np.arange(frames),
            positions=view.positions[stay] + rng.normal(0, noise, view.positions[stay].shape),
            confidence=view.confidence[stay],
        )
        for view in views
    ]


def sees_only(view, frames):
    """The view with detections in these frames alone."""
    seen = np.isin(view.frames, list(frames))
    return replace(view, positions=np.where(seen[:, None, None, None], view.positions, np.nan))


@pytest.mark.parametrize("people", [1, 3])
@pytest.mark.parametrize("noise", [0.5, 3.0])
def test_a_still_subject_is_foretold(people, noise):
    """Simulated 0.01 to 0.07 of a body."""
    views = frozen(scene(people=people, noise_px=0.0, false_detections=0.0).files, noise)
    assert all(measure_motion(view, CONFIG) < 0.9 * CONFIG.least_motion for view in views)
    (said,) = [each for each in messages(views) if "hardly anything moves" in each]
    assert "let somebody walk about" in said


@pytest.mark.parametrize("changes", [{}, {"people": 1}, {"people": 1, "frames": 10}])
def test_subjects_that_move_are_not_warned_of(changes):
    """Simulated 0.3 of a body and more, in the median over the cameras."""
    views = scene(**changes).files
    assert not any("hardly anything moves" in each for each in messages(views))
    assert np.median([measure_motion(view, CONFIG) for view in views]) > 3 * CONFIG.least_motion


def test_motion_is_in_body_sizes_and_finds_the_nearest_body():
    """A body that is shifted by its own size; with a second one, the nearest of the two counts."""
    (view, *_) = scene(people=1, noise_px=0.0, false_detections=0.0, missing=0.0).files
    body = view.positions[20, 0]
    size = np.sqrt(((body - body.mean(0)) ** 2).sum(-1).mean())
    shifted = body + [size, 0.0]
    two = replace(
        view,
        frames=np.arange(2),
        positions=np.stack([body, shifted])[:, None],
        confidence=np.ones((2, 1, len(body))),
    )
    assert measure_motion(two, CONFIG) == pytest.approx(1.0)
    both = np.stack([np.stack([body, shifted]), np.stack([shifted, body])])
    crowd = replace(two, positions=both, confidence=np.ones((2, 2, len(body))))
    assert measure_motion(crowd, CONFIG) == pytest.approx(0.0, abs=1e-9)
    assert measure_motion(sees_only(two, [0]), CONFIG) is None
    assert measure_motion(sees_only(two, []), CONFIG) is None


def test_a_camera_that_shares_few_frames_is_named():
    *others, last = scene(cameras=4).files
    assert not any("sees something together" in each for each in messages([*others, last]))
    (said,) = [
        each
        for each in messages([*others, sees_only(last, range(7))])
        if "sees something together" in each
    ]
    assert said.startswith("cam4: sees something together with another camera in 7 frames")


def test_groups_that_share_no_frame_are_foretold():
    views = scene(cameras=4).files
    first, second = range(30), range(30, 60)
    apart = [
        sees_only(view, frames)
        for view, frames in zip(views, (first, second, first, second), strict=True)
    ]
    (said,) = [each for each in messages(apart) if "groups of cameras" in each]
    assert said.startswith("2 groups of cameras see nothing in the same frames")
    assert "(cam1, cam3 | cam2, cam4)" in said
    joined = [*apart[:3], views[3]]
    assert not any("groups of cameras" in each for each in messages(joined))
