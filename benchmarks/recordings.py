"""Runs the main job on real recordings and prints the README's table.

    .venv/bin/python benchmarks/recordings.py --recordings FOLDER [NAME ...]

Each run is a process of its own that sees the keypoints and the intrinsics alone; rotation and
translation errors come from `mocap-calib evaluate`, precision and recall from the known identities,
the verdict from run.json. Those that go badly are shown as the others are.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
import tomllib
from itertools import combinations
from pathlib import Path

import numpy as np
from recording_folders import add_recordings

TOOL = Path(sys.executable).with_name("mocap-calib")
NAMES = (
    "h36m_S1_walking",
    "h36m_S1_mix",
    "h36m_S6_mix",
    "h36m_S5_multi3",
    "shelf",
    "pose2sim_single",
    "humaneva_S1_projected",
    "panoptic_band1_projected",
    "mvor_openpose",
    "acinoset_lily_run",
    "two_dogs_projected",
    "dannce_two_mice_projected",
    "sleap_anipose_mouse",
    "caliscope_4cam",
    "eks_fly",
)
NOT_OBSERVABLE = "not observable"  # what run.json says of what a recording cannot tell
HEADER = (
    "recording",
    "verdict",
    "E_R median / max (deg)",
    "E_t median (deg)",
    "precision",
    "recall",
    "wall (s)",
)


def main() -> None:
    """One row a recording, as Markdown on stdout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    add_recordings(parser)
    options = parser.parse_args()
    print(f"| {' | '.join(HEADER)} |")
    print("|---" * len(HEADER) + "|")
    for name in options.names:
        print(row(options.recordings / name), flush=True)


def row(recording: Path) -> str:
    """Run and judge one recording."""
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / "out"
        start = time.perf_counter()
        cameras = recording / "intrinsics.toml"
        command = ["run", recording / "keypoints", "--cameras", cameras, "-o", out, "--seed", "0"]
        done = run(*command, "--accept", "not-determined", "--quiet")
        wall = f"{time.perf_counter() - start:.1f}"
        figures = ["-"] * 4 if done.returncode else judge(recording, out)
        verdict = "refused" if done.returncode else read_verdict(out)
    return f"| {' | '.join([recording.name, verdict, *figures, wall])} |"


def judge(recording: Path, out: Path) -> list[str]:
    """Return the cells of the figures that need the reference."""
    done = run(
        "evaluate", out / "cameras.yaml", "--reference", recording / "reference.toml", "--json"
    )
    found = json.loads(done.stdout)
    rotation, translation = found["rotation_error_deg"], found["translation_error_deg"]
    precision, recall = identities(recording, out / "matches.csv")
    return [
        f"{rotation['median']:.2f} / {rotation['max']:.2f}",
        f"{translation['median']:.2f}",
        f"{precision:.3f}",
        f"{recall:.3f}",
    ]


def read_verdict(out: Path) -> str:
    """Return what the run says of its rig, and what it cannot tell."""
    verdict = json.loads((out / "run.json").read_text("utf-8"))["verdict"]
    open_matters = [name for name in ("reversal", "translation") if verdict[name] == NOT_OBSERVABLE]
    return "; ".join([verdict["rig"], *(f"{name} {NOT_OBSERVABLE}" for name in open_matters)])


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command of the tool; its complaints go where ours go."""
    return subprocess.run([TOOL, *arguments], stdout=subprocess.PIPE, text=True, check=False)


def identities(recording: Path, matches: Path) -> tuple[float, float]:
    """Return precision and recall of matches between views.

    Over detections of known identity in all pairs of views.
    """
    ids = np.load(recording / "truth.npz")["ids"]
    names = [
        entry["name"]
        for entry in tomllib.loads((recording / "reference.toml").read_text()).values()
    ]
    labels = np.full(ids.shape, -1)
    with matches.open(newline="") as file:
        for line in csv.DictReader(file):
            where = names.index(line["camera"]), int(line["frame"]), int(line["instance"])
            if where[2] < ids.shape[2]:
                labels[where] = int(line["individual"])
    good = matched = possible = 0
    for a, b in combinations(range(len(ids)), 2):
        known = (ids[a][:, :, None] >= 0) & (ids[b][:, None] >= 0)
        same = known & (ids[a][:, :, None] == ids[b][:, None])
        joined = (
            known & (labels[a][:, :, None] >= 0) & (labels[a][:, :, None] == labels[b][:, None])
        )
        good, matched, possible = (
            good + int((same & joined).sum()),
            matched + int(joined.sum()),
            possible + int(same.sum()),
        )
    return good / max(matched, 1), good / max(possible, 1)


if __name__ == "__main__":
    main()
