"""Link the groups of each frame through time: a group is the nearest individual.

Easy frames, in which no two want the same, are linked by a kernel; the others one by one.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.graphs import assign
from mocap_calib.kernels.linking import link_frames
from mocap_calib.rig.labels import name_groups
from mocap_calib.rig.tracking import sort_by_presence
from mocap_calib.types import Floats, Ints

_ROOM = 64  # individuals that there is room for at first
_FRAMES = 512  # between which steps are measured at a time


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
    for block in mapped.frame_slices(len(frames)):
        index = block.start
        while index < block.stop:
            index = linking.link_easy_frames(index, block.stop)
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
            frames=np.ascontiguousarray(frames, dtype=np.int64),  # a slice of a recording's is not
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

    def link_easy_frames(self, start: int, stop: int) -> int:
        """Name the groups of frames until two want the same, and return the index of that frame."""
        reached = np.zeros(2, dtype=np.int64)
        link_frames(
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
