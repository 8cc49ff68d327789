"""Label the detections of all views: who is who in a frame.

In each frame detections are joined to groups by their affinity. One label per detection is
cycle-consistent by construction. Groups are then carried through time by where they stand.
"""

from functools import partial

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import (
    SCALE_FRAMES,
    SCALE_LEAST_FIT,
    SCALE_PAIRS,
    Config,
    MatchingConfig,
    PairwiseConfig,
)
from mocap_calib.pairs.affinity import epipolar_affinity
from mocap_calib.pairs.solve import all_pairs
from mocap_calib.pairs.view_pair import (
    are_flat,
    distance_ratios,
    distances,
    distances_by_size,
    gather_detections,
    shared_frames,
)
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.rig.body_affinity import ever_compared, temper_by_bodies
from mocap_calib.rig.clustering import cluster_detections
from mocap_calib.rig.labels import per_frame_labels
from mocap_calib.rig.linking import link_through_time
from mocap_calib.rig.tracking import locate_groups
from mocap_calib.types import (
    Bools,
    CameraRig,
    Floats,
    Ints,
    LiftedPoses,
    Matches,
    Progress,
    Recording,
    Sample,
)

# pairs of detections grouped at a time: so many frames, or fewer in a crowd. They stay in the
# cache, and make blocks enough for several threads
_LIFTED_PAIRS = 50_000  # of a sample, compared by rays and lifted bodies
_PLAIN_PAIRS = 200_000  # of a recording, compared by rays alone
_SIDE_BY_SIDE = 4  # frames at least: the kernel compares several for little more than one,
_MOST_PAIRS = 4_000_000  # as long as they do not have more pairs


@single_threaded_libraries()
def associate(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config, *, progress: Progress
) -> Matches:
    """Label every detection of a sample with its individual, given the rig.

    The rig may be in any unit: its scale in body sizes is estimated from the lifted bodies.
    Returns labels `[view, frame, instance]`, -1 where no second view confirms a detection.
    """
    views, frames, instances = sample.positions.shape[:3]
    labels = np.full((views, frames, instances), -1, dtype=np.int64)
    scale = _body_scale(sample, lifted, rig, config)
    geometry_alone = has_single_subject(sample, config.matching.geometry_alone_share) or are_flat(
        sample, lifted, tuple(range(views)), np.arange(frames)
    )
    blocks = _cut_into_blocks(np.arange(frames), views * instances, _LIFTED_PAIRS)
    compared = ever_compared(lifted)

    def group(block: Ints) -> Ints:
        affinity, comparable = _affinities(
            sample,
            lifted,
            rig,
            block,
            scale=scale,
            geometry_alone=geometry_alone,
            compared=compared,
            config=config.pairwise,
        )
        return _group_detections(affinity, comparable, views, config.matching)

    for block, groups in zip(blocks, map_in_threads(group, blocks), strict=True):
        labels[:, block] = groups
        progress("match", int(block[-1]) + 1, frames)
    return _link_groups(sample, rig, labels, config.matching, scale=scale)


@single_threaded_libraries()
def label_all_frames(
    recording: Recording,
    rig: CameraRig,
    config: Config,
    *,
    sample_frames: Ints,
    sample: Sample,
    lifted: LiftedPoses,
    matches: Matches,
    progress: Progress,
) -> Matches:
    """Label the detections of a whole recording, of which some frames have been labelled.

    In the other frames the adjusted rig decides alone, without lifted bodies. All frames are then
    linked through time as one recording.

    sample_frames: `[frame]` indices of the frames of the sample, whose labels `matches` holds.
    Returns labels `[view, frame, instance]`, -1 = nobody.
    """
    views, frames, instances = recording.positions.shape[:3]
    labels = mapped.empty((views, frames, instances), np.int64)
    labels.fill(-1)
    labels[:, sample_frames, : matches.labels.shape[2]] = per_frame_labels(matches).labels

    others = np.setdiff1d(np.arange(frames), sample_frames)
    blocks = _cut_into_blocks(others, views * instances, _PLAIN_PAIRS)
    label = partial(_label_by_rig, recording=recording, rig=rig, config=config)
    found = map_in_threads(label, blocks)
    for done, (block, groups) in enumerate(zip(blocks, found, strict=True), start=1):
        labels[:, block, : groups.shape[2]] = groups
        mapped.let_go()
        progress("match all", done, len(blocks))
    scale = _body_scale(sample, lifted, rig, config)
    return _link_groups(recording, rig, labels, config.matching, scale=scale)


def has_single_subject(sample: Sample, share: float) -> bool:
    """Return whether at least this share of the frames shows each view at most one detection."""
    return bool(_shows_at_most_one(sample).mean() >= share)


def label_single_subject(sample: Sample, share: float) -> Matches | None:
    """Label the only detection of each view as the single subject.

    Returns labels `[view, frame, instance]`, 0 or -1; None where there is no single subject, see
    `has_single_subject`.
    """
    if not has_single_subject(sample, share):
        return None
    labelled = sample.detected & _shows_at_most_one(sample)[:, None]
    return Matches(np.where(labelled, 0, -1))


def _shows_at_most_one(sample: Sample) -> Bools:
    """Return the frames that show each view at most one detection, `[frame]`."""
    detections = sample.detected.sum(-1)
    return np.asarray((detections <= 1).all(0))


def have_same_groups(first: Matches, second: Matches) -> bool:
    """Return whether two labellings join the same detections in every frame, by any name."""
    return np.array_equal(per_frame_labels(first).labels, per_frame_labels(second).labels)


def _body_scale(sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config) -> float:
    """Return the body sizes per unit of the rig; 1 where nothing tells.

    It is the median, over joints, of how far away they were lifted over how far away the rig
    triangulates them; of a large rig, over those of some pairs of views.
    """
    pairs = evenly_spaced(np.array(all_pairs(len(rig.cameras))), SCALE_PAIRS)
    scales = partial(_scales_of_pair, sample=sample, lifted=lifted, rig=rig, config=config.pairwise)
    ratios = np.concatenate([np.zeros(0), *map_in_threads(scales, pairs)])
    return float(np.median(ratios)) if len(ratios) else 1.0


def _scales_of_pair(
    pair: Ints, *, sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: PairwiseConfig
) -> Floats:
    """Return `[joint]` body sizes per unit of the rig, by the matches of a pair of views."""
    a, b = pair.tolist()
    shared = shared_frames(sample, a, b, config)
    if not len(shared):
        return np.zeros(0)
    frames = evenly_spaced(shared, SCALE_FRAMES)
    first, second = (gather_detections(sample, lifted, view, frames) for view in (a, b))
    affinity, _ = epipolar_affinity(
        sample.select(views=[a, b]).select(frames=frames),
        rig.select([a, b]),
        np.stack([first.distance, second.distance]),
        config,
    )
    instances = first.distance.shape[1]
    matched = affinity[:, :instances, instances:] > SCALE_LEAST_FIT
    return distance_ratios(first, second, *rig.relative(a, b), matched)


def _affinities(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    frames: Ints,
    *,
    scale: float,
    geometry_alone: bool,
    compared: Bools,
    config: PairwiseConfig,
) -> tuple[Floats, Floats]:
    """Return how alike all detections of a frame are, by geometry and by their lifted bodies.

    frames: `[frame]` indices into the sample. scale: body sizes per unit of the rig.
    geometry_alone: there is one subject, or lifted bodies may be reversed. Bodies tell subjects
        apart; a badly lifted one must not speak against the only candidate, or the right one.
    compared: `[view, view]` of `ever_compared`.
    Returns `[frame, N, N]` affinities of the N = views x instances detections, and 1 where two
    detections can be compared.
    """
    block = sample.select(frames=frames)
    distance = distances(lifted.centre[:, frames], block.rays)
    affinity, comparable = epipolar_affinity(block, rig, distance, config)
    if geometry_alone:
        return affinity, comparable
    tempered = temper_by_bodies(
        affinity,
        lifted,
        rig,
        frames,
        distance=distance,
        scale=scale,
        compared=compared,
        config=config,
    )
    return tempered, comparable


def _label_by_rig(frames: Ints, *, recording: Recording, rig: CameraRig, config: Config) -> Ints:
    """Return `[view, frame, instance]` groups within some frames (indices), by the rig alone."""
    sample = take_sample(recording, frames)
    distance = distances_by_size(sample.rays)
    affinity, comparable = epipolar_affinity(sample, rig, distance, config.pairwise)
    return _group_detections(affinity, comparable, len(rig.cameras), config.matching)


def _group_detections(
    affinity: Floats, comparable: Floats, views: int, config: MatchingConfig
) -> Ints:
    """Return `[view, frame, instance]` groups within each frame."""
    groups = cluster_detections(
        affinity, comparable, views=views, least_affinity=config.least_affinity
    )
    return np.moveaxis(groups.reshape(len(groups), views, -1), 0, 1)


def _link_groups(
    recording: Recording, rig: CameraRig, labels: Ints, config: MatchingConfig, *, scale: float
) -> Matches:
    """Return the groups of each frame as individuals of the recording."""
    places = locate_groups(recording, rig, labels)
    places *= scale
    return Matches(link_through_time(labels, places, recording.frames, config))


def _cut_into_blocks(frames: Ints, detections: int, pairs: int) -> list[Ints]:
    """Return the frames `[frame]` in blocks that have about so many pairs of detections.

    detections: in each frame, at most.
    """
    in_frame = detections**2
    size = max(1, pairs // in_frame, min(_SIDE_BY_SIDE, _MOST_PAIRS // in_frame))
    return [frames[start : start + size] for start in range(0, len(frames), size)]
