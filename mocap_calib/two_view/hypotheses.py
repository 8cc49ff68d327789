"""What the relative pose of two views may be: rival modes, from the lifted bodies and from five-point RANSAC where it is known who is who."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import five_point
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.two_view.affinity import body_agreement
from mocap_calib.two_view.assignment import mutual_best, sinkhorn
from mocap_calib.two_view.view_pair import ViewPair, reach
from mocap_calib.types import Floats, Ints

_TRACKS = 9  # pairs of tracks that are looked at
_CELLS = 2_000_000  # hypotheses x possible matches scored at a time


@dataclass(frozen=True)
class Hypotheses:
    """Rival relative poses of one pair. rotation: `[M, 3, 3]`, translation: `[M, 3]` in body sizes, source: `[M]`."""

    rotation: Floats
    translation: Floats
    source: tuple[str, ...]

    def __getitem__(self, index: Ints) -> "Hypotheses":
        return Hypotheses(
            self.rotation[index], self.translation[index], tuple(self.source[k] for k in index)
        )


def generate_hypotheses(
    pair: ViewPair, tracked: bool, config: PairwiseConfig, rng: np.random.Generator
) -> Hypotheses:
    """Modes of the search over lifted poses, and of five-point RANSAC where it is known who is who."""
    modes = _search(pair, config, rng)
    for frame, i, j in _known_identities(pair, tracked):
        modes = _join(modes, _from_five_points(pair, frame, i, j, rng))
    return modes


def _known_identities(pair: ViewPair, tracked: bool) -> list[tuple[Ints, Ints, Ints]]:
    """Sets of matches (frame, i, j) that hold one individual a view: the frames with one subject, or each pair of tracks."""
    there_a, there_b = (pair.a.weight > 0).sum(-1) > 0, (pair.b.weight > 0).sum(-1) > 0
    if tracked:
        tracks = product(range(there_a.shape[1]), range(there_b.shape[1]))
        sets = [(np.flatnonzero(there_a[:, i] & there_b[:, j]), i, j) for i, j in tracks]
        return [(f, np.full(len(f), i), np.full(len(f), j)) for f, i, j in sets if len(f)][:_TRACKS]
    single = np.flatnonzero((there_a.sum(1) == 1) & (there_b.sum(1) == 1))
    if 2 * len(single) < len(pair.frames):
        return []
    return [(single, there_a[single].argmax(1), there_b[single].argmax(1))]


def _search(pair: ViewPair, config: PairwiseConfig, rng: np.random.Generator) -> Hypotheses:
    """Closed-form rotations of candidate matches, scored against all frames; the best well-separated modes.

    Half of the hypotheses are the candidates whose bodies agree best, half are drawn at random.
    """
    frame, i, j = np.nonzero(pair.overlap.lifted)
    if len(frame) == 0:
        return Hypotheses(np.zeros((0, 3, 3)), np.zeros((0, 3)), ())
    rotation = nearest_rotation(np.swapaxes(pair.overlap.cross[frame, i, j], -1, -2))
    own = pair.overlap.norm[frame, i, j] - 2 * np.einsum(
        "nij,nji->n", rotation, pair.overlap.cross[frame, i, j]
    )
    half = config.hypotheses // 2
    order = np.argsort(own, kind="stable")
    index = np.concatenate([order[:half], rng.permutation(order[half:])[:half]])
    rotation = rotation[index]
    translation = pair.b.centre[frame, j][index] - np.einsum(
        "nij,nj->ni", rotation, pair.a.centre[frame, i][index]
    )
    # in blocks: a single crowded frame multiplies the matches that each hypothesis is scored on
    block = max(1, _CELLS // pair.overlap.lifted.size)
    parts = [slice(k, k + block) for k in range(0, len(rotation), block)]
    support = np.concatenate(
        [_support(body_agreement(pair, rotation[p], translation[p], config)) for p in parts]
    )
    keep = separated(rotation, support, config.modes, np.deg2rad(config.mode_separation_deg))
    modes = Hypotheses(rotation[keep], translation[keep], ("lifted",) * len(keep))
    for _ in range(config.rounds):
        modes = _procrustes(pair, modes, config)
    return modes[
        separated(
            modes.rotation,
            _support(body_agreement(pair, modes.rotation, modes.translation, config)),
            config.modes,
            np.deg2rad(2.0),
        )
    ]


def _support(agree: Floats) -> Floats:
    """`[M]` sum over all detections of their best agreement, both ways."""
    return agree.max(-1).sum((-1, -2)) + agree.max(-2).sum((-1, -2))


def separated(rotation: Floats, support: Floats, count: int, gap: float) -> Ints:
    """Indices of the best supported rotations that are at least `gap` radians apart."""
    order = np.argsort(-support, kind="stable")
    flat = rotation[order].reshape(-1, 9)
    far = flat @ flat.T <= 1 + 2 * np.cos(gap)  # the trace of one turned back by the other
    keep: list[int] = []
    for k in range(len(order)):
        if len(keep) < count and far[k, keep].all():
            keep.append(k)
    return order[keep]


def _procrustes(pair: ViewPair, modes: Hypotheses, config: PairwiseConfig) -> Hypotheses:
    """One turn of matching and of weighted Procrustes on the matched bodies, all modes at once."""
    agree = body_agreement(pair, modes.rotation, modes.translation, config)
    weight = agree * mutual_best(sinkhorn(agree, dummy=0.1), least=0.05)
    rotation = nearest_rotation(
        np.einsum("mfab,fabij->mji", weight, pair.overlap.cross, optimize=True)
        + 1e-9 * modes.rotation
    )
    gap = (
        pair.b.centre[None, :, None]
        - np.einsum("mij,faj->mfai", rotation, pair.a.centre)[:, :, :, None]
    )
    near = weight / (pair.a.distance[:, :, None] ** 2 + pair.b.distance[:, None] ** 2)
    total = near.sum((1, 2, 3))[:, None]
    mean = (near[..., None] * gap).sum((1, 2, 3)) / np.maximum(total, 1e-12)
    return replace(
        modes, rotation=rotation, translation=np.where(total > 0, mean, modes.translation)
    )


def _from_five_points(
    pair: ViewPair, frame: Ints, i: Ints, j: Ints, rng: np.random.Generator
) -> Hypotheses:
    """Five-point RANSAC (Nister 2004) on subsets of matches that are known to be right."""
    rotations, translations = [], []
    for _ in range(3):
        part = np.sort(rng.permutation(len(frame))[:40])
        f, m, n = frame[part], i[part], j[part]
        both = (pair.a.weight[f, m] > 0) & (pair.b.weight[f, n] > 0)
        threshold = 0.05 / float(np.median(reach(pair)[f, m, n]))
        for rotation, translation in five_point(
            pair.a.rays[f, m][both], pair.b.rays[f, n][both], threshold
        ):
            rotations.append(rotation)
            translations.append(translation)
    return Hypotheses(
        np.reshape(rotations, (-1, 3, 3)),
        np.reshape(translations, (-1, 3)),
        ("five-point",) * len(rotations),
    )


def _join(first: Hypotheses, second: Hypotheses) -> Hypotheses:
    return Hypotheses(
        np.concatenate([first.rotation, second.rotation]),
        np.concatenate([first.translation, second.translation]),
        first.source + second.source,
    )
