"""Measure how time and memory grow with the recording.

Every run is a process of its own, so that its peak memory is its own.

    .venv/bin/python benchmarks/scale.py long      # 8 cameras, 4 people: 2,000 and 100,000 frames
    .venv/bin/python benchmarks/scale.py ring      # 31 cameras (465 pairs), 3 people, 100 frames
    .venv/bin/python benchmarks/scale.py stages    # seconds of each stage

Synthetic people with 2 px of noise, 5 % missing and 1 % gross errors, seed 0. Of `long`, each
camera numbers its tracks in an order of its own; of the others, detections come in random order and
some are false.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mocap_calib.config import Config, SimulateConfig
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.io.cameras.own import format_calibration_toml
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.steerpose.loading import load_lifter
from mocap_calib.synthetic import LAYOUTS, detect, people, ring_rig, simulate
from mocap_calib.types import CameraRig, Floats, silent

TOOL = Path(sys.executable).with_name("mocap-calib")
PART = 5000  # frames simulated at a time
GRID = (
    (4, 3, 200),
    (8, 3, 200),
    (16, 3, 200),
    (4, 1, 200),
    (4, 6, 200),
    (4, 3, 2000),
    (4, 3, 5000),
)  # cameras, people, frames


def main() -> None:
    """Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["long", "ring", "stages", "child"])
    parser.add_argument(
        "numbers",
        nargs="*",
        type=int,
        metavar="N",
        help="long: other numbers of frames; ring, child: cameras, people, frames",
    )
    parser.add_argument(
        "--scratch",
        type=Path,
        help="folder for the files of `long`; made again when they are there",
    )
    options = parser.parse_args()
    if options.what == "long":
        with tempfile.TemporaryDirectory(dir=options.scratch) as work:
            long(Path(work), options.numbers or [2000, 100_000])
    elif options.what == "child":
        print(json.dumps(child(*options.numbers)))
    else:
        table([tuple(options.numbers) or (31, 3, 100)] if options.what == "ring" else GRID)


# --- files to files


def long(work: Path, lengths: Sequence[int]) -> None:
    """Measure the same rig and people for longer and longer."""
    columns = (
        "frames",
        "calibration (s)",
        "matching all (s)",
        "triangulation (s)",
        "points",
        "points / s",
    )
    columns += ("E_R median / max", "whole run (s)", "processor (s)", "peak memory (GB)")
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for frames in lengths:
        folder = work / str(frames)
        reference = write_scene(folder, cameras=8, individuals=4, frames=frames)
        start = time.perf_counter()
        with Measured() as measured:
            measured.run(
                TOOL,
                "run",
                folder / "keypoints",
                "--cameras",
                folder / "intrinsics.toml",
                "-o",
                folder / "out",
                "--seed",
                "0",
                "--accept",
                "not-determined",
                "--quiet",
            )
        wall = time.perf_counter() - start
        report = json.loads((folder / "out" / "run.json").read_text())
        compared = subprocess.run(
            [TOOL, "evaluate", folder / "out" / "cameras.yaml", "--reference", reference, "--json"],
            check=True,
            stdout=subprocess.PIPE,
        )
        error = json.loads(compared.stdout)["rotation_error_deg"]
        seconds, points = report["seconds"], report["points"]["triangulated"]
        calibration = sum(
            spent for stage, spent in seconds.items() if stage not in ("match all", "triangulate")
        )
        spent = (calibration, seconds["match all"], seconds["triangulate"])
        cells = (
            frames,
            *(f"{one:.1f}" for one in spent),
            points,
            f"{points / seconds['triangulate']:.0f}",
        )
        used = (
            f"{error['median']:.3f} / {error['max']:.3f}",
            *(f"{one:.2f}" for one in (wall, measured.processor, measured.peak)),
        )
        print(f"| {' | '.join(map(str, (*cells, *used)))} |", flush=True)


class Measured:
    """Runs one process and knows its peak memory in GB and its processor time in seconds."""

    peak = processor = 0.0

    def __enter__(self) -> "Measured":
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.before = used.ru_utime + used.ru_stime
        return self

    def __exit__(self, *_: object) -> None:
        """Return the largest of all children so far.

        Call it for the largest last, or in a process of its own.
        """
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.peak = used.ru_maxrss * 1024 / 1e9
        self.processor = used.ru_utime + used.ru_stime - self.before

    def run(self, *command: object) -> None:
        """One command."""
        subprocess.run([str(part) for part in command], check=True)


def write_scene(folder: Path, *, cameras: int, individuals: int, frames: int) -> Path:
    """Write keypoints as DeepLabCut .h5, intrinsics, and the reference.

    People walk forth and back along the way of the first part.

    Detections are made in parts, because that needs more memory than the run may have.
    """
    usual = SimulateConfig()
    of_people, of_rig, of_detector = np.random.default_rng(0).spawn(3)
    side = 0.9 * usual.ring_radius
    bodies = people(
        of_people,
        individuals=individuals,
        frames=min(PART, frames),
        fps=usual.fps,
        room=(side, side),
    )
    rig = ring_rig(
        of_rig,
        cameras=cameras,
        radius=usual.ring_radius,
        height=2.2,
        size=usual.size,
        distortion="none",
    )
    names = LAYOUTS["coco17"]
    keypoints = folder / "keypoints"
    keypoints.mkdir(parents=True)
    order = [of_detector.permutation(individuals) for _ in rig.names]
    files = [h5py.File(keypoints / f"{name}.h5", "w") for name in rig.names]
    tables = [dlc_table(file, individuals, names, frames) for file in files]
    for start in range(0, frames, PART):
        there = (bodies if start // PART % 2 == 0 else bodies[::-1])[: frames - start]
        found = detect(
            of_detector,
            rig,
            there,
            noise_px=usual.noise_px,
            missing=usual.missing,
            outliers=usual.outliers,
            shuffle=False,
        )
        for view, table in enumerate(tables):
            own = np.full((found.identity.shape[1], individuals, len(names), 3), np.nan)
            frame, instance = np.nonzero(found.identity[view] >= 0)
            place = frame, order[view][found.identity[view, frame, instance]]
            own[..., :2][place], own[..., 2][place] = (
                found.positions[view, frame, instance],
                found.confidence[view, frame, instance],
            )
            table[start : start + PART] = own.reshape(len(own), -1)
    for file in files:
        file.close()
    (folder / "intrinsics.toml").write_text(
        format_calibration_toml(
            CameraRig(rig.cameras, 0 * rig.rotation + np.eye(3), 0 * rig.translation, "m"), {}
        )
    )
    (folder / "reference.toml").write_text(format_calibration_toml(rig, {}))
    return folder / "reference.toml"


def dlc_table(file: h5py.File, individuals: int, names: Sequence[str], frames: int) -> h5py.Dataset:
    """Write pandas' layout `fixed` of a DeepLabCut table.

    Returns the dataset `[frame, column]` of its values.
    """
    columns = [
        ("s", f"animal{who}", name, coord)
        for who in range(individuals)
        for name in names
        for coord in ("x", "y", "likelihood")
    ]
    group = file.create_group("predictions")
    group.attrs["pandas_type"] = np.bytes_(b"frame")
    for level, (title, labels) in enumerate(
        zip(
            ("scorer", "individuals", "bodyparts", "coords"),
            zip(*columns, strict=True),
            strict=True,
        )
    ):
        known = sorted(set(labels))
        for axis in ("axis0", "block0_items"):
            group[f"{axis}_level{level}"] = np.array(known, dtype="S")
            group[f"{axis}_level{level}"].attrs["name"] = np.bytes_(title.encode())
            group[f"{axis}_label{level}"] = np.array(
                [known.index(label) for label in labels], dtype=np.int8
            )
    group["axis1"] = np.arange(frames)
    values = group.create_dataset("block0_values", (frames, len(columns)), np.float64)
    values.attrs["transposed"] = 1
    return values


# --- in the library


def table(grid: Sequence[tuple[int, ...]]) -> None:
    """Stage times of whole calibrations."""
    stages = (
        "lift",
        "pairwise",
        "average",
        "match",
        "adjust",
        "match all",
        "verdict",
        "triangulate",
    )
    print(
        f"| cameras | people | frames | {' | '.join(stages)} | all (s) | processor (s) "
        "| E_R median / max | peak memory (GB) |"
    )
    print("|" + "---|" * (len(stages) + 7))
    for numbers in grid:
        done = subprocess.run(
            [sys.executable, __file__, "child", *map(str, numbers)],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        found = json.loads(done.stdout)
        spent = " | ".join(f"{found['seconds'][stage]:.2f}" for stage in stages)
        cells = (
            *numbers,
            spent,
            f"{found['all']:.1f}",
            f"{found['processor']:.1f}",
            f"{found['median']:.3f} / {found['max']:.3f}",
            f"{found['peak']:.2f}",
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def child(cameras: int, individuals: int, frames: int) -> dict[str, Any]:
    """One calibration, with all that the process has used."""
    made = simulate(SimulateConfig(cameras=cameras, people=individuals, frames=frames))
    recording = make_recording(made.files, made.rig.cameras, load_skeleton("people"), {})
    lifter = load_lifter()[0]
    start, before = time.perf_counter(), time.process_time()
    result = calibrate(recording, lifter, Config(), seed=0, device="cpu", progress=silent)
    found = result.groups[0]
    wall, processor = time.perf_counter() - start, time.process_time() - before
    error = np.degrees(errors(found.rig, made.rig))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    return {
        "seconds": found.seconds,
        "all": wall,
        "processor": processor,
        "median": float(np.median(error)),
        "max": float(error.max()),
        "peak": peak,
    }


def errors(rig: CameraRig, true: CameraRig) -> Floats:
    """`[pair]` radians between the relative rotations of the cameras that the rig has."""
    kept = [true.names.index(name) for name in rig.names]
    a, b = np.array(list(combinations(range(len(kept)), 2))).T
    first, second = ((r[b] @ np.swapaxes(r[a], 1, 2)) for r in (rig.rotation, true.rotation[kept]))
    return angle_between(first, second)


if __name__ == "__main__":
    main()
