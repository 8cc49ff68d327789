"""Choose which pairs of cameras are calibrated: all of a small rig, of a large one those that tell.

Pairs grow as the square of the cameras, and say the same many times. The first graph joins each
camera to those that see most in common with it (`covisibility`), to some that see less, from other
sides, and to its neighbours by name. It is calibrated and judged, and grows where it is weak: where
a camera has too few pairs that third cameras confirm, and where too few such pairs join two parts.
"""

from copy import deepcopy

import numpy as np

from mocap_calib.config import AveragingConfig, Config, ViewGraphConfig
from mocap_calib.geometry.graphs import connected_parts, fiedler_vector
from mocap_calib.pairs.solve import PairSolver, all_pairs, calibrate_pairs
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.covisibility import measure_covisibility
from mocap_calib.rig.loops import pairs_in_closed_triangles
from mocap_calib.rig.view_graph import select_hypotheses
from mocap_calib.types import (
    Bools,
    Floats,
    Ints,
    LiftedPoses,
    Mapper,
    PairwiseCalibration,
    Progress,
    Sample,
)


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
        partners = graph.grown * 2**number
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
        nearest, others = np.split(ranked[likely], [config.nearest])
        joined[a, nearest] = True
        joined[a, evenly_spaced(others, config.spread)] = True
    return _list_pairs(joined)


def confirmed_pairs(
    pairs: tuple[PairwiseCalibration, ...], views: int, config: AveragingConfig
) -> Bools:
    """Return which pairs close a triangle with two others, `[view, view]`, symmetric."""
    confirmed = np.zeros((views, views), dtype=bool)
    if pairs:
        selected = select_hypotheses(pairs, config)
        closes = pairs_in_closed_triangles(selected, config)
        a, b = np.array([(pair.a, pair.b) for pair in selected])[closes].T
        confirmed[a, b] = confirmed[b, a] = True
    return confirmed


def pairs_to_grow(
    confirmed: Bools, covisible: Floats, asked: Bools, *, partners: int, config: ViewGraphConfig
) -> list[tuple[int, int]]:
    """Return further pairs (a, b), a < b, where the graph of confirmed pairs is weak.

    Where less than the share `config.least_confirmed_share` of what was asked is confirmed, all
    pairs that are left: what was chosen sees too little in common, and of many wrong pairs some
    close triangles by chance.

    A view with fewer confirmed pairs than `config.least_confirmed` gets so many more partners, and
    so does each part of the graph that fewer than `config.least_bridges` confirmed pairs join to
    the rest. Those come first that see most in common.

    asked: `[view, view]` which pairs a < b were calibrated.
    """
    views = len(confirmed)
    free = ~(asked | asked.T | np.eye(views, dtype=bool))
    if confirmed.sum() / 2 < config.least_confirmed_share * asked.sum():
        return _list_pairs(free)
    joined = np.zeros((views, views), dtype=bool)
    for view in np.flatnonzero(confirmed.sum(1) < config.least_confirmed):
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
    return [inside] if bridges < config.least_bridges else []


def _rank_partners(covisible: Floats, allowed: Bools) -> Ints:
    """Return the indices of those that are allowed, those that see most in common first."""
    ranked = np.argsort(-covisible, kind="stable")
    return ranked[allowed[ranked]]


def _list_pairs(joined: Bools) -> list[tuple[int, int]]:
    """Return the pairs (a, b), a < b, of a matrix `[view, view]` with an entry in either half."""
    first, second = np.nonzero(np.triu(joined | joined.T, 1))
    return list(zip(first.tolist(), second.tolist(), strict=True))
