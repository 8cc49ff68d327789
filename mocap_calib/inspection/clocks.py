"""Frame numbers that do not go together."""

from collections.abc import Mapping, Sequence
from typing import Any

from mocap_calib.inspection.config import InspectConfig
from mocap_calib.inspection.finding import Finding, critical, warning
from mocap_calib.types import Keypoints2D
from mocap_calib.wording import count


def find_clock_problems(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Name the frame numbers that do not go together. pairs: of the report."""
    names = {view.camera for view in usable}
    pairs = [pair for pair in pairs if _names(pair) <= names]
    if not pairs:
        return []
    most = max(pair["covisible"] for pair in pairs)
    if most == 0:
        return [
            critical(
                f"no two cameras see anything in the same frame ({_frame_ranges(usable)}); "
                "number the frames of all cameras on one clock (--frame-offset), "
                "or check that the files are of one recording"
            )
        ]
    return [
        *_find_little_overlap(usable, pairs, config),
        *_find_lonely_cameras(usable, pairs),
        *_find_separate_groups(usable, pairs),
        *_find_other_frames(usable),
    ]


def _find_little_overlap(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Name the cameras that see too little together with any other. pairs: of the report."""
    enough = config.enough_frames
    if max(pair["covisible"] for pair in pairs) < enough:
        return [
            warning(
                f"no two cameras see something together in {enough} frames or more; record longer"
            )
        ]
    most = {
        view.camera: max(pair["covisible"] for pair in pairs if view.camera in _names(pair))
        for view in usable
    }
    return [
        warning(
            f"{name}: sees something together with another camera in {count(frames, 'frame')}, "
            f"expected {enough} or more; record longer, or let somebody pass where both see"
        )
        for name, frames in most.items()
        if 0 < frames < enough
    ]


def _find_separate_groups(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]]
) -> list[Finding]:
    """Say which cameras no chain of pairs joins that see something together.

    pairs: of the report. Cameras that see nothing together with any other are left out.
    """
    groups = [{view.camera} for view in usable]
    for pair in pairs:
        if pair["covisible"]:
            joined = [group for group in groups if group & _names(pair)]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    groups = [group for group in groups if len(group) > 1]
    if len(groups) < 2:
        return []
    in_order = [[view.camera for view in usable if view.camera in group] for group in groups]
    listed = " | ".join(", ".join(names) for names in in_order)
    return [
        warning(
            f"{len(groups)} groups of cameras see nothing in the same frames ({listed}), and will "
            "be calibrated each by itself; let somebody go from one to the other"
        )
    ]


def _names(pair: Mapping[str, Any]) -> set[str]:
    """Return the names of the two cameras of a pair of the report."""
    return {pair["a"], pair["b"]}


def _find_lonely_cameras(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]]
) -> list[Finding]:
    """Name the cameras that see nothing together with another. pairs: of the report."""
    covisible = [pair for pair in pairs if pair["covisible"]]
    in_company = {pair[side] for pair in covisible for side in ("a", "b")}
    return [
        warning(
            f"{view.camera}: sees nothing in a frame in which another camera does, "
            "and will be left out; check its frame numbers"
        )
        for view in usable
        if view.camera not in in_company
    ]


def _find_other_frames(usable: Sequence[Keypoints2D]) -> list[Finding]:
    """Say where the frame numbers of the views differ, and whether some may count from 1."""
    starts = {int(view.frames[0]) for view in usable}
    lengths = {len(view.frames) for view in usable}
    ranges = _frame_ranges(usable)
    first, second = min(starts), max(starts)
    if len(starts) == 2 and second - first == 1 and len(lengths) == 1:
        late = next(view.camera for view in usable if view.frames[0] == second)
        return [
            warning(
                f"equally long recordings start at frame {first} and at frame {second} ({ranges}); "
                f"say --frame-offset {late}:-1 for each such camera, if they count from 1"
            )
        ]
    ends = {(int(view.frames[0]), int(view.frames[-1])) for view in usable}
    if len(ends) == 1:
        return []
    return [
        warning(
            f"the cameras' frames differ ({ranges}); only frames that two of them have are used"
        )
    ]


def _frame_ranges(usable: Sequence[Keypoints2D]) -> str:
    """Return the first and the last frame number of each view as a text."""
    return ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in usable)
