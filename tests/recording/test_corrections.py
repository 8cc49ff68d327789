"""What changes a recording: corrections of its cameras, epochs between moves, and clocks."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import recording as of_scene
from scenes import scene, truth

import mocap_calib as mc
from mocap_calib.clocks.estimate import clocks_from, clocks_of_rates, own_frames, retime
from mocap_calib.errors import MismatchError
from mocap_calib.faults.hypotheses import option_of
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.io.results.matches_csv import matches_csv, read_matches_csv
from mocap_calib.recording.corrections import (
    Cropped,
    Exchanged,
    Mirrored,
    Moved,
    Refocused,
    Resized,
    Rotated,
    Sides,
    apply_mends,
    exchanged_sides,
    list_epochs,
    own_name,
    own_names,
    recording_of_epoch,
    rig_of_epoch,
    views_by_camera,
)
from mocap_calib.results import NO_FRAME, Clocks, Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.types import Camera, CameraClock, CameraRig, EstimatedCamera, Recording

WIDTH, HEIGHT = 1280, 720
NAMES = ("nose", "left_wrist", "right_wrist", "left_ankle", "right_ankle")
POINTS = np.random.default_rng(3).uniform(-0.6, 0.6, (6, 2, len(NAMES), 3)) + [0.1, -0.2, 4.0]
close = np.testing.assert_allclose


def camera(name, f=900.0, distortion=(-0.1, 0.02, 0.004, -0.003, 0.0)):
    matrix = [[f, 0, 631], [0, f + 8, 371], [0, 0, 1]]
    return Camera(name, (WIDTH, HEIGHT), matrix, distortion)


def seen_by(*cameras: Camera) -> Recording:
    """Return what cameras in one place see of the points."""
    positions = np.stack([pixels_from_points(each, POINTS) for each in cameras])
    frames = np.arange(10, 16)
    return Recording.from_arrays(positions, keypoints=NAMES, cameras=cameras, frames=frames)


@pytest.fixture
def recording() -> Recording:
    return seen_by(camera("a"), camera("b", f=1000.0), camera("c", distortion=np.zeros(5)))


def see(recording, view, positions):
    """Return the recording in which a view sees other pixels `[frame, instance, keypoint, 2]`."""
    changed = recording.positions.copy()
    changed[view] = positions
    return replace(recording, positions=changed)


def test_a_mirrored_image_is_mirrored_back_with_its_sides(recording):
    order = exchanged_sides(NAMES)
    assert list(order) == [0, 2, 1, 4, 3]
    mirrored = recording.positions[1].copy()
    mirrored[..., 0] = WIDTH - 1 - mirrored[..., 0]
    close(
        Mirrored("b").apply(see(recording, 1, mirrored[:, :, order])).positions,
        recording.positions,
        atol=1e-9,
    )
    # mirrored after the detection: the sides are right
    stated = (Mirrored("b"), Sides("b"))
    picture_alone = see(recording, 1, mirrored)
    for mends in (stated, (Mirrored("b", sides=False),)):
        mended = apply_mends(picture_alone, mends)
        close(mended.positions, recording.positions, atol=1e-9)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_turned_intrinsics_see_the_turned_image(recording, degrees):
    """The camera with a lens is the first: its pixels, turned, are those of turned points."""
    pixels, size = recording.positions[0], (WIDTH, HEIGHT)
    for _ in range(degrees // 90):
        pixels = np.stack([size[1] - 1 - pixels[..., 1], pixels[..., 0]], axis=-1)
        size = size[::-1]
    mended = Rotated("a", degrees).apply(see(recording, 0, pixels)).cameras[0]
    assert mended.size == size
    turn = np.deg2rad(degrees)
    about_axis = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    seen = pixels_from_points(mended, POINTS @ about_axis.T)
    close(seen, pixels, atol=1e-6)


def test_resized_and_cropped_intrinsics_see_such_images(recording):
    pixels = recording.positions[0]
    half = Resized("a", 0.5).apply(recording).cameras[0]
    assert half.size == (WIDTH // 2, HEIGHT // 2)
    # pixel centres are integers: the left edge of the image is at -0.5
    close(pixels_from_points(half, POINTS), (pixels + 0.5) / 2 - 0.5, atol=1e-6)
    part = Cropped("a", 100, 40).apply(recording).cameras[0]
    close(pixels_from_points(part, POINTS), pixels - (100, 40), atol=1e-6)


def test_exchanged_cameras_and_another_focal_length(recording):
    exchanged = Exchanged("a", "b").apply(recording)
    assert exchanged.names == recording.names
    assert exchanged.cameras[0].focal == recording.cameras[1].focal
    assert Exchanged("a", "b").apply(exchanged) == recording
    refocused = Refocused("c", focal=1000.0, sigma=4.0).apply(recording).cameras[2]
    assert isinstance(refocused, EstimatedCamera)
    assert refocused.focal == pytest.approx(1000.0)
    assert refocused.focal_sigma == 4.0


def test_a_moved_camera_becomes_two_that_share_the_frames(recording):
    split = apply_mends(recording, (Moved("b", 12), Moved("b", 14)))
    assert split.names == ("a", "b", "b@12", "b@14", "c")
    sees = split.seen.any((2, 3))
    assert sees[1].tolist() == [True, True, False, False, False, False]
    assert sees[2].tolist() == [False, False, True, True, False, False]
    assert sees[3].tolist() == [False, False, False, False, True, True]
    np.testing.assert_array_equal(np.nanmax(split.positions[1:4], axis=0), recording.positions[1])
    assert (split.confidence[1:4].sum(0) == recording.confidence[1]).all()


def test_mends_say_how_they_are_stated():
    mends = (
        Mirrored("c"),
        Mirrored("c", sides=False),
        Sides("c"),
        Rotated("c", 90),
        Resized("c", 0.5),
        Cropped("c", 10.2, 0),
        Exchanged("c", "d"),
        Moved("c", 7),
    )
    assert [option_of(mend) for mend in mends] == [
        "--mirrored c",
        "--mirrored c --sides c",
        "--sides c",
        "--rotated c:90",
        "--resized c:0.5",
        "--crop-offset c:10,0",
        "--exchanged c,d",
        "--moved c:7",
    ]


def test_a_camera_that_is_not_there_is_refused(recording):
    with pytest.raises(MismatchError, match="a, b, c"):
        Sides("d").apply(recording)


def test_what_a_lens_cannot_undo_is_no_detection(recording):
    """A strong barrel lens folds within the image: what lies beyond has no ray."""
    folded = replace(recording.cameras[0], distortion=[-3.0, 0, 0, 0, 0])
    cameras = (folded, *recording.cameras[1:])
    matches = Matches(np.zeros(recording.positions.shape[:3], np.int64))
    frames = np.arange(len(recording.frames))
    given, weight = (
        gather_tracks(replace(recording, cameras=each), matches, frames).weight
        for each in (recording.cameras, cameras)
    )
    lost = (given > 0) & (weight == 0)
    assert 0 < lost[0].sum() < (given[0] > 0).sum()
    assert not lost[1:].any()


# epochs


VIEWS = ("a", "b", "b@50", "b@70", "c", "c@50")
FRAMES = np.arange(0, 100, 2)


def test_a_recording_without_moves_has_one_epoch():
    (epoch,) = list_epochs(("a", "b"), FRAMES)
    assert (epoch.first, epoch.last, epoch.names, epoch.moved) == (0, 98, ("a", "b"), ())
    assert epoch.views.tolist() == [0, 1]


def test_epochs_begin_where_any_camera_was_moved():
    epochs = list_epochs(VIEWS, FRAMES)
    assert [(epoch.first, epoch.last) for epoch in epochs] == [(0, 48), (50, 68), (70, 98)]
    assert [epoch.moved for epoch in epochs] == [(), ("b", "c"), ("b",)]
    assert [epoch.views.tolist() for epoch in epochs] == [[0, 1, 4], [0, 2, 5], [0, 3, 5]]
    assert all(epoch.names == ("a", "b", "c") for epoch in epochs)


def test_names_are_those_of_cameras():
    assert own_names(VIEWS) == ("a", "b", "c")
    assert views_by_camera(VIEWS) == {"a": [0], "b": [1, 2, 3], "c": [4, 5]}
    assert own_name("d@50", VIEWS) == "d@50"  # a camera that is called so
    assert own_name("a@b", VIEWS) == "a@b"


def test_the_rig_and_the_recording_of_an_epoch_have_each_camera_once(recording):
    split = apply_mends(recording, (Moved("b", 14), Moved("b", 12)))
    assert split.names == ("a", "b", "b@12", "b@14", "c")
    rig = CameraRig(split.cameras, np.tile(np.eye(3), (5, 1, 1)), np.arange(15.0).reshape(5, 3))
    parts = []
    for epoch, view in zip(list_epochs(split.names, split.frames), (1, 2, 3), strict=True):
        own = rig_of_epoch(rig, epoch)
        assert own.translation.tolist() == rig.translation[[0, view, 4]].tolist()
        parts.append(recording_of_epoch(split, epoch))
        assert parts[-1].names == own.names == ("a", "b", "c")
    together = np.concatenate([part.positions for part in parts], axis=1)
    np.testing.assert_array_equal(together, recording.positions)


# clocks


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
    made = of_scene()
    clocks = clocks_of_rates(made, {made.names[1]: 0.5})
    slow = retime(made, clocks)
    shown = clocks.source[1] >= 0
    assert shown.sum() == len(made.frames) // 2
    np.testing.assert_array_equal(clocks.numbers(made.names[1])[shown], made.frames[:30])
    assert np.isnan(slow.positions[1, ~shown]).all()
    with pytest.raises(MismatchError, match="cam99"):
        clocks_of_rates(made, {"cam99": 2.0})


def test_changes_of_changes_are_one_change():
    made = of_scene()
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
    made, known = of_scene(), truth()
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
    mc.write(replace(rig, clocks=clocks), tmp_path / "cameras.yaml", "mocap-calib")
    back = mc.read_rig(tmp_path / "cameras.yaml")
    assert back.clocks == clocks
    assert [each.camera for each in back.select([0, 2]).clocks] == [names[2]]
    assert "clock" not in "".join(
        line for line in (tmp_path / "cameras.yaml").read_text().splitlines() if names[0] in line
    )
    made = of_scene()
    assert clocks_from(made, back.clocks).changed
    assert not clocks_from(made, rig.clocks).changed


def test_clocks_of_one_change_nothing():
    made = of_scene()
    assert retime(made, Clocks.of_one(made)) is made
