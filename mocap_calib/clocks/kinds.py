"""Say what kind of difference a clock has, and from which frame on which offset holds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_calib.clocks.evidence import is_decisive
from mocap_calib.config import SyncConfig
from mocap_calib.recording.sampling import usual_step
from mocap_calib.types import Bools, CameraClock, ClockKind, Ints, Recording


@dataclass(frozen=True)
class StretchNumbers:
    """Which frame numbers the frames of stretches have.

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
    own: Ints,
    rate: float,
    *,
    numbers: StretchNumbers,
    evidence: Mapping[str, float],
    config: SyncConfig,
) -> CameraClock:
    """Return what kind of clock a camera has, given its map and the evidence for it.

    own: `[stretch, frame]` own frames, -1 = none, as counted within the stretches.
    """
    time = np.arange(own.shape[1])
    known = own >= 0
    offset = own - np.round(rate * time).astype(np.int64)
    sure = evidence["margin"] >= config.ambiguity
    if not known.any():  # so late that the recording has no such frame
        return CameraClock(camera, "not known", evidence=evidence)
    if rate == 1.0 and not offset[known].any():
        return CameraClock(camera, "in step" if sure else "not known", evidence=evidence)
    steps = _count_steps(offset, known)
    size = 0 if steps else int(np.abs(offset[known]).min())
    decisive = _is_unanimous(size, evidence, config) or is_decisive(
        evidence["sigma"], evidence["score"], config
    )
    likely = evidence["gain"] >= config.least_gain and evidence["score"] >= config.least_score
    likely = likely and (bool(steps) or evidence["votes"] >= config.least_votes)
    if not (decisive and likely and (sure or steps)):
        return CameraClock(camera, "not known", evidence=evidence)
    table = _table(offset, known, rate, numbers)
    kind: ClockKind = "clock"
    if rate != 1.0 or (steps and _is_linear(offset, known, config)):
        kind = "rate"
    elif steps:
        kind = "dropped"
    return CameraClock(camera, kind, table[0][1], rate, table, evidence)


def _is_unanimous(size: int, evidence: Mapping[str, float], config: SyncConfig) -> bool:
    """Return whether the other cameras, each by itself, say that a camera is off by so much.

    Standard errors are doubtful where bodies move slowly; that nearly all cameras agree best at the
    same offset is no accident, nor that all do so, where they agree well, and by two frames.

    size: frames. evidence: as of `weigh_clock`.
    """
    if evidence["partners"] < 2 or evidence["sigma"] <= 0:
        return False
    far = size >= config.distant and evidence["votes"] >= config.unanimous_votes
    far = far and evidence["gain"] >= config.unanimous_gain
    if far and evidence["sigma"] >= config.decisive_of_unanimous:
        return True
    good = evidence["score"] >= config.good_score
    return good and size > 1 and evidence["votes"] == 1.0 and evidence["sigma"] >= 1.0


def _count_steps(offset: Ints, known: Bools) -> int:
    """Return how often offsets `[stretch, frame]` change where they are known."""
    return sum(int((np.diff(part[of]) != 0).sum()) for part, of in zip(offset, known, strict=True))


def _is_linear(offset: Ints, known: Bools, config: SyncConfig) -> bool:
    """Return whether offsets `[stretch, frame]` change evenly, as those of another rate do."""
    for part, of in zip(offset, known, strict=True):
        time = np.flatnonzero(of)
        if len(time) < 2 or _count_steps(part[None], of[None]) < config.linear_steps:
            return False
        line = np.polyval(np.polyfit(time, part[of], 1), time)
        if np.abs(part[of] - line).max() > config.linear_error:
            return False
    return True


def _table(
    offset: Ints, known: Bools, rate: float, numbers: StretchNumbers
) -> tuple[tuple[int, int], ...]:
    """Return (frame, offset) from which frame of the common clock on which offset holds."""
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
