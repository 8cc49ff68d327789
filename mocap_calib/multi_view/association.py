"""One labelling of all detections in all views.

In each frame detections are merged, most alike first, by the mean affinity between their groups; a group never holds
two detections of one view. A label per detection is cycle-consistent by construction. Groups are then carried through
time by where they stand.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from mocap_calib.compute.parallel import in_order
from mocap_calib.config import Config, MatchingConfig, PairwiseConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.projection import rays_from_pixels
from mocap_calib.multi_view.tracklets import fill_in
from mocap_calib.multi_view.triangulation import per_frame_labels
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.two_view.affinity import (
    epipolar_affinity,
    epipolar_error,
    epipolar_fit,
    match_affinity,
)
from mocap_calib.two_view.view_pair import distance_ratios, distances_by_size, view_pair
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

_SCALE_FRAMES = 40  # of each pair tell how large the rig is
_CELLS = 200_000  # pairs of detections grouped at a time, so that they stay in the cache
_FRAMES = 512  # placed at a time


def associate(
    recording: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config, *, progress: Progress
) -> Matches:
    """Labels every detection with its individual, -1 where no second view confirms it.

    The rig may be in any unit: its scale in body sizes is estimated from the bodies.
    """
    views, frames, instances = recording.positions.shape[:3]
    labels = np.full((views, frames, instances), -1, dtype=np.int64)
    scale = body_scale(recording, lifted, rig, config.pairwise)
    lone = single_subject(recording, config.matching.lone) is not None
    step = max(1, config.matching.cells // (views * instances) ** 2)
    for start in range(0, frames, step):
        block = np.arange(start, min(start + step, frames))
        affinity, comparable = _affinities(
            recording, lifted, rig, scale, block, config.pairwise, lone=lone
        )
        labels[:, block] = _groups(affinity, comparable, views, config.matching)
        progress("match", int(block[-1]) + 1, frames)
    return Matches(
        _through_time(
            labels, _places(recording, rig, labels) * scale, recording.frames, config.matching
        )
    )


def single_subject(recording: Sample, share: float = 0.5) -> Matches | None:
    """Who is who where it needs no finding: the only detection of each view; None where fewer than this share of the frames show no more."""
    there = recording.seen.any(-1)
    alone = (there.sum(-1) <= 1).all(0)
    return Matches(np.where(there & alone[:, None], 0, -1)) if alone.mean() >= share else None


def label_all_frames(
    recording: Recording,
    chosen: Ints,
    matches: Matches,
    rig: CameraRig,
    config: Config,
    *,
    scale: float,
    progress: Progress,
) -> Matches:
    """Labels for a whole recording, of which some frames (indices) have been matched.

    In the others the adjusted rig decides alone, without lifted bodies; all are then named as one recording. scale: body sizes
    per unit of the rig.
    """
    frames = len(recording.frames)
    labels = np.full(recording.positions.shape[:3], -1, dtype=np.int64)
    labels[:, chosen, : matches.labels.shape[2]] = per_frame_labels(matches).labels
    rest = np.setdiff1d(np.arange(frames), chosen)
    step = max(1, _CELLS // labels[:, 0].size ** 2)
    blocks = [rest[start : start + step] for start in range(0, len(rest), step)]

    def work(block: Ints) -> Ints:
        sample = take_sample(recording, block)
        distance = distances_by_size(sample.rays)
        affinity, comparable = epipolar_affinity(sample, rig, distance, config.pairwise)
        return _groups(affinity, comparable, len(labels), config.matching)

    for done, (block, group) in enumerate(zip(blocks, in_order(work, blocks), strict=True)):
        labels[:, block, : group.shape[2]] = group
        progress("match all", done + 1, len(blocks))
    return Matches(
        _through_time(
            labels, _places(recording, rig, labels) * scale, recording.frames, config.matching
        )
    )


def _groups(affinity: Floats, comparable: Floats, views: int, config: MatchingConfig) -> Ints:
    """`[view, frame, instance]` groups within each frame."""
    group = _cluster(affinity, comparable, views, config.least_affinity)
    return np.moveaxis(group.reshape(len(group), views, -1), 0, 1)


def body_scale(
    recording: Sample, lifted: LiftedPoses, rig: CameraRig, config: PairwiseConfig
) -> float:
    """Body sizes per unit of the rig: how far bodies were lifted over how far the rig triangulates them."""
    ratios = []
    seen = (recording.seen.sum(-1) >= 4).sum(-1) > 0
    for a, b in combinations(range(len(rig.cameras)), 2):
        shared = np.flatnonzero(seen[a] & seen[b])
        if len(shared):
            pair = view_pair(recording, lifted, a, b, evenly_spaced(shared, _SCALE_FRAMES))
            rotation, translation = rig.relative(a, b)
            error, weight = epipolar_error(pair, rotation[None], translation[None])
            matched = epipolar_fit(error, weight, config)[0] > 0.7
            ratios.append(distance_ratios(pair, rotation, translation, matched))
    found = np.concatenate(ratios) if ratios else np.zeros(0)
    return float(np.median(found)) if len(found) else 1.0


def _affinities(
    recording: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    scale: float,
    frames: Ints,
    config: PairwiseConfig,
    *,
    lone: bool,
) -> tuple[Floats, Floats]:
    """Affinity of all pairs of detections of a frame `[frame, N, N]`, N = views x instances, and 1 where it means something.

    lone: there is one subject, and geometry decides: lifted bodies tell subjects apart, and a bad one must not speak against the only candidate.
    """
    views, instances = len(rig.cameras), recording.positions.shape[2]
    affinity = np.zeros((len(frames), views, instances, views, instances))
    comparable = np.zeros_like(affinity)
    for a, b in combinations(range(views), 2):
        pair = view_pair(recording, lifted, a, b, frames)
        if lone:
            nobody = replace(pair.overlap, lifted=np.zeros_like(pair.overlap.lifted))
            pair = replace(pair, overlap=nobody)
        rotation, translation = (part[None] for part in rig.relative(a, b))
        error, weight = epipolar_error(pair, rotation, translation)
        found = match_affinity(
            pair, rotation, translation * scale, epipolar_fit(error, weight, config), config
        )[0]
        common = ((weight > 0).sum(-1) >= 3).astype(np.float64)
        affinity[:, a, :, b], affinity[:, b, :, a] = found, np.swapaxes(found, 1, 2)
        comparable[:, a, :, b], comparable[:, b, :, a] = common, np.swapaxes(common, 1, 2)
    nodes = views * instances
    return affinity.reshape(len(frames), nodes, nodes), comparable.reshape(
        len(frames), nodes, nodes
    )


def _cluster(affinity: Floats, comparable: Floats, views: int, least: float) -> Ints:
    """`[frame, N]` groups by average linkage, all frames at once; -1 for a detection that stays alone."""
    frames, nodes = affinity.shape[:2]
    total, count = affinity * comparable, comparable.copy()
    view = np.repeat(np.eye(views, dtype=bool), nodes // views, axis=0)
    holds = np.broadcast_to(view, (frames, nodes, views)).copy()
    group = np.broadcast_to(np.arange(nodes), (frames, nodes)).copy()
    linkage = np.where(view @ view.T, 0.0, total / np.maximum(count, 1.0))
    everyone = np.arange(frames)
    while len(everyone):
        flat = linkage.reshape(frames, -1)[everyone]
        best = flat.argmax(1)
        going = flat[np.arange(len(best)), best] >= least
        everyone, best = everyone[going], best[going]
        keep, gone = best // nodes, best % nodes
        for table in (total, count):
            joined = table[everyone, keep] + table[everyone, gone]
            table[everyone, keep] = table[everyone, :, keep] = joined
        holds[everyone, keep] |= holds[everyone, gone]
        holds[everyone, gone] = True  # what has been joined to another meets nobody
        clash = (holds[everyone] & holds[everyone, keep][:, None]).any(-1)
        row = np.where(clash, 0.0, total[everyone, keep] / np.maximum(count[everyone, keep], 1.0))
        linkage[everyone, keep] = linkage[everyone, :, keep] = row
        linkage[everyone, gone] = linkage[everyone, :, gone] = 0.0
        group[everyone] = np.where(group[everyone] == gone[:, None], keep[:, None], group[everyone])
    size = (group[:, :, None] == group[:, None]).sum(-1)
    return np.where(size > 1, group, -1)


def _places(recording: Recording, rig: CameraRig, labels: Ints) -> Floats:
    """`[frame, group, 3]` where the rays through the middles of a group's detections meet; NaN where there is no group."""
    frames = labels.shape[1]
    groups = int(labels.max(initial=-1)) + 1
    blocks = [slice(start, start + _FRAMES) for start in range(0, frames, _FRAMES)]

    def work(block: slice) -> Floats:
        view, frame, instance = np.nonzero(labels[:, block] >= 0)
        pixels = recording.positions[:, block][view, frame, instance].astype(np.float64)
        middle = np.zeros((len(view), 3))
        for v, camera in enumerate(recording.cameras):
            middle[view == v] = np.nansum(rays_from_pixels(camera, pixels[view == v]), axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ray = np.einsum("nji,nj->ni", rig.rotation[view], middle)
        project = np.eye(3) - ray[:, :, None] * ray[:, None]
        size = len(labels[0, block])
        matrix, vector = np.zeros((size, groups, 3, 3)), np.zeros((size, groups, 3))
        slot = (frame, labels[:, block][view, frame, instance])
        np.add.at(matrix, slot, project)
        np.add.at(vector, slot, np.einsum("nij,nj->ni", project, rig.centres[view]))
        there = np.abs(matrix).sum((-1, -2)) > 0
        point = np.linalg.solve(matrix + 1e-9 * np.eye(3), vector[..., None])[..., 0]
        return np.where(there[..., None], point, np.nan)

    return np.concatenate(list(in_order(work, blocks)))


def _through_time(labels: Ints, places: Floats, frames: Ints, config: MatchingConfig) -> Ints:
    """Renames the groups of each frame so that an individual keeps its label.

    Groups go to the nearest place an individual was last seen at, within what bodies move in this recording: a
    multiple of the usual step between its frames, so that sparse recordings are linked as well as video. The loop over
    frames assigns a handful of bodies at a time.
    """
    reach = _usual_step(places, frames, config)
    out = np.full_like(labels, -1)
    last, seen = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    for frame in range(labels.shape[1]):
        groups = np.flatnonzero(np.isfinite(places[frame, :, 0]))
        here = places[frame, groups]
        gap = np.linalg.norm(last[:, None] - here[None], axis=-1)
        limit = reach * np.minimum(frames[frame] - seen, config.memory)[:, None]
        rows, columns = (
            linear_sum_assignment(np.minimum(gap, 2 * limit))
            if gap.size
            else (np.zeros(0, int), np.zeros(0, int))
        )
        near = gap[rows, columns] <= limit[rows, 0] if gap.size else np.zeros(0, bool)
        name = np.full(len(groups), -1, dtype=np.int64)
        name[columns[near]] = rows[near]
        fresh = np.flatnonzero(name < 0)
        name[fresh] = len(last) + np.arange(len(fresh))
        last = np.concatenate([last, np.zeros((len(fresh), 3))])
        seen = np.concatenate([seen, np.zeros(len(fresh), dtype=np.int64)])
        last[name], seen[name] = here, frames[frame]
        translate = np.full(places.shape[1] + 1, -1, dtype=np.int64)
        translate[groups] = name
        out[:, frame] = translate[labels[:, frame]]
    return _by_presence(out)


def _usual_step(places: Floats, frames: Ints, config: MatchingConfig) -> float:
    """How far a body may be from where it was a frame number ago."""
    gap = (
        np.linalg.norm(places[:-1, :, None] - places[1:, None], axis=-1)
        / np.diff(frames)[:, None, None]
    )
    nearest = np.nanmin(np.where(np.isfinite(gap), gap, np.inf), axis=-1, initial=np.inf)
    found = nearest[np.isfinite(nearest)]
    return max(config.reach, 5.0 * float(np.median(found))) if len(found) else config.reach


def _by_presence(labels: Ints) -> Ints:
    """Renumbers individuals by how often they are seen, most first."""
    order = np.argsort(-_presence(labels), kind="stable")
    name = np.full(len(order) + 1, -1, dtype=np.int64)  # the last entry is where -1 finds itself
    name[order] = np.arange(len(order))
    return name[labels]


def _presence(labels: Ints) -> Ints:
    """`[individual]` number of frames each is seen in."""
    frames, individuals = labels.shape[1], int(labels.max(initial=-1)) + 1
    seen = np.zeros((frames, individuals + 1), dtype=bool)
    seen[np.arange(frames)[:, None], np.swapaxes(labels, 0, 1).reshape(frames, -1)] = True
    return seen[:, :individuals].sum(0)


def same_groups(first: Matches, second: Matches) -> bool:
    """Whether two labellings join the same detections in every frame, whatever they call them."""
    return np.array_equal(per_frame_labels(first).labels, per_frame_labels(second).labels)


def finalise_identities(
    recording: Recording, rig: CameraRig, matches: Matches, config: MatchingConfig
) -> Matches:
    """The final names: no individuals of a moment, and as few as the recording needs.

    An individual of a moment that never three views agree on is a false detection that happened to meet another: nobody.
    Of the others, one that appears takes the name of one that has gone, the last seen nearest: a cage or a stage holds so
    many bodies and no more. Detections that their own frame left unnamed take the name of their tracklet. Raises DegenerateError where nobody is left.
    """
    name, _, views = _appearances(matches.labels)
    few = min(config.fleeting_frames, int(config.fleeting_share * matches.labels.shape[1]))
    frames = np.bincount(name, minlength=matches.individuals)
    sure = np.zeros(matches.individuals, dtype=bool)
    sure[name[views >= min(3, len(rig.cameras))]] = True
    real = (frames > few) | sure
    if not real.any():
        raise DegenerateError(
            "expected bodies that two views agree on, found none for more than a moment; record longer, or with more overlap"
        )
    labels = np.where(np.append(real, False)[matches.labels], matches.labels, -1)
    named = _by_presence(
        _renamed(labels, _places(recording, rig, per_frame_labels(Matches(labels)).labels))
    )
    return Matches(fill_in(recording, named, config))


def _appearances(labels: Ints) -> tuple[Ints, Ints, Ints]:
    """(individual, frame index, number of views) of every individual in every frame that has it, by individual and frame."""
    _, frame, _ = np.nonzero(labels >= 0)
    individual = labels[labels >= 0]
    key, views = np.unique(individual * labels.shape[1] + frame, return_counts=True)
    return key // labels.shape[1], key % labels.shape[1], views


def _renamed(labels: Ints, places: Floats) -> Ints:
    """Joins individuals that are never there together, in the order they appear, each to the one last seen nearest.

    places: `[frame, group, 3]` of the groups numbered within their frames.
    """
    names, frames, _ = _appearances(labels)
    group = per_frame_labels(Matches(labels)).labels
    where = np.zeros(
        (int(labels.max(initial=-1)) + 1, 2, 3)
    )  # first and last place of each individual
    spans = {int(k): frames[names == k] for k in np.unique(names)}
    for k, present in spans.items():
        for end, at in enumerate((present[0], present[-1])):
            where[k, end] = places[at, group[:, at][labels[:, at] == k][0]]
    name = np.full(len(where) + 1, -1, dtype=np.int64)
    taken: list[Bools] = []  # per new name: the frames it is seen in
    last: list[Floats] = []  # per new name: where it was in its last frame so far
    for k, present in sorted(spans.items(), key=lambda span: span[1][0]):
        free = [n for n, busy in enumerate(taken) if not busy[present].any()]
        name[k] = min(
            free, key=lambda n: float(np.linalg.norm(last[n] - where[k, 0])), default=len(taken)
        )
        if name[k] == len(taken):
            taken.append(np.zeros(labels.shape[1], dtype=bool))
            last.append(where[k, 1])
        taken[name[k]][present] = True
        last[name[k]] = where[k, 1]
    return name[labels]
