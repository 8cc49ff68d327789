"""Measure how time and memory grow with the recording.

Every run is a process of its own, so that its peak memory is its own.

    .venv/bin/python benchmarks/scale.py long      # 8 cameras, 4 people: 2,000 and 100,000 frames
    .venv/bin/python benchmarks/scale.py long 100000 1000000 --cameras 4 --people 1
    .venv/bin/python benchmarks/scale.py ring      # 31 cameras (465 pairs), 3 people, 100 frames
    .venv/bin/python benchmarks/scale.py hall 64   # along the walls of a hall: each sees a part
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

from mocap_calib.config import Config
from mocap_calib.geometry.rotation import angle_between, looking_along
from mocap_calib.io.cameras.own import format_calibration_toml
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.synthetic import (
    LAYOUTS,
    Detections,
    detect,
    keypoint_files,
    people,
    ring_rig,
    simulate,
)
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.types import Bools, CameraRig, Floats, Keypoints2D, silent

TOOL = Path(sys.executable).with_name("mocap-calib")
SCENES = ("ring", "hall")
WIDTH, LENGTH_OF_CAMERA = 12.0, 0.36  # metres of a hall
WALLS_APART, OPENING, RANGE = 12.0, 4.0, 9.0  # metres in it
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
    parser.add_argument("what", choices=["long", "ring", "hall", "stages", "child"])
    parser.add_argument(
        "numbers",
        nargs="*",
        type=int,
        metavar="N",
        help="long: other numbers of frames; ring, hall: cameras, people, frames, seed",
    )
    parser.add_argument("--cameras", type=int, default=8, help="of `long`")
    parser.add_argument("--people", type=int, default=4, help="of `long`")
    parser.add_argument(
        "--scratch",
        type=Path,
        help="folder for the files of `long`; made again when they are there",
    )
    options = parser.parse_args()
    if options.what == "long":
        with tempfile.TemporaryDirectory(dir=options.scratch) as work:
            scene = {"cameras": options.cameras, "individuals": options.people}
            long(Path(work), options.numbers or [2000, 100_000], **scene)
    elif options.what == "child":
        kind, *numbers = options.numbers
        print(json.dumps(child(SCENES[kind], *numbers)))
    elif options.what == "stages":
        table("ring", GRID)
    else:
        usual = {"ring": (31, 3, 100, 0), "hall": (64, 12, 100, 0)}[options.what]
        table(options.what, [(*options.numbers, *usual[len(options.numbers) :])])


# --- files to files


def long(work: Path, lengths: Sequence[int], *, cameras: int, individuals: int) -> None:
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
        reference = write_scene(folder, cameras=cameras, individuals=individuals, frames=frames)
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


def table(scene: str, grid: Sequence[tuple[int, ...]]) -> None:
    """Stage times of whole calibrations."""
    stages = ("lift", "pairwise", "match", "adjust", "match all", "verdict", "triangulate")
    print(
        f"| cameras | people | frames | seed | pairs | in the rig | {' | '.join(stages)} "
        "| all (s) | processor (s) | E_R median / max | peak memory (GB) |"
    )
    print("|" + "---|" * (len(stages) + 10))
    for numbers in grid:
        asked = (*numbers, 0)[:4]  # the seed
        done = subprocess.run(
            [sys.executable, __file__, "child", *map(str, (SCENES.index(scene), *asked))],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        found = json.loads(done.stdout)
        spent = " | ".join(f"{found['seconds'][stage]:.2f}" for stage in stages)
        cells = (
            *asked,
            found["pairs"],
            found["cameras"],
            spent,
            f"{found['all']:.1f}",
            f"{found['processor']:.1f}",
            f"{found['median']:.3f} / {found['max']:.3f}",
            f"{found['peak']:.2f}",
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def child(scene: str, cameras: int, individuals: int, frames: int, seed: int) -> dict[str, Any]:
    """One calibration, with all that the process has used."""
    if scene == "ring":
        config = SimulateConfig(cameras=cameras, people=individuals, frames=frames, seed=seed)
        made = simulate(config)
        files, rig = made.files, made.rig
    else:
        files, rig = hall(cameras, individuals, frames, seed)
    recording = make_recording(files, rig.cameras, load_skeleton("people"), {})
    lifter = load_lifter()[0]
    start, before = time.perf_counter(), processor_time()
    result = calibrate(recording, lifter, Config(), seed=0, device="cpu", progress=silent)
    found = result.groups[0]
    wall, processor = time.perf_counter() - start, processor_time() - before
    error = np.degrees(errors(found.rig, rig))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    return {
        "seconds": found.seconds,
        "pairs": len(found.pairs) + len(result.unused_pairs),
        "cameras": len(found.rig),
        "all": wall,
        "processor": processor,
        "median": float(np.median(error)),
        "max": float(error.max()),
        "peak": peak,
    }


def processor_time() -> float:
    """Return the processor seconds of this process and of those that it has ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + used.ru_utime + used.ru_stime


# --- a hall


def hall(
    cameras: int, individuals: int, frames: int, seed: int
) -> tuple[tuple[Keypoints2D, ...], CameraRig]:
    """Return what detectors make of people in a hall, and the rig of its cameras.

    The hall is 12 m wide, and the longer the more cameras there are along its walls. Each looks
    across it, and a wall with an opening of 4 m stands every 12 m. Nobody is found who is behind a
    wall, behind somebody else, or farther away than 9 m. The names of cameras say nothing of where
    they are.
    """
    usual = SimulateConfig(noise_px=2.0)
    of_people, of_rig, of_detector = np.random.default_rng(seed).spawn(3)
    room = (max(8.0, LENGTH_OF_CAMERA * cameras), WIDTH)
    bodies = people(
        of_people,
        individuals=individuals,
        frames=frames,
        fps=10.0,
        room=(room[0] - 2.0, room[1] - 2.0),
    )
    rig = hall_rig(of_rig, cameras, room, usual.size)
    found = detect(
        of_detector,
        rig,
        bodies,
        noise_px=usual.noise_px,
        missing=usual.missing,
        outliers=usual.outliers,
        false_detections=usual.false_detections,
    )
    return keypoint_files(rig, without_hidden(found, hidden(rig, bodies, room[0]))), rig


def hall_rig(
    rng: np.random.Generator, cameras: int, room: tuple[float, float], size: tuple[int, int]
) -> CameraRig:
    """Return cameras of the walls of a hall, in random order."""
    made = ring_rig(
        rng, cameras=cameras, radius=4.5, height=2.2, size=size, distortion="none"
    ).cameras
    along = 2 * sum(room) * (np.arange(cameras) + rng.uniform(-0.2, 0.2, cameras)) / cameras
    along = rng.permutation(along % (2 * sum(room)))
    corner = np.array([[0, 0], [room[0], 0], room, [0, room[1]], [0, 0]])
    so_far = np.cumsum([0, room[0], room[1], room[0], room[1]])
    level = np.stack([np.interp(along, so_far, corner[:, axis]) for axis in (0, 1)], 1)
    level -= np.array(room) / 2
    centres = np.column_stack([level, 2.6 + rng.uniform(-0.4, 0.4, cameras)])
    inward = np.sign(-level) * (np.abs(np.abs(level) - np.array(room) / 2) < 1e-6)
    yaw = rng.uniform(-0.6, 0.6, cameras)
    ahead = np.stack(
        [
            inward[:, 0] * np.cos(yaw) - inward[:, 1] * np.sin(yaw),
            inward[:, 0] * np.sin(yaw) + inward[:, 1] * np.cos(yaw),
        ],
        1,
    )
    aims = np.column_stack([level + 5.0 * ahead, np.full(cameras, 0.9)])
    rotation = looking_along(aims - centres, np.array([0.0, 0.0, -1.0]))
    return CameraRig(made, rotation, -np.einsum("vij,vj->vi", rotation, centres), "m")


def hidden(rig: CameraRig, bodies: Floats, length: float) -> Bools:
    """Return `[view, frame, individual]` who cannot be seen by a camera of a hall."""
    middle = np.nanmean(bodies, axis=2)  # [frame, individual, 3]
    offset = middle - rig.centres[:, None, None]
    distance = np.linalg.norm(offset, axis=-1)
    behind = distance > RANGE
    for wall in np.arange(-length / 2, length / 2, WALLS_APART)[1:]:
        share = (wall - rig.centres[:, None, None, 0]) / offset[..., 0]
        crossing = rig.centres[:, None, None, 1] + share * offset[..., 1]
        behind |= (share > 0) & (share < 1) & (np.abs(crossing) > OPENING / 2)
    angle = 0.25 / distance  # about half the width of a body
    ray = offset / distance[..., None]
    for other in range(bodies.shape[1]):
        between = np.arccos(np.clip((ray * ray[:, :, [other]]).sum(-1), -1, 1))
        nearer = distance[:, :, [other]] < distance - 0.3
        behind |= nearer & (between < 0.7 * angle[:, :, [other]])
    return np.asarray(behind)


def without_hidden(found: Detections, hides: Bools) -> Detections:
    """Return the detections of those that are not hidden (`[view, frame, individual]`)."""
    there = np.isfinite(found.positions[..., 0]).any(-1)
    of_body = np.take_along_axis(hides, np.maximum(found.identity, 0), axis=2)
    there &= ~(of_body & (found.identity >= 0))
    order = np.argsort(~there, axis=2, kind="stable")[:, :, : int(there.sum(2).max())]
    positions = np.where(there[..., None, None], found.positions, np.nan)
    return Detections(
        keypoints=found.keypoints,
        positions=np.take_along_axis(positions, order[..., None, None], axis=2),
        confidence=np.take_along_axis(
            np.where(there[..., None], found.confidence, 0.0), order[..., None], axis=2
        ),
        identity=np.take_along_axis(np.where(there, found.identity, -1), order, axis=2),
    )


def errors(rig: CameraRig, true: CameraRig) -> Floats:
    """`[pair]` radians between the relative rotations of the cameras that the rig has."""
    kept = [true.names.index(name) for name in rig.names]
    a, b = np.array(list(combinations(range(len(kept)), 2))).T
    first, second = ((r[b] @ np.swapaxes(r[a], 1, 2)) for r in (rig.rotation, true.rotation[kept]))
    return angle_between(first, second)


if __name__ == "__main__":
    main()
