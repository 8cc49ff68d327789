"""The agreement of cameras in any two frames, and what it is evidence of.

A camera's *map* is its own frame at each frame of a clock that is common to all. Given the maps of
the others, the agreement of a camera with them is a table over its own frames.

Evidence is counted in nats: by how much it favours a map over the frame numbers as they are, given
the spread of the agreement over blocks of time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.clocks.compare import LEAST_FRAMES, Pair, Singles
from mocap_calib.config import DECISIVE_NATS
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.recording.sampling import usual_step
from mocap_calib.types import Bools, CameraClock, ClockKind, Floats, Ints, Recording

_BLOCKS = 25  # of time: neighbouring frames err alike, blocks do not
LEAST_BLOCK = 5  # frames


@dataclass(frozen=True)
class Agreements:
    """The agreement of the pairs of so many views in any two frames.

    values: (a, b) -> `[stretch, frame of a, frame of b]` in standard deviations over all pairs of
        frames, 0 where nothing is known. window: frames by which a camera may be early or late.
    """

    views: int
    values: Mapping[Pair, Singles]
    window: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of stretches, and of the frames of each."""
        stretches, frames, _ = next(iter(self.values.values())).shape
        return stretches, frames

    def between(self, view: int, other: int) -> Singles:
        """Return `[stretch, frame of other, frame of view]`."""
        if (other, view) in self.values:
            return self.values[other, view]
        return self.values[view, other].swapaxes(1, 2)

    def partners(self, view: int) -> list[int]:
        """Return the views that this one is compared with."""
        return sorted({a + b - view for a, b in self.values if view in (a, b)})


@dataclass(frozen=True)
class Timing:
    """The maps of all cameras.

    maps: `[view, stretch, frame]` own frames, -1 = none. rates: `[view]` own frames for one of the
    common clock. agreement: `[view, stretch, frame]` with all partners together; where a map has
    steps, in blocks of frames that the map was found without.
    """

    maps: Ints
    rates: Floats
    agreement: Floats

    @classmethod
    def synchronous(cls, agreements: Agreements) -> "Timing":
        """Return the timing of frame numbers as they are."""
        shape = (agreements.views, *agreements.shape)
        maps = np.broadcast_to(np.arange(shape[2]), shape)
        return cls(maps, np.ones(shape[0]), np.zeros(shape))

    def change(self, view: int, own: Ints, rate: float, agreement: Floats) -> "Timing":
        """Return the timing with another map `[stretch, frame]` of one camera."""
        maps, rates, all_agreement = self.maps.copy(), self.rates.copy(), self.agreement.copy()
        maps[view], rates[view], all_agreement[view] = own, rate, agreement
        return Timing(maps, rates, all_agreement)

    def offsets(self, view: int) -> Ints:
        """Return the offsets `[frame]` of one camera where its map is known."""
        time = np.arange(self.maps.shape[2])
        return (self.maps[view] - np.round(self.rates[view] * time).astype(np.int64))[
            self.maps[view] >= 0
        ]

    def is_constant(self, view: int) -> bool:
        """Return whether the map of a camera has no step."""
        return np.ptp(self.offsets(view)) == 0 if len(self.offsets(view)) else True


def evidence(difference: Floats, shown: Bools) -> float:
    """Return the evidence, in nats, that the mean of `[stretch, frame]` is not 0; < 0 where below.

    The log likelihood ratio of normal errors of unknown size, over blocks of time.
    """
    values = difference[shown]
    if len(values) < LEAST_FRAMES:
        return 0.0
    block = time_blocks(len(values))
    count = np.bincount(block)
    means = np.bincount(block, values) / count
    ratio = means.mean() ** 2 / max(means.var(), 1e-12)
    return float(np.sign(means.mean()) * len(count) / 2 * np.log1p(ratio))


def time_blocks(frames: int) -> Ints:
    """Return the block `[frame]` of each of so many frames: 25 at most, of 5 frames at least."""
    count = min(_BLOCKS, frames // LEAST_BLOCK)
    return np.arange(frames) * count // max(frames, 1)


def standardise(values: Singles, like: Singles) -> Singles:
    """Return agreement in standard deviations of another one from its median, 0 = not known."""
    known = like[np.isfinite(like)]
    if not len(known):
        return np.zeros_like(values)
    scaled = (values - np.median(known)) / max(float(known.std()), 1e-3)
    return np.where(np.isfinite(values), scaled, np.float32(0.0))


def camera_table(
    agreements: Agreements,
    maps: Ints,
    view: int,
    rate: float,
    partners: Sequence[int],
    *,
    window: int,
) -> Floats:
    """Return how well each frame of a camera agrees with the others, `[stretch, frame, offset]`.

    At frame t of the common clock its own frame is rate t + offset, offsets from -window to window.
    """
    time = np.arange(maps.shape[2])
    exact = np.isclose(rate * time % 1, 0)
    first = np.round(rate * time).astype(np.int64) - window
    table = np.zeros((agreements.shape[0], len(time), 2 * window + 1))
    for other in partners:
        row = np.where(exact, maps[other], -1)
        kernels.add_windows(*contiguous(agreements.between(view, other), row, first), table)
    return table


def along_map(table: Floats, own: Ints, rate: float) -> tuple[Floats, Bools]:
    """Return the agreement `[stretch, frame]` of a map in a table, and where it is known."""
    time = np.arange(own.shape[1])
    place = own - np.round(rate * time).astype(np.int64) + table.shape[2] // 2
    shown = (own >= 0) & (place >= 0) & (place < table.shape[2])
    index = np.where(shown, place, 0)[..., None]
    return np.where(shown, np.take_along_axis(table, index, 2)[..., 0], 0.0), shown


def _margin(table: Floats, agreement: Floats, shown: Bools) -> float:
    """Return by how many nats a map is better than any distant constant offset.

    Offsets are distant beyond the place where the curve about the best has fallen by half.
    """
    curve = np.where(shown[..., None], table, 0.0).sum((0, 1))
    best = int(curve.argmax())
    low = curve < 0.5 * curve[best]
    below, above = np.flatnonzero(low[:best]), np.flatnonzero(low[best:])
    left = below[-1] if len(below) else 0
    right = best + above[0] if len(above) else len(curve)
    distant = np.r_[0:left, right : len(curve)]
    if not len(distant):
        return 0.0
    rival = distant[curve[distant].argmax()]
    return evidence(agreement - table[..., rival], shown)


def weigh(
    agreements: Agreements, in_step: Agreements, timing: Timing, view: int
) -> dict[str, float]:
    """Return the evidence for the map of one camera.

    score: agreement with the other cameras, in standard deviations over all pairs of frames.
    gain: nats by which it is more than with its frame numbers as they are; 0 for these.
    margin: nats by which it is more than at any one offset that is no neighbour.

    Cameras that differ alike are no evidence: they would agree as well if all of them were in step.

    in_step: the agreement under the rotations of pairs that are in step.
    """
    witnesses = _witnesses(agreements, timing, view)
    own, rate = timing.maps[view], float(timing.rates[view])
    table = camera_table(agreements, timing.maps, view, rate, witnesses, window=agreements.shape[1])
    agreement, shown = along_map(table, own, rate)
    if not witnesses or not shown.any():
        return {"score": 0.0, "gain": 0.0, "margin": 0.0, "partners": 0.0}
    if not timing.is_constant(view):
        agreement = timing.agreement[view]
    found = {
        "score": float(agreement[shown].mean()) / len(witnesses),
        "gain": 0.0,
        "margin": _margin(table, agreement, shown),
        "partners": float(len(witnesses)),
    }
    time = np.arange(own.shape[1])
    if (own != time)[own >= 0].any():
        common = [(timing.maps[other] == time).all() for other in range(agreements.views)]
        values = {
            (a, b): (in_step.values if common[a + b - view] else agreements.values)[a, b]
            for a, b in agreements.values
            if view in (a, b)
        }
        known = [
            camera_table(each, timing.maps, view, 1.0, witnesses, window=0)[..., 0]
            for each in (agreements, replace(agreements, values=values))
        ]
        as_numbered = max(known, key=np.sum)
        found["gain"] = evidence(agreement - as_numbered, shown)
    return found


def _witnesses(agreements: Agreements, timing: Timing, view: int) -> list[int]:
    """Return the partners of a camera but those that differ alike, within a frame."""
    maps, time = timing.maps, np.arange(timing.maps.shape[2])
    found = []
    for other in agreements.partners(view):
        known = (maps[view] >= 0) & (maps[other] >= 0)
        apart = np.abs(maps[other] - maps[view])[known]
        late = np.abs(maps[other] - time)[known]
        if not (known.any() and apart.mean() <= 1 and apart.mean() < late.mean()):
            found.append(other)
    return found


# The clock of a camera: its kind, and from which frame on which offset holds


def frame_numbers(recording: Recording, stretches: Ints) -> Ints:
    """Return the numbers `[stretch, frame]` of frames, also of those that are not there.

    stretches: `[stretch, frame]` indices of the frames of a recording, -1 = no frame.
    """
    step, some = usual_step(recording.frames), (stretches >= 0).argmax(1)
    number = recording.frames[stretches[np.arange(len(stretches)), some]]
    return np.asarray((number - some * step)[:, None] + step * np.arange(stretches.shape[1]))


def describe_clock(
    camera: str,
    timing: Timing,
    view: int,
    numbers: Ints,
    found: Mapping[str, float],
    *,
    window: int,
) -> CameraClock:
    """Return what kind of clock a camera has, given its map and the evidence for it.

    numbers: `[stretch, frame]` as of `frame_numbers`. found: as of `weigh`.
    window: frames by which it may be early or late at first.
    """
    own, rate = timing.maps[view], float(timing.rates[view])
    known = own >= 0
    offset = own - np.round(rate * np.arange(own.shape[1])).astype(np.int64)
    constant = timing.is_constant(view)
    sure = found["margin"] >= DECISIVE_NATS
    within = known.any() and abs(offset[known][0]) <= window
    if rate == 1.0 and not offset[known].any() and known.any():
        return CameraClock(camera, "in step" if sure else "not known", evidence=found)
    if not (found["gain"] >= DECISIVE_NATS and (sure or not constant) and within):
        return CameraClock(camera, "not known", evidence=found)
    table = _table(offset, known, rate, numbers)
    kind: ClockKind = "clock" if constant else "dropped"
    if rate != 1.0 or (not constant and _is_linear(offset, known)):
        kind = "rate"
    return CameraClock(camera, kind, table[0][1], rate, table, found)


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


def _table(offset: Ints, known: Bools, rate: float, numbers: Ints) -> tuple[tuple[int, int], ...]:
    """Return (frame, offset): the frame of the common clock from which on each offset holds."""
    rows: list[tuple[int, int]] = []
    for part, of, number in zip(offset, known, numbers, strict=True):
        time = np.flatnonzero(of)
        if not len(time):
            continue
        begins = np.r_[True, np.diff(part[time]) != 0]
        for index in time[begins]:
            # the rate is counted from the first frame of the table
            frame, step = int(number[index]), int(number[1] - number[0])
            origin = rows[0][0] if rows else frame
            own = int(number[0] + step * (np.round(rate * index) + part[index]))
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
