"""Clocks that differ by frames are found from lifted bodies, exactly, and never where they do not.

Rotations and offsets of two views are held to their definitions.
"""

from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from oracles import clocks as oracle
from scenes import (
    adjust_twice,
    angles_deg,
    calibrate_group,
    lifted,
    recording,
    rotation_errors_deg,
    sample_of,
    turn_matrix,
)

import mocap_calib as mc
from mocap_calib.clocks.compare import (
    Agreements,
    ViewInTime,
    agreement,
    compared_pairs,
    search_rotation,
)
from mocap_calib.clocks.estimate import (
    clocks_from,
    combine_clocks,
    find_clocks,
    own_frames,
    retime,
)
from mocap_calib.clocks.maps import (
    Timing,
    describe_clock,
    describe_clocks,
    evidence,
    find_timing,
    follow_ridge,
    weigh,
)
from mocap_calib.clocks.subframe import find_time_offsets, resample
from mocap_calib.config import CLOCK_RATES, Config, PairwiseConfig, SyncConfig
from mocap_calib.kernels import clocks as kernels
from mocap_calib.results import NO_FRAME, Clocks, LiftedPoses
from mocap_calib.types import CameraClock

CONFIG = SyncConfig()


@lru_cache
def scene_of(cameras: int, people: int, frames: int = 180) -> tuple[mc.Recording, LiftedPoses]:
    """Return a recording in step and its lifted bodies."""
    options = {"cameras": cameras, "people": people, "frames": frames, "fps": 12.0}
    return recording(**options), lifted(**options)


def show(
    made: mc.Recording, bodies: LiftedPoses, shown: list[np.ndarray]
) -> tuple[mc.Recording, LiftedPoses]:
    """Return what is recorded where each view shows other frames `[view][frame]`, -1 = none."""
    count = max(map(len, shown))
    source = np.stack([np.pad(each, (0, count - len(each)), constant_values=-1) for each in shown])
    view = np.arange(len(source))[:, None]
    body = bodies.body[view, source].copy()
    body[source < 0] = np.nan
    changed = LiftedPoses(body, bodies.centre[view, source], bodies.spread[view, source])
    return made.show(source, np.arange(count)), changed


def shift(
    made: mc.Recording, bodies: LiftedPoses, offsets: tuple[int, ...]
) -> tuple[mc.Recording, LiftedPoses]:
    """Return what is recorded where the frame numbers of each view are too large by so much."""
    least, frames = min(offsets), len(made.frames)
    shown = [np.append(np.full(by - least, -1), np.arange(frames)) for by in offsets]
    return show(made, bodies, shown)


def clocks_of(made: mc.Recording, bodies: LiftedPoses) -> Clocks:
    frames = np.arange(len(made.frames))[None]
    return clocks_from(made, find_clocks(made, bodies, frames, {}, CONFIG, seed=0))


@pytest.mark.parametrize(
    ("people", "offsets"),
    [
        (1, (0, 7)),
        (3, (0, -12)),
        (1, (0, 1, 0)),
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
    assert [clock.offset for clock in clocks.cameras] == [offset - common for offset in offsets]
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


def test_no_offset_is_invented_where_nothing_moves():
    made, bodies = scene_of(3, 1)
    still, still_bodies = show(made, bodies, [np.full(150, 20)] * 3)
    noise = np.random.default_rng(0).normal(0, 0.03, still_bodies.body.shape)
    clocks = clocks_of(still, replace(still_bodies, body=still_bodies.body + noise))
    assert {clock.kind for clock in clocks.cameras} == {"not known"}
    assert retime(still, clocks) is still


@pytest.mark.parametrize("frames", [1, 5, 25])
def test_no_offset_is_invented_in_a_few_frames(frames):
    made, bodies = scene_of(3, 1)
    shown = [np.arange(frames), np.arange(2, frames + 2), np.arange(frames)]
    few, few_bodies = show(made, bodies, shown)
    assert retime(few, clocks_of(few, few_bodies)) is few


def errors_of(clocks: Clocks, shown: list[np.ndarray]) -> list[np.ndarray]:
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
    clocks = clocks_of(*show(made, bodies, shown))
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
    clocks = clocks_of(*show(made, bodies, shown))
    assert [clock.rate for clock in clocks.cameras] == [1.0, 0.5, 1.0]
    assert max(error.max() for error in errors_of(clocks, shown)) == 0


@lru_cache
def two_rooms(seed: int) -> tuple[mc.Recording, LiftedPoses]:
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


@pytest.mark.parametrize("seed", [0, 4])
def test_people_of_another_room_accuse_no_clock(seed):
    """The people of two rooms look alike at some offset; a whole room would seem to be late."""
    clocks = clocks_of(*two_rooms(seed))
    assert not [clock for clock in clocks.cameras if clock.differs]


@pytest.mark.parametrize("views", [2, 3, 7, 8, 9, 40])
def test_few_pairs_of_many_cameras_are_compared(views):
    pairs = compared_pairs(views)
    partners = np.bincount(np.ravel(pairs), minlength=views)
    assert pairs == sorted(set(pairs))
    assert all(a < b for a, b in pairs)
    assert len(pairs) <= 3 * views
    assert partners.min() >= min(views - 1, 5)


# --- how a clock is described


SURE = {"margin": 9.0, "score": 0.9, "gain": 9.0, "partners": 3.0}
NUMBERS = np.arange(200)[None]


def timing_of(*maps: np.ndarray, rate: float = 1.0) -> Timing:
    """The timing of maps `[frame]`, one for each camera."""
    own = np.array(maps)[:, None]
    return Timing(own, np.full(len(own), rate), np.zeros(1, dtype=np.int64))


@pytest.mark.parametrize(
    ("lost", "kind"),
    [([], "in step"), ([0], "clock"), ([70], "dropped"), ([20, 60, 100, 140, 180], "dropped")],
)
def test_numbers_fall_behind_where_frames_were_lost(lost, kind):
    """Frames that were lost: none, one before the first, one, and every fortieth."""
    time = np.arange(200)
    own = time - sum((time >= frame).astype(np.int64) for frame in lost)
    timing = timing_of(own + np.zeros(200, dtype=np.int64))
    clock = describe_clock("cam1", timing, 0, NUMBERS, SURE, window=60)
    assert clock.kind == kind
    begins = [(0, 0)] if lost and lost[0] else []
    lost = lost if begins or not lost else [1, *lost[1:]]  # it has no frame -1
    assert clock.table == (*begins, *[(frame, -number) for number, frame in enumerate(lost, 1)])


@pytest.mark.parametrize(
    ("own", "rate", "window", "kind"),
    [
        (np.full(30, -1), 0.5, 60, "not known"),  # it shows no frame of the others
        (np.arange(30) + 7, 1.0, 6, "not known"),  # beyond the window
        (np.arange(30) + 7, 1.0, 7, "clock"),
    ],
)
def test_a_clock_that_shows_nothing_or_is_beyond_the_window_is_not_known(own, rate, window, kind):
    timing = timing_of(own, rate=rate)
    assert describe_clock("c", timing, 0, NUMBERS[:, :30], SURE, window=window).kind == kind
    unsure = {**SURE, "margin": 0.0}  # another offset fits as well
    found = describe_clock("c", timing, 0, NUMBERS[:, :30], unsure, window=window)
    assert found.kind == "not known"


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


def test_evidence_is_of_blocks_of_time():
    """Neighbouring frames err alike: as often repeated, the same blocks are the same evidence."""
    blocks = np.random.default_rng(0).normal(0.3, 1.0, 20)
    frames = np.repeat(blocks, 40)[None]
    found = evidence(frames, np.ones(frames.shape, bool))
    ratio = blocks.mean() ** 2 / blocks.var()
    np.testing.assert_allclose(found, 20 / 2 * np.log1p(ratio), rtol=1e-6)
    assert evidence(-frames, np.ones(frames.shape, bool)) == -found
    assert evidence(frames[:, :19], np.ones((1, 19), bool)) == 0.0  # too few frames


def test_cameras_that_nothing_compares_do_not_vouch_for_each_other():
    """Two cameras agree, and so do two others. Of one that is compared with none: no warning."""
    time, agree = np.arange(40), np.eye(40, dtype=np.float32)[None]
    late = np.where(time + 3 < 40, time + 3, -1)
    agreements = Agreements(views=4, measured={(0, 1): agree, (2, 3): agree}, window=5)
    found = weigh(agreements, timing_of(time, time, late, late), 2)
    assert found["partners"] == found["score"] == 0
    scores = []
    for views in (2, 3):  # as sure of two witnesses as of one: their mean counts
        measured = dict.fromkeys(combinations(range(views), 2), agree)
        agreements = Agreements(views=views, measured=measured, window=5)
        scores.append(weigh(agreements, timing_of(*[time] * views), 1)["score"])
    assert scores[1] == pytest.approx(scores[0])
    alone = Agreements(views=3, measured={(0, 1): np.ones((1, 9, 9), np.float32)}, window=2)
    assert not any(weigh(alone, Timing.synchronous(3, np.zeros(1, np.int64), 9), 2).values())


@pytest.mark.parametrize("rate", [0.97, 1.04])
@pytest.mark.parametrize("views", [2, 3])
def test_a_clock_that_drifts_is_another_rate_of_the_last_camera(rate, views):
    """Two stretches, 300 frames apart; cameras agree where they show the same time."""
    start, time = np.array([0, 300]), np.arange(100)
    own = np.round(rate * (start[:, None] + time)).astype(int) - start[:, None] + 3
    agree = np.broadcast_to(np.eye(100, dtype=np.float32), (2, 100, 100))
    drifts = (own[..., None] == time).astype(np.float32)  # [stretch, frame, own frame]
    pairs = combinations(range(views), 2)
    measured = {(a, b): agree if b < views - 1 else drifts for a, b in pairs}
    agreements = Agreements(views=views, measured=measured, window=30)
    timing = find_timing(agreements, start)
    numbers = start[:, None] + time
    clocks = describe_clocks("abc"[:views], numbers, agreements, timing)
    assert [clock.kind for clock in clocks[:-1]] == ["in step"] * (views - 1)
    assert clocks[-1].kind == "rate"
    found = own_frames(clocks[-1], numbers.ravel())
    shown = found != NO_FRAME  # of two frames of the clock, one shows what a slower camera saw
    assert shown.mean() > 0.96
    assert np.abs(found - np.round(rate * numbers.ravel()) - 3)[shown].max() <= 1


def test_a_ridge_is_followed_where_frames_were_lost():
    path = np.repeat([5, 4, 2], 30)
    table = np.zeros((1, 90, 11))
    table[0, np.arange(90), path] = 1.0
    table += np.random.default_rng(0).normal(0, 0.1, table.shape)
    found = follow_ridge(table, partners=1)[0]
    assert np.abs(found - path).max() <= 2
    assert (found == path).mean() > 0.95
    assert np.ptp(follow_ridge(table / 1000, partners=1)) == 0  # steps that gain too little


# --- two views


TRUTH, WINDOW, TOLERANCE = turn_matrix(60.0), 60, PairwiseConfig.pose_tolerance


def unit_bodies(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Bodies `[*shape, axis, 3]` of length 1."""
    body = rng.normal(size=(*shape, 3, 3))
    return body / np.linalg.norm(body, axis=(-2, -1), keepdims=True)


def view_of(body: np.ndarray, seen: np.ndarray | None = None) -> ViewInTime:
    seen = np.ones(body.shape[:3], bool) if seen is None else seen
    return ViewInTime((body * seen[..., None, None]).astype(np.float32), seen)


@pytest.mark.parametrize(("late", "rate"), [(0, 1.0), (2, 1.0), (-2, 1.0), (0, 0.5), (0, 2.0)])
def test_the_rotation_of_two_views_is_found_at_any_offset_and_rate(late, rate):
    """A third of the bodies are others. Frames beyond those of the other view count for nothing."""
    rng = np.random.default_rng(0)
    body = unit_bodies(rng, 1, 240, 1)
    seen_by_b = body @ TRUTH.T
    if rate == 1.0:
        seen_by_b = np.roll(seen_by_b, late, axis=1)
        ends = slice(late) if late > 0 else slice(late or 240, None)
        seen_by_b[:, ends] @= turn_matrix(11.0)
    elif rate == 0.5:
        seen_by_b = seen_by_b[:, ::2]
    else:
        body = body[:, ::2]
    others = rng.random(seen_by_b.shape[1]) < 1 / 3
    seen_by_b[:, others] = unit_bodies(rng, 1, int(others.sum()), 1)
    found = search_rotation(view_of(body), view_of(seen_by_b), WINDOW, rng)
    assert angles_deg(found, TRUTH) < 0.5


def test_views_that_never_see_at_a_common_time_are_compared_without_a_complaint():
    """One sees the first 30 frames, the other the last ones: no offset of the window joins them."""
    body = unit_bodies(np.random.default_rng(0), 1, 180, 1)
    first = np.arange(180)[None, :, None] < 30
    found = search_rotation(
        view_of(body, first), view_of(body, first[:, ::-1]), 5, np.random.default_rng(0)
    )
    assert np.allclose(found @ found.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize(("in_a", "in_b"), [(1, 1), (2, 2), (2, 1), (1, 3)])
def test_bodies_agree_with_the_most_alike_of_the_other_view(in_a, in_b):
    """By its definition, body by body; bodies may be missing."""
    rng = np.random.default_rng(in_a + in_b)
    base = unit_bodies(rng, 1, 1, 1)
    a, b = (base + 0.15 * rng.normal(size=(1, 6, n, 3, 3)) / 3 for n in (in_a, in_b))
    a, b = (body / np.linalg.norm(body, axis=(-2, -1), keepdims=True) for body in (a, b))
    seen_a, seen_b = (rng.random(body.shape[:3]) < 0.7 for body in (a, b))
    cosine = np.einsum("fiax,gjax->figj", a[0], b[0])
    alike = np.exp((cosine - 1) / TOLERANCE**2)
    alike = np.where(seen_a[0][:, :, None, None] & seen_b[0], alike, 0.0)
    total = alike.max(3).sum(1) + alike.max(1).sum(2)
    count_a, count_b = seen_a[0].sum(1)[:, None], seen_b[0].sum(1)
    expected = np.where((count_a > 0) & (count_b > 0), total / (count_a + count_b + 1e-9), np.nan)
    found = agreement(view_of(a, seen_a), view_of(b @ TRUTH.T, seen_b), TRUTH)[0]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-6)


# --- kernels, held to plain numpy


@pytest.mark.parametrize("rate", [rate for rate in CLOCK_RATES if rate <= 2])
def test_compiled_sums_on_diagonals_are_those_of_their_definition(rate):
    """To the last bit; a third is not seen, and rows that no block needs are left over."""
    rng = np.random.default_rng(5)
    values = rng.random((2, 3, 10, 40)).astype(np.float32)
    values[rng.random(values.shape) < 1 / 3] = np.nan
    rows = np.sort(rng.permutation(40)[:10])
    shape = (2, 3, 3, 15)
    sums = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    kernels.sum_on_diagonals(values, np.round(rows * rate).astype(np.int64) - 7, 3, *sums)
    defined = oracle.sum_on_diagonals(values, rate, rows, 3, 7)
    for found, expected in zip(sums, defined, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert 0 < defined[1].min(initial=9, where=defined[1] > 0) < defined[1].max() == 3


@pytest.mark.parametrize("price", [0.0, 0.7, 5.0])
def test_compiled_paths_are_those_of_numpy(price):
    """Of numbers that tie, too: the first of equal steps is taken."""
    rng = np.random.default_rng(0)
    for offsets in (1, 2, 5, 41):
        for table in (rng.normal(size=(60, offsets)), rng.integers(0, 3, (60, offsets)) * 1.0):
            expected = oracle.follow(table, price)
            kernels.follow(table, price, found := np.empty(60, dtype=np.int64))
            assert (found == expected).all()


def test_rays_that_meet_are_likely_and_unseen_points_are_left_out():
    rng = np.random.default_rng(0)
    normal, ray = rng.normal(size=(2, 1, 6, 4, 3))
    square_a, square_b = rng.random((2, 1, 6, 4))
    square_a[0, 2], square_b[0, 4, :3] = np.nan, np.nan
    table = np.empty((1, 6, 5))
    kernels.mean_epipolar_likelihood(normal, ray, square_a, square_b, 0.3, table)
    for frame in range(6):
        for offset in range(-2, 3):
            expected = np.nan
            if 0 <= frame + offset < 6 and frame != 2:
                gap = (normal[0, frame] * ray[0, frame + offset]).sum(-1)
                square = square_a[0, frame] + square_b[0, frame + offset]
                expected = np.nanmean(-np.log1p(gap**2 / square / 0.3**2))
            assert table[0, frame, offset + 2] == pytest.approx(expected, nan_ok=True)


FINER = 20  # frames of the simulation for each frame of a camera
FRAMES = 60
NOISE_PX = 1.0  # at 2 px, offsets found in so few frames are too near to zero by 0.03 on average
OFFSETS = (0.0, 0.3, -0.45, 0.0)
IN_STEP = (0.0, 0.0, 0.0, 0.0)
OFF = replace(Config(), sync=replace(Config().sync, subframe=False))


@lru_cache
def finer_scene(people: int = 1) -> mc.Scene:
    """A scene that is seen 500 times a second: 25 frames a second and parts of them."""
    frames = FINER * (FRAMES + 2)
    return mc.simulate(
        mc.SimulateConfig(people=people, frames=frames, fps=25.0 * FINER, noise_px=NOISE_PX)
    )


@lru_cache
def off(offsets: tuple[float, ...] = OFFSETS, people: int = 1) -> tuple[mc.Recording, mc.Matches]:
    """What cameras whose clocks are off by parts of a frame see of it, and identities."""
    made = finer_scene(people)
    whole = mc.Recording.from_keypoints(made.files, made.rig)
    taken = [FINER * np.arange(1, FRAMES + 1) + round(FINER * tau) for tau in offsets]
    positions, confidence, labels = (
        np.stack([array[view, frames] for view, frames in enumerate(taken)])
        for array in (whole.positions, whole.confidence, made.identity.astype(np.int64))
    )
    numbers = np.arange(FRAMES)
    part = replace(whole, frames=numbers, positions=positions, confidence=confidence)
    return part, mc.Matches(labels)


def adjusted(recording: mc.Recording, matches: mc.Matches) -> mc.CameraRig:
    """The rig that fits as long as nobody asks for clocks."""
    return adjust_twice(sample_of(recording), finer_scene().rig, matches, Config())


def error_of_poses(
    recording: mc.Recording, rig: mc.CameraRig, matches: mc.Matches, people: int
) -> float:
    """Median distance of triangulated joints from where they are at the first camera's clock."""
    made = finer_scene(people)
    joints = [made.joints.index(name) for name in recording.keypoints]
    true = made.poses[FINER * np.arange(1, FRAMES + 1)][:, :, joints]
    found = mc.triangulate(recording, rig, matches).positions
    return float(np.nanmedian(np.linalg.norm(found - true, axis=-1)))


@pytest.mark.parametrize("people", [1, 2])
def test_offsets_are_found_and_rig_and_poses_get_better(people):
    """0.3 and -0.45 frames at 25 frames a second, to 0.05 (measured 0.04)."""
    recording, matches = off(people=people)
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert np.abs(found.tau - OFFSETS).max() < 0.05
    assert found.used.tolist() == [False, True, True, False]
    assert ((found.sigma[1:] > 0) & (found.sigma[1:] < 0.04)).all()
    true = finer_scene(people).rig
    without, with_offsets = (rotation_errors_deg(each, true).max() for each in (start, rig))
    assert with_offsets < 0.7 * without
    in_step = resample(recording, rig, matches, found.applied, Config().triangulate)
    error = error_of_poses(recording, start, matches, people)
    assert error_of_poses(in_step, rig, matches, people) < 0.85 * error  # measured 0.3, 0.75


@pytest.mark.parametrize(
    ("offsets", "expected"), [(IN_STEP, [0, 0, 0, 0]), ((-0.3, 0.0, 0.0, 0.0), [0, 0.3, 0.3, 0.3])]
)
def test_offsets_are_those_from_the_first_camera_and_none_is_used_where_all_are_in_step(
    offsets, expected
):
    """Whichever camera is the odd one."""
    recording, matches = off(offsets)
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert np.abs(found.tau - expected).max() < 0.05
    assert found.used.tolist() == [each > 0 for each in expected]
    assert (rig is start) == (offsets == IN_STEP)


def of_another_order(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    frames = np.random.default_rng(0).permutation(FRAMES)
    shown = replace(
        given, positions=given.positions[:, frames], confidence=given.confidence[:, frames]
    )
    return shown, matches.select(frames=frames)


def of_far_numbers(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    """The numbers say that no frame follows another: 0, 1, 10, 11, 20, 21, ..."""
    return replace(given, frames=np.arange(FRAMES) // 2 * 10 + np.arange(FRAMES) % 2), matches


def at_rest(given: mc.Recording, matches: mc.Matches) -> tuple[mc.Recording, mc.Matches]:
    """Joints differ from frame to frame by the noise of the detector alone."""
    made, rng = finer_scene(), np.random.default_rng(0)
    joints = [made.joints.index(name) for name in given.keypoints]
    still = made.rig.project(np.broadcast_to(made.poses[0, 0][joints], (FRAMES, len(joints), 3)))
    positions = np.full_like(given.positions, np.nan)
    positions[:, :, 0] = still + rng.normal(0, 2, still.shape)
    labels = np.full_like(matches.labels, -1)
    labels[:, :, 0] = 0
    confidence = np.isfinite(positions[..., 0]).astype(given.confidence.dtype)
    return replace(given, positions=positions, confidence=confidence), mc.Matches(labels)


@pytest.mark.parametrize("change", [of_another_order, of_far_numbers, at_rest])
def test_frames_that_do_not_follow_each_other_and_a_body_at_rest_tell_nothing(change):
    recording, matches = change(*off())
    start = adjusted(recording, matches)
    found, rig = find_time_offsets(recording, start, matches, Config())
    assert rig is start
    assert np.isnan(found.tau).all()
    assert not found.used.any()


def test_offsets_of_whole_frames_are_left_to_others_and_none_is_found_where_it_is_switched_off():
    """A clock that is two frames off is beyond what is known of the motion."""
    recording, matches = off()
    start = finer_scene().rig
    found, rig = find_time_offsets(recording, start, matches, OFF)
    assert rig is start
    assert np.isnan(found.tau).all()
    positions, confidence, labels = (
        array.copy() for array in (recording.positions, recording.confidence, matches.labels)
    )
    for array in (positions, confidence, labels):
        array[1] = np.roll(array[1], 2, axis=0)
    late = replace(recording, positions=positions, confidence=confidence)
    found, rig = find_time_offsets(late, start, mc.Matches(labels), Config())
    assert rig is start
    assert not found.used.any()


def test_detections_of_nobody_are_not_moved():
    recording, matches = off(people=2)
    some = mc.Matches(np.where(matches.labels == 1, -1, matches.labels))
    moved = resample(recording, finer_scene().rig, some, np.array(OFFSETS), Config().triangulate)
    change = np.abs(moved.positions - recording.positions)
    assert np.nanmax(change[some.labels < 0]) == 0
    assert np.nanmax(change[[0, 3]]) == 0  # their clocks are the first one's
    assert np.nanmedian(change[1][some.labels[1] >= 0]) > 0.1
    np.testing.assert_array_equal(np.isnan(moved.positions), np.isnan(recording.positions))


@pytest.mark.slow
def test_a_run_uses_the_offsets():
    """From detections alone; reprojection errors are those of what was brought in step."""
    recording, _ = off(people=2)
    found, blind = (calibrate_group(recording, config=each) for each in (Config(), OFF))
    assert np.abs(found.time_offsets.tau - OFFSETS).max() < 0.05
    assert list(found.clock_offsets) == ["cam2", "cam3"]
    assert not blind.clock_offsets
    # measured 0.84
    assert np.nanmedian(found.poses.error) < 0.92 * np.nanmedian(blind.poses.error)
