"""Measure one row of `real_rigs.py`: make a recording as labs have them, run it, and judge it."""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_calib.config import Config
from mocap_calib.front import read_recording
from mocap_calib.geometry.lens import change_intrinsics, pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras.own import format_intrinsics_toml
from mocap_calib.io.cameras.read import read_cameras, read_rig
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.names import assume_cameras
from mocap_calib.results import GroupResult
from mocap_calib.types import Camera, Recording
from mocap_calib.verdict.evaluation import evaluate

PROGRAM = "from mocap_calib_cli.main import main; main()"
STARTS = (0.6, 1.2, 2.4)  # image widths
SAME_START_DEG = 0.05
ROUGH = 1.2  # times the true focal lengths
ROUGH_DEG = 0.2  # worse than with unknown intrinsics
BUMP_AXIS = np.array([0.3, 0.9, 0.3])  # a camera mostly turns aside
BUMPED_FRAME = 0.02  # share of the recording
BUMPED_DEG = 1.0  # worse than without the bump
HALF_RATE_FRAMES = 0.1  # error of an offset
HALF_RATE_DEG = 0.4
SYNC_SHARE = 0.2  # of the processor time of a run without it
RESULTS = ("cameras.yaml", "calibration.toml", "matches.csv", "poses3d_*.csv")
WHOLE_FRAMES_DEG = 0.05  # by which the rig may differ from that in step
CLOCK_SHARE = 0.08  # of the time of a run that looking at clocks may take


@dataclass(frozen=True)
class Figure:
    """One figure of a row, and the bound that it is held to."""

    what: str
    value: float
    bound: float

    def __str__(self) -> str:
        mark = "" if self.value <= self.bound else " **beyond**"
        return f"{self.what} {self.value:.3f} (<= {self.bound:g}){mark}"


# Rows


def unknown(recording: Path, *, rotation_bound: float, focal_bound: float) -> list[Figure]:
    """Calibrate a recording without intrinsics."""
    with tempfile.TemporaryDirectory() as work:
        out = run(recording, Path(work))
        found = {camera.name: camera for camera in read_cameras(out / "cameras.yaml")}
        rotation = median_rotation_error(out, recording / "reference.toml")
    true = read_cameras(recording / "intrinsics.toml")
    focal = max(abs(found[camera.name].focal / camera.focal - 1) for camera in true)
    return [Figure("E_R", rotation, rotation_bound), Figure("focal", focal, focal_bound)]


def starts(recording: Path) -> list[Figure]:
    """Calibrate from several focal lengths: all must end at the same rig."""
    views = read_keypoints([recording / "keypoints"])
    sizes = {camera.name: camera.size for camera in read_cameras(recording / "intrinsics.toml")}
    views = tuple(replace(view, image_size=sizes[view.camera]) for view in views)
    with tempfile.TemporaryDirectory() as work:
        rigs = []
        for factor in STARTS:
            cameras = [with_focal(each, factor * each.size[0]) for each in assume_cameras(views)]
            out = run_with(recording, Path(work) / str(factor), cameras, "focal+k1")
            rigs.append(read_rig(out / "cameras.yaml"))
    apart = [evaluate(rig, rigs[0]).rotation_error.max() for rig in rigs[1:]]
    return [Figure("apart", float(np.rad2deg(max(apart))), SAME_START_DEG)]


def rough(recording: Path) -> list[Figure]:
    """Calibrate with focal lengths that are too long, and without intrinsics."""
    reference = recording / "reference.toml"
    true = read_cameras(recording / "intrinsics.toml")
    cameras = [with_focal(camera, ROUGH * camera.focal) for camera in true]
    with tempfile.TemporaryDirectory() as work:
        out = run_with(recording, Path(work) / "rough", cameras, "focal")
        error = median_rotation_error(out, reference)
        without = median_rotation_error(run(recording, Path(work) / "unknown"), reference)
    return [Figure("E_R", error, round(without + ROUGH_DEG, 3))]


def late(recording: Path, offsets: tuple[int, ...]) -> list[Figure]:
    """Calibrate a recording whose cameras are late by whole frames, and the same in step."""
    names = [camera.name for camera in read_cameras(recording / "intrinsics.toml")]
    by_camera = {name: by - min(offsets) for name, by in zip(names, offsets, strict=True)}
    files = recording / "keypoints", recording / "intrinsics.toml"
    moved = calibrate(read_recording(*files, frame_offset=by_camera))
    in_step = calibrate(read_recording(*files))
    found = np.array([clock.offset for clock in moved.clocks.cameras])
    wrong = np.ptp(found - np.array(offsets))  # the common clock is free
    reference = read_rig(recording / "reference.toml")
    errors = [
        float(np.rad2deg(np.median(evaluate(each.groups[0].rig, reference).rotation_error)))
        for each in (moved, in_step)
    ]
    return [
        Figure("offsets wrong by", float(wrong), 0.0),
        Figure("E_R", errors[0], round(errors[1] + WHOLE_FRAMES_DEG, 3)),
    ]


def synced(recording: Path, *, in_step: bool) -> list[Figure]:
    """Calibrate with and without a look at the frames of clocks.

    in_step: the results must be the same bytes. Others too where no clock is changed; where one
    is, detections must be no farther from points that are triangulated without them.
    """
    intrinsics = recording / "intrinsics.toml"
    outs, seconds = [], []
    with tempfile.TemporaryDirectory() as work:
        for mode in ("off", "auto"):
            before = os.times()
            out = run(recording, Path(work, mode), "--cameras", str(intrinsics), "--sync", mode)
            spent = np.array(os.times()) - before
            outs.append({p.name: p.read_bytes() for part in RESULTS for p in out.glob(part)})
            seconds.append(spent[2:4].sum())  # of the processor, by the other process
    figures = [Figure("additional time", seconds[1] / seconds[0] - 1, SYNC_SHARE)]
    same = len(outs[0]) >= len(RESULTS) and outs[0] == outs[1]
    if same or in_step:
        return [*figures, Figure("other bytes", float(not same), 0.0)]
    given, off = (
        read_recording(recording / "keypoints", intrinsics),
        replace(Config().sync, mode="off"),
    )
    found, blind = calibrate(given), calibrate(given, config=replace(Config(), sync=off))
    error, error_blind = (np.nanmedian(of.groups[0].poses.error) for of in (found, blind))
    clocks_found = (each for each in found.clocks.cameras if each.differs)
    figures += [Figure(f"{c.camera}: {c.kind}", c.offset, np.inf) for c in clocks_found]
    return [*figures, Figure("error with / without", float(error / error_blind), 1.0)]


def moved(recording: Path, *, degrees: float) -> list[Figure]:
    """Calibrate a recording whose second camera was turned at half time: the frame, both epochs."""
    reference = read_rig(recording / "reference.toml")
    intrinsics = ("--cameras", str(recording / "intrinsics.toml"))
    turn = matrix_from_vector(np.deg2rad(degrees) * BUMP_AXIS)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "sound").mkdir()
        sound = run(recording, work / "sound", *intrinsics)
        allowed = median_rotation_error(sound, recording / "reference.toml") + BUMPED_DEG
        name, start, frames = bump(recording, work / "keypoints", turn)
        out = run(work, work, *intrinsics)
        report = json.loads((out / "run.json").read_text("utf-8"))
        later = report["epochs"][1:] or [{"folder": ".", "first": np.inf}]
        rigs = [
            read_rig(out / each["folder"] / "cameras.yaml") for each in ({"folder": "."}, *later)
        ]
    others = [each["name"] for each in report["cameras"] if each["faults"] and each["name"] != name]
    rotation, translation = reference.rotation.copy(), reference.translation.copy()
    view = reference.names.index(name)
    rotation[view], translation[view] = turn @ rotation[view], turn @ translation[view]
    after = replace(reference, rotation=rotation, translation=translation)
    errors = [evaluate(rigs[0], reference), evaluate(rigs[-1], after)]
    before_deg, after_deg = (float(np.rad2deg(np.median(e.rotation_error))) for e in errors)
    return [
        Figure("frame off by", abs(later[0]["first"] - start) / frames, BUMPED_FRAME),
        Figure("E_R before", before_deg, round(allowed, 3)),
        Figure("E_R after", after_deg, round(allowed, 3)),
        Figure("sound cameras accused", len(others), 0),
    ]


def half_rate(recording: Path, phase: tuple[int, ...]) -> list[Figure]:
    """Calibrate every second frame of each camera, from that of its phase on."""
    whole = read_recording(recording / "keypoints", recording / "intrinsics.toml")
    frames = len(whole.frames) // 2
    parts = {
        name: np.stack([of[start::2][:frames] for of, start in zip(arrays, phase, strict=True)])
        for name, arrays in (("positions", whole.positions), ("confidence", whole.confidence))
    }
    found, _ = with_and_without_clocks(replace(whole, frames=np.arange(frames), **parts))
    true = (np.array(phase) - phase[0]) / 2
    errors = evaluate(found.rig, read_rig(recording / "reference.toml"))
    return [
        Figure("offset", float(np.abs(found.time_offsets.tau - true).max()), HALF_RATE_FRAMES),
        Figure("E_R", float(np.rad2deg(np.median(errors.rotation_error))), HALF_RATE_DEG),
    ]


def clocks_in_step(recording: Path) -> list[Figure]:
    """Calibrate a recording in step: nothing must change where clocks are looked at."""
    given = read_recording(recording / "keypoints", recording / "intrinsics.toml")
    found, without = with_and_without_clocks(given)
    same = found.rig == without.rig and found.poses == without.poses
    seconds = found.seconds["clocks"] / sum(without.seconds.values())
    return [Figure("changed", float(not same), 0.0), Figure("time", seconds, CLOCK_SHARE)]


def clocks(recording: Path, *, off: bool) -> list[Figure]:
    """Calibrate a recording with clocks and without, and tell what was found.

    off: the offsets must be used.
    """
    given = read_recording(recording / "keypoints", recording / "intrinsics.toml")
    found, without = with_and_without_clocks(given)
    used = found.time_offsets.applied
    ratio = float(np.nanmedian(found.poses.error) / np.nanmedian(without.poses.error))
    offsets = zip(found.rig.names, found.time_offsets.tau.tolist(), strict=True)
    return [
        *(Figure(f"{name} (frames)", tau, np.inf) for name, tau in offsets if np.isfinite(tau)),
        Figure("not used", float(off and not used.any()), 0.0),
        Figure("error with / without", ratio, 1.0),
    ]


# Steps


def bump(recording: Path, folder: Path, turn: np.ndarray) -> tuple[str, int, int]:
    """Write the keypoints of a recording whose second camera is turned at half its frames.

    Returns its name, the first frame that is changed, and how many frames it has.
    """
    folder.mkdir()
    cameras = {camera.name: camera for camera in read_cameras(recording / "intrinsics.toml")}
    bumped = list(cameras)[1]
    for view in read_keypoints([recording / "keypoints"]):
        camera, positions = cameras[view.camera], view.positions.astype(np.float64)
        if view.camera == bumped:
            half = len(view.frames) // 2
            rays = rays_from_pixels(camera, positions[half:])
            seen = pixels_from_points(camera, rays @ turn.T)
            inside = ((seen >= 0) & (seen <= np.array(camera.size))).all(-1, keepdims=True)
            positions[half:] = np.where(inside, seen, np.nan)
            start, frames = int(view.frames[half]), len(view.frames)
        missing = ~np.isfinite(positions).all(-1)
        changed = replace(
            view,
            positions=positions,
            confidence=np.where(missing, 0.0, view.confidence),
            image_size=camera.size,
        )
        write_keypoints(folder / f"{view.camera}.json", (changed,), "coco")
    return bumped, start, frames


def with_and_without_clocks(recording: Recording) -> tuple[GroupResult, GroupResult]:
    """Return what is found of the largest group where clocks are looked at, and where not."""
    config = Config()
    without = replace(config, sync=replace(config.sync, subframe=False))
    found, blind = (calibrate(recording, config=each).groups[0] for each in (config, without))
    return found, blind


def with_focal(camera: Camera, focal: float) -> Camera:
    """Return the camera with another mean focal length."""
    return change_intrinsics(camera, log_focal=float(np.log(focal / camera.focal)), k1=0.0)


def run_with(recording: Path, work: Path, cameras: list[Camera], refine: str) -> Path:
    """Calibrate a recording with these intrinsics, some of which are refined."""
    work.mkdir()
    intrinsics = work / "intrinsics.toml"
    intrinsics.write_text(format_intrinsics_toml(tuple(cameras)), "utf-8")
    return run(recording, work, "--cameras", str(intrinsics), "--refine", refine)


def run(recording: Path, work: Path, *arguments: str) -> Path:
    """Calibrate a recording in a process of its own; return the folder of its results."""
    out = work / "out"
    command = [sys.executable, "-P", "-c", PROGRAM, "run", str(recording / "keypoints")]
    sizes = []
    if not arguments:  # the cameras' files say the sizes otherwise
        for camera in read_cameras(recording / "intrinsics.toml"):
            sizes += ["--image-size", "{}:{}x{}".format(camera.name, *camera.size)]
    command += [*sizes, *arguments, "-o", str(out), "--seed", "0", "--quiet"]
    command += ["--accept", "not-determined"]
    subprocess.run(command, check=True)
    return out


def median_rotation_error(out: Path, reference: Path) -> float:
    """Return the median rotation error of the pairs of cameras, in degrees."""
    found = evaluate(read_rig(out / "cameras.yaml"), read_rig(reference))
    return float(np.rad2deg(np.median(found.rotation_error)))
