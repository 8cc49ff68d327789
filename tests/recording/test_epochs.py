"""Cameras that were moved are several views; results have them once for each epoch."""

import numpy as np

from mocap_calib.recording.corrections import (
    Moved,
    apply_mends,
    list_epochs,
    own_name,
    own_names,
    recording_of_epoch,
    rig_of_epoch,
    views_by_camera,
)
from mocap_calib.types import Camera, CameraRig, Recording

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


def test_the_rig_and_the_recording_of_an_epoch_have_each_camera_once():
    cameras = [Camera(name, (640, 480), np.diag([600.0, 600.0, 1.0])) for name in "ab"]
    positions = np.random.default_rng(0).uniform(0, 400, size=(2, 50, 1, 5, 2))
    whole = Recording.from_arrays(
        positions, keypoints=["nose", "left_hip", "right_hip", "left_knee", "right_knee"],
        cameras=cameras, frames=FRAMES,
    )  # fmt: skip
    split = apply_mends(whole, (Moved("b", 50), Moved("b", 20)))
    assert split.names == ("a", "b", "b@20", "b@50")
    rig = CameraRig(split.cameras, np.tile(np.eye(3), (4, 1, 1)), np.arange(12.0).reshape(4, 3))
    parts = []
    for epoch, view in zip(list_epochs(split.names, split.frames), (1, 2, 3), strict=True):
        own = rig_of_epoch(rig, epoch)
        assert own.names == ("a", "b")
        assert own.translation.tolist() == rig.translation[[0, view]].tolist()
        parts.append(recording_of_epoch(split, epoch))
        assert parts[-1].names == ("a", "b")
    together = np.concatenate([part.positions for part in parts], axis=1)
    np.testing.assert_array_equal(together, whole.positions)
