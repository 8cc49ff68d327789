"""Which cameras were moved since a calibration, by a rig that was adjusted to keypoints.

The calibration and the adjusted rig differ by a similarity, which means nothing, by what the
keypoints leave open, which the covariance of the adjustment has, by what models of lenses and
detectors do not know, which all cameras share, and where a camera was moved. Cameras are set free
one after the other until the rest agree: a camera was moved where the rest agree so much better
without it that chance does not explain it (Fisher's ratio of variances: what it explains, over what
the rest still disagree by).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.geometry.alignment import gauge_of, rig_size
from mocap_calib.geometry.rotation import angle_between, vector_from_matrix
from mocap_calib.records import Record
from mocap_calib.results import RigCovariance
from mocap_calib.types import Bools, CameraRig, Floats, Ints
from mocap_calib.verdict.evaluation import lay_over

_POSE = 6  # numbers that say where a camera stands
_GAUGE = 7  # of them, in a whole rig, that a similarity takes away


@dataclass(frozen=True, eq=False, repr=False)
class RigChange(Record):
    """How a rig that was adjusted anew differs from the calibration that was given.

    moved: `[view]` cameras that stand elsewhere than the others say.
    turn: `[view]` radians and shift: `[view]` rig sizes by which a camera stands elsewhere, if it
        and the moved ones alone may; turn_sigma and shift_sigma: their RMS errors. Shifts are NaN
        where a single camera would be left.
    difference: `[view]` radians between the rotations of both rigs, those of the cameras that
        stand where they did being aligned. It has all that the keypoints leave open.
    disagreement: variance that the cameras in place differ by, in those of their errors.
    refitted: the rig that was adjusted, in the coordinates and the unit of the given one.

    Of two cameras nobody can say which one moved: `moved` has both or none, and either has the
    turn of one against the other.
    """

    moved: Bools
    turn: Floats
    shift: Floats
    turn_sigma: Floats
    shift_sigma: Floats
    difference: Floats
    disagreement: float
    refitted: CameraRig


def find_changes(
    given: CameraRig,
    adjusted: CameraRig,
    covariances: tuple[RigCovariance, RigCovariance],
    config: Config,
) -> RigChange:
    """Return which cameras were moved between two rigs of the same cameras, and by how much.

    covariances: of the adjusted rig, as of `cautious_covariances`.
    """
    rigs = _Rigs.of(given, adjusted, covariances, config)
    if len(given) == 2:
        return _compare_two(rigs, covariances[0], config)
    moved = _find_moved(rigs, config)
    refitted = lay_over(adjusted, given, rigs.others(moved))
    left = np.delete(np.asarray(angle_between(given.rotation, refitted.rotation)), moved)
    if np.rad2deg(left.max()) > VERDICT_LIMITS_DEG[2]:  # another rig: no camera of it is to blame
        moved, refitted = [], lay_over(adjusted, given, rigs.others([]))
    poses = np.array([rigs.change_of(view, {*moved, view}) for view in range(len(given))]).T
    turn, shift, turn_sigma, shift_sigma = poses
    cost, freedom = rigs.disagreement(moved)
    return RigChange(
        moved=np.isin(np.arange(len(given)), moved),
        turn=turn,
        shift=shift,
        turn_sigma=turn_sigma,
        shift_sigma=shift_sigma,
        difference=np.asarray(angle_between(given.rotation, refitted.rotation)),
        disagreement=cost / freedom,
        refitted=refitted,
    )


def _compare_two(rigs: "_Rigs", covariance: RigCovariance, config: Config) -> RigChange:
    """Return whether the relative pose of two cameras is another than was given."""
    given, adjusted = rigs.given, rigs.adjusted
    turn = float(angle_between(given.relative(0, 1)[0], adjusted.relative(0, 1)[0]))
    cost, freedom = rigs.disagreement([])
    chance = chdtrc(freedom, cost / config.verify.pair_disagreement)
    moved = chance < config.verify.significance and np.rad2deg(turn) > VERDICT_LIMITS_DEG[0]
    unknown, both = np.full(2, np.nan), np.arange(2)
    return RigChange(
        moved=np.full(2, moved),
        turn=np.full(2, turn),
        shift=unknown,
        turn_sigma=np.full(2, covariance.pair_rotation_sigma[0, 1]),
        shift_sigma=unknown,
        difference=np.full(2, turn),
        disagreement=cost / freedom,
        refitted=lay_over(adjusted, given, both),
    )


@dataclass(frozen=True)
class _Rigs:
    """Two rigs of the same cameras, and the covariance of what they differ by.

    covariance: `[view, 6, view, 6]`, as that of `RigCovariance`.
    """

    given: CameraRig
    adjusted: CameraRig
    covariance: Floats

    @classmethod
    def of(
        cls,
        given: CameraRig,
        adjusted: CameraRig,
        covariances: tuple[RigCovariance, RigCovariance],
        config: Config,
    ) -> "_Rigs":
        """Return two rigs with the covariance of their difference.

        It has the shape of that of independent errors, which says best what the images show, and
        the size of the one that errors really have.
        """
        size = _POSE * len(given)
        gauge = gauge_of(adjusted).reshape(size, _GAUGE)
        basis = np.linalg.svd(gauge, full_matrices=True)[0][:, _GAUGE:]
        real, independent = (each.matrix.reshape(size, size) for each in covariances)
        inside = [basis.T @ each @ basis for each in (independent, real)]
        excess = np.trace(np.linalg.solve(*inside)) / basis.shape[1]
        floor = np.deg2rad(config.verify.least_error_deg) ** 2 * np.eye(size)
        whole = max(1.0, excess) * independent + floor
        return cls(given, adjusted, whole.reshape(len(given), _POSE, len(given), _POSE))

    def others(self, free: Iterable[int]) -> Ints:
        """Return the views (indices) that are not free."""
        return np.setdiff1d(np.arange(len(self.given)), np.array(list(free), dtype=np.int64))

    def _difference(self, rest: Ints) -> Floats:
        """Return what the rigs differ by `[view, 6]`, aligned by the views of the rest."""
        aligned = lay_over(self.given, self.adjusted, rest)
        turn = vector_from_matrix(np.swapaxes(self.adjusted.rotation, 1, 2) @ aligned.rotation)
        shift = (aligned.centres - self.adjusted.centres) / rig_size(self.adjusted)
        return np.concatenate([turn, shift], axis=1)

    def disagreement(self, free: Iterable[int]) -> tuple[float, int]:
        """Return the squared Mahalanobis distance of the views that are not free, and its freedom.

        In the changes of their poses that no similarity makes.
        """
        rest = self.others(free)
        size = _POSE * len(rest)
        gauge = gauge_of(self.adjusted)[rest].reshape(size, _GAUGE)
        basis = np.linalg.svd(gauge, full_matrices=True)[0][:, _GAUGE:]
        left = basis.T @ self._difference(rest)[rest].ravel()
        covariance = self.covariance[rest][:, :, rest].reshape(size, size)
        cost = left @ np.linalg.solve(basis.T @ covariance @ basis, left)
        return float(cost), size - _GAUGE

    def change_of(self, view: int, free: set[int]) -> tuple[float, float, float, float]:
        """Return turn (radians) and shift (rig sizes) of a free view, and the errors of both.

        As the others have them; the errors hold also where these disagree by more than they should.
        NaN for shifts where a single camera is left: two are aligned at any distance.
        """
        rest = self.others(free)
        if len(rest) < 2:
            rest = self.others([])
        cost, freedom = self.disagreement(np.setdiff1d(np.arange(len(self.given)), rest).tolist())
        gauge = gauge_of(self.adjusted)
        solved = np.linalg.pinv(gauge[rest].reshape(-1, _GAUGE)).reshape(_GAUGE, len(rest), _POSE)
        own = np.eye(len(self.given))[view]  # the view, less the similarity that aligns the rest
        slope = np.einsum("v,ij->ivj", own, np.eye(_POSE))
        slope[:, rest] -= np.einsum("ig,gvj->ivj", gauge[view], solved)
        variance = np.einsum("ivj,vjwk,iwk->i", slope, self.covariance, slope)
        variance *= max(1.0, cost / freedom) if freedom > 0 else 1.0
        change = self._difference(rest)[view]
        sigma = np.sqrt([variance[:3].sum(), variance[3:].sum()])
        turn, shift = (float(np.linalg.norm(part)) for part in (change[:3], change[3:]))
        return turn, shift, float(sigma[0]), float(sigma[1])


def _find_moved(rigs: _Rigs, config: Config) -> list[int]:
    """Return the views that were certainly moved, and by enough to matter.

    Those that explain most of the difference are set free, one after the other, until half of the
    cameras, and two, are left: a rig most of which has moved is another rig. Then the least certain
    one is put back until all are certain.
    """
    views, free = len(rigs.given), list[int]()
    while len(free) < min((views - 1) // 2, views - 2):
        rest = rigs.others(free).tolist()
        costs = [rigs.disagreement([*free, view])[0] for view in rest]
        free.append(rest[int(np.argmin(costs))])
    while free:
        order = [(_is_small(rigs, each, free, config), _chance(rigs, each, free)) for each in free]
        worst = max(range(len(free)), key=order.__getitem__)
        small, chance = order[worst]
        if not small and chance * views < config.verify.significance:
            break
        del free[worst]
    return free


def _chance(rigs: _Rigs, view: int, free: list[int]) -> float:
    """Return how likely a view that was not moved would explain as much."""
    cost, freedom = rigs.disagreement(free)
    explained = rigs.disagreement([each for each in free if each != view])[0] - cost
    return float(fdtrc(_POSE, freedom, max(explained, 0.0) / _POSE / max(1.0, cost / freedom)))


def _is_small(rigs: _Rigs, view: int, free: list[int], config: Config) -> bool:
    """Return whether a camera moved by less than is reported."""
    turn, shift, _, _ = rigs.change_of(view, set(free))
    return np.rad2deg(turn) < config.verify.least_turn_deg and shift < config.verify.least_shift
