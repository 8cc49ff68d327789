"""Measure bundle adjustment alone: ours, COLMAP's, aniposelib's and scipy's, from the same start.

    .venv/bin/python benchmarks/adjustment.py SCRATCH [--cameras 8] [--frames 1000]
        [--people 1] [--methods ours colmap colmap-all anipose scipy]

One synthetic person, identities known, 2 px of noise, 5 % missing, 1 % gross errors; the cameras
start 3 degrees and 3 % of the radius off, intrinsics fixed. SCRATCH: a folder in which the others
get an environment of their own (aniposelib 0.8.0 from the package index). Ours is timed from
detections to rig: choice of points, triangulation and all. `colmap` is Ceres through pycolmap
(`ceres.py`), on the points of `ours`; `colmap-all` takes all points. Both adjust twice,
as `ours` does: how large errors are is known only of a rig that is close. Of aniposelib,
what it compiles is not counted.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from ceres import adjust_by_ceres

from mocap_calib.adjust.refine import adjust_once
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.geometry.rotation import (
    angle_between,
    direction_angle,
    matrix_from_vector,
    vector_from_matrix,
)
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.synthetic import simulate
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.types import CameraRig, Floats, Sample


def adjust_twice(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> CameraRig:
    """Return an adjusted rig, adjusted again by the errors of a rig that is close."""
    rig = adjust_once(sample, rig, matches, config)
    return adjust_once(sample, rig, matches, config, already_close=True)


def adjust_by_ceres_twice(
    recording: Sample, rig: CameraRig, matches: Matches, config: Config
) -> CameraRig:
    """Adjust with COLMAP as `adjust_twice` does with ours."""
    rig = adjust_by_ceres(recording, rig, matches, config)
    return adjust_by_ceres(recording, rig, matches, config, already_close=True)


METHODS = ("ours", "colmap", "colmap-all", "anipose", "scipy")
ALL_POINTS = AdjustConfig(points=100_000, low_confidence_share=0.0)
OURS = {
    "ours": (adjust_twice, AdjustConfig()),
    "colmap": (adjust_by_ceres_twice, AdjustConfig()),
    "colmap-all": (adjust_by_ceres_twice, ALL_POINTS),
}
PEERS = Path(__file__).with_name("adjustment_peers.py")


def main() -> None:
    """Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--people", type=int, default=1)
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=METHODS)
    options = parser.parse_args()
    true, recording, matches = make_scene(options.cameras, options.frames, options.people)
    start = moved(true)
    print(
        "| method | seconds | processor (s) | E_R median / max (deg) | E_t median / max (deg) |\n"
        "|---|---|---|---|---|"
    )
    print(f"| start | | | {figures(start, true)} |")
    for method in options.methods:
        found, wall, processor = (
            ours(*OURS[method], recording, start, matches)
            if method in OURS
            else peer(method, options.scratch, recording, start, matches)
        )
        print(f"| {method} | {wall:.2f} | {processor:.2f} | {figures(found, true)} |", flush=True)


def make_scene(cameras: int, frames: int, people: int) -> tuple[CameraRig, Sample, Matches]:
    """Return the true rig, what was detected, and who is who."""
    size = {"cameras": cameras, "frames": frames, "people": people}
    made = simulate(SimulateConfig(**size, false_detections=0.0))
    recording = make_recording(made.files, made.rig.cameras, load_skeleton("people"), {})
    return made.rig, take_sample(recording, slice(None)), Matches(made.identity.astype(np.int64))


def moved(rig: CameraRig) -> CameraRig:
    """Every camera turned by 3 degrees and moved by 3 % of its distance from the origin."""
    rng = np.random.default_rng(0)
    turn, shift = (
        axis / np.linalg.norm(axis, axis=1, keepdims=True)
        for axis in rng.normal(size=(2, len(rig.cameras), 3))
    )
    rotation = matrix_from_vector(np.radians(3.0) * turn) @ rig.rotation
    centres = rig.centres + 0.03 * np.linalg.norm(rig.centres, axis=1, keepdims=True) * shift
    return rig.stand(rotation, centres)


def ours(
    adjuster: Callable[[Sample, CameraRig, Matches, Config], CameraRig],
    config: AdjustConfig,
    recording: Sample,
    start: CameraRig,
    matches: Matches,
) -> tuple[CameraRig, float, float]:
    """Return the rig, seconds and seconds of the processor."""
    wall, processor = time.perf_counter(), time.process_time()
    found = adjuster(recording, start, matches, Config(adjust=config))
    return found, time.perf_counter() - wall, time.process_time() - processor


def peer(
    method: str, scratch: Path, recording: Sample, start: CameraRig, matches: Matches
) -> tuple[CameraRig, float, float]:
    """Return what `ours` does, of an adjustment in another environment."""
    result = call_peer(PEERS, method, scratch, as_problem(recording, start, matches))
    found = replace(
        start,
        rotation=matrix_from_vector(result["rotation"]),
        translation=result["translation"],
    )
    return found, float(result["seconds"]), float(result["processor"])


def as_problem(recording: Sample, start: CameraRig, matches: Matches) -> dict[str, Floats]:
    """Return the arrays that the peers are given, as adjustment_peers.py says."""
    seen = gather_tracks(recording, matches, np.arange(len(recording.frames)))
    return {
        "pixels": np.moveaxis(seen.pixels, 1, 2),
        "matrix": np.stack([camera.matrix for camera in start.cameras]),
        "distortion": np.stack([np.pad(camera.distortion, (0, 5))[:5] for camera in start.cameras]),
        "size": np.array([camera.size for camera in start.cameras]),
        "rotation": vector_from_matrix(start.rotation),
        "translation": start.translation,
    }


def call_peer(
    program: Path, method: str, scratch: Path, problem: dict[str, Floats]
) -> dict[str, Floats]:
    """Return what a method of a program finds in the environment of the peers."""
    np.savez(scratch / "problem.npz", **problem)
    subprocess.run(
        [
            peers_python(scratch),
            program,
            method,
            scratch / "problem.npz",
            scratch / "result.npz",
        ],
        check=True,
        stdout=sys.stderr,
    )
    with np.load(scratch / "result.npz") as result:
        return dict(result)


def peers_python(scratch: Path) -> Path:
    """Return the interpreter of an environment that has aniposelib; it is made where it lacks."""
    python = scratch / "peers" / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", scratch / "peers"], check=True)
        subprocess.run(
            [python, "-m", "pip", "install", "--quiet", "aniposelib==0.8.0"],
            check=True,
            stdout=sys.stderr,
        )
    return python


def figures(found: CameraRig, true: CameraRig) -> str:
    """E_R and E_t of all pairs."""
    a, b = np.array(list(combinations(range(len(true.cameras)), 2))).T
    (first, forth), (second, back) = (relative(rig, a, b) for rig in (found, true))
    errors = np.degrees(angle_between(first, second)), np.degrees(direction_angle(forth, back))
    return " | ".join(f"{np.median(error):.3f} / {error.max():.3f}" for error in errors)


def relative(rig: CameraRig, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """b_from_a of pairs of cameras."""
    rotation = rig.rotation[b] @ np.swapaxes(rig.rotation[a], 1, 2)
    return rotation, rig.translation[b] - np.einsum("pij,pj->pi", rotation, rig.translation[a])


if __name__ == "__main__":
    main()
