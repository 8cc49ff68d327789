"""Carry the groups of each frame through time: who is who in the whole recording.

Groups go by where they stand in space: while a rig is built, and where frames do not follow each
other. The final names are those of `identities`.
"""

from dataclasses import dataclass
from functools import partial
from types import ModuleType

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.kernels import compiled
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.graphs import assign
from mocap_calib.geometry.projection import rays_from_pixels
from mocap_calib.multi_view.labels import name_groups, replace_labels
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Matches, Recording

_FRAMES = 512  # in which groups are located at a time
_ROOM = 64  # individuals that there is room for at first


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
    group = labels[view, frame, instance]
    pixels = recording.positions[:, block][view, frame, instance].astype(np.float64)
    rays = _central_rays(recording.cameras, view, pixels)
    rays = np.einsum("nji,nj->ni", rig.rotation[view], rays)
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    offset = np.einsum("nij,nj->ni", across, rig.centres[view])

    matrix = np.zeros((labels.shape[1], groups, 3, 3))
    vector = np.zeros((labels.shape[1], groups, 3, 1))
    np.add.at(matrix, (frame, group), across)
    np.add.at(vector, (frame, group), offset[..., None])

    present = np.abs(matrix).sum((-1, -2)) > 0
    points = np.linalg.solve(matrix + 1e-9 * np.eye(3), vector)
    return np.where(present[..., None], points[..., 0], np.nan)


def _central_rays(cameras: tuple[Camera, ...], view: Ints, pixels: Floats) -> Floats:
    """Return `[detection, 3]` unit rays, in each camera's axes, through the middles of detections.

    view: `[detection]` indices; pixels: `[detection, keypoint, 2]`, NaN = missing.
    """
    rays = np.zeros((len(view), 3))
    for index, camera in enumerate(cameras):
        of_view = view == index
        rays[of_view] = np.nansum(rays_from_pixels(camera, pixels[of_view]), axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays


def link_through_time(labels: Ints, places: Floats, frames: Ints, config: MatchingConfig) -> Ints:
    """Rename the groups of each frame so that an individual keeps its label.

    A group is the nearest individual that may have moved there since it was last seen. How far
    bodies move is a multiple of the usual step in this recording, so that sparse recordings are
    linked as well as video. The loop over frames assigns a handful of bodies at a time.

    labels: `[view, frame, instance]` groups within the frames; places: `[frame, group, 3]` in
    body sizes; frames: `[frame]` numbers. Returns labels of the same shape, those that are seen
    in most frames first.
    """
    linking = _Linking.of(places, frames, config)
    kernels = compiled("mocap_calib.multi_view.tracking_kernels")
    for block in mapped.frame_slices(len(frames)):
        index = block.start
        while index < block.stop:
            if kernels is not None:
                index = linking.link_easy_frames(kernels, index, block.stop)
            if index < block.stop:
                linking.link_frame(index)
                index += 1
    return sort_by_presence(name_groups(labels, linking.names))


@dataclass
class _Linking:
    """The individuals so far, changed in place from frame to frame.

    places: `[frame, group, 3]`; frames: `[frame]` numbers. names: `[frame, group]` the individual
    of each group, -1 = none. last_place, last_frame: `[room]` of the first `count` individuals.
    """

    places: Floats
    frames: Ints
    names: Ints
    last_place: Floats
    last_frame: Ints
    count: int
    largest_step: float
    memory: int

    @classmethod
    def of(cls, places: Floats, frames: Ints, config: MatchingConfig) -> "_Linking":
        """Return the beginning, with nobody."""
        return cls(
            places=np.ascontiguousarray(places),
            frames=frames,
            names=np.full(places.shape[:2], -1, dtype=np.int64),
            last_place=np.zeros((_ROOM, 3)),
            last_frame=np.zeros(_ROOM, dtype=np.int64),
            count=0,
            largest_step=_largest_step(places, frames, config),
            memory=config.memory,
        )

    def link_frame(self, index: int) -> None:
        """Name the groups of a frame."""
        groups = np.flatnonzero(np.isfinite(self.places[index, :, 0]))
        here = self.places[index, groups]
        known, frame = slice(self.count), self.frames[index]
        limit = self.largest_step * np.minimum(frame - self.last_frame[known], self.memory)
        individual = _nearest_individuals(self.last_place[known], here, limit)
        is_new = individual < 0
        individual[is_new] = self.count + np.arange(is_new.sum())
        self.count += int(is_new.sum())
        while self.count > len(self.last_frame):
            self.last_place = np.concatenate([self.last_place, np.zeros_like(self.last_place)])
            self.last_frame = np.concatenate([self.last_frame, np.zeros_like(self.last_frame)])
        self.last_place[individual] = here
        self.last_frame[individual] = frame
        self.names[index, groups] = individual

    def link_easy_frames(self, kernels: ModuleType, start: int, stop: int) -> int:
        """Name the groups of frames until two want the same, and return the index of that frame."""
        reached = np.zeros(2, dtype=np.int64)
        kernels.link_frames(
            self.places,
            self.frames,
            start,
            stop,
            self.count,
            self.largest_step,
            self.memory,
            self.last_place,
            self.last_frame,
            self.names,
            reached,
        )
        self.count = int(reached[1])
        return int(reached[0])


def _nearest_individuals(last_place: Floats, here: Floats, limit: Floats) -> Ints:
    """Return the individual of each group `[group]`, -1 where none may have moved there.

    last_place: `[individual, 3]`; here: `[group, 3]`; limit: `[individual]` distance that each
    may have gone.
    """
    individual = np.full(len(here), -1, dtype=np.int64)
    distance = np.linalg.norm(last_place[:, None] - here[None], axis=-1)
    if distance.size == 0:
        return individual
    # what is too far away costs the same however far it is
    cost = np.minimum(distance, 2 * limit[:, None])
    rows, columns = _assign(cost)
    near = distance[rows, columns] <= limit[rows]
    individual[columns[near]] = rows[near]
    return individual


def _assign(cost: Floats) -> tuple[Ints, Ints]:
    """Return the rows and columns of the assignment `[row, column]` of least cost.

    Where no two rows want the same column, or no two columns the same row, each gets what it wants.
    """
    rows, columns = cost.shape
    if rows <= columns and len(set((wanted := cost.argmin(1)).tolist())) == rows:
        return np.arange(rows), wanted
    if columns <= rows and len(set((wanted := cost.argmin(0)).tolist())) == columns:
        return wanted, np.arange(columns)
    return assign(cost)


def _largest_step(places: Floats, frames: Ints, config: MatchingConfig) -> float:
    """Return how far a body may be from where it was one frame number ago, in body sizes."""
    found = [np.zeros(0)]
    for block in mapped.frame_slices(len(frames) - 1, _FRAMES):
        after = slice(block.start + 1, block.stop + 1)
        apart = np.linalg.norm(places[block, :, None] - places[after, None], axis=-1)
        speed = apart / (frames[after] - frames[block])[:, None, None]
        nearest = np.where(np.isfinite(speed), speed, np.inf).min(-1, initial=np.inf)
        found.append(nearest[np.isfinite(nearest)])  # of each group, in the next frame
    steps = np.concatenate(found)
    if len(steps) == 0:
        return config.largest_step
    return max(config.largest_step, config.usual_steps * float(np.median(steps)))


def real_individuals(matches: Matches, views: int, config: MatchingConfig) -> Bools:
    """Return `[individual]` which are seen for long, or by enough views of one frame.

    views: how many cameras there are.
    """
    seen = _appearances(matches.labels)
    lasting = lasting_individuals(matches, config)
    enough = seen.views >= min(config.sure_views, views)
    lasting[seen.individual[enough]] = True
    return lasting


def lasting_individuals(matches: Matches, config: MatchingConfig) -> Bools:
    """Return `[individual]` which are seen for long."""
    seen = _appearances(matches.labels)
    frames = np.bincount(seen.individual, minlength=matches.individuals)
    share = int(config.fleeting_share * matches.labels.shape[1])
    return np.asarray(frames > min(config.fleeting_frames, share))


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
