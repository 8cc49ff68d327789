"""The order of the stages and nothing else.

sample -> lift -> pairs -> loops -> synchronise, and for each group of cameras that see the same
bodies:
average -> match -> adjust -> label all frames -> clocks -> uncertainty -> triangulate -> verdict
-> smooth -> world.

Where intrinsics are to be estimated, they are from a first rig of each group: average -> match ->
intrinsics. Then everything is done with them from the beginning, as if they had been given.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from mocap_calib.adjust.intrinsics import estimate_cameras
from mocap_calib.adjust.refine import adjust_from_best_start
from mocap_calib.clocks.estimate import calibrate_on_clocks, estimate_clocks
from mocap_calib.clocks.subframe import synchronise_detections
from mocap_calib.compute.clock import Clock
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config, Refinement
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.clock_faults import add_clocks
from mocap_calib.faults.mend import mend_faults
from mocap_calib.identities.track import finalise_identities
from mocap_calib.lift.lift import RememberedLift, lift
from mocap_calib.lift.lifter import Lifter
from mocap_calib.lift.weights import AUTO, choose_model
from mocap_calib.pairs.solve import PairSolver
from mocap_calib.poses.stage import smooth_group
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.recording.synchronise import hide_blind_spots
from mocap_calib.recording.timeline import clocks_of_rates, retime
from mocap_calib.recording.views import choose_refinement
from mocap_calib.results import CalibrationResult, Clocks, GroupResult, Matches, UnusedPair
from mocap_calib.rig.associate import associate, label_all_frames
from mocap_calib.rig.averaging import average, camera_groups
from mocap_calib.rig.large_rigs import calibrate_view_graph
from mocap_calib.rig.loops import select_hypotheses
from mocap_calib.rig.observed import Observed, leave_out_underconstrained
from mocap_calib.rig.triangulate import check_same_cameras
from mocap_calib.training.device import on_device
from mocap_calib.types import CameraRig, Mapper, Progress, Recording, silent
from mocap_calib.verdict.verdict import conclude, judge
from mocap_calib.world.place import place_result
from mocap_calib.world.requested import check_world


def calibrate(
    recording: Recording,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    refine: Refinement | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    mapper: Mapper | None = None,
    pair_solver: PairSolver | None = None,
) -> CalibrationResult:
    """Calibrate each group of cameras that see the same bodies, and triangulate the bodies.

    The rigs are found from a sample of the frames, whose size does not depend on the length of
    the recording. The result does not depend on the number of threads.

    model: lifts the detections, as `lift.weights.choose_model` takes it: "auto", the name
        of a shipped model, a file of weights, "none" for geometry alone, or a loaded lifter.
    refine: which intrinsics are estimated, "none", "focal" or "focal+k1"; None: what `config` says,
        or focal lengths and lenses where nothing is known of the cameras (`AssumedCamera`).
    device: where the network computes, "cpu" or "cuda".
    progress: is told of each step, see `types.Progress`.
    mapper: where the pairs are calibrated; by default threads or processes of this machine.
    pair_solver: how a pair is calibrated; by default `pairs.solve.calibrate_pair`.

    Raises DegenerateError where the recording determines no rig. The cameras of a group that it
    does not determine are left out. Raises FormatError where there is no such model, and
    MismatchError where there is no such device, the model knows too few of the joints,
    intrinsics that nobody knows are not to be estimated, or `config.world` names joints, cameras or
    individuals that the recording lacks: see `world.requested`. Where results do not allow the
    requested coordinates, `World.axes_unmet` and `World.scale_unmet` of the rigs have the reason.
    """
    check_world(config.world, recording, config.matching.individuals)
    intrinsics = choose_refinement(recording.cameras, config.intrinsics, refine)
    config = replace(config, intrinsics=intrinsics)
    recording, lifter = choose_model(recording, model)
    lifter = on_device(lifter, device)
    progress = progress or silent
    clock = Clock()
    lift_sample = RememberedLift(lifter, progress)
    observe = partial(
        _observe,
        lift_sample=lift_sample,
        config=config,
        clock=clock,
        seed=seed,
        progress=progress,
        mapper=mapper,
        pair_solver=pair_solver,
    )
    calibrate_once = partial(
        _calibrate_recording,
        observe=observe,
        config=config,
        clock=clock,
        seed=seed,
        progress=progress,
    )
    with single_threaded_libraries():
        said = clocks_of_rates(recording, dict(config.sync.rates))
        recording = retime(recording, said)
        observed = observe(recording)
        with clock("synchronise"):
            clocks = estimate_clocks(recording, lift_sample, observed.rotations, config, seed=seed)
        calibrated, clocks = calibrate_on_clocks(
            recording, clocks, calibrate_once, config.sync, observed=observed
        )
        recording = retime(recording, clocks)
        last = Clock()
        with last("faults"):
            result = mend_faults(recording, calibrated, calibrate_once)
        with last("smooth"):
            groups = (smooth_group(group, config, progress=progress) for group in result.groups)
            result = replace(result, groups=tuple(groups))
        result = _spent_too(result, last.seconds)
    return place_result(judge(add_clocks(result, clocks.after(said))))


def _spent_too(result: CalibrationResult, seconds: Mapping[str, float]) -> CalibrationResult:
    """Return the result with what was spent on all groups together, by stage."""
    groups = (replace(group, seconds={**group.seconds, **seconds}) for group in result.groups)
    return replace(result, groups=tuple(groups))


def _calibrate_recording(
    recording: Recording,
    observed: Observed | None = None,
    *,
    observe: Callable[[Recording], Observed],
    config: Config,
    clock: Clock,
    seed: int,
    progress: Progress,
) -> tuple[Observed, CalibrationResult]:
    """Calibrate all groups of cameras of a recording; it is observed here where it was not."""
    observed = observed or observe(recording)
    if config.intrinsics.refine != "none":
        with clock("intrinsics"):
            cameras = estimate_cameras(observed, config, progress=progress)
        observed = observe(replace(recording, cameras=cameras))
    groups = _calibrate_groups(observed, config, clock, progress=progress)
    return observed, _join_groups(observed, groups, config=config, seed=seed)


def _observe(
    recording: Recording,
    *,
    lift_sample: RememberedLift,
    config: Config,
    clock: Clock,
    seed: int,
    progress: Progress,
    mapper: Mapper | None,
    pair_solver: PairSolver | None,
) -> Observed:
    """Return what is known before a rig is built: sample -> lift -> pairs -> loops."""
    recording = hide_blind_spots(recording)
    with clock("sample"):
        sample_frames = choose_sample_frames(recording, config.sample)
        sample = take_sample(recording, sample_frames)
    with clock("lift"):
        lifted = lift_sample(sample)
    with clock("pairwise"):
        pairs = calibrate_view_graph(
            sample,
            lifted,
            config,
            rng=np.random.default_rng(seed),
            progress=progress,
            mapper=mapper,
            solve=pair_solver,
        )
    with clock("loops"):
        pairs = select_hypotheses(pairs, config.averaging)
    return Observed(
        recording=recording,
        sample_frames=sample_frames,
        sample=sample,
        lifted=lifted,
        pairs=pairs,
    )


def match(
    recording: Recording,
    rig: CameraRig,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Matches:
    """Label every detection with its individual, given where the cameras stand.

    rig: of the recording's cameras, in their order. The other arguments are those of `calibrate`.

    Raises MismatchError where rig and recording have other cameras, and what `calibrate` raises
    of model and device.
    """
    check_same_cameras(recording, rig)
    recording, lifter = choose_model(hide_blind_spots(recording), model)
    lifter = on_device(lifter, device)
    progress = progress or silent
    with single_threaded_libraries():
        sample_frames = choose_sample_frames(recording, config.sample)
        sample = take_sample(recording, sample_frames)
        lifted = lift(sample, lifter, progress=progress)
        matches = label_all_frames(
            recording,
            rig,
            config,
            sample_frames=sample_frames,
            matches=associate(sample, lifted, rig, config, progress=progress),
            progress=progress,
        )
        return finalise_identities(recording, rig, matches, config)


def _calibrate_groups(
    observed: Observed, config: Config, clock: Clock, *, progress: Progress
) -> list[GroupResult]:
    """Calibrate the groups that can be calibrated, the largest first.

    Raises DegenerateError where there is none.
    """
    groups: list[GroupResult] = []
    refusals: list[DegenerateError] = []
    for views in camera_groups(observed.recording.cameras, observed.pairs, config.averaging):
        work = partial(_calibrate_cameras, config=config, clock=clock, progress=progress)
        try:
            groups.append(leave_out_underconstrained(observed.select(views), work))
        except DegenerateError as error:
            refusals.append(error)
    if not groups:
        raise refusals[0]
    return groups


def _calibrate_cameras(
    observed: Observed, *, config: Config, clock: Clock, progress: Progress
) -> GroupResult:
    """Calibrate cameras that see the same bodies: average -> ... -> triangulate.

    clock: what was spent before; it is not changed.
    """
    clock = clock.continued()
    recording, sample, lifted = observed.recording, observed.sample, observed.lifted
    with clock("average"):
        averaged = average(recording.cameras, observed.pairs, config.averaging)
    with clock("match"):
        matches = associate(sample, lifted, averaged.rig, config, progress=progress)
    with clock("adjust"):
        adjusted = adjust_from_best_start(
            sample, averaged.rig, matches, config, lifted=lifted, progress=progress
        )
    with clock("match all"):
        matches = label_all_frames(
            recording,
            adjusted.rig,
            config,
            sample_frames=observed.sample_frames,
            matches=adjusted.matches,
            progress=progress,
        )
        matches = finalise_identities(recording, adjusted.rig, matches, config)
    with clock("clocks"):
        observed, adjusted, offsets = synchronise_detections(observed, adjusted, matches, config)
    return conclude(
        observed,
        averaged,
        adjusted,
        matches,
        offsets,
        config=config,
        clock=clock,
        progress=progress,
    )


def _join_groups(
    observed: Observed, groups: list[GroupResult], *, config: Config, seed: int
) -> CalibrationResult:
    """Return the groups with the cameras and the pairs that are in none of them."""
    names = observed.recording.names
    group_of = {name: k for k, group in enumerate(groups) for name in group.rig.names}
    unused = (
        UnusedPair(names[pair.a], names[pair.b], pair.score)
        for pair in observed.pairs
        if names[pair.a] not in group_of or group_of[names[pair.a]] != group_of.get(names[pair.b])
    )
    return CalibrationResult(
        groups=tuple(groups),
        left_out=tuple(name for name in names if name not in group_of),
        unused_pairs=tuple(unused),
        config=config,
        seed=seed,
        clocks=Clocks.of_one(observed.recording),
    )
