"""Identities through the whole recording.

The groups of all frames are followed as far as that is certain (`pieces`), and the pieces are
joined by motion, pose and bone lengths (`join`, `bones`). Where frames do not follow each other,
identities go by place alone.
"""

from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, MatchingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.graphs import assign
from mocap_calib.identities.bones import measure_bones
from mocap_calib.identities.join import join_pieces, motion_evidence, usual_distance_apart
from mocap_calib.identities.pieces import Pieces, cut_into_pieces
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import name_groups, per_frame_labels, replace_labels, view_noise
from mocap_calib.rig.triangulate import frame_blocks, triangulate_frames
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording


def finalise_identities(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> Matches:
    """Return the groups of each frame as individuals of the recording, most seen first.

    Individuals keep their labels through occlusions, and when they meet, leave and come back. There
    are as few as the recording needs, and at most `config.matching.individuals` where that is
    known. Who is followed for a few frames alone is a false detection that happened to meet
    another: unassigned, unless enough views agree on it.

    Returns labels `[view, frame, instance]`. Raises DegenerateError where no individual is left.
    """
    matching = config.matching
    groups = per_frame_labels(matches)
    points = _triangulate_groups(recording, rig, groups, config)
    pieces = cut_into_pieces(points, recording.frames, matching)
    if pieces.step < matching.sparse_step * usual_distance_apart(points):
        individual = _join_pieces(recording.frames, points, pieces, matching)
        names = _names_of_groups(individual, pieces, points)
        labels = name_groups(groups.labels, names)
        real = _lasting_individuals(individual, pieces, labels, matching)
        labels = replace_labels(labels, np.where(real, np.arange(len(real)), -1))
    else:
        labels = name_groups(groups.labels, _names_by_place(points))
    if not (labels >= 0).any():
        raise DegenerateError(
            "expected bodies that two views agree on, found none for more than a moment; "
            "record longer, or with more overlap"
        )
    labels = _sort_by_presence(labels)
    if matching.individuals is not None:
        labels = np.where(labels < matching.individuals, labels, -1)
    return Matches(labels)


def _triangulate_groups(
    recording: Recording, rig: CameraRig, groups: Matches, config: Config
) -> Floats:
    """Return the joints of all groups of all frames, `[frame, group, joint, 3]`, NaN = missing."""
    noise = view_noise(recording, rig, groups, config.triangulate)
    joints = len(recording.keypoints)
    # not a list of parts that is joined in the end: that would be twice the memory; components
    # lie apart, as the parts have them
    points = mapped.empty((3, len(recording.frames), groups.individuals, joints))

    def locate(frames: Ints) -> None:
        _, found, _ = triangulate_frames(
            frames,
            recording=recording,
            rig=rig,
            matches=groups,
            noise=noise,
            config=config.triangulate,
        )
        points[:, mapped.as_slice(frames)] = found.reshape(3, len(frames), -1, joints)

    blocks = frame_blocks(len(recording.frames), groups.individuals * joints)
    for _ in map_in_threads(locate, blocks):
        mapped.let_go()
    return np.moveaxis(points, 0, -1)


def _join_pieces(frames: Ints, points: Floats, pieces: Pieces, config: MatchingConfig) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = unassigned.

    Of a long recording, those of its parts are joined, and then these individuals.

    frames: `[frame]` numbers; points: `[frame, group, joint, 3]`.
    """
    bodies = measure_bones(points, pieces, config.most_pieces)
    individual = np.arange(pieces.count)
    while True:
        final = pieces.count <= config.most_pieces
        wanted = config if final else replace(config, individuals=None)
        joined = np.full(pieces.count, -1, dtype=np.int64)
        for start in range(0, pieces.count, config.most_pieces):
            among = np.arange(start, min(start + config.most_pieces, pieces.count))
            first, last = pieces.first[among, 0], pieces.last[among, 0]
            pairs = motion_evidence(points, frames, pieces, among, config)
            found = join_pieces(first, last, pairs, bodies.select(among), wanted)
            joined[among] = np.where(found >= 0, found + joined.max(initial=-1) + 1, -1)
        individual = np.append(joined, -1)[individual]
        if final or joined.max() + 1 == pieces.count:
            return individual
        pieces, bodies = pieces.join(joined), bodies.join_all(joined)


def _names_of_groups(individual: Ints, pieces: Pieces, points: Floats) -> Ints:
    """Return the individual `[frame, group]` of each group, -1 = unassigned.

    Where two groups of a frame would have one name, the one with more joints has it.
    """
    names = np.append(individual, -1)[pieces.number]
    joints = mapped.in_blocks(lambda block: np.isfinite(points[block, ..., 0]).sum(-1), len(points))
    first = np.argsort(-joints, axis=1, kind="stable")
    ordered = np.take_along_axis(names, first, axis=1)
    earlier = np.tril(np.ones((names.shape[1],) * 2, dtype=bool), -1)
    again = ((ordered[:, :, None] == ordered[:, None]) & earlier).any(-1)
    ordered[again] = -1
    np.put_along_axis(names, first, ordered, axis=1)
    return names


def _lasting_individuals(
    individual: Ints, pieces: Pieces, labels: Ints, config: MatchingConfig
) -> Bools:
    """Return `[individual]` which are followed for long, or seen for long by enough views.

    individual: `[piece]`, -1 = unassigned. False detections that meet by chance jump about, and are
    mostly of two views. Measured: in recordings with a false detection in a fifth of the images
    they meet in 8 to 15 frames, never in two that follow each other.
    """
    names = int(labels.max(initial=-1)) + 1
    followed = (individual >= 0) & (pieces.lengths > 1)
    frames = np.bincount(individual[followed], pieces.lengths[followed], minlength=names)[:names]
    views = _views_of_individuals(labels, names)
    frames = np.maximum(frames, (views >= min(config.sure_views, len(labels))).sum(0))
    return np.asarray(frames > config.fleeting(labels.shape[1]))


def _views_of_individuals(labels: Ints, names: int) -> Ints:
    """Return how many views see each individual in each frame, `[frame, individual]`."""
    views = np.zeros((labels.shape[1], names), dtype=np.int64)
    for of_view in labels:
        frame, instance = np.nonzero(of_view >= 0)
        np.add.at(views, (frame, of_view[frame, instance]), 1)
    return views


def _names_by_place(points: Floats) -> Ints:
    """Return names `[frame, group]`: as many as there are groups in a frame, -1 = no group.

    A group has the name that was last nearest to where it is.
    """
    known = np.isfinite(points[..., :1]).sum(2)
    middles = np.nansum(points, axis=2) / np.where(known > 0, known, np.nan)
    present = np.isfinite(middles[..., 0])
    names = np.where(present, np.arange(present.shape[1]), -1)
    last = np.full(middles.shape[1:], np.inf)
    for frame in np.flatnonzero(present.sum(1) > 0) if present.shape[1] > 1 else ():
        here = middles[frame, present[frame]]
        with np.errstate(invalid="ignore"):
            distance = np.linalg.norm(last[:, None] - here, axis=-1)
        name, group = assign(np.minimum(distance, np.finfo(np.float32).max))
        found = np.empty(len(here), dtype=np.int64)
        found[group] = name
        names[frame, present[frame]] = found
        last[found] = here
    return names


def _sort_by_presence(labels: Ints) -> Ints:
    """Renumber individuals by the number of frames they are seen in, most first."""
    views = _views_of_individuals(labels, int(labels.max()) + 1)
    order = np.argsort(-(views > 0).sum(0), kind="stable")
    names = np.empty(len(order), dtype=np.int64)
    names[order] = np.arange(len(order))
    return replace_labels(labels, names)
