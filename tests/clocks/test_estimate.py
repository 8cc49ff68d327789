"""Clocks that differ are found from lifted bodies, exactly, and never where they do not."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles import clocks as oracle
from scenes import lifted, recording

from mocap_calib.clocks.compare import Agreements, ViewInTime, compared_pairs, search_rotation
from mocap_calib.clocks.estimate import clocks_from, combine_clocks, find_clocks, retime
from mocap_calib.clocks.maps import (
    Timing,
    describe_clock,
    evidence,
    follow_ridge,
    weigh,
)
from mocap_calib.config import SyncConfig
from mocap_calib.faults.hypotheses import clock_faults, option_of
from mocap_calib.kernels import clocks as kernels
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
    return clocks_from(made, find_clocks(made, bodies, frames, {}, config, seed=0))


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


@pytest.mark.parametrize("share", [0.03, 0.1])
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


def test_views_that_never_see_at_a_common_time_are_compared_without_a_complaint():
    """One sees the first 30 frames, the other the last ones: no offset of the window joins them."""
    _, bodies = scene_of(2, 1)
    body = bodies.body[0, :, :1, :10].astype(np.float32)[None]
    first = np.arange(body.shape[1])[None, :, None] < 30
    views = [
        ViewInTime(np.where(seen[..., None, None], body, 0), seen)
        for seen in (first, first[:, ::-1])
    ]
    found = search_rotation(*views, 5, np.random.default_rng(0))
    assert np.allclose(found @ found.T, np.eye(3), atol=1e-9)


def test_faults_name_the_camera_and_the_option_that_mends_it():
    made, bodies = scene_of(3, 1)
    late, late_bodies = shift(made, bodies, (0, 5, 0))
    clocks = clocks_of(late, late_bodies)
    (fault,) = clock_faults(clocks, applied=True)
    name = made.names[1]
    assert (fault.camera, fault.word) == (name, "clock")
    assert fault.says == "its clock is 5 frames late"
    assert option_of(fault.mend) == f"--frame-offset {name}:-5"
    assert fault.mend == clocks.cameras[1]
    (named,) = clock_faults(clocks, applied=False)
    assert named.mend is None


def test_a_ridge_is_followed_where_frames_were_lost():
    path = np.repeat([5, 4, 2], 30)
    table = np.zeros((1, 90, 11))
    table[0, np.arange(90), path] = 1.0
    table += np.random.default_rng(0).normal(0, 0.1, table.shape)
    found = follow_ridge(table, partners=1)[0]
    assert np.abs(found - path).max() <= 2
    assert (found == path).mean() > 0.95
    assert np.ptp(follow_ridge(table / 1000, partners=1)) == 0  # steps that gain too little


def test_the_clock_of_one_camera_leaves_the_others():
    made, _ = scene_of(3, 1)
    clocks = clocks_from(made, [CameraClock(made.names[2], "clock", -4)])
    mended = retime(made, clocks)
    np.testing.assert_array_equal(mended.frames, clocks.frames)
    both = np.isin(mended.frames, made.frames)
    np.testing.assert_array_equal(mended.positions[:2, both], made.positions[:2])


@pytest.mark.parametrize("views", [2, 3, 7, 8, 9, 40])
def test_few_pairs_of_many_cameras_are_compared(views):
    pairs = compared_pairs(views)
    partners = np.bincount(np.ravel(pairs), minlength=views)
    assert pairs == sorted(set(pairs))
    assert all(a < b for a, b in pairs)
    assert len(pairs) <= 3 * views
    assert partners.min() >= min(views - 1, 5)


SURE = {"margin": 9.0, "score": 0.9, "gain": 9.0, "partners": 3.0}
NUMBERS = np.arange(200)[None]


def timing_of(*maps, rate=1.0):
    """The timing of maps `[frame]`, one for each camera."""
    own = np.array(maps)[:, None]
    return Timing(own, np.full(len(own), rate))


@pytest.mark.parametrize(
    ("lost", "kind"),
    [([], "in step"), ([0], "clock"), ([70], "dropped"), ([20, 60, 100, 140, 180], "rate")],
)
def test_steps_that_come_evenly_are_another_rate(lost, kind):
    """Frames that were lost: none, one before the first, one, and every fortieth."""
    time = np.arange(200)
    own = time + sum((time >= frame).astype(np.int64) for frame in lost)
    timing = timing_of(own + np.zeros(200, dtype=np.int64))
    clock = describe_clock("cam1", timing, 0, NUMBERS, SURE, window=60)
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
            expected = oracle.follow(table, price)
            kernels.follow(table, price, found := np.empty(60, dtype=np.int64))
            assert (found == expected).all()


def test_a_camera_that_is_compared_with_none_has_no_evidence():
    """Its agreement is 0, not the mean of nothing (which warns, and is NaN)."""
    agreements = Agreements(views=3, measured={(0, 1): np.ones((1, 9, 9), np.float32)}, window=2)
    found = weigh(agreements, Timing.synchronous(3, (1, 9)), 2)
    assert not any(found.values())


def test_evidence_is_of_blocks_of_time():
    """Neighbouring frames err alike: as often repeated, the same blocks are the same evidence."""
    blocks = np.random.default_rng(0).normal(0.3, 1.0, 20)
    frames = np.repeat(blocks, 40)[None]
    found = evidence(frames, np.ones(frames.shape, bool))
    ratio = blocks.mean() ** 2 / blocks.var()
    np.testing.assert_allclose(found, 20 / 2 * np.log1p(ratio), rtol=1e-6)
    assert evidence(-frames, np.ones(frames.shape, bool)) == -found
    assert evidence(frames[:, :19], np.ones((1, 19), bool)) == 0.0  # too few frames


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
    agreements = Agreements(views=4, measured={(0, 1): agree, (2, 3): agree}, window=5)
    late = np.where(time + 3 < 40, time + 3, -1)
    found = weigh(agreements, timing_of(time, time, late, late), 2)
    assert found["partners"] == found["score"] == 0


def test_a_clock_that_shows_no_frame_of_the_others_is_not_known():
    timing = timing_of(np.full(30, -1), rate=0.5)
    assert describe_clock("cam1", timing, 0, NUMBERS, SURE, window=60).kind == "not known"


def test_a_clock_beyond_the_window_is_not_known():
    timing = timing_of(np.arange(30) + 7)
    some = NUMBERS[:, :30]
    kinds = [describe_clock("c", timing, 0, some, SURE, window=each).kind for each in (6, 7)]
    assert kinds == ["not known", "clock"]


def test_what_is_left_of_a_clock_is_added_to_what_was_found():
    late = CameraClock("cam1", "clock", 5, table=((0, 5),))
    more = CameraClock("cam1", "clock", 2, table=((0, 2),))
    back = CameraClock("cam1", "clock", -5, table=((0, -5),))
    lossy = CameraClock("cam1", "dropped", 0, table=((0, 0), (9, -1)))
    known, unknown = CameraClock("cam1", "in step"), CameraClock("cam1")
    assert combine_clocks(late, more).offset == 7
    assert combine_clocks(late, back).kind == "in step"
    assert combine_clocks(lossy, more).table == ((-2, 2), (7, 1))
    assert combine_clocks(late, known) == combine_clocks(late, unknown) == late
    assert combine_clocks(unknown, more) == more
    assert combine_clocks(known, unknown) == combine_clocks(unknown, known) == known
