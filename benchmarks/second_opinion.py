"""Adjust real recordings with our solver and with COLMAP's, and print how far apart the rigs are.

    .venv/bin/python benchmarks/second_opinion.py --recordings FOLDER [NAME ...]

Each stage is a command of its own. Both solvers start from the same averaged rig and the same
matches; errors come from `mocap-calib evaluate` against the reference, and so does the angle
between the two rigs.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from recording_folders import add_recordings

from mocap_calib.config import ADJUST_SOLVERS

TOOL = Path(sys.executable).with_name("mocap-calib")
NAMES = (
    "shelf",
    "h36m_S1_walking",
    "pose2sim_single",
    "acinoset_lily_run",
    "panoptic_band1_projected",
)


def main() -> None:
    """One row a recording, as Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    add_recordings(parser)
    options = parser.parse_args()
    columns = [f"{solver} {what}" for solver in ADJUST_SOLVERS for what in ("E_R", "E_t", "s")]
    print(f"| recording | {' | '.join(columns)} | rigs apart, median / max (deg) |")
    print("|---" * (len(columns) + 2) + "|")
    for name in options.names:
        with tempfile.TemporaryDirectory() as work:
            print(row(options.recordings / name, Path(work)), flush=True)


def row(recording: Path, work: Path) -> str:
    """Adjust one recording twice, and judge both rigs (median / max in degrees)."""
    keypoints = str(recording / "keypoints")
    rig, matches = str(work / "rig.yaml"), str(work / "matches.csv")
    intrinsics = str(recording / "intrinsics.toml")
    run("pairwise", keypoints, "--cameras", intrinsics, "-o", f"{work}/pairs.json", "-q")
    run("average", f"{work}/pairs.json", "-o", rig)
    run("match", keypoints, "--rig", rig, "-o", matches, "-q")
    cells = []
    for solver in ADJUST_SOLVERS:
        found = f"{work}/{solver}.yaml"
        start = time.perf_counter()
        asked = ("--rig", rig, "--matches", matches, "--solver", solver, "-o", found)
        run("adjust", keypoints, *asked, "--accept", "not-determined", "-q")
        seconds = time.perf_counter() - start
        cells += [*errors(found, str(recording / "reference.toml")), f"{seconds:.1f}"]
    apart, _ = errors(f"{work}/colmap.yaml", f"{work}/schur.yaml", digits=4)
    return f"| {recording.name} | {' | '.join(cells)} | {apart} |"


def errors(rig: str, reference: str, digits: int = 2) -> tuple[str, str]:
    """Return E_R and E_t of all pairs, median / max in degrees."""
    found = json.loads(run("evaluate", rig, "--reference", reference, "--json"))
    rotation, translation = (
        f"{error['median']:.{digits}f} / {error['max']:.{digits}f}"
        for error in (found["rotation_error_deg"], found["translation_error_deg"])
    )
    return rotation, translation


def run(*arguments: str) -> str:
    """Return what one command of the tool writes; its complaints go where ours go."""
    return subprocess.run([TOOL, *arguments], check=True, stdout=subprocess.PIPE, text=True).stdout


if __name__ == "__main__":
    main()
