"""How firmly the number of individuals of a recording follows, whatever the constants.

Calibrate a recording with each of twelve constants times .7 and times 1.4, and count how often as
many individuals are found as there are. RECORDING is a folder with keypoints/ and intrinsics.toml,
or the name of one under the folder that MOCAP_CALIB_RECORDINGS names.

    python benchmarks/identities.py RECORDING --individuals N
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import mocap_calib
from mocap_calib.config import Config

CONSTANTS = (
    "sample.detections",
    "pairwise.inlier",
    "pairwise.centre_tolerance",
    "pairwise.pose_tolerance",
    "averaging.weak_score",
    "matching.least_affinity",
    "matching.decisive",
    "adjust.points",
    "adjust.low_confidence_share",
    "adjust.outlier",
    "triangulate.outlier",
    "triangulate.least_angle_deg",
)
FACTORS = (0.7, 1.4)


def scaled(config: Any, path: str, factor: float) -> Any:
    """Return a configuration with the constant at this path multiplied."""
    name, _, rest = path.partition(".")
    value = getattr(config, name)
    changed = scaled(value, rest, factor) if rest else type(value)(value * factor)
    return replace(config, **{name: changed})


def find_recording(name: str) -> Path:
    """Return the folder of a recording."""
    return Path(name) if Path(name).exists() else Path(os.environ["MOCAP_CALIB_RECORDINGS"]) / name


def main() -> None:
    """Print the individuals found with each constant changed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recording")
    parser.add_argument("--individuals", type=int, required=True)
    asked = parser.parse_args()
    folder = find_recording(asked.recording)
    recording = mocap_calib.read_recording(
        str(folder / "keypoints"), str(folder / "intrinsics.toml")
    )
    right = 0
    for path in CONSTANTS:
        for factor in FACTORS:
            config = scaled(Config(), path, factor)
            group = mocap_calib.calibrate(recording, config=config).groups[0]
            right += group.matches.individuals == asked.individuals
            print(f"{path} x {factor}: {group.matches.individuals}", flush=True)
    print(f"{right} of {len(CONSTANTS) * len(FACTORS)} with {asked.individuals} individuals")


if __name__ == "__main__":
    main()
