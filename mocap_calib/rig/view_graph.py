"""Use loops of pairs: which hypothesis of each pair is right, and which cameras form a group.

Two views alone may leave several relative poses: bodies are nearly flat and nearly symmetric,
cameras that face each other see the same outline, who is who may be exchanged. A third camera
tells them apart: around a triangle rotations and baselines must close. The belief in each
hypothesis of a pair follows from its score and from how well its triangles close, given the
belief in the hypotheses of the other two pairs, and so on. Zach, Klopschitz and Pollefeys 2010
("Disambiguating visual relations using loop constraints") infer wrong relations from loops in
the same way; here the alternatives are known.
Groups of cameras that no such loop and no certain pair connects are not joined by guess.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.config import AveragingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.rig.loops import (
    closure_of,
    count_triangles,
    find_lost_cameras,
    list_triangles,
    pairs_in_closed_triangles,
    stack_hypotheses,
)
from mocap_calib.types import Camera, Floats, Ints, PairwiseCalibration


def select_hypotheses(
    pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[PairwiseCalibration, ...]:
    """Return each pair with the hypothesis that its score and its loops make most probable.

    The other hypotheses become its alternatives. One whose score is below `config.least_score` is
    not taken in place of one above.
    """
    triangles = list_triangles(pairs)
    if len(triangles) == 0 or not any(pair.alternatives for pair in pairs):
        return pairs
    hypotheses = stack_hypotheses(pairs, config.least_score)
    closure = closure_of(hypotheses, triangles, config)
    belief = hypotheses.prior
    for _ in range(config.iterations):
        agreement = _agreement_of_triangles(belief, closure, triangles)
        posterior = hypotheses.prior * (config.loop_doubt + agreement)
        posterior = posterior / posterior.sum(1, keepdims=True)
        belief = (belief + posterior) / 2  # halfway, so that beliefs do not oscillate
    most_probable = belief.argmax(1).tolist()
    return tuple(map(_take_hypothesis, pairs, most_probable))


def alternative_taken(pair: PairwiseCalibration) -> bool:
    """Return whether the loops overruled the score of the pair itself."""
    return any(alternative.score > pair.score for alternative in pair.alternatives)


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
    many = looked_at >= config.contradicting_triangles
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


def _take_hypothesis(pair: PairwiseCalibration, answer: int) -> PairwiseCalibration:
    """Return the pair with one hypothesis (index) as its answer, the others as alternatives."""
    hypotheses = pair.hypotheses
    others = [replace(h, alternatives=()) for k, h in enumerate(hypotheses) if k != answer]
    others.sort(key=lambda hypothesis: -hypothesis.score)
    return replace(hypotheses[answer], alternatives=tuple(others))


def _agreement_of_triangles(belief: Floats, closure: Floats, triangles: Ints) -> Floats:
    """Return how well the triangles of a pair close, expected over what is believed of the others.

    belief: `[pair, hypothesis]`; closure: `[triangle, hypothesis, hypothesis, hypothesis]`.
    Returns `[pair, hypothesis]` in 0..1, the mean over the triangles of each pair.
    """
    ab, bc, ac = (belief[pair] for pair in triangles.T)
    expected = (
        np.einsum("tijk,tj,tk->ti", closure, bc, ac, optimize=True),
        np.einsum("tijk,ti,tk->tj", closure, ab, ac, optimize=True),
        np.einsum("tijk,ti,tj->tk", closure, ab, bc, optimize=True),
    )
    total = np.zeros_like(belief)
    count = np.zeros(len(belief))
    for pair, agreement in zip(triangles.T, expected, strict=True):
        np.add.at(total, pair, agreement)
        np.add.at(count, pair, 1.0)
    return total / np.maximum(count, 1.0)[:, None]
