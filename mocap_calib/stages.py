"""The stages of a calibration, each a function of records; `pipeline` calls them in their order."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.compute import Clock
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import PAIR_SOLVERS, Config, FilterConfig, FilterMethod
from mocap_calib.identities import finalise_identities
from mocap_calib.lift import RememberedLift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.pairs.solve import PairSolver, in_recording
from mocap_calib.paper import choose_pair_solver
from mocap_calib.poses.stage import smooth_poses
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.results import CalibrationResult, Matches, PairwiseCalibration, Poses3D
from mocap_calib.rig import Observed, pairs_among
from mocap_calib.rig.associate import associate, label_all_frames
from mocap_calib.rig.averaging import average as average_pairs
from mocap_calib.rig.triangulate import check_same_cameras, triangulate
from mocap_calib.rig.view_graph import calibrate_view_graph, usable_cameras
from mocap_calib.training import on_device
from mocap_calib.types import Camera, CameraRig, Ints, Mapper, Progress, Recording, silent
from mocap_calib.verdict.verdict import conclude_without_pairs


def pairwise(
    recording: Recording,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    solver: str = PAIR_SOLVERS[0],
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    mapper: Mapper | None = None,
) -> tuple[PairwiseCalibration, ...]:
    """Estimate the relative poses of pairs of cameras, and which of their detections match.

    `config.view_graph` says which pairs. `a` and `b` of a pair are indices into the recording's
    cameras, rotation `[3, 3]` and translation `[3]` are b_from_a, in body sizes; its matches have
    the indices of frames of the recording.

    solver: "search", "paper" (its gradient descent) or "five-point" (its baseline). The other
        arguments are those of `calibrate`.

    Raises what `calibrate` raises of model and device.
    """
    progress = progress or silent
    recording, lifter = choose_model(recording, model, pair_solver=solver)
    solve = choose_pair_solver(solver, recording, lifter, config.pairwise)
    lift_sample = RememberedLift(on_device(lifter, device), progress)
    with single_threaded_libraries():
        observed = observe(
            recording, lift_sample, config, seed=seed, progress=progress, mapper=mapper, solve=solve
        )
    return in_recording(observed.pairs, observed.sample_frames)


def average(
    pairs: Sequence[PairwiseCalibration], cameras: Sequence[Camera], config: Config = Config()
) -> CameraRig:
    """Return the rig that agrees best with all pairs: position and orientation of the cameras.

    The first camera is the world, and lengths are in body sizes. Cameras that no pair connects with
    the others are left out.

    pairs: `a` and `b` are indices into `cameras`.

    Raises DegenerateError where pairs connect no cameras, or several groups of them.
    """
    views = usable_cameras(tuple(cameras), tuple(pairs), config.averaging)
    kept = tuple(cameras[view] for view in views)
    return average_pairs(kept, pairs_among(tuple(pairs), views), config.averaging).rig


def match(
    recording: Recording,
    rig: CameraRig,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Matches:
    """Label every detection with its individual, given the rig.

    rig: of the recording's cameras, in their order. The other arguments are those of `calibrate`.

    Raises MismatchError where rig and recording have other cameras, and what `calibrate` raises
    of model and device.
    """
    check_same_cameras(recording, rig)
    progress = progress or silent
    recording, lifter = choose_model(recording, model)
    lift_sample = RememberedLift(on_device(lifter, device), progress)
    with single_threaded_libraries():
        frames = choose_sample_frames(recording, config.sample)
        sample = take_sample(recording, frames)
        matches = associate(sample, lift_sample(sample), rig, config, progress=progress)
        return label(recording, rig, frames, matches, config, progress=progress)


def bundle_adjust(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    device: str = "cpu",
    progress: Progress | None = None,
) -> tuple[CalibrationResult, Matches]:
    """Adjust a rig to the detections that match, and match again, in turn, until both are stable.

    Returns a result of one group, with errors and verdict of the frames that calibration samples,
    and the matches of all frames by the adjusted rig.

    rig: of the recording's cameras, in their order. matches: of all frames. The other arguments are
    those of `calibrate`.

    Raises MismatchError where rig and recording have other cameras, DegenerateError where the
    matches do not determine the rig, and what `calibrate` raises of model and device.
    """
    check_same_cameras(recording, rig)
    progress = progress or silent
    recording, lifter = choose_model(recording, model)
    lift_sample = RememberedLift(on_device(lifter, device), progress)
    with single_threaded_libraries():
        frames = choose_sample_frames(recording, config.sample)
        sample = take_sample(recording, frames)
        lifted = lift_sample(sample)
        instances = sample.positions.shape[2]  # a frame that is not in the sample may have more
        sampled = matches.select(frames=frames, instances=instances)
        adjusted = adjust_until_stable(
            sample, rig, sampled, config, lifted=lifted, progress=progress
        )
        labelled = label(
            recording, adjusted.rig, frames, adjusted.matches, config, progress=progress
        )
        result = conclude_without_pairs(sample, lifted, rig, adjusted, config)
    return result, labelled


def smooth(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: Config = Config(),
    *,
    progress: Progress | None = None,
) -> Poses3D:
    """Triangulate 3D poses, and fit them to motion and bone lengths, as `config.poses` says.

    Gaps that are short are bridged, and joints that a single camera saw are completed; what is too
    uncertain stays NaN. Lengths are in the rig's unit.

    rig: of the recording's cameras, in their order. matches: of all frames.

    Raises MismatchError where rig and recording have other cameras.
    """
    progress = progress or silent
    poses = triangulate(recording, rig, matches, config.triangulate, progress=progress)
    return smooth_poses(recording, rig, matches, poses, config.poses, progress=progress)[0]


def filter(
    poses: Poses3D,
    method: FilterMethod = FilterConfig.method,
    *,
    fps: float | None = None,
    cutoff: float = FilterConfig.cutoff,
    order: int = FilterConfig.order,
    window: int = FilterConfig.window,
    polynomial: int = FilterConfig.polynomial,
) -> Poses3D:
    """Filter 3D poses over time, without delay; what is missing stays missing, and parts gaps.

    method: "butterworth" (low pass), "median" or "savgol" (Savitzky-Golay).
    fps: frames per second, and cutoff: in Hz; of butterworth.
    order: of butterworth, both directions together, even.
    window: in frames, odd, of median and savgol. polynomial: order of savgol's.

    Raises MismatchError for a cutoff that is not below half of `fps`, or without it, and for a
    window that is longer than the recording.
    """
    from mocap_calib.poses.filters import filter_poses  # noqa: PLC0415 - scipy, which a run does without

    config = FilterConfig(
        method=method, cutoff=cutoff, order=order, window=window, polynomial=polynomial
    )
    return filter_poses(poses, config, fps=fps)


# --- what these and the whole calibration share


def observe(
    recording: Recording,
    lift_sample: RememberedLift,
    config: Config,
    *,
    seed: int,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
    clock: Clock | None = None,
) -> Observed:
    """Return what is known before a rig is built: sample -> lift -> pairs.

    clock: takes the wall time of each. The other arguments are those of `calibrate_view_graph`.
    """
    clock = clock or Clock()
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
            solve=solve,
        )
    return Observed(recording, sample_frames, sample, lifted, pairs)


def label(
    recording: Recording,
    rig: CameraRig,
    sample_frames: Ints,
    matches: Matches,
    config: Config,
    *,
    progress: Progress,
) -> Matches:
    """Return the matches of all frames, by a rig and the matches of a sample of the frames.

    sample_frames: `[frame]` indices into the recording of the frames of the sample.
    """
    labelled = label_all_frames(
        recording, rig, config, sample_frames=sample_frames, matches=matches, progress=progress
    )
    return finalise_identities(recording, rig, labelled, config)
