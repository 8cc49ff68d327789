"""The graph of cameras that pairs connect: which cameras form a group that sees the same bodies.

Groups of cameras that no loop and no certain pair connects are not joined by guess.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.config import AveragingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig.loops import count_triangles, find_lost_cameras, pairs_in_closed_triangles
from mocap_calib.types import Camera, Floats, Ints


def best_scores(pairs: tuple[PairwiseCalibration, ...], views: int) -> Floats:
    """Return the score of the best pair of each view: its place in the rig rests on this pair.

    `[view]`, NaN where no pair is known.
    """
    scores = np.full(views, np.nan)
    for pair in pairs:
        scores[[pair.a, pair.b]] = np.fmax(scores[[pair.a, pair.b]], pair.score)
    return scores


def usable_cameras(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Ints:
    """Return the indices `[view]` of the cameras of the only group.

    Single cameras that no pair connects to it are left out. Raises DegenerateError where there are
    several groups, or none.
    """
    groups = camera_groups(cameras, pairs, config)
    if len(groups) > 1:
        names = [", ".join(cameras[view].name for view in group) for group in groups]
        raise DegenerateError(
            "expected cameras that see the same bodies, found groups that share too little: "
            f"{' | '.join(names)}; calibrate each group by itself"
        )
    return groups[0]


def camera_groups(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[Ints, ...]:
    """Return the indices `[view]` of the cameras of each group that pairs connect.

    The largest group comes first; single cameras are in none. Raises DegenerateError where nothing
    is connected.
    """
    group_of = _join_cameras(len(cameras), _trusted_pairs(len(cameras), pairs, config), config)
    members = (np.flatnonzero(group_of == group) for group in np.unique(group_of))
    groups = [views for views in members if len(views) > 1]
    if not groups:
        raise DegenerateError(
            "expected two cameras that see the same bodies, found none; "
            "check that the files belong to these cameras and to the same time"
        )
    return tuple(sorted(groups, key=lambda views: (-len(views), views[0])))


def pairs_among(
    pairs: tuple[PairwiseCalibration, ...], cameras: Ints
) -> tuple[PairwiseCalibration, ...]:
    """Return the pairs among some cameras, renumbered to the order of these.

    cameras: `[view]` indices.
    """
    place = {int(camera): k for k, camera in enumerate(cameras)}
    return tuple(
        replace(
            pair,
            a=place[pair.a],
            b=place[pair.b],
            alternatives=pairs_among(pair.alternatives, cameras),
        )
        for pair in pairs
        if pair.a in place and pair.b in place
    )


def _trusted_pairs(
    cameras: int, pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[PairwiseCalibration, ...]:
    """Return the pairs that may join cameras: none between a lost camera and one that is not.

    Lost cameras may see a place of their own. A strong pair may join two of them if it has at least
    the median number of matches of the pairs that loops confirm.
    """
    lost = find_lost_cameras(cameras, pairs, config)
    if not lost.any():
        return pairs
    trusted = tuple(pair for pair in pairs if not lost[[pair.a, pair.b]].any())
    closes = pairs_in_closed_triangles(trusted, config)
    matches = [len(pair.matches) for pair, closed in zip(trusted, closes, strict=True) if closed]
    usual = np.median(matches) if matches else np.inf
    return trusted + tuple(
        pair
        for pair in pairs
        if lost[[pair.a, pair.b]].all()
        and pair.score >= config.weak_score
        and len(pair.matches) >= usual
    )


def _join_cameras(
    cameras: int, pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Ints:
    """Return `[view]` the number of the group that each camera belongs to.

    Pairs join the groups of their cameras, the best score first. A group is certain once it has a
    pair with a strong score. Two certain groups are joined only by a pair that has a strong score
    itself, or that closes a triangle: views of different rooms always find something alike. Nor by
    these where triangles contradict: what is alike in two rooms, it is for few of their views.
    """
    group = np.arange(cameras)
    certain = np.zeros(cameras, dtype=bool)  # by number of the group
    views = np.array([(pair.a, pair.b) for pair in pairs], dtype=np.int64).reshape(-1, 2)
    closed, looked_at = count_triangles(pairs, config)
    many = looked_at >= config.enough_triangles
    contradicted = many & (closed < config.contradicted_share * looked_at)
    usable = [k for k, pair in enumerate(pairs) if pair.score >= config.least_score]
    for k in sorted(usable, key=lambda k: -pairs[k].score):
        first, second = group[views[k]]
        strong = pairs[k].score >= config.weak_score
        joins = True
        if certain[first] and certain[second]:
            sides = group[views]
            between = ((sides == first).any(1) & (sides == second).any(1)).nonzero()
            enough = config.contradicted_share * looked_at[between].sum()
            agreed = closed[k] > 0 and closed[between].sum() >= enough
            joins = not contradicted[k] if strong else agreed
        if joins:
            certain[first] |= certain[second] or strong
            group[group == second] = first
    return group
