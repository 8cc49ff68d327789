"""Rivals of today, after their descriptions: bodies lifted in each camera are laid on each other.

`procrustes`: all joints in 3D by one similarity, as programs do that calibrate by a monocular
estimate of the pose. `sphere`: directions of bones as points on the unit sphere, whose rotation
and identities are found in turns by expectation and maximisation of von Mises-Fisher
distributions, the translation by coplanarity ("Spatiotemporal Multi-Camera Calibration using
Freely Moving People", Lee, Nishino and Nobuhara 2025, without its clocks; with identities given,
the linear step of "Extrinsic Camera Calibration from a Moving Person", Lee et al. 2022).

Their code is not public, or is not used: what their descriptions leave open is generous. Both are
given our lifted bodies, start from every pair of detections, and end in `adjust` where asked.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment

from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.epipolar import depths, essential_matrix, sampson_angle
from mocap_calib.geometry.rotation import align_by_similarity, matrix_from_vector, nearest_rotation
from mocap_calib.lift import rays_by_joint
from mocap_calib.pairs.affinity import mutual_best
from mocap_calib.paper.five_point import Found
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.results import LiftedPoses
from mocap_calib.types import Bools, Floats, Sample, Skeleton

ROUNDS = 10  # turns of matching and aligning
LEAST_JOINTS = 4  # seen in both views, of a match
CONCENTRATION = 10.0  # of von Mises-Fisher at the start: directions are right within 18 degrees
MOST_CONCENTRATION = 200.0
NOTHING = 1e3  # body sizes: what a match costs that there cannot be


@dataclass(frozen=True)
class LiftedPair:
    """What two views show and what was lifted of it, in the joints of the model.

    rays_a, rays_b: `[frame, I | J, joint, 3]` unit rays, NaN where not seen.
    placed_a, placed_b: `[frame, I | J, joint, 3]` joints in the camera's frame, in body sizes.
    bones_a, bones_b: `[frame, I | J, bone, 3]` directions in the camera's axes.
    """

    rays_a: Floats
    rays_b: Floats
    placed_a: Floats
    placed_b: Floats
    bones_a: Floats
    bones_b: Floats

    @property
    def common(self) -> Bools:
        """`[frame, I, J, joint]` which joints both detections of a match show, both lifted."""
        seen_a = np.isfinite(self.rays_a[..., 0]) & np.isfinite(self.placed_a[..., 0])
        seen_b = np.isfinite(self.rays_b[..., 0]) & np.isfinite(self.placed_b[..., 0])
        return seen_a[:, :, None] & seen_b[:, None]

    @property
    def possible(self) -> Bools:
        """`[frame, I, J]` which detections can be one body: both show enough of it."""
        return self.common.sum(-1) >= LEAST_JOINTS


def lifted_pair(
    sample: Sample, lifted: LiftedPoses, skeleton: Skeleton, a: int, b: int
) -> LiftedPair:
    """Gather the views a and b of a sample that was lifted in the joints of a skeleton."""
    edges = edges_of_keypoints(skeleton, sample.vocabulary)
    bones = sample.vocabulary[np.array(edges)]  # [bone, 2] joints
    joints = len(skeleton.keypoints)
    rays = [rays_by_joint(sample.rays[view], sample.vocabulary, joints) for view in (a, b)]
    placed = [lifted.body[view] + lifted.centre[view][..., None, :] for view in (a, b)]
    along = [_unit(body[..., bones[:, 1], :] - body[..., bones[:, 0], :]) for body in placed]
    return LiftedPair(*rays, *placed, *along)


def procrustes(pair: LiftedPair, identities: Bools | None = None) -> Found | None:
    """Align all joints in 3D by the similarity (Umeyama 1991) with the smallest residual.

    identities: `[frame, I, J]` matches; otherwise each pair of detections is tried as a start,
        and matches and similarity are found in turns.
    """
    if identities is not None:
        matched = identities & pair.possible
        pose = _similarity(pair, matched)
        return None if pose is None else _found(*pose[1:], matched)
    best, least = None, np.inf
    for start in _starts(pair):
        matched, pose = start, _similarity(pair, start)
        for _ in range(ROUNDS):
            if pose is None:
                break
            residual = _residual(pair, pose)
            again = _assign(residual, pair.possible)
            if (again == matched).all():
                break
            matched, pose = again, _similarity(pair, again)
        if pose is None:
            continue
        error = float(_residual(pair, pose)[matched].mean())
        if error < least:
            best, least = _found(*pose[1:], matched), error
    return best


def sphere(pair: LiftedPair, identities: Bools | None = None) -> Found | None:
    """Align the directions of bones on the unit sphere, and find t by coplanarity.

    identities: as in `procrustes`.
    """
    if identities is not None:
        matched = identities & pair.possible
        if not matched.any():
            return None
        return _with_translation(pair, _turn(pair, matched.astype(np.float64)), matched)
    best, most = None, -np.inf
    for start in _starts(pair):
        rotation, weight, likelihood = _expect_and_maximise(pair, _turn(pair, start * 1.0))
        if likelihood > most:
            best, most = (rotation, weight), likelihood
    if best is None:
        return None
    return _with_translation(pair, best[0], mutual_best(best[1]) & pair.possible)


def adjust(pair: LiftedPair, found: Found) -> Found:
    """Minimise the epipolar errors of the matched joints over R and the direction of t.

    Both rivals end in an adjustment of all cameras; of two views without 3D points, this is it.
    The loss is robust (soft L1).
    """
    rays_a, rays_b = _matched_rays(pair, _mask(pair, found))
    if len(rays_a) < 6:
        return found
    tangent = np.linalg.svd(found.translation[None])[2][1:]  # [2, 3], normal to t

    def pose(step: Floats) -> tuple[Floats, Floats]:
        """Return R and unit t after a step `[5]`."""
        return matrix_from_vector(step[:3]) @ found.rotation, _unit(
            found.translation + step[3:] @ tangent
        )

    def errors(step: Floats) -> Floats:
        """Return Sampson's angles `[N]` of a step in milliradians."""
        return 1e3 * sampson_angle(essential_matrix(*pose(step)), rays_a, rays_b)

    step = least_squares(errors, np.zeros(5), loss="soft_l1", f_scale=5.0).x
    rotation, translation = pose(step)
    return found._replace(
        rotation=rotation, translation=_ahead(rotation, translation, rays_a, rays_b)
    )


# --- matches


def _starts(pair: LiftedPair) -> Iterator[Bools]:
    """Yield masks `[frame, I, J]` of a single match each: all that there can be."""
    for match in np.argwhere(pair.possible):
        mask = np.zeros_like(pair.possible)
        mask[tuple(match)] = True
        yield mask


def _assign(cost: Floats, possible: Bools) -> Bools:
    """Return the matches `[frame, I, J]` of the least total cost in each frame."""
    matched = np.zeros_like(possible)
    for frame, of_frame in enumerate(np.where(possible, cost, NOTHING)):
        rows, columns = linear_sum_assignment(of_frame)
        matched[frame, rows, columns] = True
    return matched & possible


def _mask(pair: LiftedPair, found: Found) -> Bools:
    """Return the matches `[frame, I, J]` of an answer."""
    mask = np.zeros_like(pair.possible)
    mask[tuple(found.matches.T)] = True
    return mask


def _matched_rays(pair: LiftedPair, matched: Bools) -> tuple[Floats, Floats]:
    """Return the rays `[N, 3]` of both views of the joints that matches show."""
    frame, i, j, joint = np.nonzero(matched[..., None] & pair.common)
    return pair.rays_a[frame, i, joint], pair.rays_b[frame, j, joint]


# --- joints in 3D


def _similarity(pair: LiftedPair, matched: Bools) -> tuple[float, Floats, Floats] | None:
    """Return scale, R and t of b_from_a over the joints of matches `[frame, I, J]`."""
    frame, i, j, joint = np.nonzero(matched[..., None] & pair.common)
    if not len(frame):
        return None
    try:
        return align_by_similarity(pair.placed_a[frame, i, joint], pair.placed_b[frame, j, joint])
    except DegenerateError:
        return None


def _residual(pair: LiftedPair, pose: tuple[float, Floats, Floats]) -> Floats:
    """Return the mean distance `[frame, I, J]` of the joints of matches after a similarity."""
    scale, rotation, translation = pose
    moved = scale * pair.placed_a @ rotation.T + translation
    distance = np.linalg.norm(moved[:, :, None] - pair.placed_b[:, None], axis=-1)
    seen = pair.common
    return np.where(seen, distance, 0.0).sum(-1) / np.maximum(seen.sum(-1), 1)


def _found(rotation: Floats, translation: Floats, matched: Bools) -> Found:
    """Return an answer of matches `[frame, I, J]`, t made a direction."""
    return Found(rotation, _unit(translation), np.argwhere(matched))


# --- directions on the sphere


def _turn(pair: LiftedPair, weight: Floats) -> Floats:
    """Return the rotation `[3, 3]` of b_from_a that turns bones best; weight: `[frame, I, J]`."""
    bones_a, bones_b = (np.nan_to_num(bones) for bones in (pair.bones_a, pair.bones_b))
    return nearest_rotation(np.einsum("fij,fjkx,fiky->xy", weight, bones_b, bones_a))


def _expect_and_maximise(pair: LiftedPair, rotation: Floats) -> tuple[Floats, Floats, float]:
    """Return R, matches `[frame, I, J]`, and the logarithm of the likelihood.

    A detection of b is drawn from one of a's: its bones from von Mises-Fisher distributions about
    those of a, turned. Expectation is made doubly stochastic where it matches everyone to someone.
    """
    concentration, weight, likelihood = CONCENTRATION, pair.possible * 1.0, -np.inf
    bones_a, bones_b = (np.nan_to_num(bones) for bones in (pair.bones_a, pair.bones_b))
    bones = bones_a.shape[2]
    for _ in range(ROUNDS):
        cosine = np.einsum("fiky,xy,fjkx->fij", bones_a, rotation, bones_b) / bones
        # log of k / (2 pi (1 - exp(-2 k))) exp(k (cos - 1)), the distribution on the sphere
        constant = np.log(concentration / (2 * np.pi * (1 - np.exp(-2 * concentration))))
        log = bones * (constant + concentration * (cosine - 1))
        log = np.where(pair.possible, log, -np.inf)
        present = pair.possible.any(1)  # [frame, J]
        total = np.logaddexp.reduce(np.where(present[:, None], log, 0.0), axis=1)
        weight = np.where(present[:, None], np.exp(log - total[:, None]), 0.0)
        likelihood = float(total[present].sum())
        rotation = _turn(pair, weight)
        mean = float(np.clip((weight * cosine).sum() / max(weight.sum(), 1e-12), 0.1, 0.999))
        # Banerjee et al. 2005, eq. 4.4, of three dimensions
        concentration = min(mean * (3 - mean**2) / (1 - mean**2), MOST_CONCENTRATION)
    return rotation, weight, likelihood


def _with_translation(pair: LiftedPair, rotation: Floats, matched: Bools) -> Found | None:
    """Return the answer of a rotation: t is normal to all (R u_a) x u_b, as best it can be."""
    rays_a, rays_b = _matched_rays(pair, matched)
    if not len(rays_a):
        return None
    normal = np.cross(rays_a @ rotation.T, rays_b)
    translation = np.linalg.eigh(normal.T @ normal)[1][:, 0]
    return _found(rotation, _ahead(rotation, translation, rays_a, rays_b), matched)


def _ahead(rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats) -> Floats:
    """Return t or -t, whichever has more joints in front of both cameras."""
    in_front = [
        np.all([depth > 0 for depth in depths(rotation, sign * translation, rays_a, rays_b)], 0)
        for sign in (1.0, -1.0)
    ]
    return translation if in_front[0].sum() >= in_front[1].sum() else -translation


def _unit(vector: Floats) -> Floats:
    """Return vectors `[..., 3]` of length 1."""
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-12)
