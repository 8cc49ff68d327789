"""Describe the clock of a camera: its kind, and from which frame on which offset holds."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.clocks.evidence import DECISIVE, Timing
from mocap_calib.recording.sampling import usual_step
from mocap_calib.types import Bools, CameraClock, ClockKind, Ints, Recording


@dataclass(frozen=True)
class StretchNumbers:
    """The frame numbers of stretches.

    first: `[stretch]` number of the first frame; step: from each frame to the next.
    """

    first: Ints
    step: int

    @classmethod
    def of(cls, recording: Recording, stretches: Ints) -> "StretchNumbers":
        """Return the numbers of stretches `[stretch, frame]` of a recording (-1 = no frame)."""
        step = usual_step(recording.frames)
        some = (stretches >= 0).argmax(1)
        number = recording.frames[stretches[np.arange(len(stretches)), some]]
        return cls(number - some * step, step)


def describe_clock(
    camera: str,
    timing: Timing,
    view: int,
    numbers: StretchNumbers,
    evidence: Mapping[str, float],
    *,
    window: int,
) -> CameraClock:
    """Return what kind of clock a camera has, given its map and the evidence for it.

    window: frames by which it may be early or late at first.
    """
    own, rate = timing.maps[view], float(timing.rates[view])
    known = own >= 0
    offset = own - np.round(rate * np.arange(own.shape[1])).astype(np.int64)
    constant = timing.is_constant(view)
    sure = evidence["margin"] >= DECISIVE
    within = known.any() and abs(offset[known][0]) <= window
    if rate == 1.0 and not offset[known].any() and known.any():
        return CameraClock(camera, "in step" if sure else "not known", evidence=evidence)
    if not (evidence["gain"] >= DECISIVE and (sure or not constant) and within):
        return CameraClock(camera, "not known", evidence=evidence)
    table = _table(offset, known, rate, numbers)
    kind: ClockKind = "clock" if constant else "dropped"
    if rate != 1.0 or (not constant and _is_linear(offset, known)):
        kind = "rate"
    return CameraClock(camera, kind, table[0][1], rate, table, evidence)


def _is_linear(offset: Ints, known: Bools) -> bool:
    """Return whether offsets `[stretch, frame]` change evenly, as those of another rate do.

    At least four steps, all within a frame of a line.
    """
    for part, of in zip(offset, known, strict=True):
        time = np.flatnonzero(of)
        if len(time) < 2 or np.count_nonzero(np.diff(part[time])) < 4:
            return False
        line = np.polyval(np.polyfit(time, part[of], 1), time)
        if np.abs(part[of] - line).max() > 1.0:
            return False
    return True


def _table(
    offset: Ints, known: Bools, rate: float, numbers: StretchNumbers
) -> tuple[tuple[int, int], ...]:
    """Return (frame, offset): the frame of the common clock from which on each offset holds."""
    rows: list[tuple[int, int]] = []
    for part, of, first in zip(offset, known, numbers.first, strict=True):
        time = np.flatnonzero(of)
        if not len(time):
            continue
        begins = np.r_[True, np.diff(part[time]) != 0]
        for index in time[begins]:
            # the rate is counted from the first frame of the table
            frame = int(first + index * numbers.step)
            origin = rows[0][0] if rows else frame
            own = int(first + numbers.step * (np.round(rate * index) + part[index]))
            counted = origin + round((frame - origin) * rate)
            if not rows or rows[-1][1] != own - counted:
                rows.append((frame, own - counted))
    return tuple(rows)


def combine_clocks(first: CameraClock, second: CameraClock) -> CameraClock:
    """Return the clock of a camera that still differs after it was put on the first clock.

    Of two clocks that change in time the first alone is kept.
    """
    if not second.differs:
        return first if first.differs or second.kind == "not known" else second
    if not first.differs:
        return second
    if second.kind == "clock":
        by = second.offset
        table = tuple((frame - by, offset + by) for frame, offset in first.table)
        changed = replace(first, offset=first.offset + by, table=table)
    elif first.kind == "clock":
        by = first.offset
        table = tuple((frame, offset + by) for frame, offset in second.table)
        changed = replace(second, offset=second.offset + by, table=table)
    else:
        return first
    if changed.kind == "clock" and changed.offset == 0:
        return CameraClock(first.camera, "in step", evidence=second.evidence)
    return changed
