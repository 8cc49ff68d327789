"""Align a rig to a world that is known: by its cameras, or by landmarks that cameras see."""

from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np

from mocap_calib.config import KnownCamera, Landmark, WorldConfig
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.geometry.alignment import align_by_similarity
from mocap_calib.multi_view.evaluation import with_axes
from mocap_calib.recording.epochs import views_by_camera
from mocap_calib.types import Camera, CameraRig, Floats, MeasuredLandmark
from mocap_calib.wording import count
from mocap_calib.world.moving import Similarity


def align_to_cameras(rig: CameraRig, known: Sequence[KnownCamera]) -> tuple[Similarity, float]:
    """Return the similarity to the world of known cameras, and its relative error of scale.

    Raises MismatchError where fewer than two cameras are in both.
    """
    views = {name: own[0] for name, own in views_by_camera(rig.names).items()}
    shared = shared_cameras(known, list(views))
    target = CameraRig(
        cameras=tuple(_bare(camera.name) for camera in shared),
        rotation=np.array([np.reshape(camera.rotation, (3, 3)) for camera in shared]),
        translation=np.array([camera.translation for camera in shared]),
    )
    source = rig.select(np.array([views[camera.name] for camera in shared]))
    by = Similarity(*align_by_similarity(with_axes(source), with_axes(target)))
    return by, _scale_sigma(by.apply(source.centres), target.centres)


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
    rig: CameraRig, landmarks: Sequence[Landmark], config: WorldConfig
) -> tuple[Similarity, float, tuple[MeasuredLandmark, ...]]:
    """Return the similarity to the world of landmarks, and its relative error of scale.

    The landmarks are triangulated. Returned is also how far each is from where it should be.

    Raises MismatchError for unknown cameras, and landmarks that are too few or on a line.
    """
    names, known, pixels = _collect(rig, landmarks)
    found, _ = rig.triangulate(pixels)
    seen = np.isfinite(found[:, 0])
    _check_number(int(seen.sum()), len(names), config)
    for points, where in ((known[seen], "stated"), (found[seen], "seen")):
        _check_extent(points, where, config)
    by = Similarity(*align_by_similarity(found[seen], known[seen]))
    away = np.linalg.norm(by.apply(found) - known, axis=1)
    measured = (
        MeasuredLandmark(name, float(distance)) for name, distance in zip(names, away, strict=True)
    )
    return by, _scale_sigma(by.apply(found[seen]), known[seen]), tuple(measured)


def describe_alignment(landmarks: Sequence[MeasuredLandmark]) -> str:
    """Return how well landmarks are where they should be, in words."""
    away = np.array([each.distance for each in landmarks])
    away = away[np.isfinite(away)]
    rms = float(np.sqrt((away**2).mean()))
    return f"aligned to {count(len(away), 'landmark')}, RMS distance {1e3 * rms:.0f} mm"


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
