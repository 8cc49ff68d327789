"""What `inspect` foretells: subjects that stand still or are flat, cameras that see too little."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PEOPLE, scene

from mocap_calib.inspection import find_problems, inspect_views
from mocap_calib.inspection.contents import measure_motion
from mocap_calib.inspection.finding import InspectConfig
from mocap_calib.inspection.view_pairs import compare_views, find_poor_views
from mocap_calib.types import Keypoints2D

CONFIG = InspectConfig()
NAMES = tuple(PEOPLE.keypoints[:17])
MEANINGS = {name: name for name in NAMES}
WALK_FRAMES = 60
IMAGE = (1280, 720)
UP = np.array([0.0, 0, 1])


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


# --- two views of one subject


def walk(rng, bodies=1, thickness=1.0, frames=WALK_FRAMES):
    """Return `[frame, body, joint, 3]` metres of bodies that go about and turn, about the origin.

    thickness: of all that is seen along the first axis, 0 = in a plane.
    """
    body = rng.normal(size=(len(NAMES), 3)) * [0.2, 0.2, 0.5]
    time = np.linspace(0, 6, frames)[:, None] + rng.uniform(0, 6, bodies)
    heading = np.stack([np.cos(2 * time), -np.sin(2 * time)], -1)
    turned = np.stack([heading, heading[..., ::-1] * [-1, 1]], -1)  # [frame, body, 2, 2]
    level = np.einsum("fbij,kj->fbki", turned, body[:, :2])
    place = np.stack([np.sin(time), np.cos(1.7 * time)], -1)
    upright = np.broadcast_to(body[:, 2], level.shape[:-1])[..., None]
    points = np.concatenate([level + place[..., None, :], upright], axis=-1)
    return points * [thickness, 1, 1]


def film(name, azimuth, points, rng, noise_px=2.0):
    """Return the file of a level camera 4 m from the origin, of bodies as `walk` returns them."""
    turn = np.radians(azimuth)
    ahead = -np.array([np.cos(turn), np.sin(turn), 0.0])
    axes = np.stack([np.cross(ahead, UP), -UP, ahead])
    seen = (points + 4 * ahead) @ axes.T
    pixels = 600 * seen[..., :2] / seen[..., 2:] + np.array(IMAGE) / 2
    pixels += noise_px * rng.normal(size=pixels.shape)
    return Keypoints2D(
        name,
        NAMES,
        np.arange(len(points)),
        pixels,
        np.full(pixels.shape[:3], 0.9),
        False,
        IMAGE,
        f"{name}.json",
    )


def views_at(*azimuths, seed=0, noise_px=2.0, **changes):
    rng = np.random.default_rng(seed)
    points = walk(rng, **changes)
    return [
        film(f"cam{k}", azimuth, points, rng, noise_px) for k, azimuth in enumerate(azimuths, 1)
    ]


def test_the_cameras_of_these_tests_look_at_the_origin():
    (view,) = views_at(30.0, noise_px=0.0)
    assert np.abs(np.median(view.positions, axis=(0, 1, 2)) - np.array(IMAGE) / 2).max() < 150


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("apart", "facing"), [(60, False), (110, False), (172, True), (180, True)])
def test_two_cameras_that_look_at_each_other_are_named(apart, facing, seed):
    found = [each for each in messages(views_at(0, apart, seed=seed)) if "each other" in each]
    assert len(found) == facing
    if facing:
        assert found[0].startswith("cam1 and cam2 look at each other, and no third camera")


def test_a_third_camera_makes_good_for_two_that_look_at_each_other():
    assert not messages(views_at(0, 180, 90))


def test_cameras_behind_each_other_do_not_look_at_each_other():
    first, second = views_at(0, 0)
    second.positions[...] = 1.3 * (second.positions - 500) + 500
    assert not any("each other" in each for each in messages([first, second]))


@pytest.mark.parametrize(
    ("thickness", "noise_px", "flat"),
    [(0, 0.5, True), (0, 4, True), (0.02, 4, True), (0.5, 4, False), (1, 0.5, False)],
)
def test_what_lies_in_one_plane_is_named(thickness, noise_px, flat):
    found = messages(views_at(20, 60, 110, thickness=thickness, noise_px=noise_px))
    assert any("may as well lie in one plane" in each for each in found) == flat


@pytest.mark.parametrize("apart", [0.5, 1.0])
def test_cameras_side_by_side_are_named_with_what_lies_in_a_plane(apart):
    """3.5 and 7 cm between cameras at 4 m: the same sight twice."""
    (said,) = messages(views_at(0, apart, noise_px=4.0))
    assert "or the cameras stand side by side" in said


def test_a_facing_pair_is_found_among_many_cameras():
    """Five pairs, each of which sees the subject at a time of its own; one faces each other."""
    views = []
    for number in range(5):
        own = range(12 * number, 12 * number + 12)
        found = views_at(0, 180 if number == 3 else 70, seed=number, frames=12)
        views += [
            replace(view, camera=f"cam{number}{side}", frames=np.array(own))
            for side, view in zip("ab", found, strict=True)
        ]
    config = replace(CONFIG, most_pairs=1, enough_frames=10)
    report = inspect_views(views, PEOPLE, {}, config)
    (found,) = find_poor_views(views, report["pairs"], MEANINGS, config)
    assert found.message.startswith("cam3a and cam3b look at each other")


def test_views_that_share_no_joint_in_any_frame_tell_nothing(recwarn):
    first, second = views_at(0, 90)
    first.positions[:, :, ::2], second.positions[:, :, 1::2] = np.nan, np.nan
    assert compare_views(first, second, MEANINGS, CONFIG) is None
    second.positions[:50] = views_at(0, 90)[1].positions[:50]
    assert compare_views(first, second, MEANINGS, CONFIG).error < 0.05
    assert not recwarn.list


def test_where_there_are_several_subjects_nothing_is_said():
    views = views_at(0, 180, bodies=2)
    assert compare_views(*views, MEANINGS, CONFIG) is None
    assert not any("each other" in each for each in messages(views))


def test_where_frames_are_of_different_moments_nothing_is_said():
    first, second = views_at(0, 180)
    second.positions[...] = np.random.default_rng(1).permutation(second.positions)
    assert not any("each other" in each for each in messages([first, second]))


def test_joints_are_compared_by_what_they_mean_and_frames_by_their_numbers():
    first, second = views_at(0, 100)
    plain = compare_views(first, second, MEANINGS, CONFIG)
    backwards = Keypoints2D(
        "other",
        NAMES[::-1],
        second.frames[5:],
        second.positions[5:, :, ::-1],
        second.confidence[5:],
        False,
        IMAGE,
        "other.json",
    )
    again = compare_views(first, backwards, MEANINGS, CONFIG)
    assert max(plain.error, again.error) < 0.05
