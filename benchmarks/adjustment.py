"""Measure bundle adjustment alone: ours, COLMAP's and aniposelib's, from the same start.

    .venv/bin/python benchmarks/adjustment.py SCRATCH [--frames 1000]

8 cameras, one synthetic person, identities known, 2 px of noise, 5 % missing, 1 % gross errors; the
cameras start 3 degrees and 3 % of the radius off, intrinsics fixed. SCRATCH: a folder for the
environment of aniposelib. Ours is timed from detections to rig. `colmap` is Ceres through pycolmap
(`ceres.py`) on the same points. All but aniposelib adjust twice: the noise of a view is known only
of a rig that is close.
"""

import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from ceres import adjust_by_ceres
from common import make_parser, print_header, print_row
from peer_calls import call_peer, describe_rig

from mocap_calib.adjust.refine import adjust_once
from mocap_calib.config import Config
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.synthetic.scene import simulate
from mocap_calib.types import CameraRig, Floats, Sample

Found = tuple[CameraRig, float, float]  # with seconds, and those of the processor

HERE = {"ours": adjust_once, "colmap": adjust_by_ceres}


def main() -> None:
    """Print one row a method as Markdown."""
    parser = make_parser(__doc__)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--frames", type=int, default=1000)
    options = parser.parse_args()
    true, sample, matches = make_scene(options.frames)
    given = (sample, move(true), matches)
    columns = ("method", "seconds", "processor (s)")
    print_header((*columns, "E_R median / max (deg)", "E_t median / max (deg)"))
    print_row(("start", "", "", figures(given[1], true)))
    for method in (*HERE, "anipose"):
        if method in HERE:
            rig, wall, processor = adjust_here(method, *given)
        else:
            rig, wall, processor = adjust_elsewhere("adjust", options.scratch, *given)
        print_row((method, f"{wall:.2f}", f"{processor:.2f}", figures(rig, true)))


def make_scene(frames: int) -> tuple[CameraRig, Sample, Matches]:
    """Return the true rig, the detections, and the true matches."""
    size = {"cameras": 8, "frames": frames, "people": 1}
    made = simulate(SimulateConfig(**size, false_detections=0.0))
    recording = make_recording(made.files, made.rig.cameras, load_skeleton("people"), {})
    return made.rig, take_sample(recording, slice(None)), Matches(made.identity.astype(np.int64))


def move(rig: CameraRig) -> CameraRig:
    """Return the rig, every camera turned by 3 deg and moved by 3 % of its distance from 0."""
    rng = np.random.default_rng(0)
    turn, shift = (
        axis / np.linalg.norm(axis, axis=1, keepdims=True)
        for axis in rng.normal(size=(2, len(rig.cameras), 3))
    )
    rotation = matrix_from_vector(np.radians(3.0) * turn) @ rig.rotation
    centres = rig.centres + 0.03 * np.linalg.norm(rig.centres, axis=1, keepdims=True) * shift
    return rig.stand(rotation, centres)


def adjust_here(method: str, sample: Sample, start: CameraRig, matches: Matches) -> Found:
    """Adjust twice in this process, the second time with the noise of a rig that is close."""
    wall, processor = time.perf_counter(), time.process_time()
    rig = HERE[method](sample, start, matches, Config())
    rig = HERE[method](sample, rig, matches, Config(), already_close=True)
    return rig, time.perf_counter() - wall, time.process_time() - processor


def adjust_elsewhere(
    method: str, scratch: Path, sample: Sample, start: CameraRig, matches: Matches
) -> Found:
    """Adjust by a method of `peers.py`."""
    found = call_peer(method, scratch, make_problem(sample, start, matches))
    rotation = matrix_from_vector(found["rotation"])
    rig = replace(start, rotation=rotation, translation=found["translation"])
    return rig, float(found["seconds"]), float(found["processor"])


def make_problem(sample: Sample, start: CameraRig, matches: Matches) -> dict[str, Floats]:
    """Return the arrays that peers are given."""
    seen = gather_tracks(sample, matches, np.arange(len(sample.frames)))
    return {"pixels": np.moveaxis(seen.pixels, 1, 2), **describe_rig(start)}


def figures(found: CameraRig, true: CameraRig) -> str:
    """Return E_R and E_t of all pairs, median / maximum, as two cells."""
    errors = []
    for a, b in combinations(range(len(true.cameras)), 2):
        (first, forth), (second, back) = found.relative(a, b), true.relative(a, b)
        errors.append((angle_between(first, second), direction_angle(forth, back)))
    degrees = np.degrees(errors).T
    return " | ".join(f"{np.median(each):.3f} / {each.max():.3f}" for each in degrees)


if __name__ == "__main__":
    main()
