"""Split arrays of all views into what a file of each view holds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.records import as_array, check_names
from mocap_calib.types import Bools, Camera, Ints, Keypoints2D, Reals


def views_from_arrays(
    positions: ArrayLike,
    confidence: ArrayLike | None,
    *,
    keypoints: Sequence[str],
    cameras: Sequence[Camera],
    frames: ArrayLike | None,
    tracked: bool,
) -> tuple[Keypoints2D, ...]:
    """Return what files would hold of the arrays of a user, see `Recording.from_arrays`.

    A point is missing where its position or its confidence is; without confidences those that are
    there have 1.

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
    """Return what the files of the views hold, in the order of the cameras.

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
