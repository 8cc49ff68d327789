"""Cameras of which nothing is known but the size of their images."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene

from mocap_calib.errors import MismatchError
from mocap_calib.recording.names import assume_cameras

FILES = scene(cameras=2, frames=5).files


def test_a_camera_is_assumed_to_have_a_usual_focal_length_and_to_look_along_the_middle():
    upright = replace(FILES[1], image_size=(720, 1280))
    first, second = assume_cameras((FILES[0], upright))
    assert (first.name, first.size, second.size) == ("cam1", (1280, 720), (720, 1280))
    np.testing.assert_array_equal(first.matrix, [[1536, 0, 639.5], [0, 1536, 359.5], [0, 0, 1]])
    np.testing.assert_array_equal(second.matrix, [[1536, 0, 359.5], [0, 1536, 639.5], [0, 0, 1]])
    np.testing.assert_array_equal(first.distortion, 0)
    assert not first.fisheye


def test_where_the_image_size_is_not_known_it_is_asked_for():
    unknown = replace(FILES[1], image_size=(0, 0), source="b.csv")
    said = "b.csv: expected the size of the images of camera cam2.*image_size=.*cam2"
    with pytest.raises(MismatchError, match=said):
        assume_cameras((FILES[0], unknown))
