"""Turns, shifts and zooms cameras of good calibrations, and counts what `verify` says of them.

    .venv/bin/python benchmarks/verify.py --recordings FOLDER [NAME ...]

Each recording is judged by its reference calibration, which must pass, and by the same with one
camera turned about its own centre (each camera, about random axes), shifted, or with another focal
length, with two cameras turned, and described in another world. A cell counts the trials in which
the right cameras, and no others, are named.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from common import make_parser, print_header, print_row
from recordings import NAMES

import mocap_calib as mc
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import matrix_from_vector, rig_size
from mocap_calib.lift import lift
from mocap_calib.lift.lifter import choose_model
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.results import LiftedPoses
from mocap_calib.types import CameraRig, Sample, silent
from mocap_calib.verdict.verify import verify_rig

TURNS_DEG = (1, 2, 5)
AXES = 2  # random ones, for each camera
SHIFT = 0.03  # sizes of the rig
ZOOM = 1.1  # factor of the focal length
KINDS = ("turn 1", "turn 2", "turn 5", "shift 3 %", "focal +10 %", "two turned 2", "other world")


def main() -> None:
    """One row a recording, as Markdown on stdout."""
    parser = make_parser(__doc__, recordings=True)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    options = parser.parse_args()
    print_header(("recording", "verdict", "named", *KINDS))
    for name in options.names:
        print_row(row(options.recordings / name))


def row(folder: Path) -> list[str]:
    """Judge the reference of a recording, and damaged ones."""
    sample, lifted, rig = read(folder)
    sound = verify_rig(sample, lifted, rig, Config(), progress=silent)
    counts = {kind: [0, 0] for kind in KINDS}
    for kind, expected, damaged in damages(rig, np.random.default_rng(0)):
        sample = replace(sample, cameras=damaged.cameras)
        counts[kind][0] += judge(sample, lifted, damaged) == expected
        counts[kind][1] += 1
    cells = [f"{right} of {trials}" if trials else "-" for right, trials in counts.values()]
    named = ", ".join(sound.named) or "none"
    return [folder.name, sound.verdict, named, *cells]


def read(folder: Path) -> tuple[Sample, LiftedPoses, CameraRig]:
    """Return the sample of a recording, what was lifted, and the reference calibration."""
    rig = mc.read_rig(folder / "reference.toml")
    recording = mc.read_recording(folder / "keypoints", rig)
    rig = replace(rig.select(recording.names), cameras=recording.cameras)
    recording, lifter = choose_model(recording, "auto")
    sample = take_sample(recording, choose_sample_frames(recording, Config().sample))
    return sample, lift(sample, lifter, progress=silent), rig


def judge(sample: Sample, lifted: LiftedPoses, rig: CameraRig) -> tuple[str, ...]:
    """Return the cameras that are named."""
    sample = take_sample(sample, slice(None))  # the rays are those of the cameras of the rig
    try:
        return verify_rig(sample, lifted, rig, Config(), progress=silent).named
    except DegenerateError:
        return ("none agree",)


def damages(
    rig: CameraRig, rng: np.random.Generator
) -> Iterator[tuple[str, tuple[str, ...], CameraRig]]:
    """Yield kind, names of the cameras that are to be named, and the damaged rig."""
    for view, name in enumerate(rig.names):
        for _ in range(AXES):
            axis = direction(rng)
            for degrees in TURNS_DEG:
                yield f"turn {degrees}", (name,), move(rig, view, axis * np.deg2rad(degrees))
        shift = SHIFT * rig_size(rig) * direction(rng)
        yield "shift 3 %", (name,), move(rig, view, np.zeros(3), shift)
        camera = change_intrinsics(rig.cameras[view], log_focal=np.log(ZOOM), k1=0.0)
        cameras = (*rig.cameras[:view], camera, *rig.cameras[view + 1 :])
        yield "focal +10 %", (name,), replace(rig, cameras=cameras)
    if len(rig) >= 5:
        pairs = list(combinations(range(len(rig)), 2))
        for pair in rng.permutation(pairs)[:AXES].tolist():
            moved = rig
            for view in pair:
                moved = move(moved, view, direction(rng) * np.deg2rad(2.0))
            yield "two turned 2", tuple(rig.names[view] for view in sorted(pair)), moved
    yield "other world", (), another_world(rig, rng)


def direction(rng: np.random.Generator) -> np.ndarray:
    """Return a random unit vector."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def move(rig: CameraRig, view: int, turn: np.ndarray, shift: np.ndarray | float = 0.0) -> CameraRig:
    """Return the rig with one camera turned about its centre, and the centre shifted."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view] = matrix_from_vector(turn) @ rotation[view]
    translation[view] = -rotation[view] @ (rig.centres[view] + shift)
    return replace(rig, rotation=rotation, translation=translation)


def another_world(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Return the rig in other coordinates and another unit."""
    turn = matrix_from_vector(2.0 * direction(rng))
    centres = 1000 * (rig.centres @ turn.T + 10 * rng.normal(size=3))
    rotation = rig.rotation @ turn.T
    return rig.stand(rotation, centres)


if __name__ == "__main__":
    main()
