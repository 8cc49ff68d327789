"""Refine the clocks of cameras by the epipolar geometry of a first rig.

Rays of a keypoint that two cameras see at the same time meet. How nearly they meet at other offsets
of the clocks shows whole frames, as far as bodies move.
"""

import numpy as np

from mocap_calib.clocks.compare import Pair, compared_pairs
from mocap_calib.clocks.evidence import Agreements, standardise
from mocap_calib.geometry.rotation import skew
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.loading import contiguous
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
    planes = {
        (a, b): _epipolar_planes(rays[a], rays[b], *rig.relative(a, b))
        for a, b in compared_pairs(len(rig))
    }
    angles = {pair: _synchronous_angles(*each) for pair, each in planes.items()}
    known = [pair for pair, each in angles.items() if len(each)]
    if not known:
        return {}
    scale = _LOSS_SCALE * float(np.median([np.median(angles[pair]) for pair in known]))
    tables = {}
    for pair in known:
        tables[pair] = np.empty((*stretches.shape, 2 * reach + 1))
        kernels.mean_epipolar_likelihood(*contiguous(*planes[pair]), scale, tables[pair])
    return tables


def _rays(recording: Recording, matches: Matches, stretches: Ints) -> Floats:
    """Return the unit rays `[view, stretch, frame, point, 3]` of all labelled keypoints."""
    frames = np.unique(stretches[stretches >= 0])
    rays = gather_tracks(recording, matches, frames).rays
    rays = np.moveaxis(rays.reshape(len(rays), 3, len(frames), -1), 1, -1)
    place = np.searchsorted(frames, np.maximum(stretches, frames[0]))
    return np.where((stretches >= 0)[..., None, None], rays[:, place], np.nan)


def _epipolar_planes(
    a: Floats, b: Floats, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the normals of the epipolar planes of rays of a, rays of b, and squares of both.

    Two rays miss each other by the angle normal . ray / sqrt(square of a + square of b).

    a, b: `[stretch, frame, point, 3]` rays. rotation, translation: of b_from_a.
    """
    essential = skew(translation) @ rotation
    normal = a @ essential.T
    return normal, b, (normal**2).sum(-1), ((b @ essential) ** 2).sum(-1)


def _synchronous_angles(normal: Floats, ray: Floats, square_a: Floats, square_b: Floats) -> Floats:
    """Return the angles `[N]` by which rays of equal frame numbers miss each other."""
    angle = np.abs((normal * ray).sum(-1)) / np.sqrt(square_a + square_b)
    return angle[np.isfinite(angle)]
