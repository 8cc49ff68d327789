"""The view graph: which pairs of cameras are calibrated, and which of them third cameras confirm.

All pairs of a small rig are calibrated. They grow as the square of the cameras, and say the same
many times. The first graph of a large rig joins each camera to those that see most in common with
it, to some that see less, from other sides, and to its neighbours by name. It is calibrated and
judged, and grows where it is weak: where a camera has too few pairs that third cameras confirm, and
where too few such pairs join two parts.

What two views see in common is known before any pair is calibrated: distances within a lifted body
do not depend on the camera. Views of the same bodies show similar postures in the same frames, and
less similar ones in other frames.

Around a triangle rotations and baselines must close (Zach, Klopschitz and Pollefeys 2010 find wrong
relations by it): pairs that close none confirm nothing.

Pairs connect cameras to groups, each of which sees the same bodies. Groups that no loop and no
certain pair connects are not joined by guess.
"""

from copy import deepcopy
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mocap_calib.config import SMALL_RIG, AveragingConfig, Config, ViewGraphConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.graphs import connected_parts, fiedler_vector
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.pairs.solve import PairSolver, all_pairs, calibrate_pairs
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.types import Bools, Camera, Floats, Ints, Mapper, Progress, Sample

T = TypeVar("T")


def calibrate_view_graph(
    sample: Sample,
    lifted: LiftedPoses,
    config: Config,
    *,
    rng: np.random.Generator,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
) -> tuple[PairwiseCalibration, ...]:
    """Calibrate the pairs of views that are chosen; see `calibrate_pairs`.

    A pair is calibrated as it would be among all pairs. rng: is not consumed.
    """
    views, graph = len(sample.cameras), config.view_graph
    wanted = all_pairs(views)
    calibrated: tuple[PairwiseCalibration, ...] = ()
    asked = np.zeros((views, views), dtype=bool)
    covisible = np.zeros((views, views))
    if not takes_all_pairs(views, graph):
        covisible = measure_covisibility(lifted, graph)
        wanted = first_pairs(covisible, graph)
    for number in range(graph.rounds + 1):
        calibrated += calibrate_pairs(
            sample,
            lifted,
            config.pairwise,
            rng=deepcopy(rng),
            progress=progress,
            mapper=mapper,
            solve=solve,
            pairs=wanted,
        )
        asked[tuple(np.array(wanted, dtype=np.int64).reshape(-1, 2).T)] = True
        calibrated = tuple(sorted(calibrated, key=lambda pair: (pair.a, pair.b)))
        if asked.sum() == len(all_pairs(views)) or number == graph.rounds:
            break
        confirmed = confirmed_pairs(calibrated, views, config.averaging)
        partners = graph.partners * 2**number
        wanted = pairs_to_grow(confirmed, covisible, asked, partners=partners, config=graph)
        if not wanted:
            break
    return calibrated


def takes_all_pairs(views: int, config: ViewGraphConfig) -> bool:
    """Return whether a rig is so small that all its pairs are calibrated."""
    return config.pairs == "all" or views <= config.small_rig


def first_pairs(covisible: Floats, config: ViewGraphConfig) -> list[tuple[int, int]]:
    """Return the pairs (a, b), a < b, that are calibrated first, in order.

    They connect all views, and each has at least two partners. covisible: `[view, view]`.
    """
    views = len(covisible)
    joined = np.zeros((views, views), dtype=bool)
    view = np.arange(views)
    joined[view, (view + 1) % views] = True
    for a in range(views):
        ranked = _rank_partners(covisible[a], np.arange(views) != a)
        likely = covisible[a, ranked] >= config.likely * max(covisible[a, ranked[0]], 0.0)
        nearest, others = np.split(ranked[likely], [config.partners])
        joined[a, nearest] = True
        joined[a, evenly_spaced(others, config.partners)] = True
    return _list_pairs(joined)


def confirmed_pairs(
    pairs: tuple[PairwiseCalibration, ...], views: int, config: AveragingConfig
) -> Bools:
    """Return which pairs close a triangle with two others, `[view, view]`, symmetric."""
    confirmed = np.zeros((views, views), dtype=bool)
    for pair, closed in zip(pairs, count_triangles(pairs, config)[0], strict=True):
        confirmed[pair.a, pair.b] = confirmed[pair.b, pair.a] = closed > 0
    return confirmed


def pairs_to_grow(
    confirmed: Bools, covisible: Floats, asked: Bools, *, partners: int, config: ViewGraphConfig
) -> list[tuple[int, int]]:
    """Return further pairs (a, b), a < b, where the graph of confirmed pairs is weak.

    Where less than the share `config.least_confirmed_share` of what was asked is confirmed, all
    pairs that are left: what was chosen sees too little in common, and of many wrong pairs some
    close triangles by chance.

    A view with fewer confirmed pairs than `config.partners` gets so many more partners, and
    so does each part of the graph that fewer than `config.partners` confirmed pairs join to
    the rest. Those come first that see most in common.

    asked: `[view, view]` which pairs a < b were calibrated.
    """
    views = len(confirmed)
    free = ~(asked | asked.T | np.eye(views, dtype=bool))
    if confirmed.sum() / 2 < config.least_confirmed_share * asked.sum():
        return _list_pairs(free)
    joined = np.zeros((views, views), dtype=bool)
    for view in np.flatnonzero(confirmed.sum(1) < config.partners):
        ranked = _rank_partners(covisible[view], free[view])
        joined[view, ranked[:partners]] = True
    for inside in _weak_parts(confirmed, config):
        across = free & inside[:, None] & ~inside
        ranked = _rank_partners(covisible.ravel(), across.ravel())[: 2 * partners]
        joined[np.unravel_index(ranked, joined.shape)] = True
    return _list_pairs(joined)


def _weak_parts(confirmed: Bools, config: ViewGraphConfig) -> list[Bools]:
    """Return the parts of a graph, `[view]` each, that too few edges join to the rest.

    The parts that nothing joins. Where all is connected, the half on one side of the weakest cut,
    as its Fiedler vector tells.
    """
    first, second = np.nonzero(confirmed)
    part = connected_parts(first, second, len(confirmed))
    sizes = np.bincount(part)
    if len(sizes) > 1:
        several = np.flatnonzero(sizes > 1)
        return [part == number for number in several if sizes[number] < len(part)]
    inside: Bools = np.asarray(fiedler_vector(confirmed.astype(np.float64)) > 0)
    bridges = confirmed[inside][:, ~inside].sum()
    return [inside] if bridges < config.partners else []


def _rank_partners(covisible: Floats, allowed: Bools) -> Ints:
    """Return the indices of those that are allowed, those that see most in common first."""
    ranked = np.argsort(-covisible, kind="stable")
    return ranked[allowed[ranked]]


def _list_pairs(joined: Bools) -> list[tuple[int, int]]:
    """Return the pairs (a, b), a < b, of a matrix `[view, view]` with an entry in either half."""
    first, second = np.nonzero(np.triu(joined | joined.T, 1))
    return list(zip(first.tolist(), second.tolist(), strict=True))


def measure_covisibility(lifted: LiftedPoses, config: ViewGraphConfig) -> Floats:
    """Return by how much more alike the bodies of two views are in step than out of step.

    `[view, view]`, symmetric, -1..1, about 0 where two views see nothing in common, or too little
    was lifted to say.
    """
    views, count = lifted.centre.shape[:2]
    frames = evenly_spaced(np.arange(count), config.frames)
    seen: Bools = np.asarray(np.isfinite(lifted.body[:, frames]).all((-2, -1)))
    if not seen.any():
        return np.zeros((views, views))
    shapes = _describe_shapes(lifted.body[:, frames], seen, config)
    shifts = evenly_spaced(np.arange(len(frames)), config.shifts + 1)[1:]
    in_step = _likeness(shapes, seen, shift=0)
    out_of_step = [_likeness(shapes, seen, shift=int(shift)) for shift in shifts if shift > 0]
    more = in_step - sum(out_of_step) / max(len(out_of_step), 1)
    return np.asarray((more + more.T) / 2)


def _describe_shapes(body: Floats, seen: Bools, config: ViewGraphConfig) -> Floats:
    """Return what of bodies no rotation changes, `[view, frame, instance, axis]`; 0 = not lifted.

    Their Gram matrices, in units of their usual distance times the square root of `config.alike`.
    body: `[view, frame, instance, joint, 3]`.
    """
    bodies = body[seen]
    first, second = np.triu_indices(bodies.shape[1])
    gram = (bodies @ np.swapaxes(bodies, 1, 2))[:, first, second]
    gram *= np.where(first == second, 1.0, np.sqrt(2.0))  # distances are those of whole matrices
    gram -= gram.mean(0)
    usual = np.sqrt(2 * (gram**2).sum(1).mean() * config.alike)
    shapes = np.zeros((*seen.shape, gram.shape[1]))
    shapes[seen] = gram / max(float(usual), 1e-12)
    return shapes


def _likeness(shapes: Floats, seen: Bools, *, shift: int) -> Floats:
    """Return how alike the bodies of two views are, `[view, view]` in 0..1.

    Each body counts with the most alike of the other view. The frames of the second view are
    later by `shift`, going round.
    """
    views, frames, instances = seen.shape
    total, count = np.zeros((views, views)), np.zeros((views, views))
    for frame in range(frames):
        other = (frame + shift) % frames
        both = seen[:, frame].reshape(-1, 1) & seen[:, other].reshape(1, -1)
        first, second = (shapes[:, k].reshape(views * instances, -1) for k in (frame, other))
        apart = (first**2).sum(1)[:, None] + (second**2).sum(1) - 2 * first @ second.T
        alike = np.where(both, np.exp(-np.maximum(apart, 0.0)), 0.0)
        by_view = alike.reshape(views, instances, views, instances)
        total += by_view.max(3).sum(1) + by_view.max(1).sum(2)
        bodies_first, bodies_second = seen[:, frame].sum(1), seen[:, other].sum(1)
        together = (bodies_first[:, None] > 0) & (bodies_second > 0)
        count += np.where(together, bodies_first[:, None] + bodies_second, 0)
    return total / np.maximum(count, 1)


# --- loops of three pairs


def count_triangles(
    pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[Ints, Ints]:
    """Return `[pair]` how many triangles it closes, and of how many it is a side.

    Of triangles whose three pairs have a sufficient score. Going from a to b and on to c agrees
    with going from a to c by the product of two Cauchy weights, of the angle between both rotations
    and of the distance between both translations, relative to the RMS length of the baselines. A
    triangle of half the weight closes: it is within both scales.
    """
    if not pairs:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    usable = np.array([pair.score >= config.least_score for pair in pairs])
    triangles = _list_triangles(pairs)
    triangles = triangles[usable[triangles].all(1)]
    ab, bc, ac = triangles.T
    later_from_earlier = [pair if pair.a < pair.b else _reverse(pair) for pair in pairs]
    rotation = np.array([pair.rotation for pair in later_from_earlier])
    translation = np.array([pair.translation for pair in later_from_earlier])
    angle = angle_between(rotation[bc] @ rotation[ab], rotation[ac])
    carried = np.einsum("tij,tj->ti", rotation[bc], translation[ab])
    gap2 = ((carried + translation[bc] - translation[ac]) ** 2).sum(-1)
    mean_length2 = np.maximum((translation**2).sum(-1)[triangles].mean(1), 1e-12)
    # three pairs add their errors, hence the thirds
    rotation_misfit = (angle / np.deg2rad(config.scale_deg)) ** 2 / 3
    translation_misfit = gap2 / mean_length2 / config.translation_scale**2 / 3
    closes = (1 + rotation_misfit) * (1 + translation_misfit) <= 2
    return (
        np.bincount(triangles[closes].ravel(), minlength=len(pairs)),
        np.bincount(triangles.ravel(), minlength=len(pairs)),
    )


def _reverse(pair: PairwiseCalibration) -> PairwiseCalibration:
    """Return the relative pose a_from_b of a pair, as that of the pair (b, a)."""
    rotation = pair.rotation.T
    return replace(
        pair, a=pair.b, b=pair.a, rotation=rotation, translation=-rotation @ pair.translation
    )


def _list_triangles(pairs: tuple[PairwiseCalibration, ...]) -> Ints:
    """Return `[triangle, 3]` indices of the pairs (a, b), (b, c), (a, c).

    They are those of all views a < b < c that three pairs connect.
    """
    a, b = np.sort([(pair.a, pair.b) for pair in pairs]).T
    number = np.full((b.max() + 1, b.max() + 1), -1)
    number[a, b] = np.arange(len(pairs))
    edge, c = np.nonzero((number[a] >= 0) & (number[b] >= 0))
    return np.column_stack([edge, number[b[edge], c], number[a[edge], c]])


# --- groups of cameras


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
            "",
            "cameras that see the same bodies",
            f"groups that share too little: {' | '.join(names)}",
            "calibrate each group by itself",
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
            "",
            "two cameras that see the same bodies",
            "none",
            "check that the files belong to these cameras and to the same time",
        )
    return tuple(sorted(groups, key=lambda views: (-len(views), views[0])))


def _trusted_pairs(
    cameras: int, pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[PairwiseCalibration, ...]:
    """Return the pairs that may join cameras: in a large rig, half of whose triangles close.

    A camera that shows a body once or twice fits beside every other camera with a good score, and
    would join groups that do not belong together. In a small rig a camera that contradicts the
    others stays, so that its fault can be found and named.
    """
    if cameras <= SMALL_RIG:
        return pairs
    closed, looked_at = count_triangles(pairs, config)
    agree = 2 * closed >= looked_at
    return tuple(pair for pair, agrees in zip(pairs, agree, strict=True) if agrees)


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
