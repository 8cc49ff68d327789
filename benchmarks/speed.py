"""Measure how fast everything is, beside what others need for the same: one table.

    .venv/bin/python benchmarks/speed.py SCRATCH [--quick] [--runs 5]
        --recordings FOLDER [--batch 40]

Start, recordings files to files, a batch in two processes: each a process of its own, with its
seconds, seconds of the processor and peak memory; the least of several runs. A second table has the
stages of the quickest run of each recording. Adjustment and triangulation: on the scene of
adjustment.py (8 cameras, 1,000 frames), from arrays to arrays; the last column says how many times
as long others take in the same hour. SCRATCH: a folder in which they get an environment of their
own; `--quick` leaves them and the batch out. Reading beside pandas: reading.py.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
from adjustment import (
    adjust_by_ceres_twice,
    adjust_twice,
    as_problem,
    call_peer,
    figures,
    make_scene,
    moved,
    ours,
    peer,
)
from machines import describe_machine
from recording_folders import add_recordings

from mocap_calib.config import AdjustConfig
from mocap_calib.geometry.lens import rays_from_pixels
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.results import Matches
from mocap_calib.rig.triangulate import triangulate_pixels
from mocap_calib.types import CameraRig, Floats, Sample

TOOL = ["-m", "mocap_calib_cli"]
PEERS = Path(__file__).with_name("speed_peers.py")
HERE = ("shelf", "h36m_S5_multi3")
SIMULATED = {  # recording: cameras, people, frames
    "smallest: 4 cameras, 1 person, 100 frames": (4, 1, 100),
    "ring of 31, 3 people, 100 frames": (31, 3, 100),
}
START = "import mocap_calib_cli.main, mocap_calib.job.steps, mocap_calib.kernels.jit"
COLUMNS = ("what", "seconds", "processor (s)", "peak memory (MB)", "others, times as long")
POINTS_OF_COLMAP = 2000  # one call for each: more would take minutes

Measured = tuple[float, float, float]  # seconds, of the processor, megabytes


def main() -> None:
    """Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--quick", action="store_true", help="no peers, no batch")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--batch", type=int, default=40, help="recordings of the batch")
    add_recordings(parser)
    options = parser.parse_args()
    options.scratch.mkdir(parents=True, exist_ok=True)
    print(f"{describe_load()}; least of {options.runs} runs\n")
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    print_row("import and start", repeat(options.runs, lambda: measure("-c", START)))
    stages = {}
    with tempfile.TemporaryDirectory(dir=options.scratch) as work:
        for name, folder in find_recordings(Path(work), options.recordings).items():
            found, stages[name] = measure_recording(folder, Path(work) / "out", options.runs)
            print_row(name, found)
        if not options.quick:
            print_batch(Path(work), options.recordings / HERE[0], options.batch)
    print_arrays(options)
    print_stages(stages)
    print(f"\nafterwards: {describe_load()}")


def describe_load() -> str:
    """Return the processor, how many there are, and what else they do."""
    return f"{describe_machine()}, load {' '.join(f'{each:.1f}' for each in os.getloadavg())}"


def print_row(name: str, found: Measured, others: str = "") -> None:
    """Print what was measured."""
    seconds, processor, memory = found
    shown = f"{memory:.0f}" if memory else ""
    print(f"| {name} | {seconds:.2f} | {processor:.2f} | {shown} | {others} |", flush=True)


# --- processes of their own


def measure(*arguments: str | Path) -> Measured:
    """Run Python, and return what it and its children took."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-P", *arguments], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{arguments}: ended with {process.returncode}")
    return time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def repeat(runs: int, work: Callable[[], Measured]) -> Measured:
    """Return the least of each figure."""
    seconds, processor, memory = zip(*(work() for _ in range(runs)), strict=True)
    return min(seconds), min(processor), min(memory)


def find_recordings(work: Path, recordings: Path) -> dict[str, Path]:
    """Return the folders of all recordings; the simulated ones are made."""
    found = {name: recordings / name for name in HERE if (recordings / name).is_dir()}
    for number, (name, size) in enumerate(SIMULATED.items()):
        found[name] = work / f"simulated{number}"
        texts = (f"--{of}={n}" for of, n in zip(("cameras", "people", "frames"), size, strict=True))
        measure(*TOOL, "simulate", "-o", found[name], *texts)
    return found


def measure_recording(folder: Path, out: Path, runs: int) -> tuple[Measured, dict[str, float]]:
    """Run a recording files to files; return also the stages of the quickest run."""
    found: list[tuple[Measured, dict[str, float]]] = []
    for _ in range(runs):
        shutil.rmtree(out, ignore_errors=True)
        cameras = folder / "intrinsics.toml"
        command = [*TOOL, "run", folder / "keypoints", "--cameras", cameras, "-o", out, "--quiet"]
        spent = measure(*command, "--accept", "not-determined")
        stages = json.loads((out / "run.json").read_text("utf-8"))["seconds"]
        found.append((spent, stages))
    least = repeat(runs, iter([spent for spent, _ in found]).__next__)
    return least, min(found, key=lambda each: each[0][0])[1]


def print_batch(work: Path, recording: Path, count: int) -> None:
    """Calibrate copies of a recording, two at a time."""
    if not recording.is_dir():
        return
    for number in range(count):
        for part in ("keypoints", "intrinsics.toml"):
            place = work / "sessions" / f"session{number:02}" / part
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to((recording / part).resolve())
    sessions = sorted((work / "sessions").iterdir())
    command = [*TOOL, "batch", *sessions, "--cameras", "intrinsics.toml", "-o", work / "batch"]
    found = measure(*command, "--jobs", "2", "--quiet", "--accept", "not-determined")
    rate = f"{3600 * count / found[0]:.0f} an hour"
    print_row(f"batch of {count} like {recording.name}, --jobs 2: {rate}", (*found[:2], 0.0))


# --- arrays to arrays


def print_arrays(options: argparse.Namespace) -> None:
    """Measure adjustment and triangulation, in this process and in that of the peers."""
    true, recording, matches = make_scene(8, 1000, 1)
    start = moved(true)
    spent, found = repeat_adjustment(options.runs, recording, start, matches)
    others = []
    if not options.quick:
        for name, theirs in adjust_elsewhere(options.scratch, recording, start, matches).items():
            others.append(f"{name} {theirs[1] / spent[0]:.1f} ({figures(theirs[0], true)})")
    name = f"adjustment, 8 x 1,000; E_R, E_t (deg) {figures(found, true)}"
    print_row(name.replace("|", ";"), spent, ", ".join(others).replace("|", ";"))
    problem = as_problem(recording, true, matches)
    spent = repeat(options.runs, lambda: triangulate_here(true, problem["pixels"]))
    others = [] if options.quick else triangulate_elsewhere(options.scratch, true, problem, spent)
    points = problem["pixels"].shape[1]
    print_row(f"triangulation of {points} points in 8 views", spent, ", ".join(others))


def repeat_adjustment(
    runs: int, recording: Sample, start: CameraRig, matches: Matches
) -> tuple[Measured, CameraRig]:
    """Adjust several times; return also the rig."""
    found = [ours(adjust_twice, AdjustConfig(), recording, start, matches) for _ in range(runs)]
    return (min(f[1] for f in found), min(f[2] for f in found), 0.0), found[0][0]


def adjust_elsewhere(
    scratch: Path, recording: Sample, start: CameraRig, matches: Matches
) -> dict[str, tuple[CameraRig, float]]:
    """Return rig and seconds of what others do: alone, or with the five points before."""
    colmap = ours(adjust_by_ceres_twice, AdjustConfig(), recording, start, matches)
    anipose = peer("anipose", scratch, recording, start, matches)
    lab = call_peer(PEERS, "lab", scratch, as_problem(recording, start, matches))
    rotation, translation = matrix_from_vector(lab["rotation"]), lab["translation"]
    rig = CameraRig(start.cameras, rotation, translation, start.unit)
    return {
        "pycolmap": colmap[:2],
        "aniposelib": anipose[:2],
        "five points and aniposelib": (rig, float(lab["seconds"])),
    }


def triangulate_here(rig: CameraRig, pixels: Floats) -> Measured:
    """Triangulate robustly, as in a run."""
    start, processor = time.perf_counter(), time.process_time()
    triangulate_pixels(rig, pixels, np.ones(pixels.shape[:-1]))
    return time.perf_counter() - start, time.process_time() - processor, 0.0


def triangulate_elsewhere(
    scratch: Path, rig: CameraRig, problem: dict[str, Floats], spent: Measured
) -> list[str]:
    """Return how many times as long others take; none of them looks for outliers."""
    texts = []
    for method, name in (("anipose", "aniposelib"), ("opencv", "OpenCV (two views)")):
        found = call_peer(PEERS, method, scratch, problem)
        texts.append(f"{name} {float(found['seconds']) / spent[0]:.2f}")
    rays = np.stack(
        [rays_from_pixels(c, p) for c, p in zip(rig.cameras, problem["pixels"], strict=True)]
    )
    poses = np.concatenate([rig.rotation, rig.translation[..., None]], axis=2)
    chosen = rays[:, :POINTS_OF_COLMAP]
    start = time.perf_counter()
    for point in range(chosen.shape[1]):
        seen = np.isfinite(chosen[:, point, 0])
        if seen.sum() >= 2:
            pycolmap.triangulate_multi_view_point(list(poses[seen]), chosen[seen, point])
    seconds = (time.perf_counter() - start) * rays.shape[1] / chosen.shape[1]
    return [*texts, f"pycolmap {seconds / spent[0]:.2f}"]


# --- stages


def print_stages(stages: dict[str, dict[str, float]]) -> None:
    """Print the seconds of each stage of each recording."""
    names = list(dict.fromkeys(stage for found in stages.values() for stage in found))
    print(f"\n| stage (s) | {' | '.join(stages)} |\n|{'---|' * (1 + len(stages))}")
    for name in names:
        cells = (f"{found.get(name, 0.0):.2f}" for found in stages.values())
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
