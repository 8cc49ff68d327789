"""All cameras on one clock: which file belongs to which camera, which frames and keypoints they share."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.config import ReadConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.projection import rays_from_pixels
from mocap_calib.recording.joints import match_names, normalise_name
from mocap_calib.types import (
    Bools,
    Camera,
    Ints,
    Keypoints2D,
    Reals,
    Recording,
    Skeleton,
)

LEAST_JOINTS = 4  # that show how a body is turned
_CROWD = 0.2  # share of images with several detections; below it they are false ones
_OUTSIDE = 1.5  # detections this many image sizes from the corner were made at another resolution
_BLOCK = 4096  # frames at a time, so that long recordings need no more memory than they hold
_TYPICAL = (
    99.0  # percentile that stands for the largest value, so that one wild point does not count
)


def make_recording(
    views: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
) -> Recording:
    """Joins keypoint files and cameras by name, frames by number, keypoints by meaning.

    Views come in the order of `cameras`; cameras without a keypoint file or without any detection are left out.
    Frames are those that two views have, keypoints those that two views name: a name counts as the joint of the
    `skeleton` that it means, after `aliases` (own name -> joint) were applied. Each view's confidence is scaled to
    0..1 by itself. Raises MismatchError when the files do not belong together.
    """
    owner = {
        id(view): name for view, (_, name) in zip(views, name_mapping(views, cameras), strict=True)
    }
    paired = [
        (view, camera)
        for camera in cameras
        for view in usable(views)
        if owner[id(view)] == camera.name
    ]
    if len(paired) < 2:
        found = ", ".join(camera.name for _, camera in paired) or "none"
        raise MismatchError(
            f"expected detections of two cameras or more, found those of {len(paired)} ({found}); add the other keypoint files"
        )
    kept = [_sized(view, camera) for view, camera in paired]
    views = [view for view, _ in paired]
    frames, keys = _shared_frames(views), meanings(views, skeleton, aliases)
    columns = _shared_keypoints(views, keys)
    shape = (len(views), len(frames), max(view.positions.shape[1] for view in views), len(columns))
    positions, confidence = (
        np.full((*shape, 2), np.nan, dtype=np.float32),
        np.zeros(shape, dtype=np.float32),
    )
    for v, (view, camera) in enumerate(zip(views, kept, strict=True)):
        _put_on_clock(
            view,
            camera,
            frames,
            [keys[name] for name in view.keypoints],
            list(columns),
            positions=positions[v],
            confidence=confidence[v],
        )
    if not ((confidence > 0).any(axis=(2, 3)).sum(axis=0) >= 2).any():
        raise MismatchError(
            "expected frames in which two cameras see the subject, found no co-visible detections; check that the files are of one recording"
        )
    joints = {normalise_name(joint): k for k, joint in enumerate(skeleton.keypoints)}
    vocabulary = np.array([joints.get(key, -1) for key in columns], dtype=np.int64)
    tracked = np.array([view.tracked for view in views])
    return Recording(
        tuple(kept), tuple(columns.values()), frames, positions, confidence, tracked, vocabulary
    )


def name_mapping(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> list[tuple[str, str]]:
    """(source of the keypoints, name of the camera) for each view: by exact name, else regardless of case and of marks (`cam01`, `Cam_01`).

    Raises MismatchError for keypoints without a camera, and for two files of one camera.
    """
    exact = {camera.name for camera in cameras}
    folded = [_folded(camera.name) for camera in cameras]
    pairs: list[tuple[str, str]] = []
    for view in views:
        close = [camera.name for camera in cameras if _folded(camera.name) == _folded(view.camera)]
        if view.camera in exact:
            pairs.append((view.source, view.camera))
        elif folded.count(_folded(view.camera)) == 1:
            pairs.append((view.source, close[0]))
    if len(pairs) < len(views):
        listed = (
            ", ".join(names) or "none"
            for names in ([view.camera for view in views], [camera.name for camera in cameras])
        )
        raise MismatchError(
            "expected a camera of the same name for each keypoint file, found keypoints of {} and cameras {}; rename one side".format(
                *listed
            )
        )
    names = [name for _, name in pairs]
    twice = [source for source, name in pairs if names.count(name) > 1]
    if twice:
        found = f"{' and '.join(twice[:2])} for camera {dict(pairs)[twice[0]]}"
        raise MismatchError(
            f"expected one keypoint file per camera, found {found}; remove or rename one"
        )
    return pairs


def views_named(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[Keypoints2D, ...]:
    """The views whose name is one of the cameras', as `name_mapping` compares them."""
    known = {_folded(camera.name) for camera in cameras}
    return tuple(view for view in views if _folded(view.camera) in known)


def _folded(name: str) -> str:
    """The letters and digits of a name."""
    return "".join(character for character in name.casefold() if character.isalnum())


def usable(views: Sequence[Keypoints2D]) -> tuple[Keypoints2D, ...]:
    """The views that have any detection; the others take no part in a recording."""
    return tuple(view for view in views if np.isfinite(view.positions).any())


def check_pixels(view: Keypoints2D) -> None:
    """Raises MismatchError where the positions are shares of the image."""
    largest = max(np.nanmax(view.positions, initial=0.0), -np.nanmin(view.positions, initial=0.0))
    limit = ReadConfig().largest_share
    if 0 < largest <= limit:
        remedy = "say --image-size WIDTHxHEIGHT if they are shares of the image"
        raise MismatchError(
            f"{view.source}: expected positions in pixels, found none above {limit}; {remedy}"
        )


def _sized(view: Keypoints2D, camera: Camera) -> Camera:
    """The camera, with the image size of the keypoint file where it has none. Raises MismatchError when they differ."""
    remedy = "scale the intrinsics to the images of the keypoints"
    typical = np.nanpercentile(view.positions, _TYPICAL, axis=(0, 1, 2))
    check_pixels(view)
    if (0, 0) in (view.image_size, camera.size):
        if camera.size != (0, 0) and (typical > _OUTSIDE * np.array(camera.size)).any():
            found = f"detections at ({typical[0]:.0f}, {typical[1]:.0f})"
            raise MismatchError(
                f"{view.source}: expected an image of {_by(camera.size)} as camera {camera.name} has, found {found}; {remedy}"
            )
        return replace(camera, size=max(view.image_size, camera.size))
    if view.image_size != camera.size:
        found = _by(view.image_size)
        raise MismatchError(
            f"{view.source}: expected an image of {_by(camera.size)} as camera {camera.name} has, found {found}; {remedy}"
        )
    return camera


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _shared_frames(views: Sequence[Keypoints2D]) -> Ints:
    """`[frame]` numbers that two views have, ascending."""
    numbers, counts = np.unique(np.concatenate([view.frames for view in views]), return_counts=True)
    if not (counts >= 2).any():
        ranges = ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in views)
        raise MismatchError(
            f"expected frames that two cameras have, found the frame numbers {ranges}; number the frames of all cameras on one clock"
        )
    return np.asarray(numbers[counts >= 2], dtype=np.int64)


def meanings(
    views: Sequence[Keypoints2D], skeleton: Skeleton, aliases: Mapping[str, str]
) -> dict[str, str]:
    """Name -> what each keypoint name means: a joint of the skeleton, else the name itself; both normalised.

    A name that is not alone in its meaning in one of the files (`thorax` beside `neck`, `l_ear` beside `LeftEar`)
    means only itself, in all files.
    """
    joints = [normalise_name(joint) for joint in skeleton.keypoints]
    renamed = {normalise_name(name): joint for name, joint in aliases.items()}
    keys: dict[str, str] = {}
    twins: set[str] = set()
    for view in views:
        names = tuple(renamed.get(normalise_name(name), name) for name in view.keypoints)
        taken: set[str] = set()
        for name, meant, joint in zip(
            view.keypoints, names, match_names(names, skeleton), strict=True
        ):
            key = joints[joint] if joint >= 0 else normalise_name(meant)
            if key in taken or keys.setdefault(name, key) != key:
                twins.add(name)
            taken.add(key)
    # normalised names have neither capitals nor `=`, so that these cannot meet another
    return keys | {name: f"={name}" for name in twins}


def _shared_keypoints(views: Sequence[Keypoints2D], keys: Mapping[str, str]) -> dict[str, str]:
    """The meanings that two views have, each with the name that the first of them gives it."""
    meanings = [keys[name] for view in views for name in view.keypoints]
    names = {keys[name]: name for view in reversed(views) for name in view.keypoints}
    shared = {key: names[key] for key in dict.fromkeys(meanings) if meanings.count(key) >= 2}
    if not shared:
        listed = "; ".join(f"{view.camera}: {', '.join(view.keypoints[:12])}" for view in views)
        raise MismatchError(
            f"expected keypoint names that two cameras share, found {listed}; rename them, or map them with --skeleton"
        )
    return shared


def check_shared(keypoints: Sequence[str]) -> None:
    """Raises MismatchError where two views have too few keypoints in common for a calibration."""
    if len(keypoints) < LEAST_JOINTS:
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joints that two views have in common, found {', '.join(keypoints)}; detect more"
        )


def check_joints(recording: Recording) -> None:
    """Raises MismatchError where there are too few keypoints, or where a crowd asks for a model and it knows too few of them."""
    check_shared(recording.keypoints)
    known = int((recording.vocabulary >= 0).sum())
    crowded = (recording.seen.any(-1).sum(-1) > 1).mean() > _CROWD
    if known < LEAST_JOINTS and crowded and not recording.tracked.all():
        names = ", ".join(recording.keypoints)
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joint names that the model knows, found {known} among {names}; map them with --skeleton"
        )


def _put_on_clock(
    view: Keypoints2D,
    camera: Camera,
    frames: Ints,
    keys: Sequence[str],
    columns: Sequence[str],
    *,
    positions: Reals,
    confidence: Reals,
) -> None:
    """Fills `[frame, instance, keypoint, 2]` positions and `[frame, instance, keypoint]` confidences in the shared order.

    What the lens model cannot undo is no detection.
    """
    there = [k for k, key in enumerate(keys) if key in columns]
    order = np.array([columns.index(keys[k]) for k in there], dtype=np.int64)
    instances = np.arange(view.positions.shape[1])
    most = _most(view.confidence)
    known = np.flatnonzero(np.isin(view.frames, frames))
    for start in range(0, len(known), _BLOCK):
        block = known[start : start + _BLOCK]
        place = np.ix_(np.searchsorted(frames, view.frames[block]), instances, order)
        seen = view.positions[block][:, :, there].astype(np.float32)
        blind: Bools = np.asarray(~np.isfinite(rays_from_pixels(camera, seen)).all(axis=-1))
        positions[place] = np.where(blind[..., None], np.nan, seen)
        confidence[place] = np.where(
            blind, 0.0, (view.confidence[block][:, :, there] / most).clip(0.0, 1.0)
        )


def _most(confidence: Reals) -> float:
    """What confidences are divided by: detectors that go beyond 1 by what they typically reach, others by 1."""
    return (
        float(np.percentile(confidence[confidence > 0], _TYPICAL))
        if confidence.max(initial=0.0) > 1.0
        else 1.0
    )
