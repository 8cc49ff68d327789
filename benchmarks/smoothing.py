"""Compare best estimates of poses with aniposelib's `triangulate_optim`: errors, jitter, time.

    .venv/bin/python benchmarks/smoothing.py SCRATCH [NAME ...] --recordings FOLDER
        --judge judge_poses.py

Both get the same detections, identities and cameras, those of `mocap-calib run --smooth off`. A
judge compares the poses with the truth: a script that takes NAME and `--out FOLDER` and prints
`NAME: figure value ...`. aniposelib has its defaults, the bones as constraints and the confidences
as scores. It gets an environment of its own in SCRATCH (aniposelib 0.8.0 from the package index).
Seconds are the processor's, of one thread, of the smoothing alone: of ours with the choice of how
strongly, of aniposelib's without what it compiles.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
from adjustment import peers_python
from recording_folders import add_recordings

import mocap_calib as mc
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.results.matches_csv import read_matches_csv
from mocap_calib.lift.lifter import AUTO, choose_model, load_vocabulary
from mocap_calib.poses.stage import smooth_poses
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.results import Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, Floats, Recording

NAMES = (
    "h36m_S1_walking",
    "h36m_S5_multi3",
    "shelf",
    "humaneva_S1_projected",
    "panoptic_band1_projected",
)
TOOL = Path(sys.executable).with_name("mocap-calib")
PEERS = Path(__file__).with_name("smoothing_peers.py")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def main() -> None:
    """One row a recording, as Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    add_recordings(parser)
    parser.add_argument("--judge", type=Path, required=True)
    options = parser.parse_args()
    print(
        "| recording | raw mm | ours mm | theirs mm | ours jitter | theirs | truth's "
        "| ours s | theirs s | times |\n" + "|---" * 10 + "|"
    )
    for name in options.names:
        work = options.scratch / name
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        print(row(options.recordings / name, work, options), flush=True)


def row(folder: Path, work: Path, options: argparse.Namespace) -> str:
    """Return what a recording shows, from the same rig and matches."""
    raw = work / "raw"
    keypoints, intrinsics = folder / "keypoints", folder / "intrinsics.toml"
    asked = ("--cameras", intrinsics, "-o", raw, "--seed", "0", "--smooth", "off")
    subprocess.run([TOOL, "run", keypoints, *asked], check=True, capture_output=True)
    rig = mc.read_rig(raw / "calibration.toml")
    recording, _ = choose_model(mc.read_recording([keypoints], cameras=intrinsics), AUTO)
    matches = read_matches_csv(raw / "matches.csv", recording)
    ours, our_seconds = smooth_here(recording, rig, matches)
    theirs, their_seconds = smooth_there(recording, rig, matches, options.scratch, work)
    seen = np.isfinite(ours)  # points that only one of them gives are not compared
    found = {"ours": ours, "theirs": np.where(seen, theirs, np.nan)}
    judged = {"raw": judge(folder.name, raw, options.judge)}
    for who, positions in found.items():
        out = replace_positions(raw, work / who, positions)
        judged[who] = judge(folder.name, out, options.judge)
    cells = [judged[who]["mpjpe"] for who in ("raw", "ours", "theirs")]
    cells += [judged[who]["jitter"] for who in ("ours", "theirs")]
    cells += [judged["ours"]["jitter-truth"]]
    texts = [f"{value:.2f}" for value in cells]
    times = f"{our_seconds:.2f} | {their_seconds:.2f} | {their_seconds / our_seconds:.0f}"
    return f"| {folder.name} | {' | '.join(texts)} | {times} |"


def smooth_here(recording: Recording, rig: CameraRig, matches: Matches) -> tuple[Floats, float]:
    """Return our points `[frame, individual, keypoint, 3]`, and seconds."""
    with single_threaded_libraries():
        raw = triangulate(recording, rig, matches)
        start = time.process_time()
        poses, _ = smooth_poses(recording, rig, matches, raw)
        return poses.positions, time.process_time() - start


def smooth_there(
    recording: Recording, rig: CameraRig, matches: Matches, scratch: Path, work: Path
) -> tuple[Floats, float]:
    """Return aniposelib's points `[frame, individual, keypoint, 3]`, and seconds."""
    seen = gather_tracks(recording, matches, np.arange(len(recording.frames)))
    shape = (len(rig), -1, matches.individuals, len(recording.keypoints))
    pixels = np.moveaxis(seen.pixels, 1, 2).reshape(*shape, 2)
    skeleton = load_vocabulary(recording.model)
    tracks = {
        "pixels": np.moveaxis(pixels, 2, 0),
        "scores": np.moveaxis(seen.weight.reshape(shape), 2, 0),
        "edges": np.array(edges_of_keypoints(skeleton, recording.vocabulary)),
        "fisheye": rig.cameras[0].fisheye,
        "matrix": np.stack([camera.matrix for camera in rig.cameras]),
        "distortion": np.stack([np.pad(camera.distortion, (0, 5))[:5] for camera in rig.cameras]),
        "size": np.array([camera.size for camera in rig.cameras]),
        "rotation": vector_from_matrix(rig.rotation),
        "translation": rig.translation,
    }
    np.savez(work / "tracks.npz", **tracks)
    command = [peers_python(scratch), PEERS, work / "tracks.npz", work / "result.npz"]
    subprocess.run(command, check=True, stdout=sys.stderr, env=os.environ | ONE_THREAD)
    with np.load(work / "result.npz") as result:
        return np.moveaxis(result["positions"], 0, 1), float(result["processor"])


def replace_positions(raw: Path, out: Path, positions: Floats) -> Path:
    """Return a copy of a folder of results that has other positions."""
    shutil.copytree(raw, out)
    with h5py.File(out / "poses3d.h5", "r+") as file:
        file["position"][...] = positions
    return out


def judge(name: str, out: Path, script: Path) -> dict[str, float]:
    """Return the figures that the judge prints of a folder of results."""
    done = subprocess.run(
        [sys.executable, script, name, "--out", out], check=True, capture_output=True, text=True
    )
    words = done.stdout.split()[1:]
    figures = dict(zip(words[::2], words[1::2], strict=True))
    return {key: float(figures[key]) for key in ("mpjpe", "jitter", "jitter-truth")}


if __name__ == "__main__":
    main()
