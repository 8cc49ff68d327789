"""Cameras of which nothing is known but the size of their images."""

from collections.abc import Sequence

import numpy as np

from mocap_calib.config import DEFAULT_FOCAL
from mocap_calib.errors import MismatchError
from mocap_calib.types import AssumedCamera, Keypoints2D

ASSUMED_NOTE = (
    "no intrinsics were given: focal lengths and lenses are estimated together with the rig"
)


def assume_cameras(views: Sequence[Keypoints2D]) -> tuple[AssumedCamera, ...]:
    """Return a camera for each view, with the focal length that cameras mostly have.

    It looks along the middle of the image and has no distortion.

    Raises MismatchError where the size of the images is not known.
    """
    return tuple(_assume_camera(view) for view in views)


def _assume_camera(view: Keypoints2D) -> AssumedCamera:
    """Return the camera of a view. Raises MismatchError where its image size is not known."""
    width, height = view.image_size
    if (width, height) == (0, 0):
        raise MismatchError(
            f"{view.source}: expected the size of the images of camera {view.camera}, by which "
            "its focal length is guessed, found none; say --image-size "
            f"{view.camera}:WIDTHxHEIGHT, or give the intrinsics with --cameras"
        )
    focal = DEFAULT_FOCAL * max(width, height)
    middle = (width - 1) / 2, (height - 1) / 2
    return AssumedCamera(
        name=view.camera,
        size=(width, height),
        matrix=np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        fisheye=False,
    )
