"""The keypoints of single views: made from arrays, and their assumed cameras."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    DEFAULT_FOCAL,
    REFINEMENTS,
    IntrinsicsConfig,
    Refinement,
)
from mocap_calib.errors import MismatchError
from mocap_calib.records import as_array, check_names
from mocap_calib.types import AssumedCamera, Bools, Camera, Ints, Keypoints2D, Reals


def views_from_arrays(
    positions: ArrayLike,
    confidence: ArrayLike | None,
    *,
    keypoints: Sequence[str],
    cameras: Sequence[Camera],
    frames: ArrayLike | None,
    tracked: bool,
) -> tuple[Keypoints2D, ...]:
    """Return the keypoints of each view from arrays of all views, see `Recording.from_arrays`.

    A point is missing where its position is NaN or its confidence 0; without confidences, the
    confidence of each detected point is 1.

    Raises ValueError for arrays of other shapes, for frames that do not ascend and for names that
    occur twice.
    """
    check_names("keypoints", keypoints)
    check_names("cameras", [camera.name for camera in cameras])
    given = np.asarray(positions, dtype=np.float64)
    weight = np.ones(given.shape[:-1]) if confidence is None else np.asarray(confidence, float)
    alone = given.ndim == 4  # no axis of instances
    if alone:
        given, weight = given[:, :, None], np.expand_dims(weight, min(2, weight.ndim))
    views, names = len(cameras), len(keypoints)
    seen = as_array("positions", given, float, views, None, None, names, 2)
    weight = as_array("confidence", weight, float, *seen.shape[:-1])
    present = np.isfinite(seen).all(-1) & (weight > 0)
    given_frames = np.arange(seen.shape[1]) if frames is None else frames
    numbers = as_array("frames", given_frames, int, seen.shape[1])
    if (np.diff(numbers) <= 0).any():
        raise ValueError("frames: expected numbers that ascend, each once; sort the frames")
    return split_by_view(
        cameras,
        keypoints=tuple(keypoints),
        frames=numbers,
        positions=np.where(present[..., None], seen, np.nan),
        confidence=np.where(present, weight, 0.0),
        tracked=np.full(views, tracked or alone),
        source="arrays",
    )


def split_by_view(
    cameras: Sequence[Camera],
    *,
    keypoints: tuple[str, ...],
    frames: Ints,
    positions: Reals,
    confidence: Reals,
    tracked: Bools,
    source: str,
) -> tuple[Keypoints2D, ...]:
    """Return the keypoints of each view, in the order of the cameras.

    keypoints: `[keypoint]` names. frames: `[frame]` numbers, the same in all views.
    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]`, 0 = missing.
    tracked: `[view]` whether the instance index names the same individual in all frames.
    source: where the arrays come from; the name of the camera follows it in messages.
    """
    return tuple(
        Keypoints2D(
            camera=camera.name,
            keypoints=keypoints,
            frames=frames,
            positions=positions[view],
            confidence=confidence[view],
            tracked=bool(tracked[view]),
            image_size=camera.size,
            source=f"{source} {camera.name}",
        )
        for view, camera in enumerate(cameras)
    )


ASSUMED_NOTE = (
    "no intrinsics were given: focal lengths and lenses are estimated together with the rig"
)


def assume_cameras(views: Sequence[Keypoints2D]) -> tuple[AssumedCamera, ...]:
    """Return a camera for each view, with a typical focal length.

    Its principal point is the middle of the image, and it has no distortion.

    Raises MismatchError where the size of the images is not known.
    """
    return tuple(_assume_camera(view) for view in views)


def choose_refinement(
    cameras: Sequence[Camera], config: IntrinsicsConfig, refine: Refinement | None
) -> IntrinsicsConfig:
    """Return the configuration for the estimation of the intrinsics of these cameras.

    refine: None: as in `config`, or focal lengths and lenses where no intrinsics were given.

    Raises MismatchError for an unknown choice, and for one that is impossible for these cameras.
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
            "its focal length is guessed, found none; use --image-size "
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
