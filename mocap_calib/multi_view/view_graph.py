"""What loops of pairs say: which mode of each is right, and which cameras hang together.

Two views alone may leave several relative poses (bodies are nearly flat and nearly symmetric, cameras that face each other see the same
outline, who is who may be exchanged). A third camera tells them apart: around a triangle rotations and baselines must close. Each pair
believes in each of its modes as much as its score and its triangles say, the triangles are weighed by what the other two pairs believe, and
so on (Zach, Klopschitz, Pollefeys 2010 infer wrong relations from loops in the same way; here the rivals are known).
Groups of cameras between which no such evidence is left are not glued together by guess.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations, repeat

import numpy as np

from mocap_calib.config import AveragingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.types import Bools, Camera, Floats, Ints, PairwiseCalibration

_CLOSED = 0.5  # a triangle that closes to within the scales of the averaging


@dataclass(frozen=True)
class _Modes:
    """All modes of all pairs, those that a pair lacks with prior 0.

    rotation: `[pair, mode, 3, 3]` and translation: `[pair, mode, 3]` from the earlier view to the later; prior: `[pair, mode]`, the sum over a pair is 1.
    """

    rotation: Floats
    translation: Floats
    prior: Floats


def select_hypotheses(
    pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[PairwiseCalibration, ...]:
    """Each pair with the mode that it and its loops support best, the others as its rivals; a mode too poor to be evidence is not taken."""
    triangles = _triangles(pairs)
    if not len(triangles) or not any(pair.alternatives for pair in pairs):
        return pairs
    modes = _gather(pairs, config.least_score)
    closure = _closure(modes, triangles, config)
    belief = modes.prior
    for _ in repeat(None, config.iterations):
        heard = modes.prior * (config.loop_doubt + _support(belief, closure, triangles))
        belief = (belief + heard / heard.sum(1, keepdims=True)) / 2
    return tuple(
        _with_mode(pair, int(mode)) for pair, mode in zip(pairs, belief.argmax(1), strict=True)
    )


def alternative_taken(pair: PairwiseCalibration) -> bool:
    """Whether the loops overruled the score of the pair itself."""
    return any(rival.score > pair.score for rival in pair.alternatives)


def usable_cameras(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Ints:
    """Indices of the cameras of the only group; single cameras that none holds are left out. Raises DegenerateError where there are more groups."""
    first, *others = camera_groups(cameras, pairs, config)
    if others:
        raise several_groups([cameras[v].name for v in group] for group in (first, *others))
    return first


def several_groups(groups: Iterable[Iterable[str]]) -> DegenerateError:
    """The complaint where one group was expected; groups: the names of the cameras of each."""
    names = " | ".join(", ".join(group) for group in groups)
    return DegenerateError(
        f"expected cameras that see the same bodies, found groups that share too little: {names}; calibrate each group by itself"
    )


def camera_groups(
    cameras: tuple[Camera, ...], pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[Ints, ...]:
    """Indices of the cameras of each group that pairs connect, the largest group first; single cameras are in none.

    Pairs join what they connect, the best score first. Of two groups that both are sure of themselves, a pair that is not sure joins only those
    that a loop with another pair between them confirms: views of different rooms always find something alike. Raises DegenerateError where
    nothing is connected.
    """
    group, sure = np.arange(len(cameras)), np.zeros(len(cameras), dtype=bool)
    closes = _closes(pairs, config)
    for k in sorted(
        (k for k, p in enumerate(pairs) if p.score >= config.least_score),
        key=lambda k: -pairs[k].score,
    ):
        first, second = group[pairs[k].a], group[pairs[k].b]
        strong = pairs[k].score >= config.weak_score
        if strong or closes[k] or not (sure[first] and sure[second]):
            sure[first] |= sure[second] or strong
            group[group == second] = first
    groups = [
        members
        for members in (np.flatnonzero(group == k) for k in np.unique(group))
        if len(members) > 1
    ]
    if not groups:
        raise DegenerateError(
            "expected two cameras that see the same bodies, found none; check that the files belong to these cameras and to the same time"
        )
    return tuple(sorted(groups, key=lambda members: (-len(members), members[0])))


def pairs_among(
    pairs: tuple[PairwiseCalibration, ...], cameras: Ints
) -> tuple[PairwiseCalibration, ...]:
    """The pairs among some cameras, renumbered to their order."""
    place = {int(camera): k for k, camera in enumerate(cameras)}
    return tuple(
        replace(p, a=place[p.a], b=place[p.b], alternatives=pairs_among(p.alternatives, cameras))
        for p in pairs
        if p.a in place and p.b in place
    )


def _closes(pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig) -> Bools:
    """`[pair]` whether it closes a triangle with two others that are evidence."""
    closes = np.zeros(len(pairs), dtype=bool)
    evidence = np.array([p.score >= config.least_score for p in pairs], dtype=bool)
    triangles = _triangles(pairs)
    if len(triangles):
        triangles = triangles[evidence[triangles].all(1)]
        closure = _closure(
            _gather(tuple(replace(p, alternatives=()) for p in pairs), 0.0), triangles, config
        )[:, 0, 0, 0]
        closes[triangles[closure >= _CLOSED].ravel()] = True
    return closes


def _with_mode(pair: PairwiseCalibration, chosen: int) -> PairwiseCalibration:
    modes = pair.hypotheses
    others = (replace(mode, alternatives=()) for k, mode in enumerate(modes) if k != chosen)
    return replace(modes[chosen], alternatives=tuple(sorted(others, key=lambda mode: -mode.score)))


def _triangles(pairs: tuple[PairwiseCalibration, ...]) -> Ints:
    """`[triangle, 3]` the pairs (a, b), (b, c), (a, c) of all views a < b < c that three pairs join."""
    index = {(min(p.a, p.b), max(p.a, p.b)): k for k, p in enumerate(pairs)}
    views = sorted({view for edge in index for view in edge})
    found = [
        (index[a, b], index[b, c], index[a, c])
        for a, b, c in combinations(views, 3)
        if {(a, b), (b, c), (a, c)} <= index.keys()
    ]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def _gather(pairs: tuple[PairwiseCalibration, ...], least: float) -> _Modes:
    count = max(len(pair.hypotheses) for pair in pairs)
    rotation = np.tile(np.eye(3), (len(pairs), count, 1, 1))
    translation, score = np.zeros((len(pairs), count, 3)), np.zeros((len(pairs), count))
    for k, pair in enumerate(pairs):
        best = max(mode.score for mode in pair.hypotheses)
        for m, mode in enumerate(pair.hypotheses):
            forward = mode.a < mode.b
            rotation[k, m] = mode.rotation if forward else mode.rotation.T
            translation[k, m] = mode.translation if forward else -mode.rotation.T @ mode.translation
            score[k, m] = mode.score if mode.score >= min(best, least) else 0.0
    trust = score**2 + 1e-9 * (score == score.max(1, keepdims=True))
    return _Modes(rotation, translation, trust / trust.sum(1, keepdims=True))


def _closure(modes: _Modes, triangles: Ints, config: AveragingConfig) -> Floats:
    """`[triangle, mode of ab, mode of bc, mode of ac]` in 0..1 how well going from a to b to c agrees with going from a to c."""
    ab, bc, ac = triangles.T
    turned = np.einsum("tjxy,tiyz->tijxz", modes.rotation[bc], modes.rotation[ab])
    moved = (
        np.einsum("tjxy,tiy->tijx", modes.rotation[bc], modes.translation[ab])
        + modes.translation[bc][:, None]
    )
    angle = angle_between(turned[:, :, :, None], modes.rotation[ac][:, None, None])
    gap = ((moved[:, :, :, None] - modes.translation[ac][:, None, None]) ** 2).sum(-1)
    length = _outer(*((modes.translation[k] ** 2).sum(-1) for k in (ab, bc, ac))) / 3
    rotation = (
        1 + (angle / np.deg2rad(config.rotation_scale_deg)) ** 2 / 3
    )  # three pairs add their errors
    return 1 / rotation / (1 + gap / np.maximum(length, 1e-12) / config.translation_scale**2 / 3)


def _outer(first: Floats, second: Floats, third: Floats) -> Floats:
    """`[triangle, i, j, k]` sums of `[triangle, i]`, `[triangle, j]` and `[triangle, k]`."""
    return first[:, :, None, None] + second[:, None, :, None] + third[:, None, None]


def _support(belief: Floats, closure: Floats, triangles: Ints) -> Floats:
    """`[pair, mode]` in 0..1 mean over a pair's triangles of how well they close, given what the other two pairs believe."""
    first, second, third = (belief[column] for column in triangles.T)
    heard = (
        np.einsum("tijk,tj,tk->ti", closure, second, third, optimize=True),
        np.einsum("tijk,ti,tk->tj", closure, first, third, optimize=True),
        np.einsum("tijk,ti,tj->tk", closure, first, second, optimize=True),
    )
    total, count = np.zeros_like(belief), np.zeros(len(belief))
    for column, message in zip(triangles.T, heard, strict=True):
        np.add.at(total, column, message)
        np.add.at(count, column, 1.0)
    return total / np.maximum(count, 1.0)[:, None]
