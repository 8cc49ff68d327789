"""Which cameras moved since a calibration, by a rig that was adjusted to keypoints, in words.

The calibration and the adjusted rig differ by a similarity, which means nothing, by what the
keypoints leave open, which the covariance of the adjustment has, by what models of lenses and
detectors do not know, which all cameras share, and where a camera was moved. Cameras are set free
one after the other until the rest agree: a camera was moved where the rest agree so much better
without it that chance does not explain it (Fisher's ratio of variances).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc

from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.geometry.alignment import gauge_of, rig_size
from mocap_calib.geometry.rotation import angle_between, vector_from_matrix
from mocap_calib.results import Cause, RigCovariance, Verdict, Verification, VerifiedCamera
from mocap_calib.types import POSE, Bools, CameraRig, Floats
from mocap_calib.verdict.checks import OPEN_DEG
from mocap_calib.verdict.evaluation import lay_over
from mocap_calib.verdict.verdict import expected_error

_CALIBRATE = "calibrate anew: `mocap-calib run`"
_RECORD = "record longer, with subjects that move through the room"


@dataclass(frozen=True)
class RigChange:
    """How a rig that was adjusted anew differs from the calibration that was given.

    moved: `[view]` cameras that are elsewhere than the others have them.
    size, sigma: `[view, 2]` turn (radians) and shift (rig sizes) by which a camera is elsewhere, if
        it and the moved ones alone may, and their RMS errors. Shifts are NaN where a single other
        camera is left: two are aligned at any distance.
    difference: `[view]` radians between the rotations of both rigs, those of the cameras that
        stayed being aligned. It has all that the keypoints leave open.
    disagreement: variance that the cameras in place differ by, in those of their errors.
    refitted: the rig that was adjusted, in the coordinates and the unit of the given one.

    Of two cameras it is not known which one moved: `moved` has both or none.
    """

    moved: Bools
    size: Floats
    sigma: Floats
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
    rigs = _Rigs(given, adjusted, _covariance(adjusted, covariances, config))
    views = range(len(given))
    moved = _find_moved(rigs, config)
    refitted = lay_over(adjusted, given, np.setdiff1d(views, moved))
    difference = angle_between(given.rotation, refitted.rotation)
    if np.rad2deg(np.delete(difference, moved).max()) > VERDICT_LIMITS_DEG[2]:
        moved, refitted = [], lay_over(adjusted, given, views)  # another rig: no camera of it moved
        difference = angle_between(given.rotation, refitted.rotation)
    rest, is_moved = rigs.moves(moved), np.isin(views, moved)
    if len(given) == 2:
        difference = np.full(2, angle_between(given.relative(0, 1)[0], adjusted.relative(0, 1)[0]))
        chance = chdtrc(rest.degrees, rest.cost / config.verify.pair_disagreement)
        large = np.rad2deg(difference) > VERDICT_LIMITS_DEG[0]
        is_moved = large & (chance < config.verify.significance)
    alone = [rigs.moves([*(each for each in moved if each != view), view]) for view in views]
    return RigChange(
        moved=is_moved,
        size=np.array([each.size[-1] for each in alone]),
        sigma=np.array([each.sigma[-1] for each in alone]),
        difference=difference,
        disagreement=rest.cost / rest.degrees,
        refitted=refitted,
    )


def _covariance(
    rig: CameraRig, covariances: tuple[RigCovariance, RigCovariance], config: Config
) -> Floats:
    """Return the covariance `[6 view, 6 view]` of what a rig differs by from the given one.

    It has the shape of that of independent errors, which says best what the images show, and the
    size of the one that errors really have. covariances: as of `cautious_covariances`.
    """
    size = POSE * len(rig)
    real, independent = (each.matrix.reshape(size, size) for each in covariances)
    excess = np.trace(real) / np.trace(independent)
    floor = np.deg2rad(config.verify.least_error_deg) ** 2 * np.eye(size)
    return np.asarray(max(1.0, excess) * independent + floor)


@dataclass(frozen=True)
class _Moves:
    """How some cameras moved between two rigs, as the others have them.

    cost: squared Mahalanobis distance of the others, and degrees: its degrees of freedom.
    size, sigma: `[camera, 2]` as of `RigChange`. chance: `[camera]` how likely one that was not
    moved would differ as much, by Fisher's ratio of variances.
    """

    cost: float
    degrees: int
    size: Floats
    sigma: Floats
    chance: Floats


@dataclass(frozen=True)
class _Rigs:
    """Two rigs of the same cameras, and the covariance `[6 view, 6 view]` of their difference."""

    given: CameraRig
    adjusted: CameraRig
    covariance: Floats

    def moves(self, free: Sequence[int]) -> _Moves:
        """Return how some views (indices) moved, by generalised least squares.

        Where a single other is left, the last one shows as well how the rigs lie to each other.
        """
        rest = np.setdiff1d(range(len(self.given)), free)
        known = rest if len(rest) > 1 else np.append(rest, free[-1])
        difference = _change(self.adjusted, lay_over(self.given, self.adjusted, known))
        size = len(difference)
        own = np.eye(size).reshape(size, -1, POSE)[:, list(free)].reshape(size, -1)
        gauge = gauge_of(self.adjusted).reshape(size, -1)
        whiten = np.linalg.inv(np.linalg.cholesky(self.covariance))
        design = whiten @ np.concatenate([own, gauge], axis=1)
        inverse = np.linalg.pinv(design)
        found = inverse @ whiten @ difference
        cost = float(np.square(whiten @ difference - design @ found).sum())
        degrees = size - design.shape[1]
        # the errors hold also where the others disagree by more than they should
        excess = max(1.0, cost / max(degrees, 1))
        move, by_camera = found[: own.shape[1]].reshape(-1, POSE), inverse[: own.shape[1]]
        by_camera = by_camera.reshape(-1, POSE, size)
        covariance = excess * by_camera @ by_camera.swapaxes(1, 2)
        ratio = np.einsum("ci,cij,cj->c", move, np.linalg.pinv(covariance, hermitian=True), move)
        variance = np.einsum("cii->ci", covariance)
        unknown = [1.0, np.nan if len(rest) < 2 else 1.0]
        return _Moves(
            cost=cost,
            degrees=degrees,
            size=np.linalg.norm(move.reshape(-1, 2, 3), axis=2) * unknown,
            sigma=np.sqrt(variance.reshape(-1, 2, 3).sum(2)) * unknown,
            chance=np.asarray(fdtrc(POSE, degrees, ratio / POSE)),
        )


def _change(before: CameraRig, after: CameraRig) -> Floats:
    """Return the turns and shifts `[6 view]` of cameras between rigs in the same coordinates."""
    turn = vector_from_matrix(np.swapaxes(before.rotation, 1, 2) @ after.rotation)
    shift = (after.centres - before.centres) / rig_size(before)
    return np.concatenate([turn, shift], axis=1).ravel()


def _find_moved(rigs: _Rigs, config: Config) -> list[int]:
    """Return the views that certainly moved, and by enough to matter; of two cameras none.

    Those that explain most of the difference are set free, one after the other, until half of the
    cameras, and two, are left: if more moved it is another rig. Then the least certain one is put
    back until all are certain.
    """
    views, free = len(rigs.given), list[int]()
    while len(free) < min((views - 1) // 2, views - 2):
        rest = np.setdiff1d(range(views), free).tolist()
        free.append(min(rest, key=lambda view: rigs.moves([*free, view]).cost))
    while free:
        found = rigs.moves(free)
        small = found.size.max(1) < np.deg2rad(config.verify.least_turn_deg)
        chance = np.where(small, 1.0, found.chance)
        if chance.max() * views < config.verify.significance:
            break
        del free[int(chance.argmax())]
    return free


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
