"""Match keypoint files to cameras, assume cameras for them, and match keypoint names.

Keypoints of different files are matched to each other by what their names mean.
"""

import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    DEFAULT_FOCAL,
    LARGEST_SHARE,
    REFINEMENTS,
    IntrinsicsConfig,
    Refinement,
)
from mocap_calib.errors import MismatchError, argument, count, quote_for_shell, visible
from mocap_calib.recording.far_points import largest_size, without_far_points
from mocap_calib.recording.joints import match_names, normalise_name
from mocap_calib.types import AssumedCamera, Camera, Keypoints2D, Skeleton

_UNKNOWN_SIZE = (0, 0)


def pair_with_cameras(
    views: Sequence[Keypoints2D], cameras: Sequence[Camera]
) -> tuple[tuple[Keypoints2D, ...], tuple[Camera, ...]]:
    """Return the views with detections in the order of the cameras, and their cameras.

    Cameras without an image size take that of their file. Points that lie far outside of images
    are missing, see `count_far_points`.

    Raises MismatchError as `match_cameras` does, and for fewer than two cameras with detections.
    """
    view_of = dict(zip(match_cameras(views, cameras), views, strict=True))
    pairs = [
        (view_of[camera.name], camera)
        for camera in cameras
        if camera.name in view_of and _has_detections(view_of[camera.name])
    ]
    if len(pairs) < 2:
        found = ", ".join(camera.name for _, camera in pairs) or "none"
        raise MismatchError(
            "",
            "detections of two cameras or more",
            f"those of {len(pairs)} ({found})",
            "add the other keypoint files",
        )
    fitted = list(map_in_threads(lambda pair: _fit_to_image(*pair), pairs))
    return tuple(view for view, _ in fitted), tuple(camera for _, camera in fitted)


def compose_name(name: str) -> str:
    """Return a name in Unicode's normal form NFC, in which names are compared.

    macOS decomposes the names of files: `é` becomes `e` and a combining accent. Control characters
    are escaped: terminals and tables would obey them.
    """
    return visible(unicodedata.normalize("NFC", name))


def match_cameras(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[str, ...]:
    """Return the name of the camera that each view belongs to, as `find_names` finds it.

    Raises MismatchError for keypoints without a camera, and for two files of one camera.
    """
    known = [camera.name for camera in cameras]
    found = find_names([view.camera for view in views], known)
    if any(len(names) != 1 for names in found):
        listed = ", ".join(view.camera for view in views) or "none"
        raise MismatchError(
            "",
            "a camera of the same name for each keypoint file",
            f"keypoints of {listed} and cameras {', '.join(known) or 'none'}",
            _naming_remedy(views, known),
        )
    matched = tuple(name for names in found for name in names)
    _check_one_file_each(views, matched)
    return matched


def find_names(given: Sequence[str], known: Sequence[str]) -> list[list[str]]:
    """Return the known names that each given name may mean, one where it is certain.

    That is the name itself, else the name of the same letters and digits (`cam01`, `Cam_01`). Where
    some given name is like none, it is for all of them the known one that lies where they differ
    from each other (`10374` in `Video110374DLC`, `Video110376DLC`), the longest of these.
    """
    alike = [
        [name]
        if name in known
        else [each for each in known if _fold_name(each) == _fold_name(name)]
        for name in given
    ]
    if all(len(names) == 1 for names in alike):
        return alike
    folded = [_fold_name(name) for name in given]
    first, last = (
        len(os.path.commonprefix(names)) if len(given) > 1 else 0  # noqa: RUF071 - of letters
        for names in (folded, [name[::-1] for name in folded])
    )
    taken = {name for names in alike for name in names}
    free = [name for name in known if name not in taken]
    return [
        names or _names_within(name, free, first, len(name) - last)
        for name, names in zip(folded, alike, strict=True)
    ]


def _names_within(name: str, known: Sequence[str], start: int, end: int) -> list[str]:
    """Return the longest known names in a folded name that have a part from start to end.

    Of numbers all digits that follow count: `cam1` is not in `cam10`.
    """
    found: dict[int, list[str]] = {}
    for each in known:
        part = _fold_name(each)
        following = r"(?!\d)" if part[-1:].isdigit() else ""
        places = (place.span() for place in re.finditer(re.escape(part) + following, name))
        if part and any(low < max(end, start + 1) and high > start for low, high in places):
            found.setdefault(len(part), []).append(each)
    return found[max(found)] if found else []


def describe_names(views: Sequence[Keypoints2D], matched: Sequence[str]) -> str:
    """Return a line that says that cameras were found in longer names, "" where they were not."""
    for view, name in zip(views, matched, strict=True):
        if _fold_name(view.camera) != _fold_name(name):
            return f"cameras are found where the names of files differ: {name} in {view.camera}"
    return ""


def _naming_remedy(views: Sequence[Keypoints2D], known: Sequence[str]) -> str:
    """Return how to name the cameras of files whose own names match none.

    Where each path, or each name in one file, contains the name of one camera, that is the option
    that finds these names.
    """
    if not views or not known:
        return "rename one side"
    in_one_file = len({view.source for view in views}) < len(views)
    texts = [view.camera if in_one_file else view.source for view in views]
    pattern = "|".join(sorted(map(re.escape, known), key=len, reverse=True))
    named = [set(re.findall(pattern, text)) for text in texts]
    cameras = {name for names in named for name in names}
    if all(len(names) == 1 for names in named) and len(cameras) == len(views):
        return f"use {argument('camera_regex', pattern)}, which finds these names in the paths"
    if in_one_file:
        return "rename the cameras of the intrinsics as the keypoints have them"
    like = {_fold_name(name) for name in known}
    nameless = next((view for view in views if _fold_name(view.camera) not in like), views[0])
    taken = {_fold_name(view.camera) for view in views}
    camera = next((name for name in known if _fold_name(name) not in taken), known[0])
    return (
        f"give files with their cameras, as {quote_for_shell(f'{camera}={nameless.source}')}, or "
        f"use {argument('camera_regex')} to find the camera names in the paths, or rename one side"
    )


def views_named(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[Keypoints2D, ...]:
    """Return the views whose name is one of the cameras', as `match_cameras` compares them."""
    found = find_names([view.camera for view in views], [camera.name for camera in cameras])
    return tuple(view for view, names in zip(views, found, strict=True) if len(names) == 1)


def views_with_detections(views: Sequence[Keypoints2D]) -> tuple[Keypoints2D, ...]:
    """Return the views with detections; the others are left out of a recording."""
    return tuple(view for view in views if _has_detections(view))


def check_pixels(view: Keypoints2D) -> None:
    """Raise MismatchError where the positions are normalised by the image size."""
    highest = np.nanmax(view.positions, initial=0.0)
    lowest = np.nanmin(view.positions, initial=0.0)
    mapped.let_go()
    if 0 < max(highest, -lowest) <= LARGEST_SHARE:
        raise MismatchError(
            view.source,
            "positions in pixels",
            f"none above {LARGEST_SHARE}",
            f"use {argument('image_size', 'WIDTHxHEIGHT')} if they are shares of the image",
        )


def _fit_to_image(view: Keypoints2D, camera: Camera) -> tuple[Keypoints2D, Camera]:
    """Return the view without points far outside of its images, and its camera with their size.

    Raises MismatchError as `_take_image_size` does.
    """
    cleared = without_far_points(view, largest_size(view, camera))
    return cleared, _take_image_size(cleared, camera)


def _check_one_file_each(views: Sequence[Keypoints2D], matched: Sequence[str]) -> None:
    """Raise MismatchError where two views belong to one camera, whose name `matched` has."""
    sources: dict[str, list[str]] = {}
    for view, name in zip(views, matched, strict=True):
        sources.setdefault(name, []).append(view.source)
    for name, files in sources.items():
        if len(files) > 1:
            raise MismatchError(
                "",
                "one keypoint file per camera",
                f"{' and '.join(files[:2])} for camera {name}",
                "give the files of one recording alone, remove or rename one",
            )


def _has_detections(view: Keypoints2D) -> bool:
    """Return whether the view has any detection."""
    blocks = mapped.frame_slices(len(view.frames))
    return any(np.isfinite(view.positions[block]).any() for block in blocks)


def _take_image_size(view: Keypoints2D, camera: Camera) -> Camera:
    """Return the camera, with the image size of its keypoint file if it has none.

    Raises MismatchError where the positions are not in pixels.
    """
    check_pixels(view)
    return replace(camera, size=view.image_size) if camera.size == _UNKNOWN_SIZE else camera


def _fold_name(name: str) -> str:
    """Return the letters and digits of a name, in small letters."""
    return "".join(letter for letter in compose_name(name).casefold() if letter.isalnum())


_LISTED = 12  # names in a message


def keypoint_meanings(
    views: Sequence[Keypoints2D], skeleton: Skeleton, aliases: Mapping[str, str]
) -> dict[str, str]:
    """Return the meaning of each keypoint name: a joint of the skeleton, else the name itself.

    Meanings are normalised names. Two names of one file with the same meaning (`thorax` and `neck`,
    `l_ear` and `LeftEar`) are ambiguous: each means only itself, in all files.

    aliases: own name -> joint.
    """
    meanings: dict[str, str] = {}
    ambiguous: dict[str, str] = {}
    for view in views:
        taken: set[str] = set()
        view_meanings = _view_meanings(view.keypoints, skeleton, aliases)
        for name, meaning in zip(view.keypoints, view_meanings, strict=True):
            if meaning in taken or meanings.get(name, meaning) != meaning:
                # normalised names have neither capitals nor `=`: these cannot meet another
                ambiguous[name] = f"={name}"
            else:
                meanings[name] = meaning
            taken.add(meaning)
    return meanings | ambiguous


def shared_keypoints(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> dict[str, str]:
    """Return the meanings that at least two views share, with the name in the first of them.

    Raises MismatchError where there are none.
    """
    names = _names_by_camera(views, meanings)
    shared = {each: next(iter(of.values())) for each, of in names.items() if len(of) >= 2}
    if not shared:
        listed = "; ".join(
            f"{view.camera}: {', '.join(view.keypoints[:_LISTED])}" for view in views
        )
        raise MismatchError(
            "",
            "keypoint names that two cameras share",
            listed,
            f"rename them, or map them with {argument('skeleton')}",
        )
    return shared


def unshared_keypoints(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> dict[str, str]:
    """Return the keypoints that only one view has, with the name of its camera.

    meanings: as `keypoint_meanings` returns them.
    """
    names = _names_by_camera(views, meanings).values()
    return {name: camera for of in names if len(of) == 1 for camera, name in of.items()}


def _names_by_camera(
    views: Sequence[Keypoints2D], meanings: Mapping[str, str]
) -> dict[str, dict[str, str]]:
    """Return the name that each meaning has in the view of each camera that has it."""
    names: dict[str, dict[str, str]] = {}
    for view in views:
        for name in view.keypoints:
            names.setdefault(meanings[name], {})[view.camera] = name
    return names


def describe_unshared(unshared: Mapping[str, str]) -> str:
    """Return a line on the keypoints that only one view has; the first are listed."""
    named = [f"{name} ({camera})" for name, camera in unshared.items()]
    listed = ", ".join(named[:_LISTED])
    more = ", ..." if len(named) > _LISTED else ""
    return f"not used, named by a single camera: {count(len(named), 'keypoint')}: {listed}{more}"


def _view_meanings(
    names: Sequence[str], skeleton: Skeleton, aliases: Mapping[str, str]
) -> list[str]:
    """Return the meaning of each name of one file; two names may have the same meaning."""
    joints = [normalise_name(joint) for joint in skeleton.keypoints]
    renamed_by = {normalise_name(name): joint for name, joint in aliases.items()}
    renamed = tuple(renamed_by.get(normalise_name(name), name) for name in names)
    return [
        joints[joint] if joint >= 0 else normalise_name(name)
        for name, joint in zip(renamed, match_names(renamed, skeleton), strict=True)
    ]


# --- cameras of which no intrinsics are given

ASSUMED_NOTE = (
    "no intrinsics were given: focal lengths and lenses are estimated together with the rig"
)


def assume_cameras(views: Sequence[Keypoints2D]) -> tuple[AssumedCamera, ...]:
    """Return a camera for each view, with a typical focal length.

    Its principal point is the middle of the image, and it has no distortion.

    Raises MismatchError where the size of the images is not known.
    """
    return tuple(_assume_camera(view) for view in views)


def choose_refinement(
    cameras: Sequence[Camera], config: IntrinsicsConfig, refine: Refinement | None
) -> IntrinsicsConfig:
    """Return the configuration for the estimation of the intrinsics of these cameras.

    refine: None: as in `config`, or focal lengths and lenses where no intrinsics were given.

    Raises MismatchError for an unknown choice, and for one that is impossible for these cameras.
    """
    assumed = any(isinstance(camera, AssumedCamera) for camera in cameras)
    chosen = refine or config.refine
    if refine is None and chosen == "none" and assumed:
        chosen = ASSUMED_REFINEMENT
    if chosen not in REFINEMENTS:
        known = ", ".join(REFINEMENTS)
        raise MismatchError("refine", f"one of {known}", f"{chosen!r}", "choose one")
    if chosen == "none" and assumed:
        raise MismatchError(
            "refine",
            "focal or focal+k1, as nothing is known of the intrinsics",
            "none",
            "give the intrinsics, or leave it out",
        )
    return replace(config, refine=chosen)


def _assume_camera(view: Keypoints2D) -> AssumedCamera:
    """Return the camera of a view. Raises MismatchError where its image size is not known."""
    width, height = view.image_size
    if (width, height) == (0, 0):
        raise MismatchError(
            view.source,
            f"the size of the images of camera {view.camera}, by which its focal length is guessed",
            "none",
            f"use {argument('image_size', f'{view.camera}:WIDTHxHEIGHT')}, or give the intrinsics "
            f"with {argument('cameras')}",
        )
    focal = DEFAULT_FOCAL * max(width, height)
    middle = (width - 1) / 2, (height - 1) / 2
    return AssumedCamera(
        name=view.camera,
        size=(width, height),
        matrix=np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        fisheye=False,
    )
