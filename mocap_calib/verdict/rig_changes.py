"""Which cameras moved since a calibration, by a rig that was adjusted to keypoints, in words.

The calibration and the adjusted rig differ by a similarity, which means nothing, by what the
keypoints leave open, which the covariance of the adjustment has, by what models of lenses and
detectors do not know, which all cameras share, and where a camera was moved. Cameras are set free
one after the other until the rest agree: a camera was moved where the rest agree so much better
without it that chance does not explain it (Fisher's ratio of variances).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc

from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.geometry.alignment import gauge_of, rig_size
from mocap_calib.geometry.rotation import angle_between, vector_from_matrix
from mocap_calib.results import Cause, RigCovariance, Verdict, Verification, VerifiedCamera
from mocap_calib.types import Bools, CameraRig, Floats, Ints
from mocap_calib.verdict.checks import OPEN_DEG
from mocap_calib.verdict.evaluation import lay_over
from mocap_calib.verdict.verdict import expected_error

_POSE = 6  # numbers of the pose of a camera
_GAUGE = 7  # of them, in a whole rig, that a similarity takes away
_CALIBRATE = "calibrate anew: `mocap-calib run`"
_RECORD = "record longer, with subjects that move through the room"


@dataclass(frozen=True)
class RigChange:
    """How a rig that was adjusted anew differs from the calibration that was given.

    moved: `[view]` cameras that are elsewhere than the others have them.
    turn: `[view]` radians and shift: `[view]` rig sizes by which a camera is elsewhere, if it
        and the moved ones alone may; turn_sigma and shift_sigma: their RMS errors. NaN = unknown.
    difference: `[view]` radians between the rotations of both rigs, those of the cameras that
        stayed being aligned. It has all that the keypoints leave open.
    disagreement: variance that the cameras in place differ by, in those of their errors.
    refitted: the rig that was adjusted, in the coordinates and the unit of the given one.

    Of two cameras it is not known which one moved: `moved` has both or none, and either has the
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
    """Return which cameras moved between two rigs of the same cameras, and by how much.

    covariances: of the adjusted rig, as of `cautious_covariances`.
    """
    rigs = _Rigs.of(given, adjusted, covariances, config)
    views = np.arange(len(given))
    moved = _find_moved(rigs, config)
    refitted = lay_over(adjusted, given, rigs.others(moved))
    difference = np.asarray(angle_between(given.rotation, refitted.rotation))
    if np.rad2deg(difference[rigs.others(moved)].max()) > VERDICT_LIMITS_DEG[2]:
        moved, refitted = [], lay_over(adjusted, given, views)  # another rig: no camera of it moved
        difference = np.asarray(angle_between(given.rotation, refitted.rotation))
    cost, freedom = rigs.disagreement(moved)
    is_moved = np.isin(views, moved)
    poses = np.array([rigs.change_of(view, {*moved, view}) for view in views.tolist()])
    turn, shift, turn_sigma, shift_sigma = poses.T
    if len(given) == 2:
        pair = float(angle_between(given.relative(0, 1)[0], adjusted.relative(0, 1)[0]))
        certain = chdtrc(freedom, cost / config.verify.pair_disagreement)
        large = np.rad2deg(pair) > VERDICT_LIMITS_DEG[0]
        is_moved[:] = certain < config.verify.significance and large
        turn[:], turn_sigma[:] = pair, covariances[0].pair_rotation_sigma[0, 1]
        shift[:], shift_sigma[:] = np.nan, np.nan
        difference[:] = pair
    return RigChange(
        moved=is_moved,
        turn=turn,
        shift=shift,
        turn_sigma=turn_sigma,
        shift_sigma=shift_sigma,
        difference=difference,
        disagreement=cost / freedom,
        refitted=refitted,
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
    """Return the views that certainly moved, and by enough to matter; of two cameras none.

    Those that explain most of the difference are set free, one after the other, until half of the
    cameras, and two, are left: if more moved it is another rig. Then the least certain one is put
    back until all are certain.
    """
    views, free = len(rigs.given), list[int]()
    least = np.deg2rad(config.verify.least_turn_deg)
    while len(free) < min((views - 1) // 2, views - 2):
        rest = rigs.others(free).tolist()
        costs = [rigs.disagreement([*free, view])[0] for view in rest]
        free.append(rest[int(np.argmin(costs))])
    while free:
        order = [
            (max(rigs.change_of(each, set(free))[:2]) < least, _chance(rigs, each, free))
            for each in free
        ]
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


# --- verdict and words


def assess_calibration(
    cameras: Sequence[VerifiedCamera],
    change: RigChange,
    covariance: RigCovariance,
    names: tuple[str, ...],
    config: Config,
) -> Verdict:
    """Return the verdict on a calibration with the moved cameras where they are now.

    Each camera is as uncertain as the keypoints leave it, and as far off as they have it elsewhere.
    names: of the views of the change and of the covariance.
    """
    uncertain = np.rad2deg(covariance.rotation_sigma)
    refitted = change.moved & (len(names) > 2)  # of two it is not known where they are now
    apart = np.where(refitted, 0.0, np.rad2deg(change.difference))
    # keypoints that determine nothing give no better calibration
    remedy = _CALIBRATE if uncertain.max() <= VERDICT_LIMITS_DEG[1] else _RECORD
    causes = []
    for view, name in enumerate(names):
        meaning = f"{name}: the keypoints determine its rotation to +-{uncertain[view]:.1f} deg"
        causes.append(Cause("covariance", name, float(uncertain[view]), meaning, _RECORD))
        meaning = f"{name}: {apart[view]:.1f} deg from where the keypoints have it"
        causes.append(Cause("difference", name, float(apart[view]), meaning, remedy))
    unexplained = change.disagreement > config.verify.pair_disagreement
    if unexplained and apart.max() > VERDICT_LIMITS_DEG[0]:
        meaning = "the cameras contradict the calibration, and no single one explains it"
        causes.append(Cause("contradiction", "", OPEN_DEG, meaning, remedy))
    for camera in cameras:
        if camera.word == "inconsistent":
            meaning = f"{camera.name}: nothing that it sees agrees with the others, at any pose"
            causes.append(Cause(camera.word, "", OPEN_DEG, meaning, "check its files and clock"))
    causes.sort(key=lambda cause: -cause.error_deg)
    return Verdict(expected_error(names, causes), tuple(causes))


def explain_cameras(cameras: Sequence[VerifiedCamera]) -> list[str]:
    """Return a line for each camera that moved or was not checked, and what to do about it."""
    if len(cameras) == 2 and all(camera.word == "moved" for camera in cameras):
        first, second = cameras
        return [
            f"{first.name} or {second.name} moved, by {_deg(first)} deg against the other; with "
            f"two cameras nobody can say which: {_CALIBRATE}"
        ]
    lines = []
    for camera in cameras:
        if camera.word == "moved":
            lines.append(f"{camera.name} {describe_move(camera)}: put it back, or {_CALIBRATE}")
        if camera.word == "focal":
            change = float(np.expm1(camera.focal_change))
            lines.append(
                f"{camera.name}: its focal length is {abs(change):.1%} "
                f"{'longer' if change > 0 else 'shorter'} than given (zoom, or images of another "
                f"size): correct its intrinsics, or {_CALIBRATE}"
            )
        if camera.word == "not checked":
            lines.append(f"{camera.name}: sees too little with the others to be checked")
    return lines


def describe_move(camera: VerifiedCamera) -> str:
    """Return by how much a camera moved, for a person: `is turned by 2.1 +- 0.2 deg`.

    A turn or a shift of less than two standard deviations is none.
    """
    parts = []
    if camera.turn > 2 * camera.turn_sigma:
        parts.append(f"turned by {_deg(camera)} deg")
    if camera.shift > 2 * camera.shift_sigma:
        sigma = camera.relative_shift * camera.shift_sigma / camera.shift
        parts.append(f"shifted by {camera.relative_shift:.1%} +- {sigma:.1%} of the rig's size")
    return f"is {' and '.join(parts)}" if parts else "is elsewhere"


def describe_refits(cameras: Sequence[VerifiedCamera]) -> list[str]:
    """Return a line for each camera that is elsewhere in the corrected rig, for its file."""
    return [
        f"{camera.name}: refitted by keypoints; as given before it {describe_move(camera)}"
        for camera in cameras
        if camera.word in ("moved", "focal")
    ]


def verification_to_dict(found: Verification) -> dict[str, Any]:
    """Return the figures under the keys of `mocap-calib verify --json`; angles in degrees."""
    return {
        "verdict": found.verdict,
        "passes": found.passes,
        "named": list(found.named),
        "reasons": list(found.reasons),
        "unit": found.rig.unit,
        "cameras": [_camera_to_dict(camera) for camera in found.cameras],
    }


def _camera_to_dict(camera: VerifiedCamera) -> dict[str, Any]:
    """Return the figures of one camera; None where one is not known."""
    figures = {
        "turn_deg": np.rad2deg(camera.turn),
        "turn_sigma_deg": np.rad2deg(camera.turn_sigma),
        "shift": camera.shift,
        "shift_sigma": camera.shift_sigma,
        "relative_shift": camera.relative_shift,
        "focal_change": np.expm1(camera.focal_change),
        "error_px": camera.error_px,
        "refitted_px": camera.refitted_px,
    }
    known = {key: float(value) if np.isfinite(value) else None for key, value in figures.items()}
    return {"name": camera.name, "place": camera.word} | known


def _deg(camera: VerifiedCamera) -> str:
    """Return the turn of a camera and its standard deviation in degrees."""
    return f"{np.rad2deg(camera.turn):.2f} +- {np.rad2deg(camera.turn_sigma):.2f}"
