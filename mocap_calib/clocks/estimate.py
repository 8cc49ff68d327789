"""Estimate how the clocks of cameras differ, from lifted bodies, before there is a rig.

Under the rotations of pairs calibrated with the frame numbers as they are, bodies of synchronous
cameras agree best at equal numbers. Only where a camera does not are the rotations searched for
with the time left open: search -> maps -> align the bodies at these maps -> maps.

A camera stays as it is unless the evidence for another clock is decisive.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mocap_calib.clocks.compare import (
    LEAST_FRAMES,
    Agreements,
    Pair,
    ViewInTime,
    agreement,
    agreement_of_rays,
    align_at,
    compared_pairs,
    search_rotation,
    views_in_time,
)
from mocap_calib.clocks.maps import (
    Timing,
    describe_clocks,
    evidence,
    find_timing,
)
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import DECISIVE_NATS, Config, SyncConfig
from mocap_calib.errors import DegenerateError, MismatchError
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.recording.corrections import find_view
from mocap_calib.recording.sampling import choose_stretches, take_sample, usual_step
from mocap_calib.results import (
    NO_FRAME,
    CalibrationResult,
    Clocks,
    GroupResult,
    LiftedPoses,
)
from mocap_calib.types import (
    CameraClock,
    Floats,
    Ints,
    Recording,
    Sample,
)

T = TypeVar("T")  # what is observed of a recording
Calibrate = Callable[[Recording, T | None], tuple[T, CalibrationResult]]
_FAR = 5  # windows, in which a camera is looked for that is in step nowhere nearer
_ROUNDS = 4  # of calibrating again on refined clocks


def estimate_clocks(
    recording: Recording,
    lift_sample: Callable[[Sample], LiftedPoses],
    rotations: Mapping[Pair, Floats],
    config: Config,
    *,
    seed: int,
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera, all of the first kind where none can be compared.

    rotations: (a, b) -> b_from_a of pairs of views that are calibrated with the frame numbers as
        they are; none: all are searched for.
    """
    unknown = tuple(map(CameraClock, recording.names))
    if config.sync.mode == "off":
        return unknown
    clocks = unknown
    try:
        for factor in (1, _FAR):
            sync = replace(config.sync, window=factor * config.sync.window)
            stretches = choose_stretches(recording, sync)
            if factor > 1 and stretches.shape[1] // 3 <= config.sync.window:
                break  # too short to look any further
            lifted = lift_sample(take_sample(recording, stretches[stretches >= 0]))
            clocks = find_clocks(recording, lifted, stretches, rotations, sync, seed=seed)
            if all(clock.kind != "not known" for clock in clocks):
                break
    except MismatchError:  # the model knows too few of the joints: reported where they are needed
        return unknown
    return clocks


def calibrate_on_clocks(
    recording: Recording,
    cameras: tuple[CameraClock, ...],
    calibrate: Calibrate[T],
    config: SyncConfig,
    *,
    observed: T,
) -> tuple[tuple[T, CalibrationResult], Clocks]:
    """Return what is found of a recording on the clocks of its cameras, and these clocks.

    cameras: the clock of each by lifted bodies; they are refined by the rigs.
    calibrate: of a recording, and what was observed of it, None where it is to be observed.
    observed: of the recording as it is.
    """
    apply = Clocks.of_one if config.mode == "check" else clocks_from
    clocks = apply(recording, cameras)
    try:
        calibrated = calibrate(retime(recording, clocks), None if clocks.changed else observed)
    except DegenerateError:  # bodies that agree by chance make no rig
        if not clocks.changed:
            raise
        clocks = Clocks.of_one(recording)
        calibrated = calibrate(recording, observed)
    # a rig of clocks that differ and are not applied refines none
    refines = config.mode == "auto" or not any(camera.differs for camera in cameras)
    for _ in range(_ROUNDS if refines and config.mode != "off" else 0):
        before = clocks
        clocks = apply(recording, refine_clocks(calibrated[1].groups, before.cameras, config))
        same = np.array_equal(before.frames, clocks.frames)
        if same and np.array_equal(before.source, clocks.source):
            break
        calibrated = calibrate(retime(recording, clocks), None)
    return calibrated, clocks


def find_clocks(
    recording: Recording,
    lifted: LiftedPoses,
    stretches: Ints,
    rotations: Mapping[Pair, Floats],
    config: SyncConfig,
    *,
    seed: int,
) -> tuple[CameraClock, ...]:
    """Return how the clock of each camera differs.

    lifted: the bodies of all frames of the stretches, one stretch after the other.
    stretches: `[stretch, frame]` indices of the frames, -1 = not in the recording.
    rotations: as of `estimate_clocks`.
    """
    views = views_in_time(lifted, stretches)
    window = min(config.window, stretches.shape[1] // 3)
    enough = [view.seen.any(-1).sum() >= LEAST_FRAMES for view in views]
    compared = [(a, b) for a, b in compared_pairs(len(views)) if enough[a] and enough[b]]
    if window < 1 or not compared:
        return tuple(map(CameraClock, recording.names))
    numbers = frame_numbers(recording, stretches)
    start = _starts(numbers)
    given = {pair: rotations[pair] for pair in compared if pair in rotations}
    sure: set[int] = set()
    if given:
        agreements = _compare(views, given, window)
        timing = find_timing(agreements, start)
        cameras = describe_clocks(recording.names, numbers, agreements, timing)
        if all(camera.kind == "in step" for camera in cameras):
            return cameras
        near = _align(views, given, timing, window)
        cameras = describe_clocks(recording.names, numbers, *near)
        sure = {view for view, camera in enumerate(cameras) if camera.kind == "in step"}
    searched = [pair for pair in compared if not sure.issuperset(pair)]
    if not searched:
        return cameras
    generators = np.random.default_rng(seed).spawn(len(searched))
    rotated = map_in_threads(
        lambda job: search_rotation(views[job[0][0]], views[job[0][1]], 2 * window, job[1]),
        zip(searched, generators, strict=True),
    )
    found = given | dict(zip(searched, rotated, strict=True))
    best = _align(views, found, find_timing(_compare(views, found, window), start), window)
    if given:
        # bodies of a gait also match half a cycle apart, under rotations that are turned by 180 deg
        gain = _along_maps(*best, given) - _along_maps(*near, given)
        if evidence(gain, np.isfinite(gain)) < DECISIVE_NATS:
            best = near
    return describe_clocks(recording.names, numbers, *best)


def _compare(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], window: int
) -> Agreements:
    """Return the agreement of pairs under rotations b_from_a."""
    measured = {(a, b): agreement(views[a], views[b], turn) for (a, b), turn in rotations.items()}
    return Agreements(len(views), measured, window)


def _align(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], timing: Timing, window: int
) -> tuple[Agreements, Timing]:
    """Return the agreement of pairs and the maps, with the rotations aligned at a first timing."""
    aligned = {
        (a, b): align_at(views[a], views[b], turn, timing.maps[a], timing.maps[b])
        for (a, b), turn in rotations.items()
    }
    agreements = _compare(views, aligned, window)
    return agreements, find_timing(agreements, timing.start)


def _along_maps(agreements: Agreements, timing: Timing, pairs: Iterable[Pair]) -> Floats:
    """Return the mean agreement `[stretch, frame]` of pairs at the times of the maps."""
    own, stretch = timing.maps, np.arange(timing.maps.shape[1])[:, None]
    found = [
        np.where(
            (own[a] >= 0) & (own[b] >= 0),
            agreements.measured[a, b][stretch, own[a], own[b]],
            np.nan,
        )
        for a, b in pairs
    ]
    return mean_of_known(np.stack(found), 0)


def refine_clocks(
    groups: Sequence[GroupResult], clocks: Sequence[CameraClock], config: SyncConfig
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera, refined by the rigs that were found on these clocks."""
    cameras = {camera.camera: camera for camera in clocks}
    for group in groups:
        stretches = choose_stretches(group.recording, config)
        numbers = frame_numbers(group.recording, stretches)
        # a rig on clocks that are nearly right: it shows how far they are off
        window = min(config.window // 4, stretches.shape[1] // 3)
        rig = group.adjusted.rig
        values = agreement_of_rays(group.recording, rig, group.matches, stretches, window)
        if values:
            agreements = Agreements(len(rig), values, window)
            timing = find_timing(agreements, _starts(numbers), constant=True)
            for found in describe_clocks(rig.names, numbers, agreements, timing):
                before = cameras[found.camera]
                # one frame names no camera: the estimate of parts of a frame is finer
                finer = abs(found.offset) <= usual_step(group.recording.frames)
                if before.differs or not (found.differs and finer):
                    cameras[found.camera] = combine_clocks(before, found)
    return tuple(cameras.values())


def frame_numbers(recording: Recording, stretches: Ints) -> Ints:
    """Return the numbers `[stretch, frame]` of frames, also of those that are not there.

    stretches: `[stretch, frame]` indices of the frames of a recording, -1 = no frame.
    """
    step, some = usual_step(recording.frames), (stretches >= 0).argmax(1)
    number = recording.frames[stretches[np.arange(len(stretches)), some]]
    return np.asarray((number - some * step)[:, None] + step * np.arange(stretches.shape[1]))


def _starts(numbers: Ints) -> Ints:
    """Return how many frames `[stretch]` lie before each stretch. numbers: of `frame_numbers`."""
    step = np.diff(numbers[0, :2], append=numbers[0, 0] + 1)[0]
    return np.asarray((numbers[:, 0] - numbers[0, 0]) // step)


def combine_clocks(first: CameraClock, second: CameraClock) -> CameraClock:
    """Return the clock of a camera that, put on the first clock, is still off by a constant."""
    if not second.differs:
        return first if first.differs or second.kind == "not known" else second
    if not first.differs:
        return second
    by = second.offset
    table = tuple((frame - by, offset + by) for frame, offset in first.table)
    changed = replace(first, offset=first.offset + by, table=table)
    if changed.kind == "clock" and changed.offset == 0:
        return CameraClock(first.camera, "in step", evidence=second.evidence)
    return changed


# Recordings on the clocks of their cameras


def retime(recording: Recording, clocks: Clocks) -> Recording:
    """Return the recording with the detections of each camera at the frames that it saw them.

    A recording that is in step is returned as it is.
    """
    if not clocks.changed:
        return recording
    return recording.show(clocks.source, clocks.frames)


def clocks_from(recording: Recording, clocks: Iterable[CameraClock]) -> Clocks:
    """Return which frames cameras show, given how the clocks of some of them differ.

    The common clock has the frames in which two cameras show something. Cameras without a clock in
    `clocks` are on it.
    """
    given = {clock.camera: clock for clock in clocks}
    cameras = tuple(given.get(name, CameraClock(name, "in step")) for name in recording.names)
    if not any(camera.differs for camera in cameras):
        return Clocks.of_one(recording, cameras)
    frames = _common_frames(recording.frames, cameras)
    source = np.stack([_source_of(camera, frames, recording.frames) for camera in cameras])
    shown = (source >= 0).sum(0) >= 2
    return Clocks(
        frames=frames[shown],
        given=recording.frames,
        source=source[:, shown],
        cameras=cameras,
    )


def own_frames(camera: CameraClock, frames: Ints) -> Ints:
    """Return the numbers `[frame]` that a camera gave to frames `[frame]` of the common clock.

    `NO_FRAME` where it has none: of several frames of the common clock, the nearest shows one of a
    slower camera.
    """
    table = np.array(camera.table or ((0, camera.offset),), dtype=np.int64)
    row = np.searchsorted(table[:, 0], frames, side="right") - 1
    offset = table[np.maximum(row, 0), 1]
    counted = frames - table[0, 0]  # a rate is counted from the first frame of the table
    scaled = np.round(counted * camera.rate).astype(np.int64)
    nearest = np.round(scaled / camera.rate).astype(np.int64) == counted
    return np.where(nearest | (camera.rate >= 1.0), table[0, 0] + scaled + offset, NO_FRAME)


def clocks_of_rates(recording: Recording, rates: Mapping[str, float]) -> Clocks:
    """Return the clocks of cameras that have other frame rates, as somebody said.

    rates: name of a camera -> its frames for one of the common clock. All begin together, at the
        first frame of the recording.

    Raises MismatchError where the recording does not have the camera.
    """
    for name in rates:
        find_view(recording, name)
    table = ((int(recording.frames[0]), 0),)
    return clocks_from(
        recording,
        [CameraClock(name, "rate", rate=rate, table=table) for name, rate in rates.items()],
    )


def _common_frames(frames: Ints, cameras: tuple[CameraClock, ...]) -> Ints:
    """Return the frame numbers from the first to the last that any camera may show."""
    offsets = [offset for camera in cameras for _, offset in camera.table] or [0]
    offsets += [camera.offset for camera in cameras]
    step = usual_step(frames)
    before = -(-max(*offsets, 0) // step)
    after = -(min(*offsets, 0) // step)
    early = frames[0] - step * np.arange(before, 0, -1)
    late = frames[-1] + step * np.arange(1, after + 1)
    return np.concatenate([early, frames, late])


def _source_of(camera: CameraClock, frames: Ints, given: Ints) -> Ints:
    """Return the indices `[frame]` into the frames that were given, -1 = the camera has none."""
    own = own_frames(camera, frames)
    # no frame is shown twice: where some were lost, the camera shows nothing for as long
    latest = np.maximum.accumulate(own)
    repeated = np.append(False, own[1:] <= latest[:-1])
    place = np.minimum(np.searchsorted(given, own), len(given) - 1)
    return np.where((given[place] == own) & ~repeated, place, -1)
