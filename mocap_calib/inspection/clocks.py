"""Frame numbers that do not go together."""

from collections.abc import Mapping, Sequence
from typing import Any

from mocap_calib.config import InspectConfig
from mocap_calib.inspection.finding import Finding, critical, warning
from mocap_calib.types import Keypoints2D


def find_clock_problems(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Name the frame numbers that do not go together. pairs: of the report."""
    names = {view.camera for view in usable}
    pairs = [pair for pair in pairs if {pair["a"], pair["b"]} <= names]
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
    found = []
    if most < config.enough_frames:
        found.append(
            warning(
                "no two cameras see something together in "
                f"{config.enough_frames} frames or more; record longer"
            )
        )
    return [*found, *_find_lonely_cameras(usable, pairs), *_find_other_frames(usable)]


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
