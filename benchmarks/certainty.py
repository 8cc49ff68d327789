"""Measure whether rigs are as sure as they say they are, against known truth.

    .venv/bin/python benchmarks/certainty.py simulated      # whether 95 % regions hold the truth
    .venv/bin/python benchmarks/certainty.py recordings     # errors against their sigmas
    .venv/bin/python benchmarks/certainty.py degenerate     # verdicts on what determines no rig

Every case goes through the whole pipeline, which sees keypoints and intrinsics alone. Errors are
what is left after the best similarity. What is found of a case is a line of JSON in a file; cases
that are in it are not run again, so what was cut off goes on. Exit status 1 where a figure is
beyond its bound.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from certainty_cases import KINDS, Case, degenerate_cases, recorded_case, simulated_cases
from recording_folders import add_recordings
from recordings import NAMES
from scipy.stats import chi2

from mocap_calib.config import EPOCH_MARK, VERDICT_LIMITS_DEG
from mocap_calib.errors import MocapCalibError
from mocap_calib.geometry.rotation import angle_between, nearest_rotation, rig_change
from mocap_calib.pipeline import calibrate
from mocap_calib.results import VERDICTS, GroupResult
from mocap_calib.types import CameraRig, Floats

Line = dict[str, Any]

SIMULATED = 200
DEGENERATE = 25  # of each kind
INSIDE = (0.90, 0.99)  # share of cameras whose 95 % region holds the truth
RIG_SIZES = {"3": (3, 3), "4": (4, 4), "5 and more": (5, np.inf)}
CHI2_95 = float(chi2.ppf(0.95, 3))
RATIO = (0.4, 2.5)  # of the RMS error to the RMS sigma
RATIO_FREE = ("mvor_openpose",)  # reference and people's joints are apart there
RIGHT = 0.95  # share of the verdicts
# error of the worst pair of cameras above which a verdict is wrong: three times what it promises,
# and of a weak rig what nobody would still call a rig
MOST_DEG = dict(zip(VERDICTS, (*(3 * limit for limit in VERDICT_LIMITS_DEG), np.inf), strict=True))
GOOD_DEG = 1.0  # below it, a sound recording must not be called not determined


def main() -> None:
    """Run what is not there yet, print the table, and exit with 1 where it is beyond a bound."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["simulated", "recordings", "degenerate"])
    parser.add_argument("--cases", type=int, help="simulated scenes, or cases of each kind")
    add_recordings(parser, needed=False)
    parser.add_argument("--results", type=Path, help="lines of JSON; default: out/certainty/")
    given = parser.parse_args()
    if given.what == "recordings" and given.recordings is None:
        parser.error("expected --recordings FOLDER, found none")
    cases = {
        "simulated": lambda: simulated_cases(given.cases or SIMULATED),
        "recordings": lambda: (recorded_case(given.recordings / name) for name in NAMES),
        "degenerate": lambda: degenerate_cases(given.cases or DEGENERATE),
    }[given.what]()
    tables = {"simulated": table_of_regions, "recordings": table_of_ratios}
    results = given.results or Path("out/certainty") / f"{given.what}.jsonl"
    lines = list(run_all(cases, results))
    good = tables.get(given.what, table_of_verdicts)(lines)
    sys.exit(0 if good else 1)


# Running


def run_all(cases: Iterable[Case], results: Path) -> Iterator[Line]:
    """Yield what is found of each case, and keep it in a file."""
    results.parent.mkdir(parents=True, exist_ok=True)
    known = {}
    if results.is_file():
        known = {line["case"]: line for line in map(json.loads, results.read_text().splitlines())}
    for case in cases:
        line = known.get(case.name)
        if line is None:
            line = run(case)
            with results.open("a") as file:
                file.write(json.dumps(line) + "\n")
        yield line


def run(case: Case) -> Line:
    """Calibrate one case, and hold what was found against the truth."""
    start, files = time.perf_counter(), case.make()
    line: Line = {"case": case.name, "kind": case.kind, "refused": "", "groups": []}
    try:
        result = calibrate(files.record())
    except MocapCalibError as error:
        line["refused"] = str(error)
    else:
        line["groups"] = [judge_group(group, files.truth) for group in result.groups]
        line["left_out"] = list(result.left_out)
        line["faults"] = [[fault.camera, fault.word] for fault in result.faults]
    return line | {"seconds": round(time.perf_counter() - start, 1)}


# Errors and sigmas of one group


def judge_group(group: GroupResult, truth: Sequence[CameraRig]) -> dict[str, Any]:
    """Return the verdict on a group, and errors and sigmas of its cameras.

    truth: rigs of cameras that belong together. Where the group has cameras of several of them, no
    errors are given (`true` is false).
    Angles are in degrees, lengths in percent of the size of the rig; `*_distance` are the squared
    Mahalanobis distances of the errors of a camera (3 degrees of freedom). `pair_deg` is the
    largest angle between relative rotations of two cameras and the true ones.
    """
    covariance = group.uncertainty.covariance
    found: dict[str, Any] = {
        "cameras": list(group.rig.names),
        "verdict": group.verdict,
        "failed": [check.name for check in group.assessment.checks if not check.passed],
        "reasons": list(map(str, group.reasons)),
        "rotation_sigma_deg": np.degrees(covariance.rotation_sigma).tolist(),
        "centre_sigma": (100 * covariance.centre_sigma).tolist(),
        "true": False,
    }
    true = find_truth(group.rig, truth)
    if true is None:
        return found
    error, turn, shift = rig_error(group.rig, true), slice(0, 3), slice(3, 6)
    return found | {
        "true": True,
        "pair_deg": worst_pair_deg(group.rig, true),
        "rotation_deg": np.degrees(norms(error[:, turn])).tolist(),
        "rotation_distance": mahalanobis(error[:, turn], covariance.matrix[:, turn, :, turn]),
        "centre": (100 * norms(error[:, shift])).tolist(),
        "centre_distance": mahalanobis(error[:, shift], covariance.matrix[:, shift, :, shift]),
    }


def find_truth(rig: CameraRig, truth: Sequence[CameraRig]) -> CameraRig | None:
    """Return where the cameras of a rig truly stand; None where they are of several rigs."""
    names = [name.partition(EPOCH_MARK)[0] for name in rig.names]
    for each in truth:
        if set(names) <= set(each.names):
            where = [each.names.index(name) for name in names]
            placed = {"rotation": each.rotation[where], "translation": each.translation[where]}
            return replace(rig, **placed)
    return None


def rig_error(rig: CameraRig, true: CameraRig) -> Floats:
    """Return by how much cameras must be turned and shifted to be right, `[view, 6]`.

    As `rig_change` says. The rigs are first aligned by all of their rotations, which is good where
    the centres are on a line too.
    """
    turn = nearest_rotation(np.einsum("vji,vjk->ik", rig.rotation, true.rotation))
    return rig_change(rig, replace(true, rotation=true.rotation @ turn.T))


def worst_pair_deg(rig: CameraRig, true: CameraRig) -> float:
    """Return the largest angle between relative rotations of two cameras and the true ones."""
    angles = (
        angle_between(rig.relative(a, b)[0], true.relative(a, b)[0])
        for a, b in combinations(range(len(rig.cameras)), 2)
    )
    return float(np.degrees(max(angles)))


def mahalanobis(error: Floats, covariance: Floats) -> list[float]:
    """Return e' C^-1 e of the error `[view, 3]` of each camera.

    covariance: `[view, 3, view, 3]`.
    """
    inverse = np.linalg.pinv(np.einsum("vivj->vij", covariance), hermitian=True)
    return np.einsum("vi,vij,vj->v", error, inverse, error).tolist()


def norms(vectors: Floats) -> Floats:
    """Return the lengths of vectors `[view, 3]`."""
    return np.linalg.norm(vectors, axis=1)


# Tables: each prints itself, and returns whether its figures are within their bounds


def table_of_regions(lines: Sequence[Line]) -> bool:
    """Print the share of cameras whose 95 % region holds the truth, by the size of the rig."""
    groups = [group for line in lines for group in line["groups"] if group["true"]]
    print("| cameras | rigs | rotation inside | centre inside | rotation, also not determined |")
    print("|---|---|---|---|---|")
    good = True
    for name, (least, most) in RIG_SIZES.items():
        sized = [group for group in groups if least <= len(group["cameras"]) <= most]
        kept = [group for group in sized if group["verdict"] != "not determined"]
        shares = [inside(kept, "rotation"), inside(kept, "centre"), inside(sized, "rotation")]
        good = good and all(INSIDE[0] <= share <= INSIDE[1] for share in shares[:2])
        cells = [name, f"{len(kept)} of {len(sized)}", *(f"{share:.3f}" for share in shares)]
        print(f"| {' | '.join(cells)} |")
    refused = sum(bool(line["refused"]) for line in lines)
    print(f"\n{len(lines)} scenes, {refused} refused; bounds {INSIDE[0]} to {INSIDE[1]}")
    return good


def inside(groups: Sequence[dict[str, Any]], what: str) -> float:
    """Return the share of cameras whose error is within the 95 % region; what: which error."""
    distance = [each for group in groups for each in group[f"{what}_distance"]]
    return float((np.array(distance) <= CHI2_95).mean()) if distance else np.nan


def table_of_ratios(lines: Sequence[Line]) -> bool:
    """Print the RMS errors of the first group of each recording beside their RMS sigmas."""
    print(
        "| recording | verdict | rotation (deg) | sigma | ratio | centre (% of the rig) | sigma "
        "| ratio | worst camera |"
    )
    print("|---" * 9 + "|")
    good = True
    for line in lines:
        group = line["groups"][0]
        cells, ratios = [line["case"], group["verdict"]], []
        for what, sigma in (("rotation_deg", "rotation_sigma_deg"), ("centre", "centre_sigma")):
            error, stated = rms(group[what]), rms(group[sigma])
            ratios.append(error / stated)
            cells += [f"{error:.3f}", f"{stated:.3f}", f"{ratios[-1]:.2f}"]
        worst = np.max(np.array(group["rotation_deg"]) / group["rotation_sigma_deg"])
        within = all(RATIO[0] <= ratio <= RATIO[1] for ratio in ratios)
        good = good and (within or line["case"] in RATIO_FREE)
        mark = "" if within else " **beyond**"
        print(f"| {' | '.join(cells)} | {worst:.2f}{mark} |")
    return good


def rms(values: Sequence[float]) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def table_of_verdicts(lines: Sequence[Line]) -> bool:
    """Print the verdicts on each kind of case, and how many are right."""
    columns = ("kind", "cases", "refused", *VERDICTS, "right", "well determined above 3 deg")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for kind in (*KINDS, "all"):
        mine = [line for line in lines if kind in (line["kind"], "all")]
        verdicts = Counter(verdict_of(line) for line in mine)
        cells = [verdicts["refused"], *(verdicts[verdict] for verdict in VERDICTS)]
        right, bad = sum(map(is_right, mine)), sum(map(is_confidently_wrong, mine))
        print(f"| {kind} | {len(mine)} | {' | '.join(map(str, cells))} | {right} | {bad} |")
    for line in lines:
        if not is_right(line):
            print(f"* {line['case']}: {verdict_of(line)}, {describe(line)}")
    return right >= RIGHT * len(lines) and not bad


def verdict_of(line: Line) -> str:
    """Return the best verdict on a group of a case, or that it was refused."""
    verdicts = [group["verdict"] for group in line["groups"]]
    return min(verdicts, key=VERDICTS.index) if verdicts else "refused"


def error_of(group: dict[str, Any]) -> float:
    """Return the error in degrees that the verdict on a group must allow for."""
    return float(group["pair_deg"]) if group["true"] else np.inf


def is_right(line: Line) -> bool:
    """Return whether no verdict promises too much, and a sound rig is not thrown away."""
    for group in line["groups"]:
        if error_of(group) > MOST_DEG[group["verdict"]]:
            return False
    if line["kind"] != "sound":
        return True
    found = verdict_of(line)
    return found != "refused" and (
        found != "not determined" or error_of(line["groups"][0]) >= GOOD_DEG
    )


def is_confidently_wrong(line: Line) -> bool:
    """Return whether a rig is called well determined that is not."""
    most = MOST_DEG["well determined"]
    best = (group for group in line["groups"] if group["verdict"] == "well determined")
    return any(error_of(group) > most for group in best)


def describe(line: Line) -> str:
    """Return the errors of the groups of a case, or why it was refused."""
    return line["refused"] or ", ".join(
        f"{group['verdict']} at {error_of(group):.2f} deg" for group in line["groups"]
    )


if __name__ == "__main__":
    main()
