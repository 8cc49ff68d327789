"""Compare smoothed poses with aniposelib's `triangulate_optim`: errors, jitter, time.

    .venv/bin/python benchmarks/smoothing.py SCRATCH [NAME ...] --recordings FOLDER
        --judge judge_poses.py

Both get the same detections, identities and cameras, those of `mocap-calib run --smooth off`. The
judge compares poses with the truth: a script that takes NAME and `--out FOLDER` and prints
`NAME: figure value ...`. aniposelib has its defaults, the bones as constraints and the confidences
as scores. Processor seconds of one thread, of the smoothing alone.
"""

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
from common import TOOL, make_parser, print_header, print_row
from peer_calls import call_peer, describe_rig

import mocap_calib as mc
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.io.results.matches_csv import read_matches_csv
from mocap_calib.lift.lifter import AUTO, choose_model, load_vocabulary
from mocap_calib.poses.stage import smooth_poses
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.rig import gather_tracks
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, Floats, Recording

NAMES = (
    *("h36m_S1_walking", "h36m_S5_multi3", "shelf"),
    *("humaneva_S1_projected", "panoptic_band1_projected"),
)
COLUMNS = (
    *("recording", "raw mm", "ours mm", "theirs mm", "ours jitter", "theirs", "truth's"),
    *("ours s", "theirs s", "times"),
)


def main() -> None:
    """Print one row a recording as Markdown."""
    parser = make_parser(__doc__, recordings=True)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--judge", type=Path, required=True)
    options = parser.parse_args()
    print_header(COLUMNS)
    for name in options.names:
        work = options.scratch / name
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        print_row(row(options.recordings / name, work, options))


def row(folder: Path, work: Path, options: argparse.Namespace) -> list[str]:
    """Return the row of a recording."""
    raw = work / "raw"
    keypoints, intrinsics = folder / "keypoints", folder / "intrinsics.toml"
    asked = ("--cameras", intrinsics, "-o", raw, "--seed", "0", "--smooth", "off")
    command = [sys.executable, "-P", *TOOL, "run", keypoints, *asked]
    subprocess.run(command, check=True, capture_output=True)
    rig = mc.read_rig(raw / "calibration.toml")
    recording, _ = choose_model(mc.read_recording([keypoints], cameras=intrinsics), AUTO)
    matches = read_matches_csv(raw / "matches.csv", recording)
    ours, our_seconds = smooth_here(recording, rig, matches)
    theirs = call_peer("smooth", options.scratch, make_problem(recording, rig, matches))
    seen = np.isfinite(ours)  # points that only one of them gives are not compared
    found = {"ours": ours, "theirs": np.where(seen, np.moveaxis(theirs["positions"], 0, 1), np.nan)}
    judged = {"raw": judge(folder.name, raw, options.judge)}
    for who, positions in found.items():
        out = shutil.copytree(raw, work / who)
        with h5py.File(out / "poses3d.h5", "r+") as file:
            file["position"][...] = positions
        judged[who] = judge(folder.name, out, options.judge)
    figures = [judged[who]["mpjpe"] for who in ("raw", "ours", "theirs")]
    figures += [judged[who]["jitter"] for who in ("ours", "theirs")]
    figures += [judged["ours"]["jitter-truth"], our_seconds, float(theirs["processor"])]
    return [folder.name, *(f"{x:.2f}" for x in figures), f"{figures[-1] / figures[-2]:.0f}"]


def smooth_here(recording: Recording, rig: CameraRig, matches: mc.Matches) -> tuple[Floats, float]:
    """Return our points `[frame, individual, keypoint, 3]`, and seconds."""
    with single_threaded_libraries():
        raw = triangulate(recording, rig, matches)
        start = time.process_time()
        poses, _ = smooth_poses(recording, rig, matches, raw)
        return poses.positions, time.process_time() - start


def make_problem(recording: Recording, rig: CameraRig, matches: mc.Matches) -> dict[str, Floats]:
    """Return the arrays that aniposelib is given."""
    seen = gather_tracks(recording, matches, np.arange(len(recording.frames)))
    shape = (len(rig), -1, matches.individuals, len(recording.keypoints))
    pixels = np.moveaxis(seen.pixels, 1, 2).reshape(*shape, 2)
    skeleton = load_vocabulary(recording.model)
    return {
        "pixels": np.moveaxis(pixels, 2, 0),
        "scores": np.moveaxis(seen.weight.reshape(shape), 2, 0),
        "edges": np.array(edges_of_keypoints(skeleton, recording.vocabulary)),
        "fisheye": np.array(rig.cameras[0].fisheye),
        **describe_rig(rig),
    }


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
