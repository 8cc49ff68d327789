"""Which cameras of a rig stand elsewhere than a calibration says, by a second look at the rig.

The calibration and a rig that was adjusted anew differ by a similarity, which means nothing, by
what the keypoints do not determine, which the covariance of the adjustment knows, by what models of
lenses and detectors do not know, which all cameras share, and where a camera was moved. So cameras
are set free until the rest agree: a camera was moved where the rest go together so much better
without it that chance does not explain it (Fisher's ratio of variances: what it explains, over what
the rest still disagree by).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.geometry.gauge import gauge_of, rig_change
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.records import Record
from mocap_calib.types import Bools, CameraRig, Floats, Ints, RigCovariance
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
    covariance, _ = covariances
    problem = _Problem.of(given, adjusted, covariances, config)
    if problem.views == 2:
        return _compare_two(problem, covariance, config)
    moved = _significant(problem, _explaining(problem), config)
    refitted = lay_over(adjusted, given, problem.others(moved))
    left = np.delete(_angles(given, refitted), moved)
    if np.rad2deg(left.max()) > VERDICT_LIMITS_DEG[2]:  # another rig: no camera of it is to blame
        moved, refitted = [], lay_over(adjusted, given, problem.others([]))
    alone = _aligned_turns(given, refitted, covariance)
    for view in range(problem.views):
        free = {*moved, view}
        if len(problem.others(free)) >= 2:
            alone[:, view] = problem.free_pose(view, free)
    turn, shift, turn_sigma, shift_sigma = alone
    return RigChange(
        moved=np.isin(np.arange(problem.views), moved),
        turn=turn,
        shift=shift,
        turn_sigma=turn_sigma,
        shift_sigma=shift_sigma,
        difference=_angles(given, refitted),
        disagreement=problem.cost(moved) / problem.freedom(moved),
        refitted=refitted,
    )


def _aligned_turns(given: CameraRig, refitted: CameraRig, covariance: RigCovariance) -> Floats:
    """Return turn, shift and their errors `[4, view]` of two rigs that are aligned as a whole.

    Two cameras alone can be aligned at any distance: shifts are not known.
    """
    unknown = np.full(len(given), np.nan)
    return np.stack([_angles(given, refitted), unknown, covariance.rotation_sigma, unknown])


def _compare_two(problem: "_Problem", covariance: RigCovariance, config: Config) -> RigChange:
    """Return whether two cameras stand otherwise to each other than was given."""
    given, both = problem.given, np.arange(2)
    refitted = lay_over(problem.adjusted, given, both)
    before, after = given.relative(0, 1)[0], problem.adjusted.relative(0, 1)[0]
    turn = float(angle_between(before, after))
    disagreement = problem.cost([]) / problem.freedom([])
    chance = chdtrc(problem.freedom([]), problem.cost([]) / config.verify.pair_disagreement)
    moved = chance < config.verify.significance and np.rad2deg(turn) > VERDICT_LIMITS_DEG[0]
    return RigChange(
        moved=np.full(2, moved),
        turn=np.full(2, turn),
        shift=np.full(2, np.nan),
        turn_sigma=np.full(2, covariance.pair_rotation_sigma[0, 1]),
        shift_sigma=np.full(2, np.nan),
        difference=np.full(2, turn),
        disagreement=disagreement,
        refitted=refitted,
    )


@dataclass(frozen=True)
class _Problem:
    """Least squares of what two rigs differ by.

    basis: `[6 view, 6 view - 7]` changes of poses that no similarity makes.
    precision: inverse covariance of the difference in this basis.
    """

    given: CameraRig
    adjusted: CameraRig
    basis: Floats
    precision: Floats

    @classmethod
    def of(
        cls,
        given: CameraRig,
        adjusted: CameraRig,
        covariances: tuple[RigCovariance, RigCovariance],
        config: Config,
    ) -> "_Problem":
        """Return the problem of two rigs.

        The covariance has the shape of that of independent errors, which says best what the images
        show, and the size of the one that errors really have.
        """
        size = _POSE * len(given)
        whole = np.linalg.svd(gauge_of(adjusted).reshape(size, _GAUGE), full_matrices=True)[0]
        basis = whole[:, _GAUGE:]
        real, independent = (
            basis.T @ covariance.matrix.reshape(size, size) @ basis for covariance in covariances
        )
        excess = np.trace(np.linalg.solve(independent, real)) / len(real)
        floor = np.deg2rad(config.verify.least_error_deg) ** 2 * np.eye(len(real))
        precision = np.linalg.inv(max(1.0, excess) * independent + floor)
        return cls(given, adjusted, basis, precision)

    @property
    def views(self) -> int:
        """Number of cameras."""
        return len(self.given)

    def others(self, free: Iterable[int]) -> Ints:
        """Return the views (indices) that are not free."""
        return np.setdiff1d(np.arange(self.views), np.array(list(free), dtype=np.int64))

    def freedom(self, free: Iterable[int]) -> int:
        """Return how many numbers say that the views that are not free go together."""
        return _POSE * len(self.others(free)) - _GAUGE

    def cost(self, free: Iterable[int]) -> float:
        """Return the squared difference in standard deviations, where some views are free."""
        return self._solve(free)[0]

    def free_pose(self, view: int, free: Iterable[int]) -> tuple[float, float, float, float]:
        """Return turn (radians) and shift (rig sizes) of a free view, and the errors of both.

        The errors hold also where the other views disagree by more than they should.
        """
        free = sorted(free)
        cost, poses, covariance = self._solve(free)
        freedom = self.freedom(free)
        scale = max(1.0, cost / freedom) if freedom > 0 else 1.0
        start = _POSE * free.index(view)
        pose = poses[start : start + _POSE]
        variance = scale * np.diag(covariance)[start : start + _POSE]
        return (
            float(np.linalg.norm(pose[:3])),
            float(np.linalg.norm(pose[3:])),
            float(np.sqrt(variance[:3].sum())),
            float(np.sqrt(variance[3:].sum())),
        )

    def _solve(self, free: Iterable[int]) -> tuple[float, Floats, Floats]:
        """Return the least cost, and the poses of the free views with their covariance."""
        free = sorted(free)
        rest = self.others(free)
        aligned = lay_over(self.given, self.adjusted, rest)
        left = self.basis.T @ rig_change(self.adjusted, aligned).ravel()
        columns = np.eye(_POSE * self.views).reshape(-1, self.views, _POSE)[:, free]
        slope = self.basis.T @ columns.reshape(_POSE * self.views, -1)
        covariance = np.linalg.inv(slope.T @ self.precision @ slope)
        poses = covariance @ (slope.T @ self.precision @ left)
        left = left - slope @ poses
        return float(left @ self.precision @ left), poses, np.asarray(covariance)


def _explaining(problem: _Problem) -> list[int]:
    """Return the views that explain most of the difference, one after the other.

    At least half of the cameras, and two, are left: a rig most of which has moved is another rig.
    """
    free: list[int] = []
    most = min((problem.views - 1) // 2, problem.views - 2)
    while len(free) < most:
        rest = problem.others(free)
        costs = [problem.cost([*free, view]) for view in rest.tolist()]
        free.append(int(rest[np.argmin(costs)]))
    return free


def _significant(problem: _Problem, free: list[int], config: Config) -> list[int]:
    """Return which of the free views are certainly moved, and by enough to matter.

    The least certain one is put back until all are certain.
    """
    free = list(free)
    while free:
        chance = [_chance(problem, view, free) for view in free]
        small = [_is_small(problem, view, free, config) for view in free]
        worst = max(range(len(free)), key=lambda k: (small[k], chance[k]))
        if not small[worst] and chance[worst] * problem.views < config.verify.significance:
            break
        del free[worst]
    return free


def _chance(problem: _Problem, view: int, free: list[int]) -> float:
    """Return how likely a view that stands where it did would explain so much."""
    freedom = problem.freedom(free)
    cost = problem.cost(free)
    explained = problem.cost([other for other in free if other != view]) - cost
    return float(fdtrc(_POSE, freedom, max(explained, 0.0) / _POSE / max(1.0, cost / freedom)))


def _is_small(problem: _Problem, view: int, free: list[int], config: Config) -> bool:
    """Return whether a camera stands so near to where it did that nobody minds."""
    turn, shift, _, _ = problem.free_pose(view, free)
    return np.rad2deg(turn) < config.verify.least_turn_deg and shift < config.verify.least_shift


def _angles(given: CameraRig, other: CameraRig) -> Floats:
    """Return the angles `[view]` in radians between the rotations of two rigs."""
    return np.asarray(angle_between(given.rotation, other.rotation))
