"""Estimate by what part of a frame the clocks of cameras differ, and resample to the first one's.

Where a subject moves, a camera whose clock is off sees it where it was or will be. Predicted is
the motion of points in 3D; images are never interpolated, because the mean of two detections has
less noise than one, and the offset that has the least noise would look best.

The motion follows from the neighbours of each point. It stays as it is while poses, points and
offsets are adjusted, and follows anew from the adjusted points.

A detection is resampled along the motion of its triangulated point, which is taken to be straight:
single points show more noise than acceleration.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.adjust.covariance import find_covariance
from mocap_calib.adjust.problem import Problem, free_parameters, problem_of_frames
from mocap_calib.adjust.residuals import State, motion_between
from mocap_calib.adjust.solve import minimise, optimise_points
from mocap_calib.config import TYPICAL_PERCENTILE, Config, TriangulateConfig
from mocap_calib.geometry import lens
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.mapped import frame_slices
from mocap_calib.recording.sampling import evenly_spaced, take_sample, usual_step
from mocap_calib.results import Adjusted, Matches, Poses3D, TimeOffsets
from mocap_calib.rig import Observed, Tracks, labelled_frames
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

_POINTS = 12_000  # that an estimate takes
_STRETCH = 10  # frames that follow each other, of which the points come
# 1 = points move without jerks, 0 = as frames of different times would have them. Recordings of
# moving subjects have 0.6 to 0.96, samples of single frames 0.15 to 0.26
_LEAST_SMOOTHNESS = 0.5
_ROUNDS, _TOLERANCE = 7, 1e-4  # of adjusting with the motion of the round before
# frames; motion is known from a frame before to one after: the largest is as well the standard
# deviation of offsets beforehand
_LEAST_OFFSET, _MOST_OFFSET = 0.1, 1.2
# standard deviations of an offset that is applied; synchronous recordings reach 3.6, recordings
# of which cameras take every second frame 6 to 60
_SIGNIFICANT = 5.0


def synchronise_detections(
    observed: Observed, adjusted: Adjusted, matches: Matches, config: Config
) -> tuple[Observed, Adjusted, TimeOffsets]:
    """Return the detections at the time of the first camera, the rig that fits, and the offsets.

    matches: labels in all frames of the recording. All stays as it is where no offset is
    significant.
    """
    offsets, rig = find_time_offsets(observed.recording, adjusted.rig, matches, config)
    if not offsets.used.any():
        return observed, adjusted, offsets
    recording = resample(observed.recording, rig, matches, offsets.applied, config.triangulate)
    sample = take_sample(recording, observed.sample_frames)
    observed = replace(observed, recording=recording, sample=sample)
    return observed, replace(adjusted, rig=rig), offsets


def find_time_offsets(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> tuple[TimeOffsets, CameraRig]:
    """Return by what part of a frame clocks differ, and the rig that is adjusted with that.

    rig, matches: adjusted and labelled as if the clocks agreed. The rig stays as it is where no
    offset is applied. The cost does not depend on the length of the recording.
    """
    unknown = TimeOffsets.unknown(len(rig.cameras)), rig
    if not config.sync.subframe:
        return unknown
    frames = _choose_stretches(matches, len(recording.keypoints), _POINTS)
    problem = problem_of_frames(recording, rig, matches, frames, config)
    step = usual_step(recording.frames)
    triples = _find_triples(problem.tracks, recording.frames, step)
    free = _determined_views(problem, triples, config.adjust.least_keypoints)
    if not free.any():
        return unknown
    adjusted, tau, sigma = _estimate(problem, triples, step, free, config)
    used = _are_significant(tau, sigma)
    known = free | (np.arange(len(free)) == 0)
    tau, sigma = (np.where(known, each, np.nan) for each in (tau, sigma))
    return TimeOffsets(tau, sigma, used), adjusted if used.any() else rig


def _are_significant(tau: Floats, sigma: Floats) -> Bools:
    """Return `[view]` which offsets are certain and large enough to be applied.

    None is where one is too large for the motion that is known of points.
    """
    size = np.abs(tau)
    in_reach = size.max() <= _MOST_OFFSET
    return (size > _SIGNIFICANT * sigma) & (size > _LEAST_OFFSET) & in_reach


# Which points


def _find_triples(tracks: Tracks, frames: Ints, step: int) -> Ints:
    """Return the indices `[3, N]` of points a step before, of the points, and a step after.

    Points without both neighbours are left out. frames: `[frame]` numbers of the frames of the
    recording.
    """
    number = frames[tracks.frame]
    order = np.lexsort((number, tracks.keypoint, tracks.individual))
    same = (np.diff(tracks.individual[order]) == 0) & (np.diff(tracks.keypoint[order]) == 0)
    follows = same & (np.diff(number[order]) == step)
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    triples = order[np.stack([middle - 1, middle, middle + 1])]
    return triples[:, np.argsort(triples[1])]


def _choose_stretches(matches: Matches, keypoints: int, budget: int) -> Ints:
    """Return indices of frames in stretches that are evenly spread, of about `budget` points."""
    labelled = labelled_frames(matches)
    bodies = (matches.labels[:, labelled] >= 0).sum(2).max(0).mean()  # in a frame
    starts = np.unique(labelled // _STRETCH) * _STRETCH
    starts = evenly_spaced(starts, max(1, round(budget / (bodies * keypoints * _STRETCH))))
    frames = (starts[:, None] + np.arange(_STRETCH)).ravel()
    return frames[frames < matches.labels.shape[1]]


def _determined_views(problem: Problem, triples: Ints, least: int) -> Bools:
    """Return the views `[view]` whose clocks can be told from the first one's.

    Points must move, and smoothly, from frame to frame, and views see so many of them at least.
    """
    seen = problem.tracks.weight[:, triples[1]] > 0
    enough = seen.sum(1) >= least
    neighbours = (problem.points[:, each] for each in triples)
    if not enough[0] or smoothness(*neighbours) < _LEAST_SMOOTHNESS:
        return np.zeros(len(enough), dtype=bool)
    return enough & (np.arange(len(enough)) > 0)


# Offsets


def _estimate(
    problem: Problem, triples: Ints, step: int, free: Bools, config: Config
) -> tuple[CameraRig, Floats, Floats]:
    """Return the rig adjusted with the offsets of some clocks (free: `[view]`), and these.

    Offsets and standard deviations `[view]` in frames, 0 where one is not free. Each round starts
    from the motion that the one before ended with.

    triples: `[3, N]` as of `_find_triples`; the points in the middle are adjusted.
    """
    rig, loss_scale, own = problem.rig, problem.loss_scale, problem.select(triples[1])
    group = np.where(free, np.arange(len(free)), -1)
    freedom = free_parameters(group, np.full((len(free), 1), _MOST_OFFSET))
    positions, state = problem.points.copy(), own.start(np.zeros((len(free), 1)))
    for _ in range(_ROUNDS):
        last = state.intrinsics
        before, here, after = (positions[:, each] for each in triples)
        seen = replace(own.rays, motion=motion_between(here - before, after - here, step))
        state = minimise(state, seen, freedom, loss_scale=loss_scale, tolerance=_TOLERANCE)
        state = _at_size_of(rig, optimise_points(state, seen, loss_scale=loss_scale))
        positions[:, triples[1]] = state.points
        converged = np.abs(state.intrinsics - last).max() < 0.01
        if converged or np.abs(state.intrinsics).max() > _MOST_OFFSET:
            break
    covariance = find_covariance(own, state, seen, freedom, config)
    sigma = np.sqrt(freedom.by_view[:, -1] @ np.diag(covariance.cautious))
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    return adjusted, state.intrinsics[:, 0], sigma


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


# Detections at the time of the first camera


def resample(
    recording: Recording, rig: CameraRig, matches: Matches, tau: Floats, config: TriangulateConfig
) -> Recording:
    """Return the recording with detections as the cameras would have seen them at one time.

    tau: `[view]` frames by which a camera's images are later than those of the same number of a
    camera whose offset is 0. Unassigned detections, and those of points that are not known or whose
    motion is not, stay as they are.
    """
    poses = triangulate(recording, rig, matches, config)
    positions = recording.positions.copy()
    frames = len(poses.frames)
    for view in np.flatnonzero(tau).tolist():
        for rows in frame_slices(frames):
            block = np.arange(frames)[rows]
            shift = _image_motion(rig, view, poses, block, -float(tau[view]))
            labels = matches.labels[view, block]
            frame, instance = np.nonzero(labels >= 0)
            moved = np.nan_to_num(shift[frame, labels[frame, instance]])
            positions[view, block[frame], instance] += moved.astype(positions.dtype)
    return replace(recording, positions=positions)


def _image_motion(rig: CameraRig, view: int, poses: Poses3D, block: Ints, time: float) -> Floats:
    """Return how far poses of some frames move in a view's images in a time in frames.

    `[frame, individual, keypoint, 2]` in pixels, NaN where it is not known.
    """
    points = poses.positions[block].reshape(-1, 3).T
    moved = points + time * _velocity(poses, block)
    rotation, translation = rig.rotation[view], rig.translation[view][:, None]
    now, then = (
        lens.project(rig.cameras[view], rotation @ where + translation) for where in (points, moved)
    )
    return (then - now).T.reshape(*poses.positions[block].shape[:3], 2)


def _velocity(poses: Poses3D, block: Ints) -> Floats:
    """Return the velocity `[3, N]` of the points of some frames, in lengths by frame.

    block: `[frame]` indices, one after the other. Points are in the order frame, individual,
    keypoint. Where a neighbour is not known, or its frame does not follow, a point moves as the
    other one says; NaN where neither is.
    """
    step, around = usual_step(poses.frames), np.arange(block[0] - 1, block[-1] + 2)
    around = np.clip(around, 0, len(poses.frames) - 1)
    follows = np.diff(poses.frames[around]) == step
    moved = np.diff(poses.positions[around], axis=0)
    moved = np.where(follows[:, None, None, None], moved, np.nan)
    return mean_of_known(np.stack([moved[:-1], moved[1:]]), 0).reshape(-1, 3).T / step


def smoothness(before: Floats, points: Floats, after: Floats) -> float:
    """Return how smoothly points move: 1 without jerks, 0 as by chance.

    Each is `[3, N]`, the same points in frames that follow each other. Where errors are independent
    and of variance s^2, or frames do not follow each other, half of the way from before to after
    varies by s^2 / 2, and the way of a point off the middle of the two by 3 s^2 / 2. The largest
    motions, which are mistaken identities, do not count.
    """
    along = (((after - before) / 2) ** 2).sum(0)
    aside = ((points - (after + before) / 2) ** 2).sum(0)
    if not len(along):
        return 0.0
    usual = along + aside <= np.percentile(along + aside, TYPICAL_PERCENTILE)
    total = along[usual].sum()
    return float(1 - aside[usual].sum() / (3 * total)) if total > 0 else 0.0
