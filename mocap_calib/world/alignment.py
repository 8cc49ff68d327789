"""Align a rig to a world that is known: by its cameras, or by landmarks that cameras see."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import KnownCamera, Landmark, WorldConfig
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.geometry.alignment import rig_size
from mocap_calib.recording.epochs import views_by_camera
from mocap_calib.results import RigCovariance
from mocap_calib.rig.triangulate import triangulate_pixels
from mocap_calib.types import METRES, Bools, Camera, CameraRig, Floats, MeasuredLandmark
from mocap_calib.wording import count, one_line
from mocap_calib.world.agreement import (
    Fit,
    exact,
    fit_cameras,
    fit_points,
    is_mirrored,
    leave_one_out,
    point_sigmas,
    rms,
)
from mocap_calib.world.moving import Similarity


def align_to_cameras(
    rig: CameraRig, config: WorldConfig, covariance: RigCovariance | None = None
) -> tuple[Similarity, float, str]:
    """Return the similarity to the world of known cameras, its relative error of scale, and words.

    The words say how well the cameras are where they should be. covariance: of the rig; None: it
    is exact.

    Raises MismatchError where fewer than two cameras are in both, and where they stand elsewhere
    than noise can explain.
    """
    views = {name: own[0] for name, own in views_by_camera(rig.names).items()}
    shared = shared_cameras(config.cameras, list(views))
    target = CameraRig(
        cameras=tuple(_bare(camera.name) for camera in shared),
        rotation=np.array([np.reshape(camera.rotation, (3, 3)) for camera in shared]),
        translation=np.array([camera.translation for camera in shared]),
    )
    order = np.array([views[camera.name] for camera in shared])
    spread = covariance or exact(rig)
    cameras = _SharedCameras(
        rig.select(order), target, replace(spread, matrix=spread.matrix[order][:, :, order])
    )
    fit = cameras.fit(np.ones(len(shared), dtype=bool), config)
    if fit.misfit > config.most_misfit:
        raise _contradicting_cameras(cameras, fit, config)
    away = _describe_distance(fit.distance, target, config.unit)
    remark = (
        f"aligned to {count(len(shared), 'camera')} whose places were given, RMS distance {away}, "
        f"RMS angle {np.degrees(rms(fit.turn)):.1f} deg"
    )
    return fit.by, _scale_sigma(fit.by.apply(cameras.rig.centres), target.centres), remark


@dataclass(frozen=True)
class _SharedCameras:
    """Cameras of a rig, its covariance, and the same ones as a file places them."""

    rig: CameraRig
    target: CameraRig
    covariance: RigCovariance

    def fit(self, some: Bools, config: WorldConfig) -> Fit:
        """Return the fit of the cameras that a mask leaves."""
        left = np.flatnonzero(some)
        matrix = self.covariance.matrix[left][:, :, left]
        spread = replace(self.covariance, matrix=matrix)
        return fit_cameras(self.rig.select(left), self.target.select(left), spread, config)

    def are_mirrored(self, config: WorldConfig) -> bool:
        """Return whether the places of the file are those of a mirror image."""
        sigma = self.covariance.size * self.covariance.centre_sigma
        measured = replace(config, landmark_sigma=config.camera_sigma)
        return is_mirrored(self.rig.centres, self.target.centres, sigma, measured)


def _contradicting_cameras(cameras: _SharedCameras, fit: Fit, config: WorldConfig) -> MismatchError:
    """Return the refusal of a file that places cameras elsewhere than they are seen to be."""
    names, target = cameras.target.names, cameras.target
    if cameras.are_mirrored(config):
        return MismatchError(
            "--world: expected cameras in right-handed axes, found that the mirror image of their "
            "places fits the recording; exchange two axes of the file, or turn one round"
        )
    odd = (
        leave_one_out(lambda some: cameras.fit(some, config), len(names))
        if len(names) > 2
        else None
    )
    worst = int(np.argmax(fit.off))
    said = "correct the file"
    if odd is not None and odd[1].misfit <= config.most_misfit:
        worst, said = odd[0], f"correct or leave out {names[odd[0]]}, without which the others fit"
    away = _describe_distance(fit.distance, target, config.unit)
    return MismatchError(
        "--world: expected cameras where the recording shows them, found them "
        f"{away} and {np.degrees(rms(fit.turn)):.0f} deg from there (RMS), most of all "
        f"{names[worst]}; {said}"
    )


def _describe_distance(distance: Floats, target: CameraRig, unit: str) -> str:
    """Return the RMS of distances in words: in millimetres, or in percent of a rig's size."""
    if unit in METRES:
        return f"{1e3 * METRES[unit] * rms(distance):.0f} mm"
    return f"{100 * rms(distance) / rig_size(target):.1f} % of the rig's size"


def shared_cameras(known: Sequence[KnownCamera], names: Sequence[str]) -> list[KnownCamera]:
    """Return the known cameras that have one of these names.

    Raises MismatchError where they are fewer than two.
    """
    shared = [camera for camera in known if camera.name in names]
    if len(shared) < 2:
        found = ", ".join(camera.name for camera in shared) or "none"
        raise MismatchError(
            "--world: expected a file with at least two cameras of the recording "
            f"({', '.join(names)}), found {found}; check their names"
        )
    if all(_same_place(camera, shared[0]) for camera in shared):
        raise MismatchError(
            "--world: expected a file whose cameras are in different places, found "
            f"{', '.join(camera.name for camera in shared)} in one; give another"
        )
    return shared


def _same_place(a: KnownCamera, b: KnownCamera) -> bool:
    """Return whether two cameras have the same centre, to the digits that a file may have."""
    first, second = (-np.reshape(each.rotation, (3, 3)).T @ each.translation for each in (a, b))
    return bool(np.abs(first - second).max() <= 1e-9 * np.abs(first).max())


def check_landmarks(
    landmarks: Sequence[Landmark], cameras: Sequence[str], config: WorldConfig
) -> None:
    """Hold landmarks to the cameras of a recording, before it is calibrated.

    Raises MismatchError for unknown cameras, and landmarks that are too few or on a line.
    """
    strangers = {each.camera for each in landmarks} - set(cameras)
    if strangers:
        raise MismatchError(
            f"--align: expected cameras of the recording ({', '.join(cameras)}), "
            f"found {min(strangers)!r}; {suggest(min(strangers), cameras)}"
        )
    seen = Counter(each.name for each in landmarks)
    places = {each.name: each.position for each in landmarks if seen[each.name] >= 2}
    _check_number(len(places), len(seen), config)
    _check_extent(np.array(list(places.values())), "stated", config)


def align_to_landmarks(
    rig: CameraRig,
    landmarks: Sequence[Landmark],
    config: WorldConfig,
    covariance: RigCovariance | None = None,
) -> tuple[Similarity, float, tuple[MeasuredLandmark, ...]]:
    """Return the similarity to the world of landmarks, and its relative error of scale.

    The landmarks are triangulated. Returned is also how far each is from where it should be.

    covariance: of the rig; None: it is exact.

    Raises MismatchError for unknown cameras, landmarks that are too few or on a line, and those
    that are elsewhere than noise can explain.
    """
    names, known, pixels = _collect(rig, landmarks)
    found, _ = triangulate_pixels(rig, pixels, np.ones(pixels.shape[:-1]))
    seen = np.isfinite(found[:, 0])
    _check_number(int(seen.sum()), len(names), config)
    for points, where in ((known[seen], "stated"), (found[seen], "seen")):
        _check_extent(points, where, config)
    sigma = point_sigmas(
        rig, found[seen], np.isfinite(pixels[:, seen, 0]), covariance or exact(rig), config
    )
    fit = fit_points(found[seen], known[seen], sigma, config)
    if fit.misfit > config.most_misfit:
        used = [one_line(name) for name, there in zip(names, seen, strict=True) if there]
        raise _contradicting_landmarks(used, (found[seen], known[seen], sigma), fit, config)
    away = np.linalg.norm(fit.by.apply(found) - known, axis=1)
    measured = (
        MeasuredLandmark(name, float(distance)) for name, distance in zip(names, away, strict=True)
    )
    return fit.by, _scale_sigma(fit.by.apply(found[seen]), known[seen]), tuple(measured)


def _contradicting_landmarks(
    names: Sequence[str], places: tuple[Floats, Floats, Floats], fit: Fit, config: WorldConfig
) -> MismatchError:
    """Return the refusal of landmarks that are elsewhere than they are seen to be.

    places: found and stated `[N, 3]`, and standard deviations `[N]` of the former.
    """
    found, known, sigma = places
    if is_mirrored(found, known, sigma, config):
        return MismatchError(
            "--align: expected landmarks in right-handed axes, found that their mirror image fits "
            "what cameras see; exchange two axes of the file, or turn one round"
        )

    def fit_some(some: Bools) -> Fit:
        return fit_points(found[some], known[some], sigma[some], config)

    enough = len(names) > config.least_landmarks
    odd = leave_one_out(fit_some, len(names)) if enough else None
    worst, said = int(np.argmax(fit.distance)), "correct their places or pixels"
    if odd is not None and odd[1].misfit <= config.most_misfit:
        worst, said = odd[0], f"correct or leave out {names[odd[0]]}, without which the others fit"
    return MismatchError(
        "--align: expected landmarks that are where cameras see them, found them "
        f"{1e3 * rms(fit.distance):.0f} mm from there (RMS), most of all {names[worst]}; {said}"
    )


def describe_alignment(landmarks: Sequence[MeasuredLandmark]) -> str:
    """Return how well landmarks are where they should be, in words."""
    away = np.array([each.distance for each in landmarks])
    away = away[np.isfinite(away)]
    return f"aligned to {count(len(away), 'landmark')}, RMS distance {1e3 * rms(away):.0f} mm"


def _collect(
    rig: CameraRig, landmarks: Sequence[Landmark]
) -> tuple[tuple[str, ...], Floats, Floats]:
    """Return names and places `[landmark, 3]`, and pixels `[view, landmark, 2]`, NaN = not seen.

    A landmark is seen by the first of the views that a camera is. Raises MismatchError.
    """
    views = {name: own[0] for name, own in views_by_camera(rig.names).items()}
    seen: dict[str, list[Landmark]] = defaultdict(list)
    for landmark in landmarks:
        seen[landmark.name].append(landmark)
    known = np.array([own[0].position for own in seen.values()]).reshape(-1, 3)
    pixels = np.full((len(rig), len(seen), 2), np.nan)
    for k, own in enumerate(seen.values()):
        for landmark in own:
            if landmark.camera in views:
                pixels[views[landmark.camera], k] = landmark.pixel
    return tuple(seen), known, pixels


def _check_number(seen: int, all: int, config: WorldConfig) -> None:
    """Raise MismatchError where too few landmarks are seen by two cameras."""
    if seen < config.least_landmarks:
        raise MismatchError(
            f"--align: expected {config.least_landmarks} landmarks that two cameras see, "
            f"found {seen} of {all}; add observations"
        )


def _check_extent(points: Floats, where: str, config: WorldConfig) -> None:
    """Raise MismatchError where points lie on a line, which leaves the turn about it open."""
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if extent[1] <= config.least_extent * extent[0]:
        raise MismatchError(
            f"--align: expected landmarks that are not on a line, found that those {where} are; "
            "add one beside it"
        )


def _scale_sigma(found: Floats, true: Floats) -> float:
    """Return the relative standard deviation of a scale from points that were aligned."""
    size = np.sqrt(((true - true.mean(0)) ** 2).sum())
    free = max(3 * len(true) - 7, 1)
    return float(np.sqrt(((found - true) ** 2).sum() / free) / size)


def _bare(name: str) -> Camera:
    return Camera(name, (0, 0), np.eye(3))
