"""What keypoint names mean, and which of them the views share."""

from collections.abc import Mapping, Sequence

from mocap_calib.errors import MismatchError
from mocap_calib.recording.joints import match_names, normalise_name
from mocap_calib.types import Keypoints2D, Skeleton
from mocap_calib.wording import count

_LISTED_UNSHARED = 6  # names in a message
_LISTED = 12  # names of one file in a message


def keypoint_meanings(
    views: Sequence[Keypoints2D], skeleton: Skeleton, aliases: Mapping[str, str]
) -> dict[str, str]:
    """Return what each keypoint name means: a joint of the skeleton, else the name itself.

    Meanings are normalised names. A name that is not alone in its meaning in one of the files
    (`thorax` beside `neck`, `l_ear` beside `LeftEar`) means only itself, in all files.

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
    """Return the meanings that two views have, each with the name that the first of them gives it.

    Raises MismatchError where there are none.
    """
    first_name: dict[str, str] = {}
    counts: dict[str, int] = {}
    for view in views:
        for name in view.keypoints:
            meaning = meanings[name]
            first_name.setdefault(meaning, name)
            counts[meaning] = counts.get(meaning, 0) + 1
    shared = {meaning: name for meaning, name in first_name.items() if counts[meaning] >= 2}
    if not shared:
        listed = "; ".join(
            f"{view.camera}: {', '.join(view.keypoints[:_LISTED])}" for view in views
        )
        raise MismatchError(
            f"expected keypoint names that two cameras share, found {listed}; "
            "rename them, or map them with --skeleton"
        )
    return shared


def unshared_keypoints(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> dict[str, str]:
    """Return the keypoints that a single view names, each with the name of its camera.

    meanings: of the names, as `keypoint_meanings` returns them.
    """
    cameras: dict[str, set[str]] = {}
    for view in views:
        for name in view.keypoints:
            cameras.setdefault(meanings[name], set()).add(view.camera)
    return {
        name: view.camera
        for view in views
        for name in view.keypoints
        if len(cameras[meanings[name]]) == 1
    }


def describe_unshared(unshared: Mapping[str, str]) -> str:
    """Return a line on the keypoints that a single view names, of which it lists the first."""
    named = [f"{name} ({camera})" for name, camera in unshared.items()]
    listed = ", ".join(named[:_LISTED_UNSHARED])
    more = ", ..." if len(named) > _LISTED_UNSHARED else ""
    return f"not used, named by a single camera: {count(len(named), 'keypoint')}: {listed}{more}"


def _view_meanings(
    names: Sequence[str], skeleton: Skeleton, aliases: Mapping[str, str]
) -> list[str]:
    """Return the meaning of each name of one file, whether it is alone in it or not."""
    joints = [normalise_name(joint) for joint in skeleton.keypoints]
    renamed_by = {normalise_name(name): joint for name, joint in aliases.items()}
    renamed = tuple(renamed_by.get(normalise_name(name), name) for name in names)
    return [
        joints[joint] if joint >= 0 else normalise_name(name)
        for name, joint in zip(renamed, match_names(renamed, skeleton), strict=True)
    ]
