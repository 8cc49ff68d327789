"""Cameras of which nothing is known but the size of their images."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    DEFAULT_FOCAL,
    REFINEMENTS,
    IntrinsicsConfig,
    Refinement,
)
from mocap_calib.errors import MismatchError
from mocap_calib.types import AssumedCamera, Camera, Keypoints2D

ASSUMED_NOTE = (
    "no intrinsics were given: focal lengths and lenses are estimated together with the rig"
)


def assume_cameras(views: Sequence[Keypoints2D]) -> tuple[AssumedCamera, ...]:
    """Return a camera for each view, with the focal length that cameras mostly have.

    It looks along the middle of the image and has no distortion.

    Raises MismatchError where the size of the images is not known.
    """
    return tuple(_assume_camera(view) for view in views)


def choose_refinement(
    cameras: Sequence[Camera], config: IntrinsicsConfig, refine: Refinement | None
) -> IntrinsicsConfig:
    """Return the configuration with which intrinsics of these cameras are estimated.

    refine: None: as `config` says, or focal lengths and lenses of cameras that nobody knows.

    Raises MismatchError where there is no such choice, or not for these cameras.
    """
    assumed = any(isinstance(camera, AssumedCamera) for camera in cameras)
    chosen = refine or config.refine
    if refine is None and chosen == "none" and assumed:
        chosen = ASSUMED_REFINEMENT
    if chosen not in REFINEMENTS:
        known = ", ".join(REFINEMENTS)
        raise MismatchError(f"refine: expected one of {known}, found {chosen!r}; choose one")
    if chosen == "none" and assumed:
        raise MismatchError(
            "refine: expected focal or focal+k1, as nothing is known of the intrinsics, "
            "found none; give the intrinsics, or leave it out"
        )
    return replace(config, refine=chosen)


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
