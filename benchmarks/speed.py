"""Measure how fast everything is, beside what others need for the same: one table.

    .venv/bin/python benchmarks/speed.py SCRATCH [--quick] [--runs 5]
        --recordings FOLDER [--batch 40]

Start, reading a DeepLabCut .csv, recordings files to files and a batch: each a process of its own
with its seconds, processor seconds and peak memory; the least of several runs. A second table has
the stages of the quickest run of each recording. Adjustment and triangulation are measured from
arrays to arrays, on the scene of adjustment.py. The last column says how many times as long others
take in the same hour. SCRATCH: a folder for their environment; `--quick` leaves others and the
batch out.
"""

import argparse
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pycolmap
from adjustment import Found, adjust_elsewhere, adjust_here, figures, make_problem, make_scene, move
from common import (
    TOOL,
    Measured,
    describe_machine,
    make_parser,
    measure,
    print_header,
    print_row,
)
from peer_calls import call_peer

import mocap_calib as mc
from mocap_calib.geometry.lens import rays_from_pixels
from mocap_calib.rig.triangulate import triangulate_pixels
from mocap_calib.types import CameraRig, Floats

HERE = ("shelf", "h36m_S5_multi3")
SIMULATED = {  # recording: cameras, people, frames
    "smallest: 4 cameras, 1 person, 100 frames": (4, 1, 100),
    "ring of 31, 3 people, 100 frames": (31, 3, 100),
}
START = "import mocap_calib_cli.main, mocap_calib.job.steps, mocap_calib.kernels.jit"
READERS = {  # of a table of DeepLabCut of 30,000 frames x 4 animals
    "mocap-calib": "import mocap_calib as mc; mc.read_keypoints({path!r})",
    "pandas": "import pandas; pandas.read_csv({path!r}, header=[0, 1, 2, 3], index_col=0)",
}
TABLE_FRAMES = 30_000
COLUMNS = ("what", "seconds", "processor (s)", "peak memory (MB)", "others, times as long")
POINTS_OF_COLMAP = 2000  # one call for each: more would take minutes


def main() -> None:
    """Print the tables as Markdown."""
    parser = make_parser(__doc__, recordings=True)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--quick", action="store_true", help="no others, no batch")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--batch", type=int, default=40, help="recordings of the batch")
    options = parser.parse_args()
    options.scratch.mkdir(parents=True, exist_ok=True)
    print(f"{describe_load()}; least of {options.runs} runs\n")
    print_header(COLUMNS)
    print_figures("import and start", repeat(options.runs, lambda: measure("-c", START)))
    stages = {}
    with tempfile.TemporaryDirectory(dir=options.scratch) as folder:
        work = Path(folder)
        print_reading(work / "cam1.csv", options.runs)
        for name, recording in find_recordings(work, options.recordings).items():
            found, stages[name] = measure_recording(recording, work / "out", options.runs)
            print_figures(name, found)
        if not options.quick:
            print_batch(work, options.recordings / HERE[0], options.batch)
    print_arrays(options)
    print_stages(stages)
    print(f"\nafterwards: {describe_load()}")


def describe_load() -> str:
    """Return the processor, how many there are, and the load of the machine."""
    return f"{describe_machine()}, load {' '.join(f'{each:.1f}' for each in os.getloadavg())}"


def print_figures(name: str, found: Measured, others: str = "") -> None:
    """Print one row."""
    seconds, processor, memory = found
    shown = f"{memory:.0f}" if memory else ""
    cells = (name, f"{seconds:.2f}", f"{processor:.2f}", shown, others)
    print_row(cell.replace("|", ";") for cell in cells)


def repeat(runs: int, work: Callable[[], Measured]) -> Measured:
    """Return the least of each figure."""
    seconds, processor, memory = zip(*(work() for _ in range(runs)), strict=True)
    return min(seconds), min(processor), min(memory)


# --- files to files


def print_reading(path: Path, runs: int) -> None:
    """Measure the reading of a table, imports included, and by pandas where it is installed."""
    here = str(Path(__file__).parent)  # written elsewhere, as peak memory starts with the parent's
    code = f"import sys; sys.path.append({here!r}); import speed; speed.write_table({str(path)!r})"
    measure("-c", code)
    spent = {
        name: repeat(runs, lambda code=code: measure("-c", code.format(path=str(path))))
        for name, code in READERS.items()
        if find_spec(name.replace("-", "_"))
    }
    ours = spent.pop("mocap-calib")
    others = ", ".join(f"{name} {found[1] / ours[1]:.1f}" for name, found in spent.items())
    print_figures(f"reading a DeepLabCut .csv, {TABLE_FRAMES} x 4 animals", ours, others)


def write_table(path: str) -> None:
    """Write wandering points of four animals, a twentieth missing, as DeepLabCut does."""
    rng = np.random.default_rng(0)
    shape = (TABLE_FRAMES, 4, 17)
    positions = 500 + np.cumsum(rng.normal(size=(*shape, 2)), axis=0)
    positions[rng.random(shape[:2]) < 0.05] = np.nan
    view = mc.Keypoints2D(
        camera="cam1",
        keypoints=tuple(f"part_{number}" for number in range(shape[2])),
        frames=np.arange(TABLE_FRAMES),
        positions=positions,
        confidence=np.where(np.isfinite(positions[..., 0]), rng.uniform(0.5, 1.0, shape), 0.0),
        tracked=True,
        image_size=(1280, 720),
        source="made",
    )
    mc.write([view], path, format="deeplabcut-csv")


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
    command = (*TOOL, "run", folder / "keypoints", "--cameras", folder / "intrinsics.toml")
    quickest: dict[float, dict[str, float]] = {}

    def run() -> Measured:
        shutil.rmtree(out, ignore_errors=True)
        spent = measure(*command, "-o", out, "--quiet", "--accept", "not-determined")
        quickest[spent[0]] = json.loads((out / "run.json").read_text("utf-8"))["seconds"]
        return spent

    least = repeat(runs, run)
    return least, quickest[min(quickest)]


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
    command = (*TOOL, "batch", *sessions, "--cameras", "intrinsics.toml", "-o", work / "batch")
    found = measure(*command, "--jobs", "2", "--quiet", "--accept", "not-determined")
    rate = f"{3600 * count / found[0]:.0f} an hour"
    print_figures(f"batch of {count} like {recording.name}, --jobs 2: {rate}", (*found[:2], 0.0))


def print_stages(stages: dict[str, dict[str, float]]) -> None:
    """Print the seconds of each stage of each recording."""
    names = dict.fromkeys(stage for found in stages.values() for stage in found)
    print()
    print_header(("stage (s)", *stages))
    for name in names:
        print_row((name, *(f"{found.get(name, 0.0):.2f}" for found in stages.values())))


# --- arrays to arrays


def print_arrays(options: argparse.Namespace) -> None:
    """Measure adjustment and triangulation here, and by others."""
    true, sample, matches = make_scene(1000)
    given = (sample, move(true), matches)
    found = [adjust_here("ours", *given) for _ in range(options.runs)]
    seconds = min(each[1] for each in found)
    others: dict[str, Found] = {}
    if not options.quick:
        others["pycolmap"] = adjust_here("colmap", *given)
        others["aniposelib"] = adjust_elsewhere("adjust", options.scratch, *given)
        others["five points and aniposelib"] = adjust_elsewhere("lab", options.scratch, *given)
    texts = (
        f"{name} {spent / seconds:.1f} ({figures(rig, true)})"
        for name, (rig, spent, _) in others.items()
    )
    name = f"adjustment, 8 x 1,000; E_R, E_t (deg) {figures(found[0][0], true)}"
    ours = (seconds, min(each[2] for each in found), 0.0)
    print_figures(name, ours, ", ".join(texts))
    problem = make_problem(sample, true, matches)
    spent = repeat(options.runs, lambda: triangulate_here(true, problem["pixels"]))
    slower = {} if options.quick else triangulate_elsewhere(options.scratch, true, problem)
    name = f"triangulation of {problem['pixels'].shape[1]} points in 8 views"
    print_figures(name, spent, ", ".join(f"{who} {s / spent[0]:.2f}" for who, s in slower.items()))


def triangulate_here(rig: CameraRig, pixels: Floats) -> Measured:
    """Triangulate robustly, as in a run."""
    start, processor = time.perf_counter(), time.process_time()
    triangulate_pixels(rig, pixels, np.ones(pixels.shape[:-1]))
    return time.perf_counter() - start, time.process_time() - processor, 0.0


def triangulate_elsewhere(
    scratch: Path, rig: CameraRig, problem: dict[str, Floats]
) -> dict[str, float]:
    """Return the seconds of others; none of them looks for outliers."""
    methods = {"aniposelib": "triangulate", "OpenCV (two views)": "opencv"}
    found = {
        name: float(call_peer(method, scratch, problem)["seconds"])
        for name, method in methods.items()
    }
    pixels = problem["pixels"]
    rays = np.stack(
        [
            rays_from_pixels(c, p[:POINTS_OF_COLMAP])
            for c, p in zip(rig.cameras, pixels, strict=True)
        ]
    )
    poses = np.concatenate([rig.rotation, rig.translation[..., None]], axis=2)
    start = time.perf_counter()
    for point in range(rays.shape[1]):
        seen = np.isfinite(rays[:, point, 0])
        if seen.sum() >= 2:
            pycolmap.triangulate_multi_view_point(list(poses[seen]), rays[seen, point])
    seconds = (time.perf_counter() - start) * pixels.shape[1] / rays.shape[1]
    return found | {"pycolmap": seconds}


if __name__ == "__main__":
    main()
