"""Associate the detections of all views in each frame: which show one individual.

Detections are grouped by their affinity, the share of their joints that fit the epipolar geometry
of the rig. One label per detection is cycle-consistent by construction. Lifted bodies decide where
geometry leaves a choice, as far as they prove reliable in this recording: their likelihood ratio is
measured on the pairs of detections of which geometry alone is sure.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import LEAST_LIFT_SPREAD, Config, PairwiseConfig
from mocap_calib.kernels.association import cluster_frames
from mocap_calib.kernels.jit import contiguous
from mocap_calib.pairs.affinity import epipolar_affinity
from mocap_calib.pairs.view_pair import distances, distances_by_size
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.rig import per_frame_labels
from mocap_calib.types import CameraRig, Floats, Ints, Progress, Recording, Sample

# Pairs of detections grouped at a time: they stay in the cache, and make blocks enough for several
# threads. The likelihood ratio is measured on a quarter as many
_PAIRS = 200_000
_NEWTON_STEPS = 8  # of the logistic regression


@dataclass(frozen=True)
class LogRatio:
    """The log-likelihood ratio of two classes, linear in some features.

    slope: `[feature]`. low, high: `[feature]` range of the examples, beyond which it is constant.
    """

    slope: Floats
    offset: float
    low: Floats
    high: Floats

    def __call__(self, features: Floats) -> Floats:
        """Return the log-likelihood ratios `[...]` of features `[..., feature]`, 0 where NaN."""
        return np.nan_to_num(np.clip(features, self.low, self.high) @ self.slope + self.offset)


def measure_log_ratio(features: Floats, one: Floats, two: Floats) -> LogRatio | None:
    """Return the log-likelihood ratio of class one against class two; None without examples.

    Logistic regression with a normal prior of variance 1 on the slopes: few examples determine
    little. Both classes weigh alike, so that log-odds are log-likelihood ratios.

    features: `[example, feature]`, NaN = unknown. one, two: `[example]` how certainly an example
    is of either class, 0..1.
    """
    known = np.isfinite(features).all(-1)
    features, one, two = features[known], one[known], two[known]
    least = min(one.sum(), two.sum())
    if least <= 0:
        return None
    one, two = one * (least / one.sum()), two * (least / two.sum())
    middle = features.mean(0)
    rows = np.column_stack([features - middle, np.ones(len(features))])
    prior = np.diag([*np.ones(len(middle)), 1e-9])
    found = np.zeros(len(prior))
    for _ in range(_NEWTON_STEPS):
        chance = 1 / (1 + np.exp(-rows @ found))
        gradient = rows.T @ (one * (1 - chance) - two * chance) - prior @ found
        curvature = (rows.T * ((one + two) * chance * (1 - chance))) @ rows + prior
        found = found + np.linalg.solve(curvature, gradient)
    slope = found[:-1]
    offset = float(found[-1] - middle @ slope)
    return LogRatio(slope, offset, low=features.min(0), high=features.max(0))


@single_threaded_libraries()
def associate(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config, *, progress: Progress
) -> Matches:
    """Group the detections of each frame of a sample by individual, given the rig in any unit.

    Returns labels `[view, frame, instance]`, numbered from 0 in each frame, -1 where no second
    view confirms a detection.
    """
    views, frames, instances = sample.positions.shape[:3]
    labels = np.full((views, frames, instances), -1, dtype=np.int64)
    ratio = _measure_pose_ratio(sample, lifted, rig, config.pairwise)

    def group(block: Ints) -> Ints:
        affinity, comparable = _geometric_affinity(sample, lifted, rig, block, config.pairwise)
        if ratio is not None:
            # bodies were lifted from the same joints that fit the epipolar geometry or do not: they
            # choose among matches that fit, and join none that does not
            affinity *= (1 + 1 / (1 + np.exp(-ratio(_pose_features(lifted, rig, block))))) / 2
        return _group_detections(affinity, comparable, views, config.matching.least_affinity)

    blocks = _cut_into_blocks(np.arange(frames), views * instances)
    for block, groups in zip(blocks, map_in_threads(group, blocks), strict=True):
        labels[:, block] = groups
        progress("match", int(block[-1]) + 1, frames)
    return Matches(labels)


@single_threaded_libraries()
def label_all_frames(
    recording: Recording,
    rig: CameraRig,
    config: Config,
    *,
    sample_frames: Ints,
    matches: Matches,
    progress: Progress,
) -> Matches:
    """Group the detections of a whole recording, some frames of which are grouped already.

    The other frames are grouped by the adjusted rig alone, without lifted bodies.

    sample_frames: `[frame]` indices of the frames of the sample, whose labels `matches` holds.
    Returns labels `[view, frame, instance]`, numbered from 0 in each frame, -1 = unassigned.
    """
    views, frames, instances = recording.positions.shape[:3]
    labels = mapped.empty((views, frames, instances), np.int64)
    labels.fill(-1)
    labels[:, sample_frames, : matches.labels.shape[2]] = per_frame_labels(matches).labels

    others = np.setdiff1d(np.arange(frames), sample_frames)
    blocks = _cut_into_blocks(others, views * instances)

    def label(frames: Ints) -> Ints:
        part = take_sample(recording, frames)
        distance = distances_by_size(part.rays)
        affinity, comparable = epipolar_affinity(part, rig, distance, config.pairwise)
        return _group_detections(affinity, comparable, views, config.matching.least_affinity)

    found = zip(blocks, map_in_threads(label, blocks), strict=True)
    for done, (block, groups) in enumerate(found, start=1):
        labels[:, block, : groups.shape[2]] = groups
        mapped.let_go()
        progress("match all", done, len(blocks))
    return Matches(labels)


def _geometric_affinity(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, frames: Ints, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Return `[frame, N, N]` affinities of N = views x instances, and 1 where comparable, else 0.

    frames: `[frame]` indices into the sample.
    """
    block = sample.select(frames=frames)
    distance = distances(lifted.centre[:, frames], block.rays)
    return epipolar_affinity(block, rig, distance, config)


def _pose_features(lifted: LiftedPoses, rig: CameraRig, frames: Ints) -> Floats:
    """Return how lifted bodies of any two detections differ, `[frame, N, N, 2]`, NaN = unknown.

    The logarithms of the mean squared distance of their joints, both bodies turned into the world
    and centred, and of that which the network expects.
    """
    spread = lifted.spread[:, frames]
    weight = _by_frame(np.nan_to_num(1.0 / (spread**2 + LEAST_LIFT_SPREAD**2)))
    variance = _by_frame(np.nan_to_num(spread) ** 2)
    # a row times R is R' times the column
    joints = _by_frame(np.nan_to_num(lifted.body[:, frames]) @ rig.rotation[:, None, None])
    weighted = (joints * weight[..., None]).reshape(*weight.shape[:2], -1)
    squares = (joints**2).sum(-1) * weight
    total = weight @ np.swapaxes(weight, 1, 2)
    total[total == 0] = np.nan
    apart = _both_ways(squares, weight) - _both_ways(weighted, weighted)
    expected = _both_ways(variance * weight, weight)
    means = [np.maximum(sums / total, 0.0) for sums in (apart, expected)]
    return np.log(np.stack(means, axis=-1) + LEAST_LIFT_SPREAD**2)


def _by_frame(array: Floats) -> Floats:
    """Return `[frame, N, ...]` of an array `[view, frame, instance, ...]`."""
    moved = np.moveaxis(array, 0, 1)
    return np.ascontiguousarray(moved.reshape(len(moved), -1, *array.shape[3:]))


def _both_ways(first: Floats, second: Floats) -> Floats:
    """Return the symmetric sums of products `[frame, N, N]` of `[frame, N, K]` in either order."""
    products = first @ np.swapaxes(second, 1, 2)
    return np.asarray(products + np.swapaxes(products, 1, 2))


def _measure_pose_ratio(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: PairwiseConfig
) -> LogRatio | None:
    """Return the log-likelihood ratio of `_pose_features` that two detections are one individual.

    None where bodies of one individual are not closer than those of two: then geometry decides
    alone.
    """
    views, frames, instances = sample.positions.shape[:3]
    count = max(1, _PAIRS // (2 * views * instances) ** 2)
    block = evenly_spaced(np.arange(frames), count)
    one, two = _certain_pairs(*_geometric_affinity(sample, lifted, rig, block, config), views=views)
    features = _pose_features(lifted, rig, block)
    ratio = measure_log_ratio(features.reshape(-1, 2), one.ravel(), two.ravel())
    return ratio if ratio is not None and ratio.slope[0] < 0 else None


def _certain_pairs(affinity: Floats, comparable: Floats, *, views: int) -> tuple[Floats, Floats]:
    """Return how certain geometry is that pairs are one individual, and that they are two.

    `[frame, N, N]` in 0..1. One: the affinity, times how unlikely all other matches of both
    detections within each other's view are. Two: one of them certainly matches another detection of
    the other's view, and the pair has no affinity.
    """
    shape = (*affinity.shape[:2], views, -1)
    chance = affinity * comparable

    def of_others(values: Floats) -> Floats:
        """Return the sum over the other detections of the same view."""
        by_view = values.reshape(shape)
        return np.asarray((by_view.sum(-1, keepdims=True) - by_view).reshape(values.shape))

    unrivalled = of_others(np.log1p(-np.minimum(chance, 1 - 1e-9)))
    one = chance * np.exp(unrivalled + np.swapaxes(unrivalled, 1, 2))
    taken = np.minimum(of_others(one), 1.0)
    two = np.maximum(taken, np.swapaxes(taken, 1, 2)) * (1 - affinity) * comparable
    return one, two


def _group_detections(
    affinity: Floats, comparable: Floats, views: int, least_affinity: float
) -> Ints:
    """Return `[view, frame, instance]` groups within each frame."""
    groups = cluster_detections(affinity, comparable, views=views, least_affinity=least_affinity)
    return np.moveaxis(groups.reshape(len(groups), views, -1), 0, 1)


def cluster_detections(
    affinity: Floats, comparable: Floats, *, views: int, least_affinity: float
) -> Ints:
    """Return the group of each detection in its frame, `[frame, N]`; -1 for one that stays alone.

    Agglomerative clustering with average linkage (Sokal and Michener 1958). A group never holds two
    detections of one view. Groups are numbered from 0 in each frame, by their first detection.

    affinity, comparable: `[frame, N, N]` of the N = views x instances detections: how alike two
        of them are, 0..1, and 1 where they can be compared; symmetric.
    least_affinity: the mean affinity down to which groups are merged; what is not alike at all
        never is.
    """
    least_affinity = max(least_affinity, 1e-12)  # 0: clusters that must not be merged
    cluster = np.empty(affinity.shape[:2], dtype=np.int64)
    detections = affinity.shape[1]
    view = np.arange(detections) // max(detections // views, 1)
    cluster_frames(*contiguous(affinity, comparable), view, least_affinity, cluster)
    return cluster


def _cut_into_blocks(frames: Ints, detections: int) -> list[Ints]:
    """Return the frames `[frame]` in blocks that have about as many pairs of detections.

    detections: in each frame, at most.
    """
    size = max(_PAIRS // detections**2, 1)
    return [frames[start : start + size] for start in range(0, len(frames), size)]
