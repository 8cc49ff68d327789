"""Each mend undoes what was done to the files; stated beforehand, and by the numbers of images."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_calib.errors import MismatchError
from mocap_calib.faults.hypotheses import option_of
from mocap_calib.geometry.lens import pixels_from_points
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
)
from mocap_calib.results import Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.types import Camera, EstimatedCamera, Recording

WIDTH, HEIGHT = 1280, 720
NAMES = ("nose", "left_wrist", "right_wrist", "left_ankle", "right_ankle")


def camera(name, f=900.0, distortion=(-0.1, 0.02, 0.004, -0.003, 0.0)):
    matrix = [[f, 0, 631], [0, f + 8, 371], [0, 0, 1]]
    return Camera(name, (WIDTH, HEIGHT), matrix, distortion)


@pytest.fixture
def points():
    rng = np.random.default_rng(3)
    return np.array([0.1, -0.2, 4.0]) + rng.uniform(-0.6, 0.6, (6, 2, len(NAMES), 3))


@pytest.fixture
def recording(points):
    cameras = (camera("a"), camera("b", f=1000.0), camera("c", distortion=np.zeros(5)))
    positions = np.stack([pixels_from_points(each, points) for each in cameras])
    return Recording(
        cameras=cameras,
        keypoints=NAMES,
        frames=np.arange(10, 16),
        positions=positions,
        confidence=np.ones(positions.shape[:-1]),
        tracked=[False] * 3,
        vocabulary=np.full(len(NAMES), -1),
    )


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
    np.testing.assert_allclose(
        Mirrored("b").apply(see(recording, 1, mirrored[:, :, order])).positions,
        recording.positions,
        atol=1e-9,
    )
    # mirrored after the detection: the sides are right
    stated = (Mirrored("b"), Sides("b"))
    picture_alone = see(recording, 1, mirrored)
    for mends in (stated, (Mirrored("b", sides=False),)):
        mended = apply_mends(picture_alone, mends)
        np.testing.assert_allclose(mended.positions, recording.positions, atol=1e-9)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_turned_intrinsics_see_the_turned_image(recording, points, degrees):
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
    seen = pixels_from_points(mended, points @ about_axis.T)
    np.testing.assert_allclose(seen, pixels, atol=1e-6)


def test_resized_and_cropped_intrinsics_see_such_images(recording, points):
    pixels = recording.positions[0]
    half = Resized("a", 0.5).apply(recording).cameras[0]
    assert half.size == (WIDTH // 2, HEIGHT // 2)
    # pixel centres are integers: the left edge of the image is at -0.5
    np.testing.assert_allclose(
        pixels_from_points(half, points), (pixels + 0.5) / 2 - 0.5, atol=1e-6
    )
    part = Cropped("a", 100, 40).apply(recording).cameras[0]
    np.testing.assert_allclose(pixels_from_points(part, points), pixels - (100, 40), atol=1e-6)


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


def test_a_camera_that_is_not_there_is_said(recording):
    with pytest.raises(MismatchError, match="expected one of the cameras a, b, c, found d; name"):
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
