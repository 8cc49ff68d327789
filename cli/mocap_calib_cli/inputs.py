"""From what was typed to what the library takes: files and stdin.

Imports numpy and the readers: commands import this module when they run, so that --help is quick.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import cast

import click
import numpy as np

from mocap_calib.clocks.estimate import clocks_from, retime
from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    Config,
    IntrinsicsConfig,
    MatchingConfig,
    MendConfig,
    PairChoice,
    PosesConfig,
    Refinement,
    SampleConfig,
    SmoothMode,
    SyncConfig,
    SyncMode,
    ViewGraphConfig,
)
from mocap_calib.errors import MismatchError, argument, spell_as_option
from mocap_calib.io.cameras.read import load_cameras, make_rig
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.file import decode, read_bytes
from mocap_calib.io.results.further_formats import check_formats
from mocap_calib.io.results.matches_csv import read_matches_csv
from mocap_calib.job.load import KeypointSource, LoadedRecording, load_recording
from mocap_calib.job.steps import CalibrationRequest
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.types import CameraRig, Ints, Recording, Sample
from mocap_calib_cli.describe import describe_recording
from mocap_calib_cli.options import STDIO, SharedOptions
from mocap_calib_cli.progress import Reporter
from mocap_calib_cli.reading import describe_reading
from mocap_calib_cli.texts import parse_rates, read_options, stated_mends
from mocap_calib_cli.world_texts import world_config

# --- keypoints and recordings


def keypoint_source(options: SharedOptions) -> KeypointSource:
    """Return which keypoints are read, and how. Raises MismatchError and click's BadParameter."""
    return KeypointSource(
        paths=options.keypoints,
        format=options.format,
        options=read_options(options),
        aliases=options.skeleton,
        model=options.model,
        mends=stated_mends(options),
    )


def calibration_request(options: SharedOptions, output: Path) -> CalibrationRequest:
    """Return what is asked for, with the cameras of stdin where those are meant.

    Raises click's UsageError, also for further formats that could not be written in the end.
    """
    world = world_config(options)
    try:
        fps, _ = parse_rates(options.fps)
        check_formats(options.write, fps, world.stated_unit)
    except MismatchError as error:
        raise click.UsageError(error.render(spell_as_option)) from None
    intrinsics = intrinsics_config(options)
    return CalibrationRequest(
        keypoints=keypoint_source(options),
        cameras=_intrinsics_source(options.cameras),
        output=output,
        pair_solver=options.solver,
        seed=options.seed,
        device=options.device,
        config=Config(
            view_graph=view_graph_config(options),
            intrinsics=intrinsics,
            matching=MatchingConfig(individuals=options.individuals),
            mend=MendConfig(apply=options.mend != "none"),
            sync=sync_config(options),
            world=world,
            poses=PosesConfig(smooth=cast(SmoothMode, options.smooth)),
        ),
        formats=options.write,
        fps=fps,
        report=options.report,
        reading=describe_reading(options),
    )


def view_graph_config(options: SharedOptions) -> ViewGraphConfig:
    """Return which pairs of cameras are calibrated."""
    return ViewGraphConfig(pairs=cast(PairChoice, options.pairs))


def sync_config(options: SharedOptions) -> SyncConfig:
    """Return what is done about clocks that differ. Raises click's BadParameter."""
    of_all, single = parse_rates(options.fps)
    rates = tuple((camera, rate / (of_all or rate)) for camera, rate in single.items())
    mode = cast(SyncMode, options.sync)
    return SyncConfig(mode=mode, window=options.sync_window, rates=rates)


def intrinsics_config(options: SharedOptions) -> IntrinsicsConfig:
    """Return which intrinsics are estimated. Raises click's UsageError."""
    refine = options.refine or ("none" if options.cameras else ASSUMED_REFINEMENT)
    if refine == "none" and not options.cameras:
        raise click.UsageError(
            "--refine none: expected intrinsics that stay as they are, found none; "
            "give --cameras, or leave it out"
        )
    if refine == "none" and (options.focal_uncertainty or options.focal_per_camera):
        option = "--focal-uncertainty" if options.focal_uncertainty else "--focal-per-camera"
        raise click.UsageError(
            f"{option}: expected focal lengths that are estimated, found none; say --refine focal"
        )
    default = IntrinsicsConfig()
    return IntrinsicsConfig(
        refine=cast(Refinement, refine),
        focal_uncertainty=options.focal_uncertainty or default.focal_uncertainty,
        focal_per_camera=options.focal_per_camera,
    )


def _intrinsics_source(cameras: str) -> Path | bytes | None:
    """Return the file of the intrinsics, or its content on stdin; None where there is none."""
    if cameras == STDIO:
        return read_stdin("--cameras").encode()
    return Path(cameras) if cameras else None


def read_recording(
    options: SharedOptions, cameras: CameraFile, reporter: Reporter, *, of_rig: bool = False
) -> LoadedRecording:
    """Read the keypoints of the cameras, and say which file went to which camera.

    of_rig: the cameras are those of a rig, which may have left some out; the keypoints of those
        are left out too.

    Raises FormatError and MismatchError.
    """
    loaded = load_recording(keypoint_source(options), cameras, only_known_cameras=of_rig)
    reporter.say(*describe_recording(loaded.summary))
    return loaded


def read_recording_of_rig(
    options: SharedOptions, reporter: Reporter
) -> tuple[CameraRig, LoadedRecording]:
    """Read a rig and the keypoints of its cameras; the rig has those with keypoints alone.

    They are put on one clock, where the rig says that those of its cameras differ. Where a camera
    was moved, the recording has the frames alone for which the rig holds.

    Raises FormatError and MismatchError.
    """
    given, file = read_rig(options.rig, "--rig")
    rig, loaded = read_recording_of(given, file, options, reporter)
    held = _frames_of_rig(loaded.recording, file, reporter)
    return rig, replace(loaded, recording=loaded.recording.select(frames=held))


def read_matched_recording(
    options: SharedOptions, reporter: Reporter
) -> tuple[CameraRig, LoadedRecording, Matches, list[int] | None]:
    """Read a rig, the keypoints of its cameras, and identities; see `read_recording_of_rig`.

    Returns also the first and the last frame that the rig holds for, None = all.

    Raises FormatError and MismatchError.
    """
    given, file = read_rig(options.rig, "--rig")
    rig, loaded = read_recording_of(given, file, options, reporter)
    matches = read_matches(options.matches, loaded)
    held = _frames_of_rig(loaded.recording, file, reporter)
    part = replace(loaded, recording=loaded.recording.select(frames=held))
    return rig, part, matches.select(frames=held), file.judgement.get("frames")


def read_recording_of(
    rig: CameraRig, camera_file: CameraFile, options: SharedOptions, reporter: Reporter
) -> tuple[CameraRig, LoadedRecording]:
    """Read the keypoints of a rig, on one clock, in all frames.

    camera_file: all that the file of the rig says.
    """
    loaded = read_recording(options, camera_file, reporter, of_rig=True)
    rig = _rig_of_recording(rig, loaded.recording)
    clocks = clocks_from(loaded.recording, rig.clocks)
    return rig, replace(loaded, recording=retime(loaded.recording, clocks), clocks=clocks)


def _frames_of_rig(recording: Recording, file: CameraFile, reporter: Reporter) -> Ints:
    """Return the frames (indices) for which a rig holds: all, unless its file says which.

    Raises MismatchError where there are none.
    """
    first, last = file.judgement.get("frames", recording.frames[[0, -1]])
    held = np.flatnonzero((recording.frames >= first) & (recording.frames <= last))
    if not len(held):
        raise MismatchError(
            argument("rig"),
            f"frames {first} to {last}, for which it holds, as a camera was moved",
            f"{recording.frames[0]} to {recording.frames[-1]}",
            "give the rig of these frames",
        )
    if len(held) < len(recording.frames):
        reporter.say(f"frames {first} to {last}: a camera was moved, the rig holds for these alone")
    return held


def lift_sample(
    loaded: LoadedRecording, device: str, reporter: Reporter, *, pair_solver: str = "search"
) -> tuple[Ints, Sample, LiftedPoses]:
    """Return the `[frame]` indices that calibration looks at, their detections, and those lifted.

    pair_solver: what will calibrate the pairs, see `lift.lifter.load_model`.

    Raises MismatchError where there is no such device.
    """
    sample_frames = choose_sample_frames(loaded.recording, SampleConfig())
    sample = take_sample(loaded.recording, sample_frames)
    model = loaded.recording.model
    lifted = lift_with_model(sample, model, device, reporter, pair_solver=pair_solver)
    return sample_frames, sample, lifted


def lift_with_model(
    sample: Sample, model: str, device: str, reporter: Reporter, *, pair_solver: str = "search"
) -> LiftedPoses:
    """Lift the detections of a sample. Raises MismatchError where there is no such device."""
    from mocap_calib.lift import lift
    from mocap_calib.lift.lifter import load_model
    from mocap_calib.training import on_device

    lifter = on_device(load_model(model, pair_solver=pair_solver), device)
    return lift(sample, lifter, progress=reporter)


# --- cameras and matches


def load_camera_file(path: str, option: str) -> CameraFile:
    """Return what a file, a folder or stdin says of cameras. Raises FormatError."""
    if path == STDIO:
        return load_cameras(read_stdin(option).encode())
    return load_cameras(Path(path))


def read_rig(path: str, option: str) -> tuple[CameraRig, CameraFile]:
    """Return the cameras and where they stand, and all that their file says.

    Raises FormatError.
    """
    found = load_camera_file(path, option)
    return make_rig(found, "stdin" if path == STDIO else path), found


def read_matches(path: str, loaded: LoadedRecording) -> Matches:
    """Return the matches in a file or on stdin. Raises FormatError and MismatchError.

    loaded: on the clock of its rig.
    """
    source = read_stdin("--matches") if path == STDIO else Path(path)
    return read_matches_csv(source, loaded.recording, loaded.clocks)


def _rig_of_recording(rig: CameraRig, recording: Recording) -> CameraRig:
    """Return the rig with the cameras of the recording alone, in their order."""
    return replace(rig.select(recording.names), cameras=recording.cameras)


# --- stdin


def read_text(path: str, what: str) -> str:
    """Return the text of a file or of stdin. Raises FormatError.

    what: the argument that names the file.
    """
    return read_stdin(what) if path == STDIO else decode(read_bytes(Path(path)), path)


def read_stdin(what: str) -> str:
    """Return all of stdin, for one input of the command."""
    meta = click.get_current_context().meta
    if "stdin" in meta:
        raise click.UsageError(
            f"{meta['stdin']} and {what} cannot both come from stdin; give a file for one of them"
        )
    meta["stdin"] = what
    return decode(sys.stdin.buffer.read(), "stdin")
