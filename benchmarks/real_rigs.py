"""Measure runs on real recordings as labs have them, one row each.

Intrinsics or clocks are rough or unknown, or a camera was bumped.

    .venv/bin/python benchmarks/real_rigs.py --recordings FOLDER [PART ...]

PART is a row's name, or a part of it; without one all rows are made. Runs see the keypoints, and
the intrinsics that the row says, alone. Exit status 1 where a figure is beyond its bound.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from recording_folders import add_recordings

import mocap_calib as mc
from mocap_calib.config import EPOCH_MARK
from mocap_calib.geometry.lens import change_intrinsics, pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import CameraRig

# median E_R in degrees; relative error of the focal lengths
UNKNOWN = {
    "h36m_S1_walking": (1.0, 0.015),
    "h36m_S1_mix": (1.0, 0.015),
    "h36m_S5_multi3": (1.0, 0.015),
    "pose2sim_single": (1.5, np.inf),
    "shelf": (2.3, np.inf),
}
ROUGH = 1.2  # times the true focal lengths
ROUGH_DEG = 0.2  # worse than with unknown intrinsics
LATE = (  # frames by which cameras are made late, from the first on
    ("h36m_S1_walking", (0, 3, -5, 8)),
    ("h36m_S5_multi3", (0, -4, 7, 11)),
    ("h36m_S5_multi3", (0, 1, -1, 1)),
    ("humaneva_S1_projected", (0, 3, -5)),
)
LATE_DEG = 0.05  # worse than the synchronous recording
# every second frame of each camera, of some the odd ones: they are half a frame late then
HALF_RATE = {"shelf": (0, 1, 0, 1, 1)}
HALF_RATE_FRAMES, HALF_RATE_DEG = 0.1, 0.4
IN_STEP = (
    *("h36m_S1_walking", "h36m_S1_mix", "h36m_S6_mix", "h36m_S5_multi3", "two_dogs_projected"),
    *("humaneva_S1_projected", "panoptic_band1_projected", "dannce_two_mice_projected"),
)
SYNC_SHARE = 0.2  # of the processor time of a run without clocks
BUMPED = ("h36m_S1_mix", "h36m_S5_multi3", "humaneva_S1_projected", "shelf", "acinoset_lily_run")
BUMPS_DEG = (2, 10)
BUMP_AXIS = np.array([0.3, 0.9, 0.3])  # a camera mostly turns aside
BUMPED_FRAME = 0.02  # share of the recording
BUMPED_DEG = 1.0  # worse than without the bump


@dataclass(frozen=True)
class Figure:
    """One figure of a row, and the bound that it is held to."""

    what: str
    value: float
    bound: float

    def __str__(self) -> str:
        mark = "" if self.value <= self.bound else " **beyond**"
        return f"{self.what} {self.value:.3f} (<= {self.bound:g}){mark}"


def main() -> None:
    """Print one row after the other as Markdown; exit with 1 where one is beyond its bound."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    add_recordings(parser)
    given = parser.parse_args()
    print("| row | figures | wall (s) |\n|---|---|---|")
    good = True
    for name, measure in rows(given.recordings):
        if given.parts and not any(part in name for part in given.parts):
            continue
        start = time.perf_counter()
        figures = measure()
        seconds = time.perf_counter() - start
        print(f"| {name} | {', '.join(map(str, figures))} | {seconds:.0f} |", flush=True)
        good = good and all(figure.value <= figure.bound for figure in figures)
    sys.exit(0 if good else 1)


def rows(folder: Path) -> Iterator[tuple[str, Callable[[], list[Figure]]]]:
    """Yield the name of each row, and what measures it."""
    for name, bounds in UNKNOWN.items():
        yield f"{name}, no intrinsics", partial(unknown, folder / name, *bounds)
        yield f"{name}, focal lengths {ROUGH:g} times as long", partial(rough, folder / name)
    for name, offsets in LATE:
        yield f"{name}, offsets {offsets}", partial(late, folder / name, offsets)
    for name, phase in HALF_RATE.items():
        yield f"{name}, clocks at half the rate", partial(half_rate, folder / name, phase)
    for name in IN_STEP:
        yield f"{name}, synchronous", partial(synchronous, folder / name)
    for name in BUMPED:
        for degrees in BUMPS_DEG:
            measure = partial(bumped, folder / name, degrees)
            yield f"{name}, moved: a camera turned by {degrees} deg at half time", measure


# --- rows


def unknown(folder: Path, rotation_bound: float, focal_bound: float) -> list[Figure]:
    """Calibrate a recording without intrinsics."""
    true = {camera.name: camera for camera in mc.read_cameras(folder / "intrinsics.toml")}
    rig = calibrate_unknown(folder)
    focal = max(abs(camera.focal / true[camera.name].focal - 1) for camera in rig.cameras)
    return [
        Figure("E_R", rotation_deg(rig, folder), rotation_bound),
        Figure("focal", focal, focal_bound),
    ]


def rough(folder: Path) -> list[Figure]:
    """Calibrate with focal lengths that are too long, and without intrinsics."""
    cameras = [
        change_intrinsics(camera, log_focal=float(np.log(ROUGH)), k1=0.0)
        for camera in mc.read_cameras(folder / "intrinsics.toml")
    ]
    found = mc.calibrate(mc.read_recording(folder / "keypoints", cameras), refine="focal")
    bound = rotation_deg(calibrate_unknown(folder), folder) + ROUGH_DEG
    return [Figure("E_R", rotation_deg(found.groups[0].rig, folder), round(bound, 3))]


def late(folder: Path, offsets: tuple[int, ...]) -> list[Figure]:
    """Calibrate a recording whose cameras are late by whole frames, and as it is."""
    names = [camera.name for camera in mc.read_cameras(folder / "intrinsics.toml")]
    shifts = {name: by - min(offsets) for name, by in zip(names, offsets, strict=True)}
    found, sound = mc.calibrate(read(folder, frame_offset=shifts)), mc.calibrate(read(folder))
    wrong = [clock.offset - by for clock, by in zip(found.clocks.cameras, offsets, strict=True)]
    bound = rotation_deg(sound.groups[0].rig, folder) + LATE_DEG
    return [
        Figure("offsets wrong by", float(np.ptp(wrong)), 0.0),  # the common clock is free
        Figure("E_R", rotation_deg(found.groups[0].rig, folder), round(bound, 3)),
    ]


def half_rate(folder: Path, phase: tuple[int, ...]) -> list[Figure]:
    """Calibrate every second frame of each camera, from that of its phase on."""
    whole = read(folder)
    frames = len(whole.frames) // 2
    halves = {
        name: np.stack([of[start::2][:frames] for of, start in zip(arrays, phase, strict=True)])
        for name, arrays in (("positions", whole.positions), ("confidence", whole.confidence))
    }
    group = mc.calibrate(replace(whole, frames=np.arange(frames), **halves)).groups[0]
    true = (np.array(phase) - phase[0]) / 2
    wrong = float(np.abs(group.time_offsets.tau - true).max())
    return [
        Figure("offset", wrong, HALF_RATE_FRAMES),
        Figure("E_R", rotation_deg(group.rig, folder), HALF_RATE_DEG),
    ]


def synchronous(folder: Path) -> list[Figure]:
    """Calibrate with and without clocks: nothing changes, and it costs little."""
    recording, config = read(folder), mc.Config()
    off = replace(config, sync=replace(config.sync, mode="off", subframe=False))
    groups, seconds = [], []
    for each in (off, config):
        start = time.process_time()
        groups.append(mc.calibrate(recording, config=each).groups[0])
        seconds.append(time.process_time() - start)
    same = groups[0].rig == groups[1].rig and groups[0].poses == groups[1].poses
    return [
        Figure("changed", float(not same), 0.0),
        Figure("additional time", seconds[1] / seconds[0] - 1, SYNC_SHARE),
    ]


def bumped(folder: Path, degrees: float) -> list[Figure]:
    """Calibrate a recording whose second camera was turned at half time."""
    recording, reference = read(folder), mc.read_rig(folder / "reference.toml")
    allowed = rotation_deg(mc.calibrate(recording).groups[0].rig, folder) + BUMPED_DEG
    view, half = 1, len(recording.frames) // 2
    name, camera = recording.names[view], recording.cameras[view]
    turn = matrix_from_vector(np.deg2rad(degrees) * BUMP_AXIS)
    positions, confidence = recording.positions.copy(), recording.confidence.copy()
    rays = rays_from_pixels(camera, positions[view, half:].astype(np.float64))
    seen = pixels_from_points(camera, rays @ turn.T)
    inside = ((seen >= 0) & (seen <= np.array(camera.size))).all(-1)
    positions[view, half:] = np.where(inside[..., None], seen, np.nan)
    confidence[view, half:] = np.where(inside, confidence[view, half:], 0.0)
    changed = replace(recording, positions=positions, confidence=confidence)
    found = mc.calibrate(changed)
    first, last = (rig_of_epoch(found.groups[0].rig, name, which) for which in (0, -1))
    rotation, translation = reference.rotation.copy(), reference.translation.copy()
    where = reference.names.index(name)
    rotation[where], translation[where] = turn @ rotation[where], turn @ translation[where]
    after = replace(reference, rotation=rotation, translation=translation)
    starts = [fault.mend.frame for fault in found.faults if fault.word == "moved"]
    wrong = min((abs(each - int(recording.frames[half])) for each in starts), default=np.inf)
    others = {fault.camera for fault in found.faults} - {name}
    return [
        Figure("frame off by", wrong / len(recording.frames), BUMPED_FRAME),
        Figure("E_R before", error_deg(first, reference), round(allowed, 3)),
        Figure("E_R after", error_deg(last, after), round(allowed, 3)),
        Figure("sound cameras named", len(others), 0),
    ]


# --- steps


def read(folder: Path, **options: object) -> mc.Recording:
    """Read a recording with its intrinsics."""
    return mc.read_recording(folder / "keypoints", folder / "intrinsics.toml", **options)


def calibrate_unknown(folder: Path) -> CameraRig:
    """Return the rig from keypoints and image sizes alone."""
    sizes = {camera.name: camera.size for camera in mc.read_cameras(folder / "intrinsics.toml")}
    recording = mc.read_recording(folder / "keypoints", image_size=sizes)
    return mc.calibrate(recording).groups[0].rig


def rig_of_epoch(rig: CameraRig, name: str, which: int) -> CameraRig:
    """Return the rig in which a moved camera has its first (0) or last (-1) pose."""
    poses = [each for each in rig.names if each.partition(EPOCH_MARK)[0] == name]
    chosen = rig.select([each for each in rig.names if each not in poses or each == poses[which]])
    names = (each.partition(EPOCH_MARK)[0] for each in chosen.names)
    cameras = zip(chosen.cameras, names, strict=True)
    return replace(chosen, cameras=tuple(replace(camera, name=own) for camera, own in cameras))


def rotation_deg(rig: CameraRig, folder: Path) -> float:
    """Return the median E_R against the reference of a recording."""
    return error_deg(rig, mc.read_rig(folder / "reference.toml"))


def error_deg(rig: CameraRig, reference: CameraRig) -> float:
    """Return the median rotation error of the pairs of cameras, in degrees."""
    return float(np.rad2deg(np.median(mc.evaluate(rig, reference).rotation_error)))


if __name__ == "__main__":
    main()
