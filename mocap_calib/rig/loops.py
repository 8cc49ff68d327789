"""Loops of three pairs of cameras: around a triangle rotations and baselines must close.

Two views alone may leave several relative poses: bodies are nearly flat and nearly symmetric,
cameras that face each other see the same outline, identities may be exchanged. A third camera
decides. The belief in each hypothesis of a pair follows from its score and from how well its
triangles close, given the belief in the hypotheses of the other two pairs, by message passing
(Zach, Klopschitz and Pollefeys 2010 infer wrong relations in the same way; here the alternatives
are known).
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import AveragingConfig
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Bools, Floats, Ints


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
