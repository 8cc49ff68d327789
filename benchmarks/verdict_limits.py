"""Fit the limits of the verdict's checks to runs whose errors are known.

    python benchmarks/verdict_limits.py RUNS.jsonl

A line of RUNS.jsonl is one run: {"name": ..., "error_deg": rotation error of its worst camera by a
reference, "fit": true or false, "verdict": that of its run.json}. Limits are fitted to the runs
with "fit", by the likelihood of their errors: half-normal, with the expected error as standard
deviation. The others are held against them. Causes that are no checks stay as they are.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from mocap_calib.results import word_of_error
from mocap_calib.types import Floats
from mocap_calib.verdict.checks import CHECKS

MOST_DEG = 5.0  # of one check, as in verdict/checks.py
MOST_ERROR_DEG = 60.0  # larger errors count as this
STRENGTH = 1.0  # of the pull to the limits at present, for checks that few runs fail

SOUND = np.array([kind.sound[1] for kind in CHECKS])
LIMITS = np.array([kind.limit for kind in CHECKS])


def excess_of(verdict: dict) -> Floats:
    """Return by how much each check `[check]` is beyond the values of sound recordings."""
    values = {check["name"]: check["value"] for check in verdict["checks"]}
    found = [values[kind.name] for kind in CHECKS]
    known = np.array([np.nan if value is None else value for value in found])
    return np.maximum(np.nan_to_num(known - SOUND, nan=0.0), 0.0)


def other_variance(verdict: dict) -> float:
    """Return the largest squared error in degrees that causes other than checks stand for."""
    names = {kind.name for kind in CHECKS}
    others = [cause for cause in verdict["causes"] if cause["name"] not in names]
    cameras = {cause["camera"] for cause in others} | {None}
    sums = [
        sum(each["error_deg"] ** 2 for each in others if each["camera"] in (None, camera))
        for camera in cameras
    ]
    return max(sums)


def expected(slope: Floats, excess: Floats, variance: Floats) -> Floats:
    """Return the expected errors `[run]` in degrees. slope: `[check]` degrees for the excess."""
    return np.sqrt(variance + (np.minimum(slope * excess, MOST_DEG) ** 2).sum(1))


def fit_limits(excess: Floats, variance: Floats, error: Floats) -> Floats:
    """Return the limits `[check]` with which the errors `[run]` are most likely."""
    start = -np.log(LIMITS - SOUND)

    def cost(log_slope: Floats) -> float:
        sigma = expected(np.exp(log_slope), excess, variance)
        likelihood = np.log(sigma) + np.minimum((error / sigma) ** 2, 100) / 2
        return float(likelihood.sum() + STRENGTH * ((log_slope - start) ** 2).sum() / 2)

    return SOUND + np.exp(-minimize(cost, start, method="L-BFGS-B").x)


def main() -> None:
    """Print the limits, at present and fitted, and the runs whose verdict promises too much."""
    lines = Path(sys.argv[1]).read_text("utf-8").splitlines()
    runs = [json.loads(line) for line in lines]
    excess = np.stack([excess_of(run["verdict"]) for run in runs])
    variance = np.array([other_variance(run["verdict"]) for run in runs])
    error = np.minimum([run["error_deg"] for run in runs], MOST_ERROR_DEG)
    part = np.array([run["fit"] for run in runs])
    fitted = fit_limits(excess[part], variance[part], error[part])
    for kind, limit, failed in zip(CHECKS, fitted, (excess > 0).sum(0), strict=True):
        print(f"{kind.name:16s} limit {kind.limit:7.3g}  fitted {limit:7.3g}  in {failed} runs")
    for title, limits in (("at present", LIMITS), ("fitted", fitted)):
        degrees = expected(1 / (limits - SOUND), excess, variance)
        broken = [
            f"{run['name']} {run['error_deg']:.2f} deg: {word_of_error(each)}"
            for run, each in zip(runs, degrees, strict=True)
            if run["error_deg"] > 2 * each
        ]
        print(f"{title}: {len(broken)} of {len(runs)} runs are off by more than twice expected")
        print("\n".join(f"  {line}" for line in broken))


if __name__ == "__main__":
    main()
