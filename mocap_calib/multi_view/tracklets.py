"""Detections followed through each view by their motion in the image: many frames tell who one is that a single frame does not.

Tracks that the input names are not needed for this and not believed: where they are exchanged the image jumps, and what jumps is not followed.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mocap_calib.config import MatchingConfig
from mocap_calib.types import Bools, Floats, Ints, Reals, Recording

_FRAMES = 512  # linked at a time


def fill_in(recording: Recording, labels: Ints, config: MatchingConfig) -> Ints:
    """`[view, frame, instance]` labels in which nobody takes the name that most of his tracklet has, where another view has it too.

    Names that are given stay, and none is given twice in a view and frame.
    """
    out = labels.copy()
    for view, own in enumerate(labels):
        wanted = _majority(tracklets(recording, view, config), own, config)
        taken = (wanted[:, :, None] == own[:, None]).any(-1)
        others = np.moveaxis(np.delete(labels, view, axis=0), 1, 0).reshape(len(own), -1)
        confirmed = (wanted[:, :, None] == others[:, None]).any(-1)
        out[view] = np.where((own < 0) & confirmed & ~taken & ~_twice(wanted), wanted, own)
    return out


def tracklets(recording: Recording, view: int, config: MatchingConfig) -> Ints:
    """`[frame, instance]` number of the tracklet of each detection of a view, -1 where there is none.

    Detections of neighbouring frames are linked that are each other's nearest and near for their size.
    """
    positions = recording.positions[view]
    frames, instances = positions.shape[:2]
    links = [
        _links(positions[start : start + _FRAMES + 1], config)
        for start in range(0, frames - 1, _FRAMES)
    ]
    linked = np.concatenate(links) if links else np.zeros((0, instances, instances), dtype=bool)
    linked &= (np.diff(recording.frames) == 1)[:, None, None]
    frame, i, j = np.nonzero(linked)
    first, second = frame * instances + i, (frame + 1) * instances + j
    graph = coo_array(
        (np.ones(len(first)), (first, second)), shape=(frames * instances, frames * instances)
    )
    number = connected_components(graph, directed=False)[1].reshape(frames, instances)
    return np.where(np.isfinite(positions[..., 0]).any(-1), number, -1)


def _links(positions: Reals, config: MatchingConfig) -> Bools:
    """`[frame - 1, instance, instance]` which detections of a frame go on as which of the next."""
    gap2, size2 = _gaps(positions[:-1], positions[1:])
    near = np.where(gap2 < config.tracklet_step**2 * size2, gap2, np.inf)
    best = (near == near.min(-1, keepdims=True)) & (near == near.min(-2, keepdims=True))
    return np.asarray(best & np.isfinite(near))


def _gaps(before: Reals, after: Reals) -> tuple[Floats, Floats]:
    """`[frame, I, J]` mean squared distance of the joints that both have (inf below three), and mean squared extent of the earlier."""
    there_a, there_b = (
        np.isfinite(before[..., 0]).astype(np.float64),
        np.isfinite(after[..., 0]).astype(np.float64),
    )
    a, b = (np.nan_to_num(x.astype(np.float64)) for x in (before, after))
    count = np.einsum("fik,fjk->fij", there_a, there_b)
    square = np.einsum("fik,fjk->fij", (a**2).sum(-1), there_b) + np.einsum(
        "fik,fjk->fij", there_a, (b**2).sum(-1)
    )
    gap2 = (square - 2 * np.einsum("fikx,fjkx->fij", a, b, optimize=True)) / np.maximum(count, 1)
    number = np.maximum(there_a.sum(-1), 1)[..., None]
    middle = a.sum(-2) / number
    size2 = (a**2).sum((-1, -2)) / number[..., 0] - (middle**2).sum(-1)
    return np.where(count >= 3, np.maximum(gap2, 0.0), np.inf), np.broadcast_to(
        size2[:, :, None], gap2.shape
    )


def _majority(track: Ints, labels: Ints, config: MatchingConfig) -> Ints:
    """`[frame, instance]` the name that more than half of a detection's tracklet has within a stretch of frames; -1 where there is none."""
    stretches = len(track) // config.tracklet_frames + 1
    part = track * stretches + np.arange(len(track))[:, None] // config.tracklet_frames
    parts, own = np.unique(np.where(track >= 0, part, -1), return_inverse=True)
    own = own.reshape(part.shape)
    names = int(labels.max(initial=0)) + 1
    keys, votes = np.unique((own * names + labels)[labels >= 0], return_counts=True)
    most = 2 * votes > np.bincount(own.ravel(), minlength=len(parts))[keys // names]
    winner = np.full(len(parts), -1, dtype=np.int64)
    winner[keys[most] // names] = keys[most] % names
    return winner[own]


def _twice(names: Ints) -> Bools:
    """`[frame, instance]` whether another detection of the frame has the same name."""
    same = (names[:, :, None] == names[:, None]) & (names >= 0)[:, :, None]
    return np.asarray(same.sum(-1) > 1)
