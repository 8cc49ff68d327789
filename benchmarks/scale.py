"""Measure how time and memory grow with the recording.

Every run is a process of its own, so that its peak memory is its own.

    .venv/bin/python benchmarks/scale.py long      # 8 cameras, 4 people: 2,000 and 100,000 frames
    .venv/bin/python benchmarks/scale.py long 100000 1000000 --cameras 4 --people 1
    .venv/bin/python benchmarks/scale.py ring      # 31 cameras (465 pairs), 3 people, 100 frames
    .venv/bin/python benchmarks/scale.py hall 64   # along the walls of a hall: each sees a part

Synthetic people with 2 px of noise, 5 % missing and 1 % gross errors, seed 0. Of `long`, tracks
have another order in each camera; of the others, detections come in random order and some are
false.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import TOOL, make_parser, measure, print_header, print_row

import mocap_calib as mc
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.synthetic.bodies import motion_times, move_person
from mocap_calib.synthetic.detections import LAYOUTS, Detections, detect, keypoint_files
from mocap_calib.synthetic.scene import ring_rig
from mocap_calib.synthetic.signals import turn_about
from mocap_calib.synthetic.walking import plan_walks
from mocap_calib.types import Bools, CameraRig, Floats, Keypoints2D

WIDTH, LENGTH_OF_CAMERA = 12.0, 0.36  # metres of a hall
WALLS_APART, OPENING, RANGE = 12.0, 4.0, 9.0  # metres in it
PART = 5000  # frames that are simulated; people then walk back and forth along them
USUAL = {"ring": (31, 3, 100, 0), "hall": (64, 12, 100, 0)}  # cameras, people, frames, seed
LONG_COLUMNS = (
    *("frames", "calibration (s)", "matching all (s)", "triangulation (s)", "points"),
    *("E_R median / max", "whole run (s)", "processor (s)", "peak memory (GB)"),
)
SCENE_COLUMNS = (
    *("cameras", "people", "frames", "seed", "pairs", "in the rig"),
    *("all (s)", "processor (s)", "E_R median / max", "peak memory (GB)"),
)


def main() -> None:
    """Print a table as Markdown."""
    parser = make_parser(__doc__)
    parser.add_argument("what", choices=["long", *USUAL])
    numbers = "long: other numbers of frames; ring, hall: cameras, people, frames, seed"
    parser.add_argument("numbers", nargs="*", type=int, metavar="N", help=numbers)
    parser.add_argument("--cameras", type=int, default=8, help="of `long`")
    parser.add_argument("--people", type=int, default=4, help="of `long`")
    parser.add_argument("--scratch", type=Path, help="folder for the files of `long`")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    usual = USUAL.get(options.what, ())
    scene = (*options.numbers, *usual[len(options.numbers) :])
    if options.child:
        print(json.dumps(calibrate_scene(options.what, *scene)))
    elif options.what == "long":
        print_header(LONG_COLUMNS)
        for frames in options.numbers or [2000, 100_000]:
            with tempfile.TemporaryDirectory(dir=options.scratch) as work:
                print_row(run_long(Path(work), options.cameras, options.people, frames))
    else:
        print_header(SCENE_COLUMNS)
        command = [sys.executable, __file__, options.what, *map(str, scene), "--child"]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        print_row([*scene, *json.loads(done.stdout)])


# --- files to files


def run_long(folder: Path, cameras: int, individuals: int, frames: int) -> list[object]:
    """Run a recording of so many frames in a new folder; return its row."""
    truth = write_scene(folder, cameras, individuals, frames)
    command = ("run", folder / "keypoints", "--cameras", folder / "reference.toml")
    command += ("-o", folder / "out", "--quiet", "--accept", "not-determined")
    wall, processor, megabytes = measure(*TOOL, *command)
    report = json.loads((folder / "out" / "run.json").read_text("utf-8"))
    error = rotation_errors(mc.read_rig(folder / "out" / "cameras.yaml"), truth)
    later = [report["seconds"][stage] for stage in ("match all", "triangulate")]
    spent = (sum(report["seconds"].values()) - sum(later), *later)
    cells = [frames, *(f"{each:.1f}" for each in spent), report["points"]["triangulated"]]
    return [*cells, error, f"{wall:.1f}", f"{processor:.1f}", f"{megabytes / 1000:.2f}"]


def write_scene(folder: Path, cameras: int, individuals: int, frames: int) -> CameraRig:
    """Write keypoints as DeepLabCut .h5 and the rig; return the rig."""
    few = {"cameras": cameras, "people": individuals, "frames": min(PART, frames)}
    made = mc.simulate(mc.SimulateConfig(**few, false_detections=0.0, shuffle=False))
    rng = np.random.default_rng(0)
    forth = np.arange(few["frames"])
    source = np.resize(np.concatenate([forth, forth[::-1]]), frames)
    (folder / "keypoints").mkdir(parents=True)
    for view in made.files:
        order = rng.permutation(view.positions.shape[1])
        long = replace(
            view,
            frames=np.arange(frames),
            positions=view.positions[source][:, order],
            confidence=view.confidence[source][:, order],
            tracked=True,
        )
        mc.write([long], folder / "keypoints" / f"{view.camera}.h5", format="deeplabcut-h5")
    mc.write(made.rig, folder / "reference.toml", format="anipose")
    return made.rig


# --- in the library


def calibrate_scene(
    scene: str, cameras: int, individuals: int, frames: int, seed: int
) -> list[object]:
    """Calibrate one scene; return the cells of its row after its size."""
    if scene == "ring":
        size = {"cameras": cameras, "people": individuals, "frames": frames, "seed": seed}
        made = mc.simulate(mc.SimulateConfig(**size))
        files, rig = made.files, made.rig
    else:
        files, rig = make_hall(cameras, individuals, frames, seed)
    recording = mc.Recording.from_keypoints(files, rig)
    start, before = time.perf_counter(), time.process_time()
    result = mc.calibrate(recording, model="people")
    wall, processor = time.perf_counter() - start, time.process_time() - before
    found = result.groups[0]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    cells = [len(found.pairs) + len(result.unused_pairs), len(found.rig)]
    error = rotation_errors(found.rig, rig)
    return [*cells, f"{wall:.1f}", f"{processor:.1f}", error, f"{peak:.2f}"]


def rotation_errors(rig: CameraRig, true: CameraRig) -> str:
    """Return the median and the largest rotation error of the pairs in degrees."""
    error = np.degrees(mc.evaluate(rig, true.select(rig.names)).rotation_error)
    return f"{np.median(error):.3f} / {error.max():.3f}"


# --- a hall


def make_hall(
    cameras: int, individuals: int, frames: int, seed: int
) -> tuple[tuple[Keypoints2D, ...], CameraRig]:
    """Return what detectors make of people in a hall, and the rig of its cameras.

    The hall is 12 m wide, and the longer the more cameras there are along its walls. Each looks
    across it, and a wall with an opening of 4 m stands every 12 m. Nobody is found who is behind a
    wall, behind somebody else, or farther away than 9 m. The names of cameras say nothing of where
    they are.
    """
    usual = mc.SimulateConfig(noise_px=2.0)
    of_people, of_rig, of_detector = np.random.default_rng(seed).spawn(3)
    room = (max(8.0, LENGTH_OF_CAMERA * cameras), WIDTH)
    inner = (room[0] - 2.0, room[1] - 2.0)
    time, seen = motion_times(frames, fps=10.0)
    walks = plan_walks(of_people, time, individuals, inner)
    bodies = np.stack([move_person(of_people, time, walk)[seen] for walk in walks], axis=1)
    rig = hall_rig(of_rig, cameras, room, usual.size)
    found = detect(of_detector, rig, bodies, LAYOUTS["coco17"], usual)
    return keypoint_files(rig, without_hidden(found, hidden(rig, bodies, room[0]))), rig


def hall_rig(
    rng: np.random.Generator, cameras: int, room: tuple[float, float], size: tuple[int, int]
) -> CameraRig:
    """Return cameras of the walls of a hall, in random order."""
    made = ring_rig(rng, mc.SimulateConfig(cameras=cameras, size=size)).cameras
    along = 2 * sum(room) * (np.arange(cameras) + rng.uniform(-0.2, 0.2, cameras)) / cameras
    along = rng.permutation(along % (2 * sum(room)))
    corner = np.array([[0, 0], [room[0], 0], room, [0, room[1]], [0, 0]])
    so_far = np.cumsum([0, room[0], room[1], room[0], room[1]])
    level = np.stack([np.interp(along, so_far, corner[:, axis]) for axis in (0, 1)], 1)
    level -= np.array(room) / 2
    centres = np.column_stack([level, 2.6 + rng.uniform(-0.4, 0.4, cameras)])
    inward = np.sign(-level) * (np.abs(np.abs(level) - np.array(room) / 2) < 1e-6)
    yaw = rng.uniform(-0.6, 0.6, cameras)
    ahead = np.einsum("vij,vj->vi", turn_about(yaw)[:, :2, :2], inward)
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


if __name__ == "__main__":
    main()
