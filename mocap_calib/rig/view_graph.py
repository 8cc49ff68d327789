"""The view graph: which pairs of cameras are calibrated, and which of their poses loops confirm.

All pairs of a small rig are calibrated. They grow as the square of the cameras, and say the same
many times. The first graph of a large rig joins each camera to those that see most in common with
it, to some that see less, from other sides, and to its neighbours by name. It is calibrated and
judged, and grows where it is weak: where a camera has too few pairs that third cameras confirm, and
where too few such pairs join two parts.

What two views see in common is known before any pair is calibrated: distances within a lifted body
do not depend on the camera. Views of the same bodies show similar postures in the same frames, and
less similar ones in other frames.

Around a triangle rotations and baselines must close. Two views alone may leave several relative
poses: bodies are nearly flat and nearly symmetric, cameras that face each other see the same
outline, identities may be exchanged. A third camera decides. The belief in each hypothesis of a
pair follows from its score and from how well its triangles close, given the belief in the
hypotheses of the other two pairs, by message passing (Zach, Klopschitz and Pollefeys 2010 infer
wrong relations in the same way; here the alternatives are known).
"""

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import AveragingConfig, Config, ViewGraphConfig
from mocap_calib.geometry.graphs import connected_parts, fiedler_vector
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.pairs.solve import PairSolver, all_pairs, calibrate_pairs
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.types import Bools, Floats, Ints, Mapper, Progress, Sample


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

    The principal axes of their Gram matrices, in units of their usual distance times the square
    root of `config.alike`. body: `[view, frame, instance, joint, 3]`.
    """
    bodies = body[seen]
    first, second = np.triu_indices(bodies.shape[1])
    gram = (bodies @ np.swapaxes(bodies, 1, 2))[:, first, second]
    gram *= np.where(first == second, 1.0, np.sqrt(2.0))  # distances are those of whole matrices
    gram -= gram.mean(0)
    axes = np.linalg.eigh(gram.T @ gram)[1][:, -config.axes :]
    along = gram @ axes
    usual = np.sqrt(2 * (along**2).sum(1).mean() * config.alike)
    shapes = np.zeros((*seen.shape, along.shape[1]))
    shapes[seen] = along / max(float(usual), 1e-12)
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


@dataclass(frozen=True)
class PairHypotheses:
    """The hypotheses of all pairs as arrays; those that a pair lacks have prior 0.

    rotation: `[pair, hypothesis, 3, 3]` and translation: `[pair, hypothesis, 3]` from the earlier
        view to the later.
    prior: `[pair, hypothesis]` belief before loops are looked at; the sum over a pair is 1.
    """

    rotation: Floats
    translation: Floats
    prior: Floats


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


def pairs_in_closed_triangles(
    pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> Bools:
    """Return `[pair]` whether it closes a triangle with two other pairs of sufficient score."""
    return np.asarray(count_triangles(pairs, config)[0] > 0)


def count_triangles(
    pairs: tuple[PairwiseCalibration, ...], config: AveragingConfig
) -> tuple[Ints, Ints]:
    """Return `[pair]` how many triangles it closes, and of how many it is a side.

    Of triangles whose three pairs have a sufficient score.
    """
    triangles = list_triangles(pairs)
    usable = np.array([pair.score >= config.least_score for pair in pairs], dtype=bool)
    triangles = triangles[usable[triangles].all(1)]
    closes = np.zeros(0, dtype=bool)
    if len(triangles):
        answers = stack_hypotheses(tuple(replace(pair, alternatives=()) for pair in pairs), 0.0)
        # half the weight: within both scales
        closes = closure_of(answers, triangles, config)[:, 0, 0, 0] >= 0.5
    return (
        np.bincount(triangles[closes].ravel(), minlength=len(pairs)),
        np.bincount(triangles.ravel(), minlength=len(pairs)),
    )


def list_triangles(pairs: tuple[PairwiseCalibration, ...]) -> Ints:
    """Return `[triangle, 3]` indices of the pairs (a, b), (b, c), (a, c).

    They are those of all views a < b < c that three pairs connect.
    """
    edges = [(min(pair.a, pair.b), max(pair.a, pair.b)) for pair in pairs]
    index = {edge: k for k, edge in enumerate(edges)}
    later: dict[int, set[int]] = {}  # of each view: those after it that a pair joins it to
    for a, b in edges:
        later.setdefault(a, set()).add(b)
    found = [
        (index[a, b], index[b, c], index[a, c])
        for a, b in sorted(index)
        for c in sorted(later[a] & later.get(b, set()))
    ]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def stack_hypotheses(pairs: tuple[PairwiseCalibration, ...], least_score: float) -> PairHypotheses:
    """Return the hypotheses as arrays; their prior goes with the square of the score.

    The prior of one below `least_score` is 0, unless none of its pair is better.
    """
    count = max(len(pair.hypotheses) for pair in pairs)
    rotation = np.tile(np.eye(3), (len(pairs), count, 1, 1))
    translation = np.zeros((len(pairs), count, 3))
    score = np.zeros((len(pairs), count))
    exists = np.zeros((len(pairs), count), dtype=bool)
    for k, pair in enumerate(pairs):
        best = max(hypothesis.score for hypothesis in pair.hypotheses)
        for m, hypothesis in enumerate(pair.hypotheses):
            rotation[k, m], translation[k, m] = _later_from_earlier(hypothesis)
            exists[k, m] = True
            if hypothesis.score >= min(best, least_score):
                score[k, m] = hypothesis.score
    is_best = exists & (score == score.max(1, keepdims=True))
    prior = score**2 + 1e-9 * is_best  # a pair without any score keeps its best hypothesis
    return PairHypotheses(rotation, translation, prior / prior.sum(1, keepdims=True))


def _later_from_earlier(pair: PairwiseCalibration) -> tuple[Floats, Floats]:
    """Return R `[3, 3]` and t `[3]` from the view with the lower index to the other."""
    if pair.a < pair.b:
        return pair.rotation, pair.translation
    return pair.rotation.T, -pair.rotation.T @ pair.translation


def closure_of(hypotheses: PairHypotheses, triangles: Ints, config: AveragingConfig) -> Floats:
    """Return how well going from a to b and on to c agrees with going from a to c.

    Returns `[triangle, hypothesis of ab, hypothesis of bc, hypothesis of ac]` in 0..1: a product
    of two Cauchy weights, of the angle between both rotations and of the distance between both
    translations relative to the RMS length of the three baselines. 1 is a loop that closes.
    """
    ab, bc, ac = triangles.T
    rotation, translation = hypotheses.rotation, hypotheses.translation
    chained_rotation = np.einsum("tjxy,tiyz->tijxz", rotation[bc], rotation[ab])
    carried = np.einsum("tjxy,tiy->tijx", rotation[bc], translation[ab])
    chained_translation = carried + translation[bc][:, None]

    angle = angle_between(chained_rotation[:, :, :, None], rotation[ac][:, None, None])
    gap = chained_translation[:, :, :, None] - translation[ac][:, None, None]
    length2 = (translation**2).sum(-1)
    mean_length2 = _outer_sum(length2[ab], length2[bc], length2[ac]) / 3
    gap2 = (gap**2).sum(-1) / np.maximum(mean_length2, 1e-12)

    # three pairs add their errors, hence the thirds
    rotation_misfit = (angle / np.deg2rad(config.scale_deg)) ** 2 / 3
    translation_misfit = gap2 / config.translation_scale**2 / 3
    return 1 / (1 + rotation_misfit) / (1 + translation_misfit)


def _outer_sum(first: Floats, second: Floats, third: Floats) -> Floats:
    """Return `[triangle, i, j, k]` sums of `[triangle, i]`, `[triangle, j]`, `[triangle, k]`."""
    return first[:, :, None, None] + second[:, None, :, None] + third[:, None, None]


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
