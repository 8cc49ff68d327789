"""What stands in the way of a run, each with its remedy."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mocap_calib.config import LEAST_JOINTS, TYPICAL_PERCENTILE, SampleConfig
from mocap_calib.errors import (
    MismatchError,
    argument,
    count,
    spell_arguments,
    spell_as_option,
)
from mocap_calib.faults.hypotheses import describe_corrected
from mocap_calib.inspection.contents import InspectConfig, fill_image_sizes, seen_points
from mocap_calib.inspection.view_pairs import compare_views
from mocap_calib.recording.image_sizes import join_sized
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
    evenly_spaced,
)
from mocap_calib.recording.synchronise import (
    find_copies,
    find_repeated,
    largest_confidence,
)
from mocap_calib.results import Mend
from mocap_calib.types import Camera, Keypoints2D, Recording, Skeleton

_LISTED = 6  # names in one message
_Views = Sequence[Keypoints2D]
_Pairs = Sequence[Mapping[str, Any]]  # of the report


@dataclass(frozen=True)
class Finding:
    """Something that stands in the way.

    critical: a run could not work; else its result may be worse than it could be.
    message: one line, with the remedy.
    """

    critical: bool
    message: str


def _critical(message: str) -> Finding:
    """Return a finding without whose remedy a run could not work."""
    return Finding(critical=True, message=spell_arguments(message, spell_as_option))


def _warning(message: str) -> Finding:
    """Return a finding that a run survives."""
    return Finding(critical=False, message=spell_arguments(message, spell_as_option))


def find_problems(
    views: Sequence[Keypoints2D],
    report: Mapping[str, Any],
    *,
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    config: InspectConfig,
    mends: Sequence[Mend] = (),
    cropped: AbstractSet[str] = frozenset(),
) -> tuple[Finding, ...]:
    """Return what stands in the way of a run, the critical first.

    report: what `inspect_views` says of the views.
    cameras: may be none; then what needs them is not looked at.
    aliases: own name -> joint of the skeleton.
    mends, cropped: what is stated of the images, see `join_sized`.
    """
    usable = [view for view in views if seen_points(view).any()]
    names = {view.camera for view in usable}
    pairs = [pair for pair in report["pairs"] if _names(pair) <= names]
    meanings = keypoint_meanings(usable, skeleton, aliases)
    found = [
        *_find_missing_views(views, usable),
        *_find_other_scales(usable, config),
        *(each for view in fill_image_sizes(usable, cameras) for each in _find_corner(view)),
        *_find_clock_problems(usable, pairs, config),
        *_find_still_subjects(usable, report["cameras"], config),
        *_find_poor_views(usable, pairs, meanings, config),
        *_find_name_problems(usable, meanings, known_joints=report["model"]["knows"]),
        *(
            _critical(f"{says}; give each camera its own file")
            for says in find_copies(usable, meanings, least=config.copied)
        ),
        *(finding for view in usable for finding in _find_weaknesses(view, config)),
    ]
    if cameras and not any(finding.critical for finding in found):
        join = partial(join_sized, mends=mends, cropped=cropped)
        found += _find_camera_problems(views, cameras, skeleton, aliases, join)
    return tuple(sorted(found, key=lambda finding: not finding.critical))


# --- views


def _find_missing_views(views: _Views, usable: _Views) -> Iterator[Finding]:
    """Name the views without any point, and say that two are needed where fewer have any."""
    for view in views:
        if view not in usable:
            yield _warning(
                f"{view.camera}: no valid point in {view.source}; it will be left out: "
                "check the detector's output"
            )
    if len(usable) < 2:
        names = ", ".join(view.camera for view in usable) or "none"
        yield _critical(
            "expected detections of two cameras or more, "
            f"found those of {len(usable)} ({names}); add the other keypoint files"
        )


def _find_still_subjects(
    usable: _Views, cameras: _Pairs, config: InspectConfig
) -> Iterator[Finding]:
    """Return a finding where little moves. cameras: of the report."""
    names = {view.camera for view in usable}
    known = [
        each["motion"] for each in cameras if each["name"] in names and each["motion"] is not None
    ]
    if known and np.median(known) < config.least_motion:
        yield _warning(
            f"little moves: between frames bodies are {np.median(known):.0%} of their "
            f"size apart, expected {config.least_motion:.0%} or more; still subjects do not "
            "determine where cameras stand: let somebody walk about and turn"
        )


# --- frame numbers


def _find_clock_problems(usable: _Views, pairs: _Pairs, config: InspectConfig) -> Iterator[Finding]:
    """Name the frame numbers that do not go together."""
    if not pairs:
        return
    most = {
        view.camera: max(pair["covisible"] for pair in pairs if view.camera in _names(pair))
        for view in usable
    }
    if not any(most.values()):
        yield _critical(
            f"no two cameras see anything in the same frame ({_frame_ranges(usable)}); number "
            f"the frames of all cameras on one clock ({argument('frame_offset')}), or check "
            "that the files are of one recording"
        )
        return
    enough = config.enough_frames
    if max(most.values()) < enough:
        yield _warning(
            f"no two cameras see something together in {enough} frames or more; record longer"
        )
    else:
        for name, frames in most.items():
            if 0 < frames < enough:
                yield _warning(
                    f"{name}: sees something together with another camera in "
                    f"{count(frames, 'frame')}, expected {enough} or more; record longer, or let "
                    "somebody pass where both see"
                )
    for name, frames in most.items():
        if not frames:
            yield _warning(
                f"{name}: sees nothing in a frame in which another camera does, "
                "and will be left out; check its frame numbers"
            )
    yield from _find_separate_groups(usable, pairs)
    yield from _find_other_frames(usable)


def _find_separate_groups(usable: _Views, pairs: _Pairs) -> Iterator[Finding]:
    """Say which cameras no chain of pairs joins that see something together.

    Cameras that see nothing together with any other are left out.
    """
    groups = [{view.camera} for view in usable]
    for pair in pairs:
        if pair["covisible"]:
            joined = [group for group in groups if group & _names(pair)]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    groups = [group for group in groups if len(group) > 1]
    if len(groups) > 1:
        in_order = [[view.camera for view in usable if view.camera in group] for group in groups]
        listed = " | ".join(", ".join(names) for names in in_order)
        yield _warning(
            f"{len(groups)} groups of cameras see nothing in the same frames ({listed}), and will "
            "be calibrated each by itself; let somebody go from one to the other"
        )


def _find_other_frames(usable: _Views) -> Iterator[Finding]:
    """Say where the frame numbers of the views differ, and whether some may count from 1."""
    starts = {int(view.frames[0]) for view in usable}
    lengths = {len(view.frames) for view in usable}
    ranges = _frame_ranges(usable)
    first, second = min(starts), max(starts)
    if len(starts) == 2 and second - first == 1 and len(lengths) == 1:
        late = next(view.camera for view in usable if view.frames[0] == second)
        yield _warning(
            f"equally long recordings start at frame {first} and at frame {second} "
            f"({ranges}); say {argument('frame_offset', f'{late}:-1')} for each such camera, "
            "if they count from 1"
        )
    elif len({(int(view.frames[0]), int(view.frames[-1])) for view in usable}) > 1:
        yield _warning(
            f"the cameras' frames differ ({ranges}); only frames that two of them have are used"
        )


def _names(pair: Mapping[str, Any]) -> set[str]:
    """Return the names of the two cameras of a pair of the report."""
    return {pair["a"], pair["b"]}


def _frame_ranges(usable: _Views) -> str:
    """Return the first and the last frame number of each view as a text."""
    return ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in usable)


# --- geometry


def _find_poor_views(
    usable: _Views, pairs: _Pairs, meanings: Mapping[str, str], config: InspectConfig
) -> Iterator[Finding]:
    """Warn of a single subject that lies in one plane, and of two cameras that look at each other.

    Of these only where no third camera sees the same. meanings: of the names of keypoints.
    """
    view_of = {view.camera: view for view in usable}
    together = [
        (pair["a"], pair["b"]) for pair in pairs if pair["covisible"] >= config.enough_frames
    ]
    number = Counter(name for pair in together for name in pair)
    alone = [(a, b) for a, b in together if number[a] == number[b] == 1]
    some = evenly_spaced(np.arange(len(together)), config.most_pairs).tolist()
    compared = {
        (a, b): found
        for a, b in dict.fromkeys([*alone, *(together[k] for k in some)])
        if (found := compare_views(view_of[a], view_of[b], meanings, config)) is not None
        and found.error < config.most_error
    }
    depth = [found.plane_error / found.error for found in compared.values()]
    if depth and np.median(depth) < config.least_depth:
        yield _warning(
            "all that was seen may as well lie in one plane, or the cameras stand side by "
            "side, so that other rigs would fit, too; let the subject come closer, rise, jump "
            "or tilt, or move the cameras apart"
        )
        return
    for (a, b), found in compared.items():
        if found.mirrored and found.epipole < 1 and (a, b) in alone:
            yield _warning(
                f"{a} and {b} look at each other, and no third camera sees the same: points "
                "between them will be uncertain along that line; add a camera that looks from the "
                "side, or let the subject keep off the line"
            )


# --- positions and scores


def _find_other_scales(usable: _Views, config: InspectConfig) -> Iterator[Finding]:
    """Name the views whose positions are no pixels, or those of another image."""
    for view in usable:
        try:
            check_pixels(view)
        except MismatchError as error:
            yield _critical(error.render(spell_as_option))
            continue
        width, height = view.image_size
        points = np.abs(view.positions[seen_points(view)])
        outside = float((points > (width, height)).any(-1).mean())
        if width and outside > config.outside:
            yield _warning(
                f"{view.camera}: {outside:.0%} of the points lie outside its image of {width} "
                f"x {height}; check its size, or say {argument('crop_offset')}"
            )


def _find_corner(view: Keypoints2D) -> Iterator[Finding]:
    """Say where nearly all points lie in one quarter of the image, as those of a smaller one do."""
    middle = np.array(view.image_size) / 2
    points = view.positions[seen_points(view)]
    low, high = np.percentile(points, [100 - TYPICAL_PERCENTILE, TYPICAL_PERCENTILE], axis=0)
    before, after = high < middle, low > middle
    if (before | after).all() and middle.all():
        corner = f"{'upper' if before[1] else 'lower'} {'left' if before[0] else 'right'}"
        factor = argument("resized", f"{view.camera}:FACTOR")
        offset = argument("crop_offset", f"{view.camera}:X,Y")
        yield _warning(
            f"{view.camera}: the keypoints lie in the {corner} quarter of its image of "
            f"{view.image_size[0]} x {view.image_size[1]}; check its size, or say "
            f"{factor if before.all() else offset} if they are from other images"
        )


def _find_weaknesses(view: Keypoints2D, config: InspectConfig) -> Iterator[Finding]:
    """Yield what makes the detections of a view worth less."""
    scores = view.confidence[seen_points(view)]
    twice = int(find_repeated(view.positions).sum())
    if twice:
        yield _warning(
            f"{view.camera}: {twice} of {seen_points(view).any(-1).sum()} detections repeat "
            "another one of their frame, so they will be left out; "
            "check whether the detector, or a conversion, wrote bodies twice"
        )
    if np.median(scores) < config.low_confidence:
        yield _warning(
            f"{view.camera}: half of the scores are below {config.low_confidence}; "
            "check the detector's output"
        )
    if scores.max() > 1.0:
        largest = float(scores.max())
        excess = f"{largest:.2f}" if largest >= 1.01 else f"1 + {largest - 1:.0e}"
        yield _warning(
            f"{view.camera}: some scores are above 1 (up to {excess}), so all will be divided by "
            f"{largest_confidence(view.confidence):.3g}, the {TYPICAL_PERCENTILE:.0f}th "
            "percentile, and cut off at 1; nothing to do if the detector writes such"
        )
    skipped = int((np.diff(view.frames) - 1).sum())
    if skipped > config.gaps * (skipped + len(view.frames)):
        yield _warning(
            f"{view.camera}: missing between the first frame and the last: "
            f"{count(skipped, 'frame number')}; check that no frames were lost"
        )


# --- names of keypoints


def _find_name_problems(
    usable: _Views, meanings: Mapping[str, str], *, known_joints: int
) -> Iterator[Finding]:
    """Name the keypoints that do not go together, and say if no model knows enough of them.

    known_joints: how many of its joints the model of the report has among the keypoints.
    """
    if len(usable) < 2:
        return
    remedy = (
        f"give them one name in all files, or map them with {argument('skeleton')} where they are "
        "joints of a model (docs/skeletons.md)"
    )
    unshared = unshared_keypoints(usable, meanings)
    shared: dict[str, str] = {}  # the name of each keypoint that two views have, as the first does
    for view in usable:
        for name in view.keypoints:
            if name not in unshared:
                shared.setdefault(meanings[name], name)
    if not shared:
        listed = "; ".join(
            f"{view.camera}: {', '.join(view.keypoints[:_LISTED])}, ..." for view in usable
        )
        yield _critical(f"no two cameras share a keypoint name ({listed}); {remedy}")
        return
    if unshared:
        yield _warning(f"{describe_unshared(unshared)}; {remedy}")
    try:
        check_shared_keypoints(list(shared.values()))
    except MismatchError as error:
        yield _critical(error.render(spell_as_option))
        return
    if known_joints < LEAST_JOINTS:
        yield _warning(
            f"the models ({', '.join(SHIPPED)}) know {known_joints} of the joints: calibrated "
            "by geometry alone; map those that are joints of a model with "
            f"{argument('skeleton')} (docs/skeletons.md)"
        )


# --- keypoints and cameras together


def _find_camera_problems(
    views: _Views,
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    join: Callable[..., Recording],
) -> Iterator[Finding]:
    """Say what a run would say of the keypoints and the cameras together. join: as `join_sized`."""
    try:
        recording = join(views, cameras, skeleton, aliases)
        sample_frames = choose_sample_frames(recording, SampleConfig())
        check_joints(recording.select(frames=sample_frames))
    except MismatchError as error:
        yield _critical(error.render(spell_as_option))
        return
    yield from map(_warning, describe_corrected(recording))
    matched = match_cameras(views, cameras)
    if idle := [camera.name for camera in cameras if camera.name not in matched]:
        yield _warning(
            f"{', '.join(idle)}: no keypoints for these cameras; "
            "add their files, or go on without them"
        )
