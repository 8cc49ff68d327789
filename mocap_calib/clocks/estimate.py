"""Estimate how the clocks of cameras differ, from lifted bodies, before there is a rig.

Under the rotations of pairs calibrated with the frame numbers as they are, bodies of synchronous
cameras agree best at equal numbers. Only where a camera does not are the rotations searched for
with the time left open: search -> maps -> align the bodies at these maps -> maps.

A camera stays as it is unless the evidence for another clock is decisive.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from mocap_calib.clocks.compare import (
    LEAST_FRAMES,
    Pair,
    compared_pairs,
    search_rotation,
    views_in_time,
)
from mocap_calib.clocks.evidence import (
    Agreements,
    Timing,
    combine_clocks,
    describe_clock,
    frame_numbers,
    standardise,
    weigh,
)
from mocap_calib.clocks.follow import (
    agreement_values,
    find_timing,
    is_better,
    scaled_agreements,
    solve_maps,
)
from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import Config, SyncConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import skew
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.lift.lift import lift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.recording.sampling import choose_stretches, take_sample, usual_step
from mocap_calib.recording.timeline import clocks_from, clocks_of_rates, retime
from mocap_calib.results import CalibrationResult, Clocks, GroupResult, LiftedPoses, Matches
from mocap_calib.rig.large_rigs import calibrate_view_graph
from mocap_calib.rig.tracks import gather_tracks
from mocap_calib.training import on_device
from mocap_calib.types import (
    CameraClock,
    CameraRig,
    Floats,
    Ints,
    Progress,
    Recording,
    Sample,
    silent,
)

T = TypeVar("T")  # what is observed of a recording
Calibrate = Callable[[Recording, T | None], tuple[T, CalibrationResult]]
_ROUNDS = 4  # of calibrating again on refined clocks
_REACH = 15  # frames: offsets that are compared by a rig, early and late
_LOSS_SCALE = 1.5  # median distances of rays, at which the loss turns


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
        before, clocks = (
            clocks,
            clocks_from(recording, refine_clocks(calibrated[1].groups, clocks.cameras, config)),
        )
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
    given = {pair: rotations[pair] for pair in compared if pair in rotations}
    as_numbered = agreement_values(views, given)
    if given:
        agreements = scaled_agreements(as_numbered, as_numbered, len(views), window)
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
    values, timing = solve_maps(views, dict(zip(compared, searched, strict=True)), window)
    if given:
        # bodies of a gait also match half a cycle apart, under rotations that are turned by 180 deg
        near = solve_maps(views, given, window)
        if not is_better((values, timing), near):
            values, timing = near
    agreements = scaled_agreements(values, values, len(views), window)
    in_step = scaled_agreements(values | as_numbered, values, len(views), window)
    return _cameras(recording.names, numbers, timing, agreements, in_step)


def refine_clocks(
    groups: Sequence[GroupResult], clocks: Sequence[CameraClock], config: SyncConfig
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera, refined by the rigs that were found on these clocks."""
    cameras = {camera.camera: camera for camera in clocks}
    for group in groups:
        stretches = choose_stretches(group.recording, config)
        numbers = frame_numbers(group.recording, stretches)
        window = min(config.window, stretches.shape[1] // 3)
        rig = group.adjusted.rig
        agreements = _agreements_of_rig(group.recording, rig, group.matches, stretches, window)
        if agreements.values:
            timing = find_timing(agreements, constant=True)
            for found in _cameras(rig.names, numbers, timing, agreements, agreements):
                before = cameras[found.camera]
                # one frame names no camera: the estimate of parts of a frame is finer
                finer = abs(found.offset) <= usual_step(group.recording.frames)
                if before.differs or not (found.differs and finer):
                    cameras[found.camera] = combine_clocks(before, found)
    return tuple(cameras.values())


def _cameras(
    names: Sequence[str],
    numbers: Ints,
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


def _agreements_of_rig(
    recording: Recording, rig: CameraRig, matches: Matches, stretches: Ints, window: int
) -> Agreements:
    """Return how nearly the rays of pairs of views meet in any two frames up to a window apart.

    The mean log likelihood of the keypoints; pairs that share none are left out. How nearly rays of
    two cameras meet at other offsets of the clocks shows whole frames, as far as bodies move.

    matches: labels in all frames. stretches: `[stretch, frame]` indices, -1 = no frame.
    """
    window, rays = min(window, _REACH), _rays(recording, matches, stretches)
    planes = {
        (a, b): _epipolar_planes(rays[a], rays[b], *rig.relative(a, b))
        for a, b in compared_pairs(len(rig))
    }
    angles = {pair: _synchronous_angles(*each) for pair, each in planes.items()}
    known = [pair for pair, each in angles.items() if len(each)]
    scale = _LOSS_SCALE * float(np.median([np.median(angles[pair]) for pair in known] or 1.0))
    time = np.arange(stretches.shape[1])[:, None]
    column = time + np.arange(-window, window + 1)
    row, offset = np.nonzero((column >= 0) & (column < len(time)))
    values = {}
    for pair in known:
        table = np.empty((*stretches.shape, 2 * window + 1))
        kernels.mean_epipolar_likelihood(*contiguous(*planes[pair]), scale, table)
        whole = np.full((len(table), len(time), len(time)), np.nan, np.float32)
        whole[:, row, column[row, offset]] = table[:, row, offset]
        values[pair] = standardise(whole, whole)
    return Agreements(len(rig), values, window)


def _rays(recording: Recording, matches: Matches, stretches: Ints) -> Floats:
    """Return the unit rays `[view, stretch, frame, point, 3]` of all labelled keypoints."""
    frames = np.unique(stretches[stretches >= 0])
    rays = gather_tracks(recording, matches, frames).rays
    rays = np.moveaxis(rays.reshape(len(rays), 3, len(frames), -1), 1, -1)
    place = np.searchsorted(frames, np.maximum(stretches, frames[0]))
    return np.where((stretches >= 0)[..., None, None], rays[:, place], np.nan)


def _epipolar_planes(
    a: Floats, b: Floats, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the normals of the epipolar planes of rays of a, rays of b, and squares of both.

    Two rays miss each other by the angle normal . ray / sqrt(square of a + square of b).

    a, b: `[stretch, frame, point, 3]` rays. rotation, translation: of b_from_a.
    """
    essential = skew(translation) @ rotation
    normal = a @ essential.T
    return normal, b, (normal**2).sum(-1), ((b @ essential) ** 2).sum(-1)


def _synchronous_angles(normal: Floats, ray: Floats, square_a: Floats, square_b: Floats) -> Floats:
    """Return the angles `[N]` by which rays of equal frame numbers miss each other."""
    angle = np.abs((normal * ray).sum(-1)) / np.sqrt(square_a + square_b)
    return angle[np.isfinite(angle)]
