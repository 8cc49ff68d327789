"""From what was typed to what the library takes: files and stdin.

Imports numpy and the readers: commands import this module when they run, so that --help is quick.
"""

import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocap_calib.clocks.estimate import clocks_from, retime
from mocap_calib.config import (
    ASSUMED_REFINEMENT,
    Config,
    IntrinsicsConfig,
    KnownCamera,
    MatchingConfig,
    MendConfig,
    PosesConfig,
    ScaleCue,
    SyncConfig,
    UncertaintyConfig,
    ViewGraphConfig,
    WorldConfig,
)
from mocap_calib.errors import MismatchError, argument
from mocap_calib.faults.hypotheses import describe_corrected
from mocap_calib.faults.image_sizes import turn_rig
from mocap_calib.io.camera_files import load_cameras, make_rig
from mocap_calib.io.camera_files import read_rig as read_rig_of
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.file import decode
from mocap_calib.io.landmarks_csv import read_landmarks
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.results.further_formats import check_formats
from mocap_calib.io.results.matches_csv import read_matches_csv
from mocap_calib.job.load import KeypointSource, LoadedRecording, load_recording
from mocap_calib.job.steps import CalibrationRequest
from mocap_calib.recording.corrections import (
    Exchanged,
    Flipped,
    Mirrored,
    Moved,
    Resized,
    Rotated,
    Sides,
)
from mocap_calib.types import ARBITRARY, CameraRig, Ints, Recording
from mocap_calib_cli.describe import describe_recording
from mocap_calib_cli.names import WORLD
from mocap_calib_cli.option_files import is_list
from mocap_calib_cli.options import KEYPOINTS, SCALE, SHARED
from mocap_calib_cli.outputs import STDIO
from mocap_calib_cli.screen import Reporter
from mocap_calib_cli.typed import Texts, Typed, refused_as_usage

# --- keypoints and recordings

# kept in run.json, so that a report can read the keypoints again
_KEPT = (*KEYPOINTS, "skeleton", "model")
_OF_INTRINSICS = ("rotated", "resized", "exchanged")  # the cameras of results have these already


def read_options(typed: Typed) -> ReadOptions:
    """Return how keypoint files are read."""
    sizes = dict(typed.image_size)
    return ReadOptions(
        layout=typed.layout or (),
        image_size=sizes.pop("", (0, 0)),
        image_sizes=sizes,
        camera_pattern=typed.camera_regex or "",
        frame_offset=dict(typed.frame_offset),
        crop_offset=dict(typed.crop_offset),
        views=typed.views or (),
    )


def keypoint_source(typed: Typed) -> KeypointSource:
    """Return which keypoints are read, and how.

    Images are turned before they are resized, intrinsics are corrected before detections, and a
    camera that moved is split in the end.
    """
    return KeypointSource(
        paths=typed.keypoints,
        format=typed.format,
        options=read_options(typed),
        aliases=typed.skeleton,
        model=typed.model,
        mends=(
            *starmap(Exchanged, typed.exchanged),
            *map(Mirrored, typed.mirrored),
            *map(Flipped, typed.flipped),
            *map(Sides, typed.sides),
            *starmap(Rotated, dict(typed.rotated).items()),
            *(Resized(camera, *factors) for camera, factors in dict(typed.resized).items()),
            *starmap(Moved, typed.moved),
        ),
    )


def describe_reading(typed: Typed) -> dict[str, Any]:
    """Return the texts that say how keypoints are read, for run.json."""
    return {
        name: texts if is_list(SHARED[name]) else texts[0]
        for name, texts in typed.texts.items()
        if name in _KEPT
    }


def options_of_reading(reading: Mapping[str, Any], typed: Typed) -> Typed:
    """Return the options with which a run read its keypoints; those typed now count more.

    reading: as run.json has it. What no option can be is left out.
    """
    texts: Texts = {}
    for name in set(_KEPT) - {*_OF_INTRINSICS, *typed.texts}:
        value = reading.get(name)
        if isinstance(value, list if is_list(SHARED[name]) else str):
            texts[name] = tuple(map(str, value)) if isinstance(value, list) else value
    return Typed({name: getattr(typed, name) for name in _KEPT if name in typed.texts}).replace(
        texts
    )


def calibration_request(typed: Typed, output: Path) -> CalibrationRequest:
    """Return what is asked for, with the cameras of stdin where those are meant.

    Raises click's UsageError, also for further formats that could not be written in the end.
    """
    world = world_config(typed)
    fps = typed.fps.get("")
    with refused_as_usage():
        check_formats(typed.write, fps, world.stated_unit)
    return CalibrationRequest(
        keypoints=keypoint_source(typed),
        cameras=open_input(typed.cameras, "--cameras") if typed.cameras else None,
        output=output,
        pair_solver=typed.solver,
        seed=typed.seed,
        device=typed.device,
        config=Config(
            view_graph=ViewGraphConfig(pairs=typed.pairs),
            intrinsics=_intrinsics_config(typed),
            matching=MatchingConfig(individuals=typed.individuals),
            mend=MendConfig(apply=typed.mend != "none"),
            sync=sync_config(typed),
            world=world,
            poses=PosesConfig(smooth=typed.smooth),
            uncertainty=uncertainty_config(typed),
        ),
        formats=typed.write,
        fps=fps,
        report=typed.report,
        reading=describe_reading(typed),
    )


def sync_config(typed: Typed) -> SyncConfig:
    """Return what is done about clocks that differ."""
    rates = dict(typed.fps)
    of_all = rates.pop("", 0.0)
    ratios = tuple((camera, rate / of_all) for camera, rate in rates.items())
    return SyncConfig(mode=typed.sync, window=typed.sync_window, rates=ratios)


def uncertainty_config(typed: Typed) -> UncertaintyConfig:
    """Return how well given intrinsics are known."""
    return UncertaintyConfig(
        centre_uncertainty=typed.centre_uncertainty, focal_uncertainty=typed.focal_uncertainty
    )


def _intrinsics_config(typed: Typed) -> IntrinsicsConfig:
    """Return which intrinsics are estimated. Raises click's UsageError."""
    refine = typed.refine or ("none" if typed.cameras else ASSUMED_REFINEMENT)
    if refine == "none" and not typed.cameras:
        raise click.UsageError(
            "--refine none: expected intrinsics that stay as they are, found none; "
            "give --cameras, or leave it out"
        )
    if refine == "none" and typed.focal_per_camera:
        raise click.UsageError(
            "--focal-per-camera: expected focal lengths that are estimated, found none; "
            "use --refine focal"
        )
    return IntrinsicsConfig(
        refine=refine,
        focal_uncertainty=typed.focal_uncertainty or IntrinsicsConfig.focal_uncertainty,
        focal_per_camera=typed.focal_per_camera,
    )


def scale_cues(typed: Typed) -> tuple[ScaleCue, ...]:
    """Return the lengths that are known."""
    return tuple(cue for name in SCALE for cue in getattr(typed, name))


def world_config(typed: Typed) -> WorldConfig:
    """Return the coordinates that are asked for. Raises FormatError and click's UsageError."""
    if typed.align and typed.world != WorldConfig.axes:
        raise click.UsageError(
            f"--align: expected the world of the landmarks alone, found --world {typed.world} "
            "too; leave one out"
        )
    config = WorldConfig(
        axes=typed.world,
        cues=scale_cues(typed),
        forward=typed.forward,
        landmarks=read_landmarks(typed.align) if typed.align else (),
        unit=ARBITRARY,
    )
    if not WORLD.is_file(Path(typed.world)):
        return config
    rig = read_rig_of(Path(typed.world))
    cameras = tuple(
        KnownCamera(camera.name, tuple(camera.rotation.ravel()), tuple(camera.translation))
        for camera in rig
    )
    return replace(config, axes=WorldConfig.axes, cameras=cameras, unit=rig.unit)


def read_recording(typed: Typed, cameras: CameraFile, reporter: Reporter) -> LoadedRecording:
    """Read the keypoints of the cameras, and say which file went to which camera.

    Raises FormatError and MismatchError.
    """
    loaded = load_recording(keypoint_source(typed), cameras)
    reporter.say(*describe_recording(loaded.summary))
    return loaded


def read_recording_of_rig(
    typed: Typed, reporter: Reporter
) -> tuple[CameraRig, LoadedRecording, Any, list[int] | None]:
    """Read a rig, the keypoints of its cameras, and identities where these are given.

    The rig has the cameras with keypoints alone. They are put on one clock, where the rig says that
    those of its cameras differ. Where a camera was moved, the recording has the frames alone for
    which the rig holds: the first and the last of them are returned too, None = all.

    Returns rig, recording, identities (`Matches`, or None) and these frames. Raises FormatError and
    MismatchError.
    """
    given, file = read_rig(typed.rig, "--rig")
    rig, loaded = read_recording_of(given, file, typed, reporter)
    recording, matches = loaded.recording, None
    held = _frames_of_rig(recording, file, reporter)
    if typed.matches:
        source = open_input(typed.matches, "--matches")
        text = source if isinstance(source, Path) else source.decode()
        matches = read_matches_csv(text, recording, loaded.clocks).select(frames=held)
    loaded = replace(loaded, recording=recording.select(frames=held))
    return rig, loaded, matches, file.judgement.get("frames")


def read_recording_of(
    rig: CameraRig, camera_file: CameraFile, typed: Typed, reporter: Reporter
) -> tuple[CameraRig, LoadedRecording]:
    """Read the keypoints of a rig, on one clock, in all frames.

    Its cameras are those of the images; keypoints of cameras that it left out are left out, too.

    camera_file: all that the file of the rig says.
    """
    source = keypoint_source(typed)
    loaded = load_recording(source, camera_file, only_known_cameras=True)
    rig = rig.select(loaded.recording.names)
    rig, recording = turn_rig(rig, loaded.recording, source.mends)
    corrected = describe_corrected(recording, decided=True)
    reporter.say(*describe_recording(replace(loaded.summary, corrected=corrected)))
    clocks = clocks_from(recording, rig.clocks)
    return rig, replace(loaded, recording=retime(recording, clocks), clocks=clocks)


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


# --- cameras, and stdin


def open_input(path: str, option: str) -> Path | bytes:
    """Return the file or folder that an option names, or the content of stdin.

    Raises click's UsageError where another option has read it.
    """
    if path != STDIO:
        return Path(path)
    meta = click.get_current_context().meta
    if "stdin" in meta:
        raise click.UsageError(
            f"{meta['stdin']} and {option} cannot both come from stdin; give a file for one of them"
        )
    meta["stdin"] = option
    return decode(sys.stdin.buffer.read(), "stdin").encode()


def load_camera_file(path: str, option: str) -> CameraFile:
    """Return what a file, a folder or stdin says of cameras. Raises FormatError."""
    return load_cameras(open_input(path, option))


def read_rig(path: str, option: str) -> tuple[CameraRig, CameraFile]:
    """Return the cameras and where they stand, and all that their file says.

    Raises FormatError.
    """
    found = load_camera_file(path, option)
    return make_rig(found, "stdin" if path == STDIO else path), found
