"""Estimate by what part of a frame the clocks of cameras differ, together with the rig.

Where a subject moves, a camera whose clock is off sees it where it was or will be. Predicted is
the motion of points in 3D; images are never interpolated, because the mean of two detections has
less noise than one, and the offset that has the least noise would look best.

The motion follows from the neighbours of each point. It stays as it is while poses, points and
offsets are adjusted, and follows anew from the adjusted points.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.covariance import find_covariance
from mocap_calib.adjust.motion import Motion, motion_between, smoothness
from mocap_calib.adjust.parameters import free_clocks
from mocap_calib.adjust.problem import Problem, problem_of_frames
from mocap_calib.adjust.residuals import RayResiduals, State, TimedRayResiduals
from mocap_calib.adjust.solve import minimise, optimise_points
from mocap_calib.clocks.in_step import held_out_error
from mocap_calib.config import Config, SubframeConfig
from mocap_calib.recording.sampling import evenly_spaced, usual_step
from mocap_calib.results import Matches, TimeOffsets
from mocap_calib.rig.labels import per_frame_labels
from mocap_calib.rig.tracks import Tracks, labelled_frames
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

_COUNTED_FRAMES = 200  # that tell how many points a frame has


@dataclass(frozen=True)
class _Tracks:
    """Points of frames that follow each other, and what was seen of some of them.

    frames: `[frame]` indices into the recording. points: all M of these frames.
    own: `[N]` indices of the points that are known `step` frames before and after, too.
    before, after: `[N]` indices of these neighbours. seen: of the points `own`.
    leader: `[M]` index of the point of `own` that a point moves with when the rig changes; its own
        index where there is none beside it.
    """

    frames: Ints
    points: Problem
    own: Ints
    before: Ints
    after: Ints
    leader: Ints
    step: int
    seen: RayResiduals

    def motion(self, positions: Floats) -> Motion:
        """Return how the points `own` move, given where all are `[3, M]`."""
        before, here, after = (positions[:, i] for i in (self.before, self.own, self.after))
        return motion_between(here - before, after - here, self.step)

    def move(self, positions: Floats, own: Floats) -> Floats:
        """Return where all points `[3, M]` are after the points `own` have moved to `[3, N]`.

        The others are not adjusted: each moves as its neighbour does.
        """
        moved = np.zeros_like(positions)
        moved[:, self.own] = own - positions[:, self.own]
        return positions + moved[:, self.leader]


@dataclass(frozen=True)
class _Estimate:
    """Offsets of clocks, in frames, and the rig that goes with them.

    tau, sigma: `[view]`, 0 where an offset is not free.
    """

    rig: CameraRig
    tau: Floats
    sigma: Floats


def find_time_offsets(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> tuple[TimeOffsets, CameraRig]:
    """Return by what part of a frame clocks differ, and the rig that is adjusted with that.

    rig, matches: adjusted and labelled as if the clocks agreed. The rig stays as it is where no
    offset is used. What a first look takes does not depend on the length of the recording; only
    where it finds something is more looked at.
    """
    options = config.subframe
    if not options.enabled:
        return TimeOffsets.unknown(len(rig.cameras)), rig
    tracks = _find_tracks(recording, rig, matches, config, budget=options.screen_points)
    free = _determined_views(tracks, options)
    if not free.any():
        return TimeOffsets.unknown(len(rig.cameras)), rig
    found = _estimate(tracks, rig, free, config, first_look=True)
    none = np.zeros(len(rig.cameras), dtype=bool)
    if not _are_usable(found, options.screen_significance, options, share=0.5).any():
        return _describe(found, free, none), rig
    tracks = _find_tracks(recording, rig, matches, config, budget=options.points)
    found = _estimate(tracks, rig, free, config)
    used = _are_usable(found, options.significance, options)
    if used.any():
        alone = _estimate(tracks, rig, used, config)  # other clocks agree with the first one
        in_reach = np.abs(alone.tau).max() <= options.most_offset
        part, labels = recording.select(frames=tracks.frames), matches.select(frames=tracks.frames)
        if in_reach and _predicts_better(alone, part, rig, labels, config):
            both = replace(
                alone,
                tau=np.where(used, alone.tau, found.tau),
                sigma=np.where(used, alone.sigma, found.sigma),
            )
            return _describe(both, free, used), alone.rig
    return _describe(found, free, none), rig


def _describe(found: _Estimate, free: Bools, used: Bools) -> TimeOffsets:
    """Return the offsets as a record; free, used: `[view]`."""
    known = free | (np.arange(len(free)) == 0)
    return TimeOffsets(
        tau=np.where(known, found.tau, np.nan),
        sigma=np.where(known, found.sigma, np.nan),
        used=used,
    )


def _are_usable(
    found: _Estimate, significance: float, config: SubframeConfig, *, share: float = 1.0
) -> Bools:
    """Return `[view]` which offsets are so many standard deviations, and large enough.

    None is where one is too large for the motion that is known of points: clocks that differ by
    whole frames are to be mended first. share: of the least offset that does, too.
    """
    size = np.abs(found.tau)
    large_enough = size > share * config.least_offset
    in_reach = size.max() <= config.most_offset
    return (size > significance * found.sigma) & large_enough & in_reach


def _predicts_better(
    found: _Estimate, recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> bool:
    """Return whether detections that are left out are better predicted with the offsets.

    recording, matches: of the frames that are looked at. rig: that without offsets.
    """
    error = held_out_error(recording, found.rig, matches, found.tau, config)
    return error < held_out_error(recording, rig, matches, np.zeros(len(rig.cameras)), config)


# Which points


def _find_tracks(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config, *, budget: int
) -> _Tracks:
    """Return about `budget` points of stretches of the recording, with their neighbours."""
    frames = _choose_stretches(matches, len(recording.keypoints), budget, config.subframe.stretch)
    points = problem_of_frames(recording, rig, matches, frames, config)
    step = usual_step(recording.frames)
    before, after = _find_neighbours(points.tracks, recording.frames, step)
    between = (before >= 0) & (after >= 0)
    own = np.flatnonzero(between)
    leader = np.arange(len(between))
    for neighbour in (before, after):
        leader = np.where(~between & (neighbour >= 0) & between[neighbour], neighbour, leader)
    return _Tracks(
        frames=frames,
        points=points,
        own=own,
        before=before[own],
        after=after[own],
        leader=leader,
        step=step,
        seen=points.select(own).rays,
    )


def _find_neighbours(tracks: Tracks, frames: Ints, step: int) -> tuple[Ints, Ints]:
    """Return the indices `[M]` of the points a step before and after; -1 = none.

    frames: `[frame]` numbers of the frames of the recording.
    """
    present, rank = np.unique(tracks.frame, return_inverse=True)
    shape = (len(present) + 1, tracks.individual.max(initial=0) + 1)
    index = np.full((*shape, tracks.keypoint.max(initial=0) + 1), -1)
    index[rank, tracks.individual, tracks.keypoint] = np.arange(len(rank))
    follows = np.append(np.diff(frames[present]) == step, False)[: len(present)]
    next_one = index[rank + 1, tracks.individual, tracks.keypoint]
    after = np.where(follows[rank], next_one, -1)
    before = np.full(len(rank), -1)
    before[after[after >= 0]] = np.flatnonzero(after >= 0)
    return before, after


def _choose_stretches(matches: Matches, keypoints: int, budget: int, stretch: int) -> Ints:
    """Return indices of frames in stretches that are evenly spread, of about `budget` points."""
    labelled = labelled_frames(matches)
    some = per_frame_labels(matches.select(frames=evenly_spaced(labelled, _COUNTED_FRAMES))).labels
    individuals = np.arange(some.max(initial=0) + 1)
    views = (some[..., None] == individuals).any(2).sum(0)  # [frame, individual]
    points = max(1.0, (views >= 2).sum(1).mean()) * keypoints  # in a frame
    starts = np.unique(labelled // stretch) * stretch
    starts = evenly_spaced(starts, max(1, round(budget / (points * stretch))))
    frames = (starts[:, None] + np.arange(stretch)).ravel()
    return frames[frames < matches.labels.shape[1]]


def _determined_views(tracks: _Tracks, config: SubframeConfig) -> Bools:
    """Return the views `[view]` whose clocks can be told from the first one's.

    Points must move, and smoothly, from frame to frame, and views see enough of them.
    """
    points = tracks.points.points
    enough = (tracks.seen.weight > 0).sum(1) >= config.least_points
    neighbours = (points[:, index] for index in (tracks.before, tracks.own, tracks.after))
    if not enough[0] or smoothness(*neighbours) < config.least_smoothness:
        return np.zeros(len(enough), dtype=bool)
    return enough & (np.arange(len(enough)) > 0)


# Offsets


def _estimate(
    tracks: _Tracks, rig: CameraRig, free: Bools, config: Config, *, first_look: bool = False
) -> _Estimate:
    """Adjust poses, points and the offsets of some clocks (free: `[view]`) in rounds.

    Each round starts from the motion that the one before ended with. A first look is one round, to
    no great precision.
    """
    options, last_scale = config.subframe, tracks.points.loss_scale
    freedom = free_clocks(free, options.uncertainty)
    positions, adjusted, tau = tracks.points.points, rig, np.zeros(len(free))
    for _ in range(1 if first_look else options.rounds):
        before = tau
        seen = TimedRayResiduals(tracks.seen, tracks.motion(positions))
        own = positions[:, tracks.own]
        state = minimise(
            State(adjusted.rotation, adjusted.translation, own, tau[:, None]),
            seen,
            freedom,
            loss_scale=last_scale,
            tolerance=config.adjust.rough_tolerance if first_look else options.tolerance,
        )
        state = _at_size_of(rig, optimise_points(state, seen, loss_scale=last_scale))
        adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
        positions = tracks.move(positions, state.points)
        tau = state.intrinsics[:, 0]
        settled = np.abs(tau - before).max() < options.settled
        if settled or np.abs(tau).max() > options.most_offset:
            break
    points = tracks.points.tracks.select(tracks.own)
    covariance = find_covariance(
        state,
        seen,
        freedom,
        period=points.time_blocks(config.uncertainty.time_blocks),
        joint=points.keypoint,
        scale=last_scale,
    )
    sigma = np.sqrt(freedom.by_view[:, -1] @ np.diag(covariance.cautious))
    return _Estimate(rig=adjusted, tau=tau, sigma=sigma)


def _at_size_of(rig: CameraRig, state: State) -> State:
    """Return a state at the size of a rig, with the offsets that then go with the same motion.

    A larger world at larger offsets looks alike as long as the motion stays as it is.
    """
    first = rig.centres[0]
    centres = -np.einsum("vji,vj->vi", state.rotation, state.translation)
    size = np.sqrt(((centres - first) ** 2).sum() / ((rig.centres - first) ** 2).sum())
    centres = first + (centres - first) / size
    return State(
        rotation=state.rotation,
        translation=-np.einsum("vij,vj->vi", state.rotation, centres),
        points=first[:, None] + (state.points - first[:, None]) / size,
        intrinsics=state.intrinsics / size,
    )
