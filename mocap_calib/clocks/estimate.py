"""Estimate how the clocks of cameras differ, from lifted bodies, before there is a rig.

Under the rotations of pairs calibrated with the frame numbers as they are, bodies of synchronous
cameras agree best at equal numbers. Only where a camera does not are the rotations searched for
with the time left open: search -> maps -> align the bodies at these maps -> maps.

A camera stays as it is unless the evidence for another clock is decisive.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from mocap_calib.clocks.compare import (
    LEAST_FRAMES,
    Pair,
    Singles,
    ViewInTime,
    agreement,
    align_at,
    compared_pairs,
    search_rotation,
    views_in_time,
)
from mocap_calib.clocks.describe import StretchNumbers, combine_clocks, describe_clock
from mocap_calib.clocks.evidence import (
    DECISIVE,
    Agreements,
    Timing,
    evidence,
    standardise,
    weigh,
)
from mocap_calib.clocks.follow import find_timing
from mocap_calib.clocks.refine import agreements_of_rig
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import Config, SyncConfig
from mocap_calib.errors import MismatchError
from mocap_calib.lift.lift import lift
from mocap_calib.lift.lifter import Lifter
from mocap_calib.lift.weights import AUTO, choose_model
from mocap_calib.recording.sampling import choose_stretches, take_sample
from mocap_calib.recording.timeline import clocks_from, clocks_of_rates, retime
from mocap_calib.results import CalibrationResult, Clocks, GroupResult, LiftedPoses
from mocap_calib.rig.large_rigs import calibrate_view_graph
from mocap_calib.training.device import on_device
from mocap_calib.types import CameraClock, Floats, Ints, Progress, Recording, Sample, silent

T = TypeVar("T")  # what is observed of a recording
Calibrate = Callable[[Recording, T | None], tuple[T, CalibrationResult]]
_ROUNDS = 4  # of calibrating again on refined clocks


def compare_clocks(
    recording: Recording,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Clocks:
    """Return how the clocks of the cameras differ, by lifted bodies; nothing is changed.

    The arguments are those of `calibrate`. Raises FormatError where there is no such model, and
    MismatchError where there is no such device.
    """
    recording, lifter = choose_model(recording, model)
    said = clocks_of_rates(recording, dict(config.sync.rates))
    recording, progress = retime(recording, said), progress or silent
    stretches = choose_stretches(recording, config.sync)
    sample = take_sample(recording, stretches[stretches >= 0])
    with single_threaded_libraries():
        try:
            lifted = lift(sample, on_device(lifter, device), progress=progress)
        except MismatchError:  # the model knows too few of the joints
            return Clocks.of_one(recording).after(said)
        rng = np.random.default_rng(seed)
        pairs = calibrate_view_graph(sample, lifted, config, rng=rng, progress=progress)
        rotations = {(pair.a, pair.b): pair.rotation for pair in pairs}
        found = find_clocks(recording, lifted, stretches, rotations, config.sync, seed=seed)
    return Clocks.of_one(recording, found).after(said)


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
    stretches = choose_stretches(recording, config.sync)
    sample = take_sample(recording, stretches[stretches >= 0])
    try:
        lifted = lift_sample(sample)
    except MismatchError:  # the model knows too few of the joints: reported where they are needed
        return unknown
    return find_clocks(recording, lifted, stretches, rotations, config.sync, seed=seed)


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
    if config.mode == "check":
        calibrated = calibrate(recording, observed)
        if not any(camera.differs for camera in cameras):
            cameras = refine_clocks(calibrated[1].groups, cameras, config)
        return calibrated, Clocks.of_one(recording, cameras)
    clocks = clocks_from(recording, cameras)
    calibrated = calibrate(retime(recording, clocks), None if clocks.changed else observed)
    if config.mode == "off":
        return calibrated, clocks
    for _ in range(_ROUNDS):
        cameras = refine_clocks(calibrated[1].groups, clocks.cameras, config)
        before, clocks = clocks, clocks_from(recording, cameras)
        if _show_same(before, clocks):
            break
        calibrated = calibrate(retime(recording, clocks), None)
    return calibrated, clocks


def _show_same(first: Clocks, second: Clocks) -> bool:
    """Return whether two clocks show the same frames."""
    same = np.array_equal(first.frames, second.frames)
    return same and np.array_equal(first.source, second.source)


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
    numbers = StretchNumbers.of(recording, stretches)
    given = {pair: rotations[pair] for pair in compared if pair in rotations}
    as_numbered = _values(views, given)
    if given:
        agreements = _agreements(as_numbered, as_numbered, len(views), window)
        cameras = _cameras(
            recording.names, numbers, find_timing(agreements), agreements, agreements
        )
        if all(camera.kind == "in step" for camera in cameras):
            return cameras
    generators = np.random.default_rng(seed).spawn(len(compared))
    searched = map_in_threads(
        lambda job: search_rotation(views[job[0][0]], views[job[0][1]], 2 * window, job[1]),
        zip(compared, generators, strict=True),
    )
    values, timing = _solve(views, dict(zip(compared, searched, strict=True)), window)
    if given:
        # bodies of a gait also match half a cycle apart, under rotations that are turned by 180 deg
        near = _solve(views, given, window)
        if not _is_better((values, timing), near):
            values, timing = near
    agreements = _agreements(values, values, len(views), window)
    in_step = _agreements(values | as_numbered, values, len(views), window)
    return _cameras(recording.names, numbers, timing, agreements, in_step)


Solution = tuple[dict[Pair, Singles], Timing]


def _solve(views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], window: int) -> Solution:
    """Return the agreement of pairs and the maps, both fitted in turn from given rotations on."""
    for _ in range(2):
        values = _values(views, rotations)
        timing = find_timing(_agreements(values, values, len(views), window))
        rotations = _align_at_maps(views, rotations, timing)
    values = _values(views, rotations)
    return values, find_timing(_agreements(values, values, len(views), window))


def _is_better(found: Solution, than: Solution) -> bool:
    """Return whether bodies agree decisively better in one solution than in another one."""
    first, second = (_along_maps(each, found[0].keys() & than[0].keys()) for each in (found, than))
    shown = np.isfinite(first) & np.isfinite(second)
    return evidence(first - second, shown) >= DECISIVE


def _along_maps(solution: Solution, pairs: Iterable[Pair]) -> Floats:
    """Return the mean agreement `[stretch, frame]` of pairs at the times of the maps."""
    values, timing = solution
    total, count = np.zeros(timing.maps.shape[1:]), np.zeros(timing.maps.shape[1:])
    for a, b in pairs:
        own_a, own_b = timing.maps[a], timing.maps[b]
        stretch = np.arange(len(own_a))[:, None]
        agreement = values[a, b][stretch, np.maximum(own_a, 0), np.maximum(own_b, 0)]
        known = (own_a >= 0) & (own_b >= 0) & np.isfinite(agreement)
        total += np.where(known, agreement, 0.0)
        count += known
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def refine_clocks(
    groups: Sequence[GroupResult], clocks: Sequence[CameraClock], config: SyncConfig
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera, refined by the rigs that were found on these clocks."""
    cameras = {camera.camera: camera for camera in clocks}
    for group in groups:
        stretches = choose_stretches(group.recording, config)
        numbers = StretchNumbers.of(group.recording, stretches)
        window = min(config.window, stretches.shape[1] // 3)
        rig = group.adjusted.rig
        agreements = agreements_of_rig(group.recording, rig, group.matches, stretches, window)
        if agreements.values:
            timing = find_timing(agreements, constant=True)
            for found in _cameras(rig.names, numbers, timing, agreements, agreements):
                before = cameras[found.camera]
                # one frame names no camera: the estimate of parts of a frame is finer
                if before.differs or not found.differs or abs(found.offset) > numbers.step:
                    cameras[found.camera] = combine_clocks(before, found)
    return tuple(cameras.values())


def _values(views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats]) -> dict[Pair, Singles]:
    """Return the agreement of pairs of views under rotations b_from_a."""
    return {(a, b): agreement(views[a], views[b], turn) for (a, b), turn in rotations.items()}


def _agreements(
    values: Mapping[Pair, Singles], like: Mapping[Pair, Singles], views: int, window: int
) -> Agreements:
    """Return agreement in standard deviations of that of the same pairs in `like`."""
    scaled = {pair: standardise(each, like[pair]) for pair, each in values.items()}
    return Agreements(views, scaled, window)


def _align_at_maps(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], timing: Timing
) -> dict[Pair, Floats]:
    """Return the rotations of pairs that align their bodies at the times of the maps."""
    return {
        (a, b): align_at(views[a], views[b], turn, timing.maps[a], timing.maps[b])
        for (a, b), turn in rotations.items()
    }


def _cameras(
    names: Sequence[str],
    numbers: StretchNumbers,
    timing: Timing,
    agreements: Agreements,
    in_step: Agreements,
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera.

    Cameras of which nothing decisive is found stay as they are. Then the others are judged again:
    each must also differ from the cameras that stay.
    """
    synchronous = Timing.synchronous(agreements)
    stay = np.zeros(len(names), dtype=bool)
    while True:
        cameras = tuple(
            describe_clock(
                name,
                timing,
                view,
                numbers,
                weigh(agreements, in_step, timing, view),
                window=agreements.window,
            )
            for view, name in enumerate(names)
        )
        differ = np.array([camera.differs for camera in cameras])
        if (differ | stay).all() or not differ.any():
            return cameras
        stay = ~differ
        kept = stay[:, None, None]
        timing = Timing(
            np.where(kept, synchronous.maps, timing.maps),
            np.where(stay, 1.0, timing.rates),
            np.where(kept, 0.0, timing.agreement),
        )
