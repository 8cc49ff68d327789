"""Putting views on one clock: what each shows, and what its files call it."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import recording, scene, truth

from mocap_calib.clocks.estimate import clocks_from, clocks_of_rates, own_frames, retime
from mocap_calib.config import SyncConfig
from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.io.results.matches_csv import matches_csv, read_matches_csv
from mocap_calib.recording.sampling import choose_stretches
from mocap_calib.results import NO_FRAME, Clocks
from mocap_calib.types import CameraClock


def clock(name, kind="in step", **fields):
    return CameraClock(name, kind, **fields)


def test_own_frames_follow_the_table():
    frames = np.arange(6)
    np.testing.assert_array_equal(own_frames(clock("a", "clock", offset=-2), frames), frames - 2)
    lossy = clock("a", "dropped", table=((0, 0), (3, -1)))
    np.testing.assert_array_equal(own_frames(lossy, frames), [0, 1, 2, 2, 3, 4])
    slow = clock("a", "rate", rate=0.5, table=((0, 1),))
    expected = [1, NO_FRAME, 2, NO_FRAME, 3, NO_FRAME]
    np.testing.assert_array_equal(own_frames(slow, frames), expected)


def test_a_camera_of_five_sixths_of_the_rate_shows_each_of_its_frames_once():
    own = own_frames(clock("a", "rate", rate=5 / 6, table=((0, 0),)), np.arange(60))
    np.testing.assert_array_equal(own[own != NO_FRAME], np.arange(50))
    shown = np.flatnonzero(own != NO_FRAME)
    assert np.abs(shown * 5 / 6 - own[shown]).max() <= 0.5


def test_rates_that_are_said_are_used():
    made = recording()
    clocks = clocks_of_rates(made, {made.names[1]: 0.5})
    slow = retime(made, clocks)
    shown = clocks.source[1] >= 0
    assert shown.sum() == len(made.frames) // 2
    np.testing.assert_array_equal(clocks.numbers(made.names[1])[shown], made.frames[:30])
    assert np.isnan(slow.positions[1, ~shown]).all()
    with pytest.raises(MismatchError, match="cam99"):
        clocks_of_rates(made, {"cam99": 2.0})


def test_changes_of_changes_are_one_change():
    made = recording()
    names = made.names
    first = clocks_from(
        made, (clock(names[0]), clock(names[1], "clock", offset=3), *map(clock, names[2:]))
    )
    once = retime(made, first)
    second = clocks_from(once, (*map(clock, names[:3]), clock(names[3], "clock", offset=-2)))
    both = retime(made, second.after(first))
    assert both == retime(once, second)
    assert [each.offset for each in second.after(first).cameras] == [0, 3, 0, -2]


def test_matches_name_the_frames_of_the_files():
    made, known = recording(), truth()
    names = made.names
    clocks = clocks_from(
        made, (clock(names[0]), clock(names[1], "clock", offset=5), *map(clock, names[2:]))
    )
    moved = retime(made, clocks)
    view = np.arange(len(names))[:, None]
    labels = np.where((clocks.source >= 0)[..., None], known.labels[view, clocks.source], -1)
    matches = replace(known, labels=labels)
    text = b"".join(matches_csv(moved, matches, clocks)).decode()
    rows = [line.split(",") for line in text.splitlines()[1:]]
    for name, view in ((names[0], 0), (names[1], 1)):
        for frame, instance, who in (map(int, row[1:]) for row in rows if row[0] == name):
            assert known.labels[view, frame, instance] == who
    back = read_matches_csv(text, moved, clocks)
    seen = np.isfinite(moved.positions[..., 0]).any(-1)
    np.testing.assert_array_equal(back.labels[seen], labels[seen])


def test_cameras_yaml_keeps_the_clocks(tmp_path):
    rig = scene().rig
    names = rig.names
    clocks = (
        clock(names[1], "clock", offset=-7),
        clock(names[2], "dropped", table=((0, 0), (50, -1))),
        clock(names[3], "rate", rate=0.5, table=((10, 2),), offset=2),
    )
    write_cameras(tmp_path / "cameras.yaml", replace(rig, clocks=clocks), "mocap-calib", {})
    back = read_rig(tmp_path / "cameras.yaml")
    assert back.clocks == clocks
    assert [each.camera for each in back.select([0, 2]).clocks] == [names[2]]
    assert "clock" not in "".join(
        line for line in (tmp_path / "cameras.yaml").read_text().splitlines() if names[0] in line
    )
    made = recording()
    assert clocks_from(made, back.clocks).changed
    assert not clocks_from(made, rig.clocks).changed


def test_clocks_of_one_change_nothing():
    made = recording()
    assert retime(made, Clocks.of_one(made)) is made


def test_stretches_are_of_bounded_number_whatever_the_length():
    made = recording()
    config = SyncConfig(window=10)
    short = choose_stretches(made, config)
    np.testing.assert_array_equal(short, np.arange(60)[None])
    frames = np.arange(5000)
    long = made.select(frames=frames % 60)
    long = replace(long, frames=frames)
    stretches = choose_stretches(long, config)
    assert stretches.shape == (13, 30)
    assert (stretches[0, 0], stretches[-1, -1]) == (0, 4999)
    assert (np.diff(stretches, axis=1) == 1).all()


def test_missing_numbers_are_missing_in_stretches():
    made = recording().select(frames=np.array([0, 1, 2, 5, 6, 7]))
    stretches = choose_stretches(made, SyncConfig())
    np.testing.assert_array_equal(stretches, [[0, 1, 2, -1, -1, 3, 4, 5]])
