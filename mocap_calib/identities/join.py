"""Join the pieces of tracks that are one individual: the likeliest first.

Agglomerative clustering by the sum of the evidence of all pairs of pieces, and that of the bone
lengths of what is joined. What is seen in the same frames is two individuals, but for a few frames
in which one is a false group.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import MatchingConfig
from mocap_calib.identities.bones import BoneLengths
from mocap_calib.types import Bools, Floats, Ints


def join_pieces(
    first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths, config: MatchingConfig
) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = unassigned.

    Where individuals certainly arrive from outside what the cameras see, at some rate, one who was
    not seen for some frames returns, or another one arrives, whichever is likelier. Elsewhere a
    recording has as few individuals as it needs: two are one unless evidence is decisive against
    it. Where `config.individuals` says how many there are at most, more are joined, and those seen
    least are unassigned that cannot be.

    What is followed through several frames is joined first: the place of a single one is uncertain,
    and it must not keep others apart.

    first, last: `[piece]` frames. pairs: `[piece, piece]` evidence of motion, in nats.
    """
    clusters = _Clusters.of(first, last, pairs, bodies, config)
    clusters.join(0.0)
    arrivals = _count_arrivals(clusters.individual, first, last, config)
    clusters = _Clusters.of(first, last, pairs, bodies, config)
    clusters.rate = arrivals / (last.max(initial=0) + 1)
    least = 0.0 if arrivals else -config.strangers
    clusters.join(least)
    clusters.alive |= last == first
    clusters.join(least)
    if config.individuals is not None:
        clusters.join(-np.inf, config.individuals)
    return _name(clusters.individual, clusters.lengths, config.individuals)


def _count_arrivals(individual: Ints, first: Ints, last: Ints, config: MatchingConfig) -> int:
    """Return how many individuals certainly come from outside what the cameras see.

    They appear while all those are seen who have been seen before. individual, first, last:
    `[piece]`. Who is seen for a few frames alone does not count.
    """
    count = 0
    lengths = np.bincount(individual, last - first + 1)
    lasting = np.flatnonzero(lengths > config.fleeting(int(last.max(initial=0)) + 1))
    begin = {name: first[individual == name].min() for name in lasting.tolist()}
    for start in begin.values():
        there = (first <= start) & (last >= start)
        before = [name for name, earlier in begin.items() if earlier < start]
        count += bool(before) and all(there[individual == name].any() for name in before)
    return count


@dataclass
class _Clusters:
    """Individuals as far as pieces are joined, changed in place; each goes by one of its pieces.

    individual: `[piece]` the cluster of each piece; alive: `[piece]` which are to be joined. pairs,
    together: `[piece, piece]` evidence between clusters, and frames in which both are seen.
    gap: `[piece, piece]` least number of frames from the end of a piece of one to the beginning of
    one of the other. lengths: `[piece]` frames; bodies: of the clusters. rate: of individuals who
    come from outside, a frame; 0 = none does.
    """

    individual: Ints
    alive: Bools
    pairs: Floats
    together: Ints
    gap: Ints
    lengths: Ints
    bodies: BoneLengths
    false_share: float
    rate: float = 0.0

    @classmethod
    def of(
        cls, first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths, config: MatchingConfig
    ) -> "_Clusters":
        """Return each piece by itself, of which those of several frames are joined at first."""
        together = _frames_together(first, last)
        after = first - last[:, None]
        return cls(
            individual=np.arange(len(first)),
            alive=last > first,
            pairs=pairs - config.decisive * together,
            together=together,
            gap=np.maximum(np.maximum(after, after.T), 1),
            lengths=last - first + 1,
            bodies=bodies.copy(),
            false_share=config.false_share,
        )

    def join(self, least: float, most: int = 0) -> None:
        """Join clusters, the likeliest first, down to this evidence or to so many clusters."""
        pieces = range(len(self.lengths))
        total = np.array([self._evidence(piece) for piece in pieces]).reshape(2 * (len(pieces),))
        best = total.max(1, initial=-np.inf)
        while self.alive.sum() > most and best.max() > least:
            ends = int(best.argmax()), int(total[best.argmax()].argmax())
            kept, merged = min(ends), max(ends)
            self._merge(kept, merged)
            stale = (total[:, kept] == best) | (total[:, merged] == best)
            total[merged] = total[:, merged] = -np.inf
            total[kept] = total[:, kept] = row = self._evidence(kept)
            best = np.maximum(best, row)
            stale[[kept, merged]] = True
            best[stale] = total[stale].max(1)

    def _evidence(self, piece: int) -> Floats:
        """Return `[piece]` the evidence that each is the same as this one; -inf = cannot be."""
        shorter = np.minimum(self.lengths, self.lengths[piece])
        no = (self.together[piece] > self.false_share * shorter) | ~self.alive
        no[piece] = True
        if not self.alive[piece]:
            no[:] = True
        evidence = self.pairs[piece] + self.bodies.evidence(piece)
        if self.rate:
            # odds that one who was not seen for so long returns in a frame, to that of an arrival:
            # gaps follow a power law, most are short and some are long
            evidence -= np.log(self.rate * self.gap[piece].astype(np.float64) ** 2)
        return np.where(no, -np.inf, evidence)

    def _merge(self, kept: int, merged: int) -> None:
        """Make two clusters one."""
        self.individual[self.individual == merged] = kept
        for sums in (self.pairs, self.together):
            sums[kept] += sums[merged]
            sums[:, kept] = sums[kept]
        self.gap[kept] = self.gap[:, kept] = np.minimum(self.gap[kept], self.gap[merged])
        self.lengths[kept] += self.lengths[merged]
        self.alive[merged] = False
        self.bodies.join(kept, merged)


def _frames_together(first: Ints, last: Ints) -> Ints:
    """Return `[piece, piece]` in how many frames both are seen; 0 on the diagonal."""
    common = np.minimum(last[:, None], last) - np.maximum(first[:, None], first) + 1
    common = np.maximum(common, 0)
    np.fill_diagonal(common, 0)
    return np.asarray(common)


def _name(individual: Ints, lengths: Ints, most: int | None) -> Ints:
    """Return individuals `[piece]` numbered from 0, -1 for those beyond the longest `most`."""
    kept, number = np.unique(individual, return_inverse=True)
    rank = np.argsort(np.argsort(-lengths[kept], kind="stable"), kind="stable")
    names: Bools | Ints = np.arange(len(kept))
    if most is not None:
        names = np.where(rank < most, np.cumsum(rank < most) - 1, -1)
    return np.asarray(np.append(names, -1)[number])
