"""Estimate by what part of a frame the clocks of cameras differ, together with the rig.

Where a subject moves, a camera whose clock is off sees it where it was or will be. Predicted is
the motion of points in 3D; images are never interpolated, because the mean of two detections has
less noise than one, and the offset that has the least noise would look best.

The motion follows from the neighbours of each point. It stays as it is while poses, points and
offsets are adjusted, and follows anew from the adjusted points.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import Config, SubframeConfig
from mocap_calib.multi_view.bundle_adjustment import (
    AdjustablePoints,
    agreed_points,
    observe_rays,
)
from mocap_calib.multi_view.covariance import find_covariance
from mocap_calib.multi_view.in_step import held_out_error
from mocap_calib.multi_view.motion import smoothness, usual_step
from mocap_calib.multi_view.ray_residuals import RayObservations, TimedRayObservations
from mocap_calib.multi_view.residuals import State
from mocap_calib.multi_view.schur import Freedom, free_clocks, minimise
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches, Recording, TimeOffsets


@dataclass(frozen=True)
class _Tracks:
    """Points of frames that follow each other, and what was seen of some of them.

    frames: `[frame]` indices into the recording. points: all of these frames.
    own: `[N]` indices of the points that are known `step` frames before and after, too.
    before, after: `[N]` indices of the neighbours. seen: of the points `own`.
    """

    frames: Ints
    points: AdjustablePoints
    own: Ints
    before: Ints
    after: Ints
    step: int
    seen: RayObservations

    def velocity(self, positions: Floats) -> Floats:
        """Return the velocity `[3, N]` of the points `own`, given where all are `[3, M]`."""
        return (positions[:, self.after] - positions[:, self.before]) / (2 * self.step)


@dataclass(frozen=True)
class _Estimate:
    """Offsets of clocks and the rig that goes with them.

    positions: `[3, M]` of all points. tau, sigma: `[view]` in frames.
    """

    rig: CameraRig
    positions: Floats
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
    views, options = len(rig.cameras), config.subframe
    others, none = np.arange(views) > 0, np.zeros(views, dtype=bool)
    tracks = _find_tracks(recording, rig, matches, config, budget=options.screen_points)
    if not _is_determined(tracks, options):
        return TimeOffsets.unknown(views), rig
    found = _estimate(tracks, rig, others, config, rounds=1)
    if not _exceed(found, options.screen_significance, options.least_offset / 2).any():
        return TimeOffsets(found.tau, found.sigma, none), rig
    tracks = _find_tracks(recording, rig, matches, config, budget=options.points)
    found = _estimate(tracks, rig, others, config, rounds=options.rounds)
    used = _exceed(found, options.significance, options.least_offset)
    if used.any():
        # the others' clocks agree with the first one's
        alone = _estimate(tracks, rig, used, config, rounds=options.rounds)
        offsets = TimeOffsets(
            np.where(used, alone.tau, found.tau), np.where(used, alone.sigma, found.sigma), used
        )
        part, labels = recording.select(frames=tracks.frames), matches.select(frames=tracks.frames)
        if _predicts_better(alone, part, rig, labels, config):
            return offsets, alone.rig
    return TimeOffsets(found.tau, found.sigma, none), rig


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
    points = agreed_points(recording, rig, matches, frames=frames, config=config)
    step = usual_step(recording.frames)
    index = np.full((len(recording.frames) + 1, matches.individuals, len(recording.keypoints)), -1)
    index[points.frame, points.individual, points.keypoint] = np.arange(len(points.frame))
    follows = np.append(np.diff(recording.frames) == step, [False, False])  # [frame + 1]
    next_one = index[points.frame + 1, points.individual, points.keypoint]
    next_one = np.where(follows[points.frame], next_one, -1)
    last_one = np.full(len(points.frame), -1)
    last_one[next_one[next_one >= 0]] = np.flatnonzero(next_one >= 0)
    own = np.flatnonzero((next_one >= 0) & (last_one >= 0))
    return _Tracks(
        frames=frames,
        points=points,
        own=own,
        before=last_one[own],
        after=next_one[own],
        step=step,
        seen=observe_rays(rig, points.select(own)),
    )


def _choose_stretches(matches: Matches, keypoints: int, budget: int, stretch: int) -> Ints:
    """Return indices of frames in stretches that are evenly spread, of about `budget` points."""
    individuals = (_count_labels(matches) >= 2).sum(1)  # [frame] that two views see
    starts = np.arange(0, len(individuals), stretch)
    points = np.add.reduceat(individuals, starts) * keypoints
    starts, points = starts[points > 0], points[points > 0]
    share = min(1.0, budget / max(float(points.sum()), 1.0))
    starts = evenly_spaced(starts, max(1, round(share * len(starts))))
    frames = (starts[:, None] + np.arange(stretch)).ravel()
    return frames[frames < len(individuals)]


def _count_labels(matches: Matches) -> Ints:
    """Return how many views see each individual, `[frame, individual]`."""
    view, frame, instance = np.nonzero(matches.labels >= 0)
    count = np.zeros((matches.labels.shape[1], matches.individuals), dtype=np.int64)
    np.add.at(count, (frame, matches.labels[view, frame, instance]), 1)
    return count


def _is_determined(tracks: _Tracks, config: SubframeConfig) -> bool:
    """Return whether points move, and smoothly, from frame to frame."""
    if len(tracks.own) < config.least_points:
        return False
    points = tracks.points.points
    moved = smoothness(points[:, tracks.before], points[:, tracks.own], points[:, tracks.after])
    return moved >= config.least_smoothness


# Offsets


def _estimate(
    tracks: _Tracks, rig: CameraRig, free: Bools, config: Config, *, rounds: int
) -> _Estimate:
    """Adjust poses, points and the offsets of some clocks (free: `[view]`) in rounds.

    Each round starts from the motion that the one before ended with.
    """
    freedom = free_clocks(free, config.subframe.uncertainty)
    positions = tracks.points.points.copy()
    tau = np.zeros(len(free))
    adjusted, before = rig, tau
    for _ in range(rounds):
        seen = TimedRayObservations(tracks.seen, tracks.velocity(positions))
        start = State(
            adjusted.rotation, adjusted.translation, positions[:, tracks.own], tau[:, None]
        )
        state = _at_size_of(rig, _adjust(start, seen, freedom, config))
        adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
        positions[:, tracks.own] = state.points
        before, tau = tau, state.intrinsics[:, 0]
        if np.abs(tau - before).max() < config.subframe.settled:
            break
    sigma = _sigma(state, seen, freedom, tracks, config)
    return _Estimate(rig=adjusted, positions=positions, tau=tau, sigma=sigma)


def _adjust(start: State, seen: TimedRayObservations, freedom: Freedom, config: Config) -> State:
    """Return the state of least cost; the rig has been adjusted before, if without offsets."""
    adjust = config.adjust
    return minimise(
        start,
        seen,
        freedom,
        loss_scale=adjust.loss_scales[-1],
        tolerance=adjust.rough_tolerance,
    )


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


def _sigma(
    state: State, seen: TimedRayObservations, freedom: Freedom, tracks: _Tracks, config: Config
) -> Floats:
    """Return the standard deviation `[view]` of the offsets, 0 of those that are not free."""
    points = tracks.points.select(tracks.own)
    covariance = find_covariance(
        state,
        seen,
        freedom,
        clusters=(points.time_blocks(config.intrinsics.time_blocks), points.keypoint),
        loss_scale=config.adjust.loss_scales[-1],
    )
    by_view = freedom.basis.reshape(len(state.rotation), 7, -1)[:, 6]
    return np.sqrt(by_view @ np.diag(covariance.sandwich))


def _exceed(found: _Estimate, significance: float, least: float) -> Bools:
    """Return `[view]` which offsets are so many standard deviations, and so many frames."""
    size = np.abs(found.tau)
    return (size > significance * found.sigma) & (size > least)
