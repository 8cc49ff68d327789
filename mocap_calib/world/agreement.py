"""Tell whether a world that somebody states can be that of a rig, up to what noise allows.

Stated places are compared with where the rig has them, in standard deviations of all that may
move either: hands that measured, pixels that were clicked, the rig itself.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_calib.config import WorldConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.alignment import align_by_similarity, rig_size
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.results import RigCovariance
from mocap_calib.types import Bools, CameraRig, Floats
from mocap_calib.verdict.evaluation import with_axes
from mocap_calib.world.moving import Similarity

_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Fit:
    """How far things `[N]` are from where they were stated, after the best similarity.

    distance: in the unit of the stated world. turn: angle in radians, 0 for points.
    off: in standard deviations. misfit: all of these in one number, about 1 for errors as allowed.
    """

    by: Similarity
    distance: Floats
    turn: Floats
    off: Floats
    misfit: float


def fit_points(found: Floats, known: Floats, sigma: Floats, config: WorldConfig) -> Fit:
    """Return the fit of points `[N, 3]` to their stated places.

    sigma: `[N]` standard deviations of the points found, in their own unit.
    """
    by = Similarity(*align_by_similarity(found, known))
    distance = np.linalg.norm(by.apply(found) - known, axis=1)
    measured = config.landmark_sigma * _extent(known)
    off = distance / np.hypot(measured, by.scale * sigma)
    free = max(3 * len(known) - 7, 1)  # of the coordinates of errors, after a similarity
    return Fit(by, distance, np.zeros(len(known)), off, float(np.sqrt(3 * (off**2).sum() / free)))


def fit_cameras(
    rig: CameraRig, target: CameraRig, covariance: RigCovariance, config: WorldConfig
) -> Fit:
    """Return the fit of cameras to those of the same names in a stated world.

    covariance: of the rig, in its own axes.
    """
    by = Similarity(*align_by_similarity(with_axes(rig), with_axes(target)))
    distance = np.linalg.norm(by.apply(rig.centres) - target.centres, axis=1)
    turn = angle_between(rig.rotation @ by.rotation.T, target.rotation)
    moved = by.scale * covariance.size * covariance.centre_sigma
    placed = distance / np.hypot(config.camera_sigma * rig_size(target), moved)
    turned = turn / np.hypot(config.camera_turn_sigma, covariance.rotation_sigma)
    misfit = max(np.sqrt((off**2).mean()) for off in (placed, turned))
    return Fit(by, distance, turn, np.maximum(placed, turned), float(misfit))


def is_mirrored(found: Floats, known: Floats, sigma: Floats, config: WorldConfig) -> bool:
    """Return whether the mirror image of points fits as noise allows, and they themselves do not.

    The arguments are those of `fit_points`.
    """
    plain, mirrored = (
        fit_points(points, known, sigma, config).misfit for points in (found, found * _MIRROR)
    )
    return mirrored <= config.most_misfit < plain


def leave_one_out(fit: Callable[[Bools], Fit], number: int) -> tuple[int, Fit] | None:
    """Return the one of some things without which the others fit best, and that fit.

    fit: of those that a mask `[N]` leaves. None where nothing can be left out.
    """
    fits: list[tuple[int, Fit]] = []
    for index in range(number):
        try:
            fits.append((index, fit(np.arange(number) != index)))
        except DegenerateError:
            continue  # the others are all in one place
    return min(fits, key=lambda each: each[1].misfit, default=None)


def point_sigmas(
    rig: CameraRig, points: Floats, seen: Bools, covariance: RigCovariance, config: WorldConfig
) -> Floats:
    """Return the standard deviations `[N]` of points `[N, 3]`, in the unit of the rig.

    They are due to pixels that somebody clicked, and to the rig. seen: `[view, N]` in which views.

    To first order, as in `geometry.intersection`.
    """
    offset = points - rig.centres[:, None]
    far = np.linalg.norm(offset, axis=-1)
    focal = np.array([camera.matrix[0, 0] for camera in rig.cameras])
    angle = np.hypot(config.landmark_pixels / focal, covariance.rotation_sigma)[:, None]
    shift = (covariance.size * covariance.centre_sigma)[:, None] / far
    weight = np.where(seen, 1 / (np.hypot(angle, shift) * far) ** 2, 0.0)
    along = offset / far[..., None]
    normal = np.einsum("vn,vnij->nij", weight, np.eye(3) - along[..., None] * along[..., None, :])
    return np.asarray(np.sqrt(np.trace(np.linalg.pinv(normal), axis1=-2, axis2=-1)))


def rms(values: Floats) -> float:
    """Return the root of the mean of the squares."""
    return float(np.sqrt((values**2).mean()))


def exact(rig: CameraRig) -> RigCovariance:
    """Return the covariance of a rig without error."""
    views = len(rig)
    return RigCovariance(np.zeros((views, 6, views, 6)), rig_size(rig))


def _extent(points: Floats) -> float:
    """Return the RMS distance of points from their middle."""
    return rms(np.linalg.norm(points - points.mean(0), axis=1))
