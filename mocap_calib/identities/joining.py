"""Join the pieces of tracks that are one individual: the likeliest first.

Agglomeration of pieces by the sum of their evidence, and exchanges of pieces afterwards. What is
seen in one frame is two individuals, but for a few frames in which one is a false group.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import MatchingConfig
from mocap_calib.identities.proportions import Proportions
from mocap_calib.types import Bools, Floats, Ints

_ROUNDS = 5  # of exchanging pieces and giving individuals up; it stops when none changes
_SWEEPS = 5  # of exchanges in a round; it stops when none is left
_CANDIDATES = 4  # individuals that a piece may go to
_LEAST_GAIN = 1e-6


@dataclass(frozen=True)
class _Evidence:
    """All that is known of who pieces are.

    pairs: `[piece, piece]` evidence that two are one, of motion and of the frames both are seen in.
    bodies: their proportions. together: `[piece, piece]` number of frames that both are seen in.
    lengths: `[piece]` number of frames.
    """

    pairs: Floats
    bodies: Proportions
    together: Ints
    lengths: Ints

    def of(self, individual: Ints, names: int) -> Floats:
        """Return `[piece, individual]` all evidence that a piece is of each of so many."""
        member = (individual[:, None] == np.arange(names)).astype(np.float64)
        return np.asarray(self.pairs @ member + self.bodies.evidence_of(individual, names))


def join_pieces(
    first: Ints, last: Ints, pairs: Floats, bodies: Proportions, config: MatchingConfig
) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = nobody.

    first, last: `[piece]` frames. pairs: `[piece, piece]` evidence of motion and of single views
    that two are one; bodies: of the pieces.

    Pieces are joined, then exchanged between individuals as long as that is likelier. Individuals
    that the recording does not need are given up, the least seen first.
    """
    if not len(first):
        return np.zeros(0, dtype=np.int64)
    together = _frames_together(first, last)
    evidence = _Evidence(
        pairs=pairs - config.false_frame * together,
        bodies=bodies,
        together=together,
        lengths=last - first + 1,
    )
    apart = _are_two(together, evidence.lengths, evidence.lengths, config)
    individual = _agglomerate(evidence, config)
    for _ in range(_ROUNDS):
        before = individual
        individual = _exchange(individual, evidence, apart)
        individual = _give_up(individual, evidence, apart, config)
        if np.array_equal(before, individual):
            break
    return individual


def _frames_together(first: Ints, last: Ints) -> Ints:
    """Return `[piece, piece]` in how many frames both are seen; 0 on the diagonal."""
    common = np.minimum(last[:, None], last) - np.maximum(first[:, None], first) + 1
    common = np.maximum(common, 0)
    np.fill_diagonal(common, 0)
    return np.asarray(common)


def _are_two(together: Ints, lengths_a: Ints, lengths_b: Ints, config: MatchingConfig) -> Bools:
    """Return `[..., a, b]` what is seen together too often to be one with false groups."""
    shorter = np.minimum(lengths_a[..., :, None], lengths_b)
    return np.asarray(together > config.false_share * shorter)


def _agglomerate(evidence: _Evidence, config: MatchingConfig) -> Ints:
    """Return the individual `[piece]` of each piece: the likeliest are joined first."""
    pairs, together = evidence.pairs.copy(), evidence.together.copy()
    bodies, lengths = evidence.bodies.copy(), evidence.lengths.copy()
    alive = np.ones(len(lengths), dtype=bool)

    def row_of(piece: int) -> Floats:
        two = _are_two(together[piece], lengths[piece : piece + 1], lengths, config)[0]
        two |= ~alive
        two[piece] = True
        return np.where(two, -np.inf, pairs[piece] + bodies.evidence(piece))

    total = np.stack([row_of(piece) for piece in range(len(lengths))])
    individual = np.arange(len(lengths))
    best = total.max(1)
    while best.max() > -config.strangers:
        ends = int(best.argmax()), int(total[best.argmax()].argmax())
        kept, merged = min(ends), max(ends)
        individual[individual == merged] = kept
        for sums in (pairs, together):
            sums[kept] += sums[merged]
            sums[:, kept] = sums[kept]
        lengths[kept] += lengths[merged]
        alive[merged] = False
        bodies.join(kept, merged)

        stale = (total[:, kept] == best) | (total[:, merged] == best)
        total[merged] = total[:, merged] = -np.inf
        total[kept] = total[:, kept] = row = row_of(kept)
        best = np.maximum(best, row)
        stale[[kept, merged]] = True
        best[stale] = total[stale].max(1)
    return np.asarray(np.unique(individual, return_inverse=True)[1])


def _exchange(individual: Ints, evidence: _Evidence, apart: Bools) -> Ints:
    """Return the individuals `[piece]` after pieces have changed theirs where that is likelier.

    A piece goes to another individual, and what this has at the same time goes the other way, with
    what is in the way there.
    """
    individual = individual.copy()
    names = int(individual.max(initial=-1)) + 1
    for _ in range(_SWEEPS):
        likely = evidence.of(individual, names)
        exchanges = 0
        for piece in np.flatnonzero(individual >= 0).tolist():
            for name in np.argsort(-likely[piece])[:_CANDIDATES].tolist():
                own = individual[piece]
                ours, theirs = _parts_to_exchange(piece, name, individual, apart)
                gain = (likely[ours, name] - likely[ours, own]).sum()
                gain += (likely[theirs, own] - likely[theirs, name]).sum()
                if gain <= _LEAST_GAIN:
                    continue
                exchanges += 1
                for moved, old, new in ((ours, own, name), (theirs, name, own)):
                    individual[moved] = new
                    shift = evidence.pairs[moved].sum(0)
                    likely[:, old] -= shift
                    likely[:, new] += shift
        if not exchanges:
            break
    return individual


def _parts_to_exchange(piece: int, name: int, individual: Ints, apart: Bools) -> tuple[Ints, Ints]:
    """Return what the individual of a piece would give to another, and get for it (pieces).

    Nothing where more would be in the way.
    """
    nothing = np.zeros(0, dtype=np.int64)
    own = individual[piece]
    if name == own:
        return nothing, nothing
    theirs = np.flatnonzero(apart[piece] & (individual == name))
    if not len(theirs):
        return np.array([piece]), theirs
    ours = np.flatnonzero(apart[theirs].any(0) & (individual == own))
    in_the_way = apart[ours].any(0) & (individual == name)
    return (ours, theirs) if in_the_way.sum() == len(theirs) else (nothing, nothing)


def _give_up(individual: Ints, evidence: _Evidence, apart: Bools, config: MatchingConfig) -> Ints:
    """Return the individuals `[piece]` without those whose pieces may as well be of others.

    The least seen first. As many as are too many, where the number of individuals is known: what
    no other can have is nobody then.
    """
    there = individual >= 0
    seen = np.bincount(individual[there], evidence.lengths[there].astype(np.float64))
    left = len(seen)
    for name in np.argsort(seen, kind="stable").tolist():
        too_many = config.individuals is not None and left > config.individuals
        moved, support = _spread_pieces(name, individual, evidence, apart, alive=seen > 0)
        if too_many or support > -config.strangers * seen[name]:
            individual, left = moved, left - 1
            seen[name] = 0
    number = np.cumsum(seen > 0) - 1
    return np.asarray(np.append(number, -1)[individual])


def _spread_pieces(
    name: int, individual: Ints, evidence: _Evidence, apart: Bools, *, alive: Bools
) -> tuple[Ints, float]:
    """Return the individuals after the pieces of one went to those that are likeliest otherwise.

    alive: `[individual]` who there is. -1: no other is free. Also the evidence for it, summed over
    frames; minus infinity where a piece is nobody then.
    """
    likely = evidence.of(individual, len(alive))
    likely[:, ~alive] = -np.inf
    likely[:, name] = -np.inf
    moved, support = individual.copy(), 0.0
    for piece in np.flatnonzero(individual == name).tolist():
        likely[piece, moved[apart[piece] & (moved >= 0)]] = -np.inf
        new = int(likely[piece].argmax())
        support += float(evidence.lengths[piece] * likely[piece, new])
        moved[piece] = new if np.isfinite(likely[piece, new]) else -1
    return moved, support
