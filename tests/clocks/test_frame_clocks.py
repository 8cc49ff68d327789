"""Clocks that differ are found from lifted bodies, exactly, and never where they do not."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles import clocks as oracle
from scenes import lifted, recording

from mocap_calib.clocks.evidence import weigh_clock
from mocap_calib.clocks.frame_clocks import choose_pairs, doubt_lost_frames, find_clocks
from mocap_calib.clocks.kinds import StretchNumbers, describe_clock
from mocap_calib.clocks.paths import Agreements, Ridge, follow_ridge
from mocap_calib.clocks.timing import ViewInTime, compare_in_time
from mocap_calib.config import LARGEST_STEP, SyncConfig
from mocap_calib.faults.clock_faults import Retimed, clock_faults
from mocap_calib.faults.words import option_of
from mocap_calib.kernels import clocks as kernels
from mocap_calib.recording.retiming import clocks_from, retime
from mocap_calib.results import LiftedPoses
from mocap_calib.types import CameraClock

CONFIG = SyncConfig()


@lru_cache
def scene_of(cameras, people, frames=180):
    """Return a recording in step and its lifted bodies."""
    options = {"cameras": cameras, "people": people, "frames": frames, "fps": 12.0}
    return recording(**options), lifted(**options)


def show(made, bodies, shown):
    """Return what is recorded where each view shows other frames `[view][frame]`, -1 = none."""
    count = max(map(len, shown))
    source = np.stack([np.pad(each, (0, count - len(each)), constant_values=-1) for each in shown])
    view = np.arange(len(source))[:, None]
    body = bodies.body[view, source].copy()
    body[source < 0] = np.nan
    changed = LiftedPoses(body, bodies.centre[view, source], bodies.spread[view, source])
    return made.show(source, np.arange(count)), changed


def shift(made, bodies, offsets):
    """Return what is recorded where the frame numbers of each view are too large by so much."""
    least, frames = min(offsets), len(made.frames)
    shown = [np.append(np.full(by - least, -1), np.arange(frames)) for by in offsets]
    return show(made, bodies, shown)


def clocks_of(made, bodies, config=CONFIG):
    frames = np.arange(len(made.frames))[None]
    return find_clocks(made, bodies, frames, config, seed=0)


@pytest.mark.parametrize(
    ("people", "offsets"),
    [
        (1, (0, 7)),
        (3, (0, -12)),
        (1, (0, 1, 0)),
        (2, (0, 0, -3)),
        (1, (3, -5, 8, 0)),
        (3, (0, 1, -1, 1)),
        (2, (0, 40, 0, 0)),
        (1, (0, 0, 60)),
    ],
)
def test_a_shift_is_found_exactly(people, offsets):
    made, bodies = scene_of(len(offsets), people)
    late, late_bodies = shift(made, bodies, offsets)
    clocks = clocks_of(late, late_bodies)
    values, counts = np.unique(offsets, return_counts=True)
    common = next(each for each in offsets if counts[values == each] == counts.max())
    found = [clock.offset for clock in clocks.cameras]
    assert found == [offset - common for offset in offsets]
    assert all((clock.kind == "clock") == (clock.offset != 0) for clock in clocks.cameras)
    mended = retime(late, clocks)
    for view in range(len(offsets)):  # every view shows the same instant as the first
        seen = np.isfinite(mended.positions).any((2, 3, 4))[[0, view]].all(0)
        index = clocks.source[:, seen] + min(offsets) - np.array(offsets)[:, None]
        assert (index[view] == index[0]).all()


@pytest.mark.parametrize(("cameras", "people"), [(2, 1), (3, 2), (4, 3)])
def test_a_recording_in_step_is_returned_as_it_is(cameras, people):
    made, bodies = scene_of(cameras, people)
    clocks = clocks_of(made, bodies)
    assert {clock.kind for clock in clocks.cameras} == {"in step"}
    assert retime(made, clocks) is made
    assert not clock_faults(clocks, applied=True)


def test_no_offset_is_invented_where_nothing_moves():
    made, bodies = scene_of(3, 1)
    still, still_bodies = show(made, bodies, [np.full(150, 20)] * 3)
    noise = np.random.default_rng(0).normal(0, 0.03, still_bodies.body.shape)
    still_bodies = replace(still_bodies, body=still_bodies.body + noise)
    clocks = clocks_of(still, still_bodies)
    assert {clock.kind for clock in clocks.cameras} == {"not known"}
    assert retime(still, clocks) is still


@pytest.mark.parametrize("frames", [1, 5, 25])
def test_no_offset_is_invented_in_a_few_frames(frames):
    made, bodies = scene_of(3, 1)
    shown = [np.arange(frames), np.arange(2, frames + 2), np.arange(frames)]
    few, few_bodies = show(made, bodies, shown)
    clocks = clocks_of(few, few_bodies)
    assert retime(few, clocks) is few


def errors_of(clocks, shown):
    """Return by how many frames what each view shows is off what the first one shows."""
    time = [
        np.where(source >= 0, np.array(each)[np.minimum(source, len(each) - 1)], -1)
        for source, each in zip(clocks.source, shown, strict=True)
    ]
    both = [(time[0] >= 0) & (each >= 0) for each in time]
    return [np.abs(each - time[0])[of] for each, of in zip(time, both, strict=True)]


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_lost_frames_are_found(share):
    """Measured: mean errors up to 0.4 frames; without, they are 2 and 9."""
    made, bodies = scene_of(4, 1)
    kept = np.flatnonzero(np.random.default_rng(1).random(len(made.frames)) >= share)
    shown = [np.arange(len(made.frames)), kept, *[np.arange(len(made.frames))] * 2]
    lossy, lossy_bodies = show(made, bodies, shown)
    clocks = clocks_of(lossy, lossy_bodies)
    kinds = [clock.kind for clock in clocks.cameras]
    assert kinds[1] in ("dropped", "rate")
    assert kinds[:1] + kinds[2:] == ["in step"] * 3
    assert max(error.mean() for error in errors_of(clocks, shown)) < 1.0
    own = clocks.source[1][clocks.source[1] >= 0]
    assert (np.diff(own) > 0).all()  # no frame is shown twice


def test_half_the_rate_is_found():
    made, bodies = scene_of(3, 1)
    frames = np.arange(len(made.frames))
    shown = [frames, frames[::2], frames]
    slow, slow_bodies = show(made, bodies, shown)
    clocks = clocks_of(slow, slow_bodies)
    assert [clock.rate for clock in clocks.cameras] == [1.0, 0.5, 1.0]
    assert max(error.max() for error in errors_of(clocks, shown)) == 0


@pytest.mark.parametrize(
    ("votes", "kinds"),
    [
        ((0.0,), ["dropped"]),
        ((0.0, 0.4), ["not known", "not known"]),
        ((1.0, 0.2), ["dropped", "dropped"]),
        ((1.0, 1.0), ["dropped", "dropped"]),
    ],
)
def test_lost_frames_of_several_cameras_need_the_votes_of_the_others(votes, kinds):
    seeming = tuple(
        CameraClock(f"cam{k}", "dropped", 0, table=((0, 0), (9, 1)), evidence={"votes": share})
        for k, share in enumerate(votes)
    )
    assert [clock.kind for clock in doubt_lost_frames(seeming, CONFIG)] == kinds


def test_views_that_never_see_at_a_common_time_are_compared_without_a_complaint():
    """One sees the first 30 frames, the other the last ones: no offset of the window joins them."""
    _, bodies = scene_of(2, 1)
    body = bodies.body[0, :, :1, :10].astype(np.float32)[None]
    first = np.arange(body.shape[1])[None, :, None] < 30
    views = [
        ViewInTime(np.where(seen[..., None, None], body, 0), seen)
        for seen in (first, first[:, ::-1])
    ]
    found = compare_in_time(*views, SyncConfig(window=5), np.random.default_rng(0))
    assert found is not None
    assert np.allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)


def test_faults_name_the_camera_and_the_option_that_mends_it():
    made, bodies = scene_of(3, 1)
    late, late_bodies = shift(made, bodies, (0, 5, 0))
    clocks = clocks_of(late, late_bodies)
    (fault,) = clock_faults(clocks, applied=True)
    name = made.names[1]
    assert (fault.camera, fault.word) == (name, "clock")
    assert fault.says == "its clock is 5 frames late"
    assert option_of(fault.mend) == f"--frame-offset {name}:-5"
    np.testing.assert_array_equal(fault.mend.apply(late).positions, retime(late, clocks).positions)
    (named,) = clock_faults(clocks, applied=False)
    assert named.mend is None


def test_a_ridge_is_followed_where_frames_were_lost():
    path = np.repeat([5, 4, 2], 30)
    table = np.zeros((1, 90, 11))
    table[0, np.arange(90), path] = 1.0
    table += np.random.default_rng(0).normal(0, 0.1, table.shape)
    found = follow_ridge(table, price=2.0)[0]
    assert np.abs(found - path).max() <= 2
    assert (found == path).mean() > 0.95
    assert np.ptp(follow_ridge(table, price=1e3)) == 0  # steps that cost too much are not made


def test_a_mend_of_one_camera_leaves_the_others():
    made, _ = scene_of(3, 1)
    mend = Retimed(CameraClock(made.names[2], "clock", -4))
    clocks = clocks_from(made, (*map(CameraClock, made.names[:2]), mend.clock))
    mended = mend.apply(made)
    np.testing.assert_array_equal(mended.frames, clocks.frames)
    both = np.isin(mended.frames, made.frames)
    np.testing.assert_array_equal(mended.positions[:2, both], made.positions[:2])


@pytest.mark.parametrize("views", [2, 3, 7, 8, 9, 40])
def test_few_pairs_of_many_cameras_are_compared(views):
    pairs = choose_pairs(views)
    partners = np.bincount(np.ravel(pairs), minlength=views)
    assert pairs == sorted(set(pairs))
    assert all(a < b for a, b in pairs)
    assert len(pairs) <= 3 * views
    assert partners.min() >= min(views - 1, 5)


SURE = {"margin": 9.0, "sigma": 9.0, "score": 0.9, "gain": 0.3, "votes": 1.0, "partners": 3}


@pytest.mark.parametrize(
    ("lost", "kind"),
    [([], "in step"), ([0], "clock"), ([70], "dropped"), ([20, 60, 100, 140, 180], "rate")],
)
def test_steps_that_come_evenly_are_another_rate(lost, kind):
    """Frames that were lost: none, one before the first, one, and every fortieth."""
    time = np.arange(200)
    own = time + sum((time >= frame).astype(np.int64) for frame in lost)
    clock = describe_clock(
        "cam1",
        np.atleast_2d(own + np.zeros(200, dtype=np.int64)),
        1.0,
        numbers=StretchNumbers(np.zeros(1, dtype=np.int64), 1),
        evidence=SURE,
        config=CONFIG,
    )
    assert clock.kind == kind
    begins = [(0, 0)] if lost and lost[0] else []
    steps = [(frame, number) for number, frame in enumerate(lost, 1)]
    assert clock.table == (*begins, *steps)


@pytest.mark.parametrize("price", [0.0, 0.7, 5.0])
def test_compiled_paths_are_those_of_numpy(price):
    """Of numbers that tie, too: the first of equal steps is taken."""
    rng = np.random.default_rng(0)
    for offsets in (1, 2, 5, 41):
        for table in (rng.normal(size=(60, offsets)), rng.integers(0, 3, (60, offsets)) * 1.0):
            expected = oracle.follow(table, price, LARGEST_STEP)
            kernels.follow(table, price, LARGEST_STEP, found := np.empty(60, dtype=np.int64))
            assert (found == expected).all()


def test_a_camera_that_nobody_can_be_compared_with_has_no_evidence():
    """Its share of agreeing cameras is 0, not the mean of nothing (which warns, and is NaN)."""
    agreements = Agreements(
        views=3, found={}, values={(0, 1): np.ones((1, 9, 9), np.float32)}, window=2
    )
    maps = np.tile(np.arange(9), (3, 1, 1))
    ridge = Ridge(
        maps[2], steps=0, agreement=np.zeros((1, 9)), total=0.0, cost=0.0, held_out=np.zeros((1, 9))
    )
    evidence = weigh_clock(agreements, [], 2, ridge, rate=1.0, maps=maps, config=CONFIG)
    assert evidence["votes"] == evidence["score"] == evidence["gain"] == 0.0


@lru_cache
def two_rooms(seed):
    """Return a recording in step, and the bodies that eight cameras of two rooms see.

    Four cameras are in each room, with two people of its own.
    """
    options = {"people": 2, "frames": 60, "fps": 10.0}
    rooms = [lifted(cameras=4, seed=seed + room, **options) for room in range(2)]
    order = np.random.default_rng(seed).permutation(8)
    body, centre, spread = (
        np.concatenate([getattr(room, name) for room in rooms])[order]
        for name in ("body", "centre", "spread")
    )
    return recording(cameras=8, **options), LiftedPoses(body, centre, spread)


@pytest.mark.parametrize("seed", [0, 2, 4, 6])
def test_people_of_another_room_accuse_no_clock(seed):
    """The people of two rooms look alike at some offset; a whole room would seem to be late."""
    clocks = clocks_of(*two_rooms(seed))
    assert not [clock for clock in clocks.cameras if clock.differs]


def test_cameras_that_differ_alike_do_not_vouch_for_each_other():
    """Two cameras agree, and so do two others, but nothing compares the two pairs."""
    time = np.arange(40)
    agree = np.eye(40, dtype=np.float32)[None]
    agreements = Agreements(views=4, found={}, values={(0, 1): agree, (2, 3): agree}, window=5)
    late = np.where(time + 3 < 40, time + 3, -1)
    maps = np.stack([time, time, late, late])[:, None]
    nothing = np.zeros((1, 40))
    ridge = Ridge(maps[2], 0, nothing, 0.0, 0.0, nothing)
    evidence = weigh_clock(agreements, [], 2, ridge, rate=1.0, maps=maps, config=CONFIG)
    assert evidence["partners"] == evidence["score"] == evidence["votes"] == 0


def test_a_clock_that_shows_no_frame_of_the_others_is_not_known():
    clock = describe_clock(
        "cam1",
        np.full((1, 30), -1),
        0.5,
        numbers=StretchNumbers(np.zeros(1, dtype=np.int64), 1),
        evidence=SURE,
        config=CONFIG,
    )
    assert clock.kind == "not known"


def test_windows_of_agreement_are_those_of_numpy():
    """Windows that reach beyond both ends, and rows that are not there."""
    rng = np.random.default_rng(2)
    values = rng.normal(size=(2, 9, 14)).astype(np.float32)
    row, first = rng.integers(-1, 9, (2, 12)), 2 * np.arange(12) - 7
    found, defined = np.ones((2, 2, 12, 9))
    kernels.add_windows(values, row, first, found)
    oracle.add_windows(values, row, first, defined)
    np.testing.assert_array_equal(found, defined)
    assert (row < 0).any()
    assert (found[:, 6] != 1)[row[:, 6] >= 0].all()
    assert (found[row < 0] == 1).all()
