"""Points that lie so far outside of an image that no detector can mean them."""

from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import FAR_OUTSIDE
from mocap_calib.types import Bools, Camera, Keypoints2D, Reals


def count_far_points(view: Keypoints2D, size: tuple[int, int]) -> int:
    """Return how many points lie further than three image sizes outside of the image.

    None where the size is not known, (0, 0), and where most do: then they are of another image.
    """
    far = seen = 0
    if size == (0, 0):
        return 0
    for block in mapped.frame_slices(len(view.frames)):
        positions = view.positions[block]
        far += int(_are_far(positions, size).sum())
        seen += int((~np.isnan(positions[..., 0])).sum())
    return far if 2 * far < seen else 0


def _are_far(positions: Reals, size: tuple[int, int]) -> Bools:
    """Return `[...]` whether points `[..., 2]` (pixels, NaN = missing) lie far outside an image."""
    least = -FAR_OUTSIDE * np.array(size)
    is_far: Bools = (positions < least) | (positions > np.array(size) - least)
    return np.asarray(is_far.any(-1))


def without_far_points(view: Keypoints2D, size: tuple[int, int]) -> Keypoints2D:
    """Return the view with points far outside of its images missing; itself where none are."""
    far = count_far_points(view, size)
    if not far:
        return view

    def positions_of(block: slice) -> Reals:
        given = view.positions[block]
        return np.where(_are_far(given, size)[..., None], np.nan, given)

    def confidence_of(block: slice) -> Reals:
        return np.where(_are_far(view.positions[block], size), 0.0, view.confidence[block])

    frames = len(view.frames)
    return replace(
        view,
        positions=mapped.in_blocks(positions_of, frames),
        confidence=mapped.in_blocks(confidence_of, frames),
        missing={**view.missing, "far outside of the image": far},
    )


def largest_size(view: Keypoints2D, camera: Camera) -> tuple[int, int]:
    """Return the size of the images of a view: it may be a part of those of its camera, or larger.

    (0, 0) = not known.
    """
    width, height = map(max, view.image_size, camera.size)
    return width, height
