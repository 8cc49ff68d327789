"""The order of the stages and nothing else.

sample -> lift -> pairs -> loops, and for each group of cameras that see the same bodies:
average -> match -> adjust -> label all frames -> uncertainty -> triangulate.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.multi_view.association import associate, label_all_frames
from mocap_calib.multi_view.averaging import average
from mocap_calib.multi_view.refinement import adjust_from_best_start
from mocap_calib.multi_view.tracking import finalise_identities
from mocap_calib.multi_view.triangulation import check_same_cameras, triangulate
from mocap_calib.multi_view.uncertainty import assess_uncertainty, judge_rig
from mocap_calib.multi_view.view_graph import camera_groups, pairs_among, select_hypotheses
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.steerpose.checkpoint import AUTO, choose_model
from mocap_calib.steerpose.device import check_device
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.model import Lifter
from mocap_calib.two_view.solve import PairSolver, calibrate_pairs, in_recording
from mocap_calib.types import (
    CalibrationResult,
    CameraRig,
    GroupResult,
    Ints,
    LiftedPoses,
    Mapper,
    Matches,
    PairwiseCalibration,
    Progress,
    Recording,
    Sample,
    UnusedPair,
    silent,
)


class Clock:
    """Wall time by stage: `with clock("lift"): ...` adds an entry to `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Take the time of what is done inside the context."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start

    def continued(self) -> "Clock":
        """Return a clock that goes on from the entries of this one."""
        clock = Clock()
        clock.seconds = dict(self.seconds)
        return clock


@dataclass(frozen=True)
class Observed:
    """What is known of some cameras before a rig is built.

    sample_frames: `[frame]` indices into the recording of the frames of the sample.
    lifted: the detections of the sample, lifted. pairs: between these cameras.
    """

    recording: Recording
    sample_frames: Ints
    sample: Sample
    lifted: LiftedPoses
    pairs: tuple[PairwiseCalibration, ...]

    def select(self, views: Ints) -> "Observed":
        """Return what is known of these views (`[view]` indices) alone."""
        return Observed(
            recording=self.recording.select(views=views),
            sample_frames=self.sample_frames,
            sample=self.sample.select(views=views),
            lifted=self.lifted.select(views),
            pairs=pairs_among(self.pairs, views),
        )

    def without(self, camera: str) -> "Observed":
        """Return what is known of all cameras but this one."""
        names = self.recording.names
        return self.select(np.array([v for v, name in enumerate(names) if name != camera]))


def calibrate(
    recording: Recording,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    mapper: Mapper | None = None,
    pair_solver: PairSolver | None = None,
) -> CalibrationResult:
    """Calibrate each group of cameras that see the same bodies, and triangulate the bodies.

    The rigs are found from a sample of the frames, whose size does not depend on the length of
    the recording. The result does not depend on the number of threads.

    model: lifts the detections, as `steerpose.checkpoint.choose_model` takes it: "auto", the name
        of a shipped model, a file of weights, "none" for geometry alone, or a loaded lifter.
    device: where the network computes, "cpu" or "cuda".
    progress: is told of each step, see `types.Progress`.
    mapper: where the pairs are calibrated; by default threads or processes of this machine.
    pair_solver: how a pair is calibrated; by default `two_view.solve.calibrate_pair`.

    Raises DegenerateError where the recording determines no rig. The cameras of a group that it
    does not determine are left out. Raises FormatError where there is no such model, and
    MismatchError where there is no such device or the model knows too few of the joints.
    """
    check_device(device)
    recording, lifter = choose_model(recording, model)
    progress = progress or silent
    clock = Clock()
    with single_threaded_libraries():
        with clock("sample"):
            sample_frames = choose_sample_frames(recording, config.sample)
            sample = take_sample(recording, sample_frames)
        with clock("lift"):
            lifted = lift(sample, lifter, device=device, progress=progress)
        with clock("pairwise"):
            pairs = calibrate_pairs(
                sample,
                lifted,
                config.pairwise,
                rng=np.random.default_rng(seed),
                progress=progress,
                mapper=mapper,
                solve=pair_solver,
            )
        with clock("loops"):
            pairs = select_hypotheses(pairs, config.averaging)
        observed = Observed(
            recording=recording,
            sample_frames=sample_frames,
            sample=sample,
            lifted=lifted,
            pairs=pairs,
        )
        groups = _calibrate_groups(observed, config, clock, seed=seed, progress=progress)
    return _join_groups(recording, pairs, groups, config=config, seed=seed)


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
    check_device(device)
    recording, lifter = choose_model(recording, model)
    progress = progress or silent
    with single_threaded_libraries():
        sample_frames = choose_sample_frames(recording, config.sample)
        sample = take_sample(recording, sample_frames)
        lifted = lift(sample, lifter, device=device, progress=progress)
        return label_all_frames(
            recording,
            rig,
            config,
            sample_frames=sample_frames,
            matches=associate(sample, lifted, rig, config, progress=progress),
            sample=sample,
            lifted=lifted,
            progress=progress,
        )


def _calibrate_groups(
    observed: Observed, config: Config, clock: Clock, *, seed: int, progress: Progress
) -> list[GroupResult]:
    """Calibrate the groups that can be calibrated, the largest first.

    Raises DegenerateError where there is none.
    """
    groups: list[GroupResult] = []
    refusals: list[DegenerateError] = []
    for views in camera_groups(observed.recording.cameras, observed.pairs, config.averaging):
        group = observed.select(views)
        try:
            groups.append(_calibrate_group(group, config, clock, seed=seed, progress=progress))
        except DegenerateError as error:
            refusals.append(error)
    if not groups:
        raise refusals[0]
    return groups


def _calibrate_group(
    observed: Observed, config: Config, clock: Clock, *, seed: int, progress: Progress
) -> GroupResult:
    """Calibrate the cameras of one group that are constrained.

    A camera that sees too little that agrees with others must not cost the others their rig: it
    is left out, and the rest starts again.
    """
    while True:
        own = clock.continued()
        try:
            return _calibrate_cameras(observed, config, own, seed=seed, progress=progress)
        except UnderconstrainedCameraError as error:
            if len(observed.recording.cameras) == 2:
                raise
            observed = observed.without(error.camera)


def _calibrate_cameras(
    observed: Observed, config: Config, clock: Clock, *, seed: int, progress: Progress
) -> GroupResult:
    """Calibrate cameras that see the same bodies: average -> ... -> triangulate."""
    recording, sample, lifted = observed.recording, observed.sample, observed.lifted
    with clock("average"):
        averaged = average(recording.cameras, observed.pairs, config.averaging)
    with clock("match"):
        matches = associate(sample, lifted, averaged.rig, config, progress=progress)
    with clock("adjust"):
        adjusted = adjust_from_best_start(
            sample, averaged.rig, matches, config, lifted=lifted, progress=progress
        )
    rig = adjusted.rig
    with clock("match all"):
        matches = label_all_frames(
            recording,
            rig,
            config,
            sample_frames=observed.sample_frames,
            matches=adjusted.matches,
            sample=sample,
            lifted=lifted,
            progress=progress,
        )
        matches = finalise_identities(recording, rig, matches, config.matching)
    with clock("verdict"):
        instances = sample.positions.shape[2]
        sampled = matches.select(frames=observed.sample_frames, instances=instances)
        uncertainty = assess_uncertainty(sample, rig, sampled, config, seed=seed)
    with clock("triangulate"):
        poses = triangulate(recording, rig, matches, config.triangulate, progress=progress)
    return GroupResult(
        recording=recording,
        pairs=in_recording(observed.pairs, observed.sample_frames),
        averaged=averaged,
        adjusted=adjusted,
        matches=matches,
        uncertainty=uncertainty,
        verdict=judge_rig(uncertainty, config.uncertainty),
        poses=poses,
        seconds=clock.seconds,
    )


def _join_groups(
    recording: Recording,
    pairs: tuple[PairwiseCalibration, ...],
    groups: list[GroupResult],
    *,
    config: Config,
    seed: int,
) -> CalibrationResult:
    """Return the groups with the cameras and the pairs that are in none of them."""
    names = recording.names
    group_of = {name: k for k, group in enumerate(groups) for name in group.rig.names}
    unused = (
        UnusedPair(names[pair.a], names[pair.b], pair.score)
        for pair in pairs
        if names[pair.a] not in group_of or group_of[names[pair.a]] != group_of.get(names[pair.b])
    )
    return CalibrationResult(
        groups=tuple(groups),
        left_out=tuple(name for name in names if name not in group_of),
        unused_pairs=tuple(unused),
        config=config,
        seed=seed,
    )
