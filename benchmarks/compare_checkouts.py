"""Compare what two checkouts make of the same recordings: cameras, matches and 3D poses.

    .venv/bin/python benchmarks/compare_checkouts.py BEFORE AFTER [NAME ...] [--work FOLDER]

BEFORE and AFTER are folders with a checkout each. Both run under the interpreter that runs this
script, so that only the code differs. Results of BEFORE that are in the work folder are used
again; those of AFTER are always made anew. Labels must be equal, and numbers equal to 1e-6.
Exit status 1 where something differs.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import yaml
from common import make_parser, print_header, print_row
from recordings import NAMES

TOLERANCE = 1e-6
PROGRAM = "from mocap_calib_cli.main import main; main()"


def main() -> None:
    """Print one row a recording, as Markdown, and exit with 1 where something differs."""
    parser = make_parser(__doc__, recordings=True)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "compared")
    given = parser.parse_args()
    files = ("matches.csv", "cameras.yaml", "poses3d.h5")
    print_header(("recording", *files, "verdict", "before, after (s)"))
    alike = [compare(given.recordings / name, given) for name in given.names]
    sys.exit(0 if all(alike) else 1)


def compare(recording: Path, given: argparse.Namespace) -> bool:
    """Run both checkouts on one recording, print its row, and return whether they agree."""
    before = given.work / "before" / recording.name
    after = given.work / "after" / recording.name
    if not (before / "run.json").is_file():
        run(given.before, recording, before)
    shutil.rmtree(after, ignore_errors=True)
    run(given.after, recording, after)
    same_labels = labels(before) == labels(after)
    rig = largest_difference(cameras(before), cameras(after))
    poses = largest_difference(poses3d(before), poses3d(after))
    seconds = ", ".join((folder / "seconds").read_text() for folder in (before, after))
    matches = "equal" if same_labels else "DIFFERENT"
    verdict = " -> ".join(dict.fromkeys(verdict_of(folder) for folder in (before, after)))
    print_row((recording.name, matches, f"{rig:.1e}", f"{poses:.1e}", verdict, seconds))
    return same_labels and max(rig, poses) <= TOLERANCE


def run(checkout: Path, recording: Path, output: Path) -> None:
    """Calibrate a recording with the code of a checkout; the wall time goes beside the results."""
    code = os.pathsep.join(str((checkout / part).resolve()) for part in (".", "cli"))
    # -P: the code of the checkout, not that of the folder where this is run
    command = [sys.executable, "-P", "-c", PROGRAM, "run", str(recording / "keypoints")]
    command += ["--cameras", str(recording / "intrinsics.toml"), "-o", str(output)]
    start = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": code}
    done = subprocess.run([*command, "--seed", "0", "--quiet"], check=False, env=environment)
    if not (output / "run.json").exists():  # the status is 1 also where a rig is not determined
        done.check_returncode()
    (output / "seconds").write_text(f"{time.perf_counter() - start:.1f}")


def labels(folder: Path) -> list[tuple[str, ...]]:
    """Return camera, frame, instance and individual of every detection, sorted."""
    with (folder / "matches.csv").open(newline="") as file:
        return sorted(
            (row["camera"], row["frame"], row["instance"], row["individual"])
            for row in csv.DictReader(file)
        )


def verdict_of(folder: Path) -> str:
    """Return what run.json says of the rig."""
    return json.loads((folder / "run.json").read_text())["verdict"]["rig"]


def cameras(folder: Path) -> dict[str, np.ndarray]:
    """Return the numbers of each field of each camera, by `camera.field`."""
    found = yaml.safe_load((folder / "cameras.yaml").read_text())["cameras"]
    return {
        f"{camera['name']}.{field}": np.array(value, dtype=float)
        for camera in found
        for field, value in camera.items()
        if field not in ("name", "model")
    }


def poses3d(folder: Path) -> dict[str, np.ndarray]:
    """Return all datasets of numbers, by name."""
    with h5py.File(folder / "poses3d.h5") as file:
        numeric = [name for name in file if file[name].dtype.kind in "fi"]
        return {name: np.asarray(file[name], dtype=float) for name in numeric}


def largest_difference(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> float:
    """Return the largest difference, relative where numbers exceed 1; infinite for other shapes.

    What is new in the second is no difference.
    """
    if before.keys() - after.keys():
        return np.inf
    found = 0.0
    for name, first in before.items():
        second = after[name]
        if first.shape != second.shape or (np.isnan(first) != np.isnan(second)).any():
            return np.inf
        gap = np.abs(first - second) / np.maximum(np.abs(first), 1.0)
        found = max(found, float(np.nanmax(gap, initial=0.0)))
    return found


if __name__ == "__main__":
    main()
