"""Run the main job on real recordings, and print the README's table.

    .venv/bin/python benchmarks/recordings.py --recordings FOLDER [NAME ...]
    .venv/bin/python benchmarks/recordings.py --unknown [NAME ...]   # that of docs/intrinsics.md

Each run is a process of its own that sees the keypoints and the intrinsics alone, with --unknown
the image sizes alone. Errors are those of the reference, precision and recall those of the known
identities, the verdict that of run.json.
"""

import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from common import TOOL, make_parser, print_header, print_row

import mocap_calib as mc

NAMES = (
    *("h36m_S1_walking", "h36m_S1_mix", "h36m_S6_mix", "h36m_S5_multi3", "shelf"),
    *("pose2sim_single", "humaneva_S1_projected", "panoptic_band1_projected", "mvor_openpose"),
    *("acinoset_lily_run", "two_dogs_projected", "dannce_two_mice_projected"),
    *("sleap_anipose_mouse", "caliscope_4cam", "eks_fly"),
)
NOT_OBSERVABLE = "not observable"  # in run.json, of what a recording does not determine
HEADER = (
    *("recording", "verdict", "E_R median / max (deg)", "E_t median (deg)"),
    *("precision", "recall", "wall (s)"),
)


def main() -> None:
    """One row a recording, as Markdown on stdout."""
    parser = make_parser(__doc__, recordings=True)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--unknown", action="store_true", help="without intrinsics")
    options = parser.parse_args()
    print_header(HEADER)
    for name in options.names:
        print_row(run(options.recordings / name, unknown=options.unknown))


def run(recording: Path, *, unknown: bool) -> list[str]:
    """Run and judge one recording; return its row."""
    given = ["--cameras", recording / "intrinsics.toml"]
    if unknown:
        cameras = mc.read_cameras(recording / "intrinsics.toml")
        sizes = (f"{each.name}:{each.size[0]}x{each.size[1]}" for each in cameras)
        given = [word for size in sizes for word in ("--image-size", size)]
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / "out"
        command = [sys.executable, "-P", *TOOL, "run", recording / "keypoints", *given]
        command += ["-o", out, "--seed", "0", "--quiet", "--accept", "not-determined"]
        start = time.perf_counter()
        done = subprocess.run(command, check=False)
        wall = f"{time.perf_counter() - start:.1f}"
        if done.returncode:
            return [recording.name, "refused", *["-"] * 4, wall]
        return [recording.name, read_verdict(out), *judge(recording, out), wall]


def judge(recording: Path, out: Path) -> list[str]:
    """Return the cells of the figures that need the reference."""
    reference = mc.read_rig(recording / "reference.toml")
    found = mc.evaluate(mc.read_rig(out / "cameras.yaml"), reference)
    rotation, translation = np.degrees([found.rotation_error, found.translation_error])
    precision, recall = identities(recording, reference.names, out / "matches.csv")
    return [
        f"{np.median(rotation):.2f} / {rotation.max():.2f}",
        f"{np.median(translation):.2f}",
        f"{precision:.3f}",
        f"{recall:.3f}",
    ]


def read_verdict(out: Path) -> str:
    """Return the verdict of a run on its rig, and what is not observable."""
    verdict = json.loads((out / "run.json").read_text("utf-8"))["verdict"]
    open_matters = [name for name in ("reversal", "translation") if verdict[name] == NOT_OBSERVABLE]
    return "; ".join([verdict["rig"], *(f"{name} {NOT_OBSERVABLE}" for name in open_matters)])


def identities(recording: Path, names: Sequence[str], matches: Path) -> tuple[float, float]:
    """Return precision and recall of matches, over known detections in all pairs of views."""
    ids = np.load(recording / "truth.npz")["ids"]
    labels = np.full(ids.shape, -1)
    with matches.open(newline="") as file:
        for line in csv.DictReader(file):
            where = names.index(line["camera"]), int(line["frame"]), int(line["instance"])
            if where[2] < ids.shape[2]:
                labels[where] = int(line["individual"])
    counts = np.zeros(3)  # right matches, matches, possible ones
    for a, b in combinations(range(len(ids)), 2):
        same, joined = (
            (of[a][:, :, None] == of[b][:, None]) & (of[a][:, :, None] >= 0) for of in (ids, labels)
        )
        known = (ids[a][:, :, None] >= 0) & (ids[b][:, None] >= 0)
        counts += (same & joined).sum(), (known & joined).sum(), same.sum()
    right, matched, possible = np.maximum(counts, [0, 1, 1])
    return right / matched, right / possible


if __name__ == "__main__":
    main()
