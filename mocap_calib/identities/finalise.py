"""Who is who in the end: individuals that last through a recording.

The groups of all frames are followed as far as that is certain (`pieces`), and the pieces are
joined by motion, pose and the proportions of the bodies (`evidence`, `joining`). Where frames do
not follow each other, names stay as they were linked by place alone (`tracking`).
"""

from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, MatchingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.identities.evidence import (
    image_evidence,
    image_links,
    motion_evidence,
    usual_distance_apart,
)
from mocap_calib.identities.joining import join_pieces
from mocap_calib.identities.pieces import Pieces, cut_into_pieces
from mocap_calib.identities.proportions import measure_proportions
from mocap_calib.identities.tracklets import all_tracklets
from mocap_calib.rig.labels import name_groups, per_frame_labels, replace_labels
from mocap_calib.rig.noise import view_noise
from mocap_calib.rig.tracking import (
    frames_by_chance,
    frames_of_sure_views,
    locate_groups,
    real_individuals,
    reuse_names,
    sort_by_presence,
)
from mocap_calib.rig.triangulate import frame_blocks, triangulate_frames
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches, Recording


def finalise_identities(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> Matches:
    """Give the final names: who is who through the whole recording.

    Individuals keep their names through occlusions, and when they meet, leave and come back: by
    motion, pose and proportions. A recording has as few names as it needs, and no more than
    `config.matching.individuals`, where these are known. Who is followed for a moment alone is a
    false detection that happened to meet another: nobody; unless enough views agree on it for
    longer, or in one frame where bodies cannot be followed.

    Returns labels `[view, frame, instance]`, those that are seen in most frames first. Raises
    DegenerateError where nobody is left.
    """
    matching = config.matching
    groups = per_frame_labels(matches)
    points = _triangulate_groups(recording, rig, groups, config)
    tracks = all_tracklets(recording, matching)
    pieces = _followable_pieces(points, recording.frames, matching)
    if pieces is None:
        real = real_individuals(matches, len(rig.cameras), matching)
        labels = _select_individuals(matches, real)
        in_frames = per_frame_labels(Matches(labels)).labels
        labels = reuse_names(labels, in_frames, locate_groups(recording, rig, in_frames))
    else:
        individual = _join_pieces(
            recording.frames, points, pieces, matching, groups=groups.labels, tracks=tracks
        )
        names = _names_of_groups(individual, pieces, points)
        named = Matches(name_groups(groups.labels, names))
        real = _lasting_individuals(individual, pieces, named, len(rig.cameras), matching)
        labels = _select_individuals(named, real)
    labels = sort_by_presence(labels)
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


def _followable_pieces(points: Floats, frames: Ints, config: MatchingConfig) -> Pieces | None:
    """Return the pieces of a recording in which bodies can be followed, None of another.

    Bodies cannot be followed where they go so far between frames as they are from each other; and
    need not be where there is never more than one.
    """
    pieces = cut_into_pieces(points, frames, config)
    apart = usual_distance_apart(points, config)
    return pieces if pieces.step < config.sparse_step * apart else None


def _join_pieces(
    frames: Ints,
    points: Floats,
    pieces: Pieces,
    config: MatchingConfig,
    *,
    groups: Ints,
    tracks: Ints,
) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = nobody.

    frames: `[frame]` numbers. groups, tracks: `[view, frame, instance]`.

    Of a long recording, those of its parts are joined, and then these individuals.
    """
    links = image_links(tracks, groups, pieces)
    bodies = measure_proportions(points, pieces, config)
    individual = np.arange(pieces.count)
    while True:
        final = pieces.count <= config.most_pieces
        wanted = config if final else replace(config, individuals=None)
        joined = np.full(pieces.count, -1, dtype=np.int64)
        for start in range(0, pieces.count, config.most_pieces):
            among = np.arange(start, min(start + config.most_pieces, pieces.count))
            pairs = motion_evidence(points, frames, pieces, among, config)
            pairs += image_evidence(links, among, config)
            first, last = pieces.first[among, 0], pieces.last[among, 0]
            found = join_pieces(first, last, pairs, bodies.select(among), wanted)
            joined[among] = np.where(found >= 0, found + joined.max(initial=-1) + 1, -1)
        individual = np.append(joined, -1)[individual]
        if final or joined.max() + 1 == pieces.count:
            return individual
        pieces, bodies = pieces.join(joined), bodies.join_all(joined)
        links = np.append(joined, -1)[links[0]], np.append(joined, -1)[links[1]]


def _names_of_groups(individual: Ints, pieces: Pieces, points: Floats) -> Ints:
    """Return the individual `[frame, group]` of each group, -1 = nobody.

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
    individual: Ints, pieces: Pieces, matches: Matches, views: int, config: MatchingConfig
) -> Bools:
    """Return `[individual]` which are followed for long, or seen for long by enough views.

    individual: `[piece]`, -1 = nobody. False detections that meet by chance jump about, and are
    mostly of two views. Measured: in recordings with a false detection in a fifth of the images
    they meet in 8 to 15 frames, never in two that follow each other.
    """
    followed = (individual >= 0) & (pieces.lengths > 1)
    frames = np.bincount(
        individual[followed], pieces.lengths[followed], minlength=matches.individuals
    )[: matches.individuals]
    frames = np.maximum(frames, frames_of_sure_views(matches, views, config))
    return np.asarray(frames > frames_by_chance(matches.labels.shape[1], config))


def _select_individuals(matches: Matches, real: Bools) -> Ints:
    """Return the labels without individuals that are false detections.

    real: `[individual]`. Raises DegenerateError where nobody is left.
    """
    if not real.any():
        raise DegenerateError(
            "expected bodies that two views agree on, found none for more than a moment; "
            "record longer, or with more overlap"
        )
    kept = np.where(real, np.arange(len(real)), -1)
    return replace_labels(matches.labels, kept)
