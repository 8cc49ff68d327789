"""Refine the clocks of cameras by the epipolar geometry of a first rig.

Rays of a keypoint that two cameras see at the same time meet. How nearly they meet at other offsets
of the clocks shows whole frames, as far as bodies move.
"""

import numpy as np

from mocap_calib.clocks.compare import Pair, compared_pairs
from mocap_calib.clocks.evidence import Agreements, standardise
from mocap_calib.geometry.rotation import skew
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import gather_tracks
from mocap_calib.types import CameraRig, Floats, Ints, Recording

_REACH = 15  # frames: offsets that are compared, early and late
_LOSS_SCALE = 1.5  # median distances of rays, at which the loss turns


def agreements_of_rig(
    recording: Recording, rig: CameraRig, matches: Matches, stretches: Ints, window: int
) -> Agreements:
    """Return how nearly the rays of pairs of views meet in any two frames up to a window apart.

    matches: labels in all frames. stretches: `[stretch, frame]` indices, -1 = no frame.
    """
    window = min(window, _REACH)
    tables = epipolar_tables(recording, rig, matches, stretches, window)
    frames = stretches.shape[1]
    time = np.arange(frames)[:, None]
    column = time + np.arange(-window, window + 1)
    inside = (column >= 0) & (column < frames)
    row = np.broadcast_to(time, column.shape)
    values = {}
    for pair, table in tables.items():
        whole = np.full((len(table), frames, frames), np.nan, np.float32)
        whole[:, row[inside], column[inside]] = table[:, inside]
        values[pair] = standardise(whole, whole)
    return Agreements(len(rig), values, window)


def epipolar_tables(
    recording: Recording, rig: CameraRig, matches: Matches, stretches: Ints, reach: int
) -> dict[Pair, Floats]:
    """Return how nearly rays of pairs of views meet, `[stretch, frame of a, offset of b]`.

    The mean log likelihood of the keypoints, NaN where two views share none; offsets are from
    -reach to reach.

    matches: labels in all frames. stretches: `[stretch, frame]` indices, -1 = no frame.
    """
    rays = _rays(recording, matches, stretches)
    errors = {
        (a, b): _epipolar_errors(rays[a], rays[b], *rig.relative(a, b), reach)
        for a, b in compared_pairs(len(rig))
    }
    medians = [np.nanmedian(each[..., reach]) for each in errors.values() if _is_known(each, reach)]
    if not medians:
        return {}
    scale = _LOSS_SCALE * np.median(medians)
    return {
        pair: _mean_of_known(-np.log1p((each / scale) ** 2))
        for pair, each in errors.items()
        if _is_known(each, reach)
    }


def _is_known(errors: Floats, reach: int) -> bool:
    """Return whether two views share a keypoint at the frame numbers as they are."""
    return bool(np.isfinite(errors[..., reach]).any())


def _mean_of_known(values: Floats) -> Floats:
    """Return means `[stretch, frame, offset]` over points `[stretch, frame, point, offset]`."""
    known = np.isfinite(values)
    count = known.sum(2)
    total = np.where(known, values, 0.0).sum(2)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rays(recording: Recording, matches: Matches, stretches: Ints) -> Floats:
    """Return the unit rays `[view, stretch, frame, point, 3]` of all labelled keypoints."""
    frames = np.unique(stretches[stretches >= 0])
    rays = gather_tracks(recording, matches, frames).rays
    rays = np.moveaxis(rays.reshape(len(rays), 3, len(frames), -1), 1, -1)
    place = np.searchsorted(frames, np.maximum(stretches, frames[0]))
    return np.where((stretches >= 0)[..., None, None], rays[:, place], np.nan)


def _epipolar_errors(
    a: Floats, b: Floats, rotation: Floats, translation: Floats, reach: int
) -> Floats:
    """Return the angles `[stretch, frame of a, point, offset of b]` by which rays do not meet.

    a, b: `[stretch, frame, point, 3]` rays. rotation, translation: of b_from_a.
    """
    essential = skew(translation) @ rotation
    of_a, of_b = a @ essential.T, b @ essential
    square_a, square_b = (of_a**2).sum(-1), (of_b**2).sum(-1)
    frames = a.shape[1]
    found = np.full((*a.shape[:3], 2 * reach + 1), np.nan)
    for offset in range(-reach, reach + 1):
        here = slice(max(0, -offset), min(frames, frames - offset))
        there = slice(max(0, offset), min(frames, frames + offset))
        gap = np.abs((of_a[:, here] * b[:, there]).sum(-1))
        found[:, here, :, offset + reach] = gap / np.sqrt(square_a[:, here] + square_b[:, there])
    return found
