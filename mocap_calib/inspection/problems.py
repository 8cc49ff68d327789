"""What stands in the way of a run, each with its remedy."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mocap_calib.config import LEAST_JOINTS, TYPICAL_PERCENTILE, SampleConfig
from mocap_calib.errors import MismatchError, argument, count, spell_as_option
from mocap_calib.inspection.contents import seen_points
from mocap_calib.inspection.finding import Finding, InspectConfig, critical, warning
from mocap_calib.inspection.view_pairs import find_clock_problems, find_poor_views
from mocap_calib.recording.joints import SHIPPED
from mocap_calib.recording.names import (
    check_pixels,
    describe_unshared,
    keypoint_meanings,
    match_cameras,
    unshared_keypoints,
)
from mocap_calib.recording.sampling import (
    check_joints,
    check_shared_keypoints,
    choose_sample_frames,
)
from mocap_calib.recording.synchronise import (
    find_copies,
    find_repeated,
    largest_confidence,
    make_recording,
)
from mocap_calib.types import Camera, Keypoints2D, Skeleton

_LISTED = 6  # names in one message


def find_problems(
    views: Sequence[Keypoints2D],
    report: Mapping[str, Any],
    *,
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    config: InspectConfig,
) -> tuple[Finding, ...]:
    """Return what stands in the way of a run, the critical first.

    report: what `inspect_views` says of the views.
    cameras: may be none; then what needs them is not looked at.
    aliases: own name -> joint of the skeleton.
    """
    usable = [view for view in views if seen_points(view).any()]
    meanings = keypoint_meanings(usable, skeleton, aliases)
    found = [
        *_find_empty_views(views),
        *_find_too_few_views(usable),
        *_find_other_scales(usable, config),
        *find_clock_problems(usable, report["pairs"], config),
        *_find_still_subjects(usable, report["cameras"], config),
        *find_poor_views(usable, report["pairs"], meanings, config),
        *_find_name_problems(usable, meanings, known_joints=report["model"]["knows"]),
        *_find_copies(usable, meanings, config),
        *(finding for view in views for finding in _find_weaknesses(view, config)),
    ]
    if cameras and not any(finding.critical for finding in found):
        found += _find_camera_problems(views, cameras, skeleton, aliases)
    return tuple(sorted(found, key=lambda finding: not finding.critical))


# --- views


def _find_empty_views(views: Sequence[Keypoints2D]) -> list[Finding]:
    """Name the views without any point."""
    return [
        warning(
            f"{view.camera}: no valid point in {view.source}; it will be left out: "
            "check the detector's output"
        )
        for view in views
        if not seen_points(view).any()
    ]


def _find_too_few_views(usable: Sequence[Keypoints2D]) -> list[Finding]:
    """Say that two cameras are needed, where fewer have detections."""
    if len(usable) >= 2:
        return []
    names = ", ".join(view.camera for view in usable) or "none"
    return [
        critical(
            "expected detections of two cameras or more, "
            f"found those of {len(usable)} ({names}); add the other keypoint files"
        )
    ]


def _find_copies(
    usable: Sequence[Keypoints2D], meanings: Mapping[str, str], config: InspectConfig
) -> list[Finding]:
    """Name the pairs of cameras with the same detections."""
    return [
        critical(f"{says}; give each camera its own file")
        for says in find_copies(usable, meanings, least=config.copied)
    ]


def _find_still_subjects(
    usable: Sequence[Keypoints2D], cameras: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Say that hardly anything moves, where that is so. cameras: of the report."""
    names = {view.camera for view in usable}
    motion = [each["motion"] for each in cameras if each["name"] in names]
    known = [value for value in motion if value is not None]
    if not known or np.median(known) >= config.least_motion:
        return []
    return [
        warning(
            f"hardly anything moves: between frames bodies are {np.median(known):.0%} of their "
            f"size apart, expected {config.least_motion:.0%} or more; still subjects do not "
            "determine where cameras stand: let somebody walk about and turn"
        )
    ]


# --- positions and scores


def _find_other_scales(usable: Sequence[Keypoints2D], config: InspectConfig) -> list[Finding]:
    """Name the views whose positions are no pixels, or those of another image."""
    found = []
    for view in usable:
        try:
            check_pixels(view)
        except MismatchError as error:
            found.append(critical(error.render(spell_as_option)))
            continue
        width, height = view.image_size
        points = np.abs(view.positions[seen_points(view)])
        outside = float((points > (width, height)).any(-1).mean())
        if width and outside > config.outside:
            found.append(
                warning(
                    f"{view.camera}: {outside:.0%} of the points lie outside its image of {width} "
                    f"x {height}; check its size, or say {argument('crop_offset')}"
                )
            )
    return found


def _find_weaknesses(view: Keypoints2D, config: InspectConfig) -> Iterator[Finding]:
    """Yield what makes the detections of a view worth less."""
    scores = view.confidence[seen_points(view)]
    if not len(scores):
        return
    twice = int(find_repeated(view.positions).sum())
    if twice:
        yield warning(
            f"{view.camera}: {twice} of {seen_points(view).any(-1).sum()} detections repeat "
            "another one of their frame, so they will be left out; "
            "check whether the detector, or a conversion, wrote bodies twice"
        )
    if np.median(scores) < config.low_confidence:
        yield warning(
            f"{view.camera}: half of the scores are below {config.low_confidence}; "
            "check the detector's output"
        )
    if scores.max() > 1.0:
        yield warning(_describe_large_scores(view, float(scores.max())))
    skipped = int((np.diff(view.frames) - 1).sum())
    if skipped > config.gaps * (skipped + len(view.frames)):
        yield warning(
            f"{view.camera}: missing between the first frame and the last: "
            f"{count(skipped, 'frame number')}; check that no frames were lost"
        )


def _describe_large_scores(view: Keypoints2D, largest: float) -> str:
    """Say what becomes of the scores of a view of which some are above 1.

    largest: of the scores.
    """
    excess = f"{largest:.2f}" if largest >= 1.01 else f"1 + {largest - 1:.0e}"
    return (
        f"{view.camera}: some scores are above 1 (up to {excess}), so all will be divided by "
        f"{largest_confidence(view.confidence):.3g}, the {TYPICAL_PERCENTILE:.0f}th percentile, "
        "and cut off at 1; nothing to do if the detector writes such"
    )


# --- names of keypoints


def _find_name_problems(
    usable: Sequence[Keypoints2D], meanings: Mapping[str, str], *, known_joints: int
) -> list[Finding]:
    """Name the keypoints that do not go together, and say if no model knows enough of them.

    known_joints: how many of its joints the model of the report has among the keypoints.
    """
    if len(usable) < 2:
        return []
    remedy = (
        f"give them one name in all files, or map them with {argument('skeleton')} where they are "
        "joints of a model (docs/skeletons.md)"
    )
    unshared = unshared_keypoints(usable, meanings)
    shared = _shared_names(usable, meanings, unshared)
    if not shared:
        listed = "; ".join(
            f"{view.camera}: {', '.join(view.keypoints[:_LISTED])}, ..." for view in usable
        )
        return [critical(f"no two cameras share a keypoint name ({listed}); {remedy}")]
    found = [warning(f"{describe_unshared(unshared)}; {remedy}")] if unshared else []
    try:
        check_shared_keypoints(shared)
    except MismatchError as error:
        return [critical(error.render(spell_as_option)), *found]
    if known_joints < LEAST_JOINTS:
        found.append(
            warning(
                f"the models ({', '.join(SHIPPED)}) know {known_joints} of the joints: calibrated "
                "by geometry alone; map those that are joints of a model with "
                f"{argument('skeleton')} (docs/skeletons.md)"
            )
        )
    return found


def _shared_names(
    usable: Sequence[Keypoints2D], meanings: Mapping[str, str], unshared: Mapping[str, str]
) -> list[str]:
    """Return a name of each keypoint that two views name, as the first of them does."""
    first_name: dict[str, str] = {}
    for view in usable:
        for name in view.keypoints:
            if name not in unshared:
                first_name.setdefault(meanings[name], name)
    return list(first_name.values())


# --- keypoints and cameras together


def _find_camera_problems(
    views: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
) -> list[Finding]:
    """Say what a run would say of the keypoints and the cameras together."""
    try:
        recording = make_recording(views, cameras, skeleton, aliases)
        sample_frames = choose_sample_frames(recording, SampleConfig())
        check_joints(recording.select(frames=sample_frames))
    except MismatchError as error:
        return [critical(error.render(spell_as_option))]
    matched = match_cameras(views, cameras)
    idle = [camera.name for camera in cameras if camera.name not in matched]
    if not idle:
        return []
    return [
        warning(
            f"{', '.join(idle)}: no keypoints for these cameras; "
            "add their files, or go on without them"
        )
    ]
