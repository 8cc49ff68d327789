"""The order of the stages and nothing else.

sample -> lift -> pairs -> synchronise, and for each group of cameras that see the same
bodies:
average -> match -> adjust -> label all frames -> clocks -> uncertainty -> triangulate; then
faults -> smooth -> verdict -> world.

Where intrinsics are to be estimated, they are from a first rig of each group: average -> match ->
intrinsics. Then everything is done with them from the beginning, as if they had been given.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from mocap_calib.adjust.intrinsics import estimate_cameras
from mocap_calib.adjust.refine import adjust_from_best_start
from mocap_calib.clocks.estimate import (
    calibrate_on_clocks,
    clocks_of_rates,
    estimate_clocks,
    retime,
)
from mocap_calib.clocks.subframe import synchronise_detections
from mocap_calib.compute import Clock
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config, Refinement
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.mend import add_clocks, confirm_clocks, mend_faults
from mocap_calib.lift import RememberedLift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.pairs.solve import PairSolver
from mocap_calib.poses.stage import smooth_group
from mocap_calib.recording.names import choose_refinement
from mocap_calib.results import CalibrationResult, Clocks, GroupResult, UnusedPair
from mocap_calib.rig import Observed, leave_out_underconstrained
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average
from mocap_calib.rig.view_graph import camera_groups
from mocap_calib.stages import label, observe
from mocap_calib.training import on_device
from mocap_calib.types import Mapper, Progress, Recording, silent
from mocap_calib.verdict.verdict import conclude, judge
from mocap_calib.world.place import check_world, place_result


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

    model: lifts the detections, as `lift.lifter.choose_model` takes it: "auto", the name
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
    individuals that the recording lacks: see `world.place`. Where results do not allow the
    requested coordinates, `World.axes_unmet` and `World.scale_unmet` of the rigs have the reason.
    """
    check_world(config.world, recording, config.matching.individuals)
    intrinsics = choose_refinement(recording.cameras, config.intrinsics, refine)
    config = replace(config, intrinsics=intrinsics)
    recording, lifter = choose_model(recording, model)
    progress = progress or silent
    lift_sample = RememberedLift(on_device(lifter, device), progress)
    calibrator = _Calibrator(config, lift_sample, seed, progress, mapper, pair_solver)
    with single_threaded_libraries():
        stated = clocks_of_rates(recording, dict(config.sync.rates))
        recording = retime(recording, stated)
        observed = calibrator.observe(recording)
        with calibrator.clock("synchronise"):
            found = estimate_clocks(recording, lift_sample, observed.rotations, config, seed=seed)
        calibrated, clocks = calibrate_on_clocks(
            recording, found, calibrator, config.sync, observed=observed
        )
        calibrated, clocks = confirm_clocks(
            recording, calibrated, clocks, partial(calibrator, observed=observed)
        )
        last = Clock()
        with last("faults"):
            result = mend_faults(retime(recording, clocks), calibrated, calibrator)
        with last("smooth"):
            groups = [smooth_group(group, config, progress=progress) for group in result.groups]
    groups = [replace(group, seconds={**group.seconds, **last.seconds}) for group in groups]
    result = add_clocks(replace(result, groups=tuple(groups)), clocks.after(stated))
    return place_result(judge(result))


@dataclass(frozen=True)
class _Calibrator:
    """Calibrates a recording, and what is made of it, each time in the same way.

    The fields are as in `calibrate`. clock: wall time by stage of all that was calibrated so far.
    """

    config: Config
    lift_sample: RememberedLift
    seed: int
    progress: Progress
    mapper: Mapper | None
    pair_solver: PairSolver | None
    clock: Clock = field(default_factory=Clock)

    def __call__(
        self, recording: Recording, observed: Observed | None = None
    ) -> tuple[Observed, CalibrationResult]:
        """Calibrate all groups of cameras of a recording; it is observed here where it was not.

        Raises DegenerateError where no group can be calibrated.
        """
        observed = observed or self.observe(recording)
        if self.config.intrinsics.refine != "none":
            with self.clock("intrinsics"):
                cameras = estimate_cameras(observed, self.config, progress=self.progress)
            observed = self.observe(replace(recording, cameras=cameras))
        groups: list[GroupResult] = []
        refusals: list[DegenerateError] = []
        averaging = self.config.averaging
        for views in camera_groups(observed.recording.cameras, observed.pairs, averaging):
            try:
                group = leave_out_underconstrained(observed.select(views), self._calibrate_group)
                groups.append(group)
            except DegenerateError as error:
                refusals.append(error)
        if not groups:
            raise refusals[0]
        return observed, self._join(groups, observed)

    def observe(self, recording: Recording) -> Observed:
        """Return what is known before a rig is built, see `stages.observe`."""
        return observe(
            recording,
            self.lift_sample,
            self.config,
            seed=self.seed,
            progress=self.progress,
            mapper=self.mapper,
            solve=self.pair_solver,
            clock=self.clock,
        )

    def _calibrate_group(self, observed: Observed) -> GroupResult:
        """Calibrate cameras that see the same bodies: average -> ... -> triangulate."""
        config, progress, clock = self.config, self.progress, Clock(self.clock.seconds)
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
            matches = label(
                recording,
                adjusted.rig,
                observed.sample_frames,
                adjusted.matches,
                config,
                progress=progress,
            )
        with clock("clocks"):
            observed, adjusted, offsets = synchronise_detections(
                observed, adjusted, matches, config
            )
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

    def _join(self, groups: list[GroupResult], observed: Observed) -> CalibrationResult:
        """Return the groups with the cameras and the pairs that are in none of them."""
        names = observed.recording.names
        group_of = {name: k for k, group in enumerate(groups) for name in group.rig.names}
        ends = ((names[pair.a], names[pair.b], pair.score) for pair in observed.pairs)
        return CalibrationResult(
            groups=tuple(groups),
            left_out=tuple(name for name in names if name not in group_of),
            unused_pairs=tuple(
                UnusedPair(a, b, score)
                for a, b, score in ends
                if a not in group_of or group_of[a] != group_of.get(b)
            ),
            config=self.config,
            seed=self.seed,
            clocks=Clocks.of_one(observed.recording),
        )
