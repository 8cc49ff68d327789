"""Align a rig to a known world, by its cameras or by landmarks that cameras see.

Stated places are compared with those of the rig, after the best similarity, in standard deviations
of all that may move either: measurements by hand, clicks in images, and the rig itself.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.config import KnownCamera, Landmark, WorldConfig
from mocap_calib.errors import MismatchError, argument, count, one_line, suggest
from mocap_calib.geometry.rotation import Similarity, align_by_similarity, angle_between, rig_size
from mocap_calib.recording.epochs import views_by_camera
from mocap_calib.results import RigCovariance
from mocap_calib.rig.triangulate import triangulate_pixels
from mocap_calib.types import METRES, Bools, Camera, CameraRig, Floats, MeasuredLandmark, World
from mocap_calib.verdict.evaluation import with_axes

LEAST_LANDMARKS = 3  # that determine a similarity


@dataclass(frozen=True)
class _Stated:
    """Cameras or landmarks of a rig, and the poses or places that a user states for them.

    option: that states them, and unit: of stated lengths. things: "cameras" or "landmarks".
    found, known: `[N, point, 3]` in the rig and as stated: the place, then the ends of a camera's
        axes. sigma: `[N]` standard deviation of the places found, in the unit of the rig.
    turned: `[N, 3, 3]` from the rig's axes to the stated ones, by each camera alone; none of
        landmarks. turn_sigma: `[N]` standard deviation in radians.
    """

    option: str
    unit: str
    things: str
    names: tuple[str, ...]
    found: Floats
    known: Floats
    sigma: Floats
    turned: Floats | None = None
    turn_sigma: Floats | float = 0.0


@dataclass(frozen=True)
class _Fit:
    """A similarity, and how far things `[N]` are from where they are stated after it.

    distance: in the unit of the stated world. turn: angle in radians, 0 of landmarks.
    scale_sigma: relative standard deviation of the scale.
    """

    by: Similarity
    distance: Floats
    turn: Floats
    scale_sigma: float


def align_to_cameras(
    rig: CameraRig, config: WorldConfig, covariance: RigCovariance
) -> tuple[Similarity, float, World]:
    """Return the similarity to the world of known cameras, its relative error of scale, the world.

    Its remark says how well the cameras fit. covariance: of the rig.

    Raises MismatchError where fewer than two cameras are in both, and where their stated poses
    differ by more than errors can.
    """
    views = {name: own[0] for name, own in views_by_camera(rig.names).items()}
    target = stated_rig(config.cameras, list(views))
    order = np.array([views[name] for name in target.names])
    own = rig.select(order)
    stated = _Stated(
        option=argument("world"),
        unit=config.unit,
        things="cameras",
        names=target.names,
        found=with_axes(own),
        known=with_axes(target),
        sigma=(covariance.size * covariance.centre_sigma)[order],
        turned=np.swapaxes(target.rotation, 1, 2) @ own.rotation,
        turn_sigma=covariance.rotation_sigma[order],
    )
    fit = _fit(stated, config)
    remark = (
        f"aligned to {count(len(order), 'camera')} of known pose, RMS distance "
        f"{_describe_distance(stated, fit.distance)}, "
        f"RMS angle {np.degrees(_rms(fit.turn)):.1f} deg"
    )
    return fit.by, fit.scale_sigma, World(kind="file", remarks=(remark,))


def stated_rig(known: Sequence[KnownCamera], names: Sequence[str]) -> CameraRig:
    """Return the known cameras that have one of these names.

    Raises MismatchError where they are fewer than two, or all in one place.
    """
    shared = [camera for camera in known if camera.name in names]
    if len(shared) < 2:
        found = ", ".join(camera.name for camera in shared) or "none"
        raise MismatchError(
            argument("world"),
            f"a file with at least two cameras of the recording ({', '.join(names)})",
            found,
            "check their names",
        )
    rig = CameraRig(
        cameras=tuple(Camera(camera.name, (0, 0), np.eye(3)) for camera in shared),
        rotation=np.array([np.reshape(camera.rotation, (3, 3)) for camera in shared]),
        translation=np.array([camera.translation for camera in shared]),
    )
    if rig_size(rig) <= 1e-9 * np.abs(rig.centres).max():
        raise MismatchError(
            argument("world"),
            "a file whose cameras are in different places",
            f"{', '.join(rig.names)} in one",
            "give another",
        )
    return rig


def align_to_landmarks(
    rig: CameraRig, config: WorldConfig, covariance: RigCovariance
) -> tuple[Similarity, float, World]:
    """Return the similarity to the world of landmarks, its relative error of scale, the world.

    The landmarks are triangulated; each is in the world with its distance from its stated place.

    covariance: of the rig.

    Raises MismatchError for landmarks that are too few or on a line, and where their stated places
    differ by more than errors can.
    """
    landmarks = config.landmarks
    names = tuple(dict.fromkeys(each.name for each in landmarks))
    places = {each.name: each.position for each in landmarks}
    known = np.array([places[name] for name in names]).reshape(-1, 3)
    views = {name: own[0] for name, own in views_by_camera(rig.names).items()}
    pixels = np.full((len(rig), len(names), 2), np.nan)
    for each in landmarks:
        if each.camera in views:
            pixels[views[each.camera], names.index(each.name)] = each.pixel
    found, _ = triangulate_pixels(rig, pixels, np.ones(pixels.shape[:-1]))
    seen = np.isfinite(found[:, 0])
    _check_landmarks(found[seen], len(names), config)
    detected = np.isfinite(pixels[:, seen, 0])
    stated = _Stated(
        option=argument("align"),
        unit="m",
        things="landmarks",
        names=tuple(one_line(name) for name, there in zip(names, seen, strict=True) if there),
        found=found[seen][:, None],
        known=known[seen][:, None],
        sigma=_sigmas_of_points(rig, found[seen], detected, covariance, config),
    )
    fit = _fit(stated, config)
    away = np.full(len(names), np.nan)
    away[seen] = fit.distance
    measured = tuple(map(MeasuredLandmark, names, away.tolist()))
    remark = (
        f"aligned to {count(len(fit.distance), 'landmark')}, RMS distance "
        f"{_describe_distance(stated, fit.distance)}"
    )
    world = World(kind="landmarks", landmarks=measured, remarks=(remark,))
    return fit.by, fit.scale_sigma, world


def check_landmarks(
    landmarks: Sequence[Landmark], cameras: Sequence[str], config: WorldConfig
) -> None:
    """Compare landmarks with the cameras of a recording, before it is calibrated.

    Raises MismatchError for unknown cameras, and landmarks that are too few or on a line.
    """
    strangers = {each.camera for each in landmarks} - set(cameras)
    if strangers:
        raise MismatchError(
            argument("align"),
            f"cameras of the recording ({', '.join(cameras)})",
            f"{min(strangers)!r}",
            suggest(min(strangers), cameras),
        )
    seen = Counter(each.name for each in landmarks)
    places = {each.name: each.position for each in landmarks if seen[each.name] >= 2}
    _check_landmarks(np.array(list(places.values())), len(seen), config)


def _check_landmarks(points: Floats, number: int, config: WorldConfig) -> None:
    """Raise MismatchError for landmarks `[N, 3]` that are too few, or on a line.

    number: of all landmarks, also of those that fewer than two cameras see.
    """
    if len(points) < LEAST_LANDMARKS:
        raise MismatchError(
            argument("align"),
            f"{LEAST_LANDMARKS} landmarks that two cameras see",
            f"{len(points)} of {number}",
            "add observations",
        )
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    # within three standard deviations of their places: the rotation about the line is open
    if extent[1] <= 3 * config.stated_sigma * extent[0]:
        raise MismatchError(
            argument("align"),
            "landmarks that are not on a line",
            "all of them on one",
            "add one beside it",
        )


def _fit(stated: _Stated, config: WorldConfig) -> _Fit:
    """Return the best similarity. Raises MismatchError where it fits worse than errors can be."""
    found, known, turn = stated.found[:, 0], stated.known[:, 0], np.zeros(len(stated.names))
    by = align_by_similarity(stated.found.reshape(-1, 3), stated.known.reshape(-1, 3))
    distance, extent = np.linalg.norm(by.apply(found) - known, axis=1), _extent(known)
    offs = [distance / np.hypot(config.stated_sigma * extent, by.scale * stated.sigma)]
    if stated.turned is not None:
        turn = angle_between(stated.turned, by.rotation)
        offs.append(turn / np.hypot(config.stated_sigma, stated.turn_sigma))
    numbers = known.size * len(offs)
    free = max(numbers - 7, 1)  # the similarity follows 7 of the numbers
    misfit = np.sqrt(numbers / free) * max(map(_rms, offs))
    if not misfit <= config.most_misfit:  # NaN where all stated places are one
        angle = "" if stated.turned is None else f" and {np.degrees(_rms(turn)):.0f} deg"
        worst = stated.names[int(np.argmax(np.max(offs, axis=0)))]
        raise MismatchError(
            stated.option,
            f"{stated.things} where the recording shows them",
            f"them {_describe_distance(stated, distance)}{angle} from there (RMS), most of all "
            f"{worst}",
            "correct or leave out that one, or give the file right-handed axes",
        )
    return _Fit(by, distance, turn, _rms(distance) / extent / np.sqrt(max(known.size - 7, 1)))


def _describe_distance(stated: _Stated, distance: Floats) -> str:
    """Return the RMS distance in words: in millimetres, or in percent of the rig's size."""
    rms = _rms(distance)
    if stated.unit in METRES:
        return f"{1e3 * METRES[stated.unit] * rms:.0f} mm"
    return f"{100 * rms / _extent(stated.known[:, 0]):.1f} % of the rig's size"


def _sigmas_of_points(
    rig: CameraRig, points: Floats, seen: Bools, covariance: RigCovariance, config: WorldConfig
) -> Floats:
    """Return the standard deviations `[N]` of points `[N, 3]`, in the unit of the rig.

    To first order, from errors of clicked pixels and of the rig. seen: `[view, N]` in which views.
    """
    offset = points - rig.centres[:, None]
    far = np.linalg.norm(offset, axis=-1)
    focal = np.array([camera.matrix[0, 0] for camera in rig.cameras])
    angle = np.hypot(config.landmark_pixels / focal, covariance.rotation_sigma)[:, None]
    shift = (covariance.size * covariance.centre_sigma)[:, None]
    weight = np.where(seen, 1 / ((angle * far) ** 2 + shift**2), 0.0)
    along = offset / far[..., None]
    normal = np.einsum("vn,vnij->nij", weight, np.eye(3) - along[..., None] * along[..., None, :])
    return np.asarray(np.sqrt(np.trace(np.linalg.pinv(normal), axis1=-2, axis2=-1)))


def _extent(points: Floats) -> float:
    """Return the RMS distance of points `[N, 3]` from their middle."""
    return _rms(np.linalg.norm(points - points.mean(0), axis=1))


def _rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt((values**2).mean()))
