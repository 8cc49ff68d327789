"""Split arrays of all views into what a file of each view holds."""

from collections.abc import Sequence

from mocap_calib.types import Bools, Camera, Ints, Keypoints2D, Reals


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
