"""Carry the groups of each frame through time: who is who in the whole recording.

Groups go by where they stand in space: while a rig is built, and where frames do not follow each
other. The final names are those of `identities`.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry import lens
from mocap_calib.rig.labels import replace_labels
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Matches, Recording

_FRAMES = 512  # in which groups are located at a time


def locate_groups(recording: Recording, rig: CameraRig, labels: Ints) -> Floats:
    """Return where each group of each frame stands: the point nearest to its central rays.

    labels: `[view, frame, instance]`, -1 = nobody. Returns `[frame, group, 3]` in the unit of the
    rig, NaN where a frame does not have the group.
    """
    groups = int(labels.max(initial=-1)) + 1
    starts = range(0, labels.shape[1], _FRAMES)
    blocks = [slice(start, start + _FRAMES) for start in starts]
    locate = partial(_locate_in_block, recording=recording, rig=rig, labels=labels, groups=groups)
    places = mapped.empty((labels.shape[1], groups, 3))
    for block, part in zip(blocks, map_in_threads(locate, blocks), strict=True):
        places[block] = part
        mapped.let_go()
    return places


def _locate_in_block(
    block: slice, *, recording: Recording, rig: CameraRig, labels: Ints, groups: int
) -> Floats:
    """Return `[frame, group, 3]` places in one block of frames.

    The point nearest to lines with directions r through points c solves
    sum (I - r r') x = sum (I - r r') c.
    """
    labels = labels[:, block]
    view, frame, instance = np.nonzero(labels >= 0)
    group = frame * groups + labels[view, frame, instance]
    pixels = recording.positions[:, block][view, frame, instance].astype(np.float64)
    rays = _central_rays(recording.cameras, view, pixels)
    rays = np.einsum("nji,jn->in", rig.rotation[view], rays)
    across = np.eye(3)[..., None] - rays[:, None] * rays
    offset = np.einsum("ijn,nj->in", across, rig.centres[view])

    frames = labels.shape[1]
    rows = (*across.reshape(9, -1), *offset)
    sums = [np.bincount(group, row, minlength=frames * groups) for row in rows]
    matrix = np.stack(sums[:9], axis=-1).reshape(frames, groups, 3, 3)
    vector = np.stack(sums[9:], axis=-1).reshape(frames, groups, 3, 1)
    present = np.abs(matrix).sum((-1, -2)) > 0
    points = np.linalg.solve(matrix + 1e-9 * np.eye(3), vector)
    return np.where(present[..., None], points[..., 0], np.nan)


def _central_rays(cameras: tuple[Camera, ...], view: Ints, pixels: Floats) -> Floats:
    """Return `[3, detection]` unit rays, in each camera's axes, through the middles of detections.

    view: `[detection]` indices; pixels: `[detection, keypoint, 2]`, NaN = missing.
    """
    rays = np.zeros((3, len(view)))
    for index, camera in enumerate(cameras):
        of_view = view == index
        own = np.moveaxis(pixels[of_view], -1, 0)
        found = lens.unproject(camera, np.ascontiguousarray(own).reshape(2, -1))
        rays[:, of_view] = np.nansum(found.reshape(3, *own.shape[1:]), axis=-1)
    return rays / np.linalg.norm(rays, axis=0)


def real_individuals(matches: Matches, views: int, config: MatchingConfig) -> Bools:
    """Return `[individual]` which are seen for long, or by enough views of one frame.

    views: how many cameras there are.
    """
    seen = _appearances(matches.labels)
    frames = np.bincount(seen.individual, minlength=matches.individuals)
    lasting = frames > frames_by_chance(matches.labels.shape[1], config)
    return np.asarray(lasting | (frames_of_sure_views(matches, views, config) > 0))


def frames_of_sure_views(matches: Matches, views: int, config: MatchingConfig) -> Ints:
    """Return in how many frames `[individual]` so many views agree that chance hardly does it.

    views: how many cameras there are.
    """
    seen = _appearances(matches.labels)
    enough = seen.views >= min(config.sure_views, views)
    return np.bincount(seen.individual[enough], minlength=matches.individuals)


def frames_by_chance(frames: int, config: MatchingConfig) -> int:
    """Return in how many of some frames false detections may meet by chance."""
    return min(config.fleeting_frames, int(config.fleeting_share * frames))


@dataclass(frozen=True)
class _Appearances:
    """Every individual in every frame that has it, in the order of individuals, then frames.

    individual, frame (index), views (their number): `[appearance]`.
    """

    individual: Ints
    frame: Ints
    views: Ints


def _appearances(labels: Ints) -> _Appearances:
    """Return who is seen when, of labels `[view, frame, instance]`."""
    frames = labels.shape[1]
    keys, views = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for block in mapped.frame_slices(frames):
        _, frame, _ = np.nonzero(labels[:, block] >= 0)
        individual = labels[:, block][labels[:, block] >= 0]
        key, count = np.unique(individual * frames + frame + block.start, return_counts=True)
        keys.append(key)
        views.append(count)
    key = np.concatenate(keys)
    order = np.argsort(key)  # each once: one frame is in one block
    key = key[order]
    return _Appearances(
        individual=key // frames, frame=key % frames, views=np.concatenate(views)[order]
    )


@dataclass(frozen=True)
class _Presence:
    """When an individual is seen, and where at first and at last.

    frames: indices, ascending. first_place, last_place: `[3]`.
    """

    individual: int
    frames: Ints
    first_place: Floats
    last_place: Floats


def _list_presences(labels: Ints, groups: Ints, places: Floats) -> list[_Presence]:
    """List when and where each individual is seen, in the order of their labels.

    labels: `[view, frame, instance]`; groups: the same, numbered within each frame; places:
    `[frame, group, 3]`.
    """
    seen = _appearances(labels)
    presences = []
    for individual in np.unique(seen.individual).tolist():
        frames = seen.frame[seen.individual == individual]
        first_place, last_place = (
            places[frame, groups[:, frame][labels[:, frame] == individual][0]]
            for frame in (frames[0], frames[-1])
        )
        presences.append(
            _Presence(
                individual=individual,
                frames=frames,
                first_place=first_place,
                last_place=last_place,
            )
        )
    return presences


def reuse_names(labels: Ints, groups: Ints, places: Floats) -> Ints:
    """Return the labels with as few names as the recording needs, by place alone.

    Individuals that are never seen together are joined, in the order in which they appear, each
    to the one that was last seen nearest to where it appears: a cage or a stage holds so many
    bodies and no more.

    labels: `[view, frame, instance]`; groups: the same, numbered within each frame; places:
    `[frame, group, 3]`.
    """
    presences = _list_presences(labels, groups, places)
    individuals, frames = int(labels.max(initial=-1)) + 1, labels.shape[1]
    names = np.full(individuals, -1, dtype=np.int64)
    busy: list[Bools] = []  # of each name: the frames it is seen in
    last_place: list[Floats] = []  # of each name: where it was last seen so far
    for presence in sorted(presences, key=lambda each: each.frames[0]):
        free = [name for name, frames_of in enumerate(busy) if not frames_of[presence.frames].any()]
        if free:
            gaps = [last_place[name] - presence.first_place for name in free]
            distances = [float(np.linalg.norm(gap)) for gap in gaps]
            name = free[distances.index(min(distances))]
        else:
            name = len(busy)
            busy.append(np.zeros(frames, dtype=bool))
            last_place.append(presence.last_place)
        names[presence.individual] = name
        busy[name][presence.frames] = True
        last_place[name] = presence.last_place
    return replace_labels(labels, names)


def sort_by_presence(labels: Ints) -> Ints:
    """Renumber individuals by the number of frames they are seen in, most first."""
    presence = np.bincount(_appearances(labels).individual)
    by_presence = np.argsort(-presence, kind="stable")
    names = np.zeros(len(by_presence), dtype=np.int64)
    names[by_presence] = np.arange(len(by_presence))
    return replace_labels(labels, names)
