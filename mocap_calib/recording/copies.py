"""Find files that were given twice: two cameras never see the same detections.

Detections of two files are the same where all coordinates are, up to the digits that a file keeps.
Subjects that stand still, and cameras side by side, look alike but never to the hundredth of a
pixel in tens of detections.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import CopyConfig
from mocap_calib.errors import MismatchError
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints, Keypoints2D
from mocap_calib.wording import count

_DEFAULT = CopyConfig()


@dataclass(frozen=True)
class Copy:
    """Two views with the same detections.

    shift: frames by which those of the second come later.
    """

    first: Keypoints2D
    second: Keypoints2D
    shift: int

    @property
    def says(self) -> str:
        """Which cameras and files have the same detections, for a person."""
        first, second = self.first, self.second
        later = ""
        if self.shift:
            view = second if self.shift > 0 else first
            later = f", {count(abs(self.shift), 'frame')} later in {view.camera}"
        return (
            f"{first.camera} and {second.camera} have the same detections "
            f"({first.source}, {second.source}{later})"
        )


@dataclass(frozen=True)
class _Detections:
    """The detections of a view in the order of their keys.

    key: `[detection]` the mean of the coordinates that are seen, ascending.
    frame: `[detection]` index of the frame; instance: `[detection]`.
    """

    key: Floats
    frame: Ints
    instance: Ints


def check_copies(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> None:
    """Raise MismatchError where two views have the same detections.

    meanings: of the names of their keypoints, see `recording.meanings.keypoint_meanings`.
    """
    copies = find_copies(views, meanings)
    if copies:
        raise MismatchError(
            "expected a file of its own for each camera, "
            f"found that {copies[0].says}; "
            "give each camera its own file, or leave one of the two out"
        )


def find_copies(
    views: Sequence[Keypoints2D], meanings: Mapping[str, str], config: CopyConfig = _DEFAULT
) -> list[Copy]:
    """Return the pairs of views with the same detections, in any order, at a constant shift.

    meanings: of the names of their keypoints.
    """
    columns = _shared_columns(views, meanings)
    if not views or not columns[0].size:
        return []
    pairs = zip(views, columns, strict=True)
    found = list(map_in_threads(lambda pair: _list_detections(*pair), pairs))
    copies = []
    for a, b in combinations(range(len(views)), 2):
        fewer, more = sorted((a, b), key=lambda view: len(found[view].key))
        shift = _find_shift(
            (views[fewer], columns[fewer], found[fewer]),
            (views[more], columns[more], found[more]),
            config,
        )
        if shift is not None:
            copies.append(Copy(views[a], views[b], shift if fewer == a else -shift))
    return copies


def _shared_columns(views: Sequence[Keypoints2D], meanings: Mapping[str, str]) -> list[Ints]:
    """Return the `[keypoint]` columns of the keypoints that all views have, in one order each."""
    own = [{meanings[name]: k for k, name in enumerate(view.keypoints)} for view in views]
    shared = [meaning for meaning in own[0] if all(meaning in of for of in own)] if own else []
    return [np.array([of[meaning] for meaning in shared], dtype=np.int64) for of in own]


def _list_detections(view: Keypoints2D, columns: Ints) -> _Detections:
    """Return the detections of a view by their keys."""
    parts = [(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    own = mapped.as_slice(columns)
    for rows in mapped.frame_slices(len(view.frames)):
        block = view.positions[rows][:, :, own]
        block = block.reshape(*block.shape[:2], -1)
        seen = np.isfinite(block)
        number = np.count_nonzero(seen, axis=-1)
        total = np.where(seen, block, 0.0) @ np.ones(block.shape[-1])
        frame, instance = np.nonzero(number)
        parts.append(
            (total[frame, instance] / number[frame, instance], frame + rows.start, instance)
        )
    key, frame, instance = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(key, kind="stable")
    return _Detections(key[order], frame[order], instance[order])


def _find_shift(
    fewer: tuple[Keypoints2D, Ints, _Detections],
    more: tuple[Keypoints2D, Ints, _Detections],
    config: CopyConfig,
) -> int | None:
    """Return by how many frames the second view is later, None where it is another camera's.

    Each is a view, its columns and its detections; the first has no more than the second.
    """
    (first, first_columns, here), (second, second_columns, there) = fewer, more
    tolerance = config.tolerance * float(np.abs(here.key).max(initial=0.0))
    distinct = np.flatnonzero(np.diff(here.key, prepend=-np.inf) > tolerance)
    if len(distinct) < config.least_detections:
        return None
    chosen = evenly_spaced(distinct, config.compared_detections)
    low = np.searchsorted(there.key, here.key[chosen] - tolerance)
    high = np.searchsorted(there.key, here.key[chosen] + tolerance)
    number = np.minimum(high - low, config.candidates)
    of = np.repeat(np.arange(len(chosen)), number)
    candidate = low[of] + np.arange(len(of)) - np.repeat(number.cumsum() - number, number)
    own = chosen[of]
    ours = first.positions[here.frame[own], here.instance[own]][:, first_columns]
    theirs = second.positions[there.frame[candidate], there.instance[candidate]]
    theirs = theirs[:, second_columns]
    mapped.let_go()
    equal = np.isclose(ours, theirs, rtol=0.0, atol=tolerance, equal_nan=True).all((1, 2))
    shifts = second.frames[there.frame[candidate]] - first.frames[here.frame[own]]
    values, counts = np.unique(
        np.unique(np.column_stack([of, shifts])[equal], axis=0)[:, 1], return_counts=True
    )
    if not len(values) or counts.max() < config.least_share * len(chosen):
        return None
    return int(values[counts.argmax()])
