"""Measure whether rigs are as certain as they state, against known truth.

    .venv/bin/python benchmarks/certainty.py simulated      # whether 95 % regions hold the truth
    .venv/bin/python benchmarks/certainty.py recordings     # errors against their sigmas
    .venv/bin/python benchmarks/certainty.py damaged        # what each cause of a verdict is for

Damaged copies of the recordings (`DAMAGES`) show what each cause of a verdict is for: without it,
or with another weight, verdicts break their promise or are timid. Recordings of even places in the
list are those that weights may be fitted on, the others those that they are validated on.

Each case goes through the whole pipeline, which sees keypoints and intrinsics alone. Errors are
those after the best similarity. A result is a line of JSON in a file; cases that are in it are
skipped, so a stopped run continues. Exit status 1 where a figure is beyond its bound.
"""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import add_recordings, make_parser, print_header, print_row
from recordings import NAMES
from scipy.stats import chi2

import mocap_calib as mc
from mocap_calib.config import EPOCH_MARK, VERDICT_LIMITS_DEG
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import nearest_rotation, rig_change
from mocap_calib.results import VERDICTS, Cause, word_of_error
from mocap_calib.types import CameraRig, Floats
from mocap_calib.verdict.verdict import expected_error

Line = dict[str, Any]
Damage = Callable[[mc.Recording], mc.Recording]

ONE = 1  # the view that is damaged
SIMULATED = 200
ANIMALS = ("quadruped", "rodent", "bird")
ANIMAL_SHARE = 0.25  # of the scenes; the others show people
NOISE_PX = (1.0, 2.0, 4.0)
LENGTHS = (60, 120)  # frames
INSIDE = (0.90, 0.99)  # share of cameras whose 95 % region holds the truth
RIG_SIZES = {"2": (2, 2), "3": (3, 3), "4": (4, 4), "5 and more": (5, np.inf)}
CHI2_95 = float(chi2.ppf(0.95, 3))
RATIO = (0.4, 2.5)  # of the RMS error to the RMS sigma
RATIO_FREE = ("mvor_openpose",)  # its reference and keypoints disagree
HEADER = ("recording", "verdict", "rotation (deg)", "sigma", "ratio")
HEADER += ("centre (% of the rig)", "sigma", "ratio", "worst camera")
WEIGHTS = (0.0, 0.7, 1.4)  # of a cause, beside the others
PROMISE = 2.0  # limits of its verdict, by which no camera may be off
TIMID_DEG = 1.0  # below which a rig should be usable


def main() -> None:
    """Run what is missing, print the table, and exit with 1 where it is beyond a bound."""
    parser = make_parser(__doc__)
    parser.add_argument("what", choices=["simulated", "recordings", "damaged"])
    parser.add_argument("--cases", type=int, default=SIMULATED, help="simulated scenes")
    add_recordings(parser, needed=False)
    parser.add_argument("--results", type=Path, help="lines of JSON; default: out/certainty/")
    given = parser.parse_args()
    simulated = given.what == "simulated"
    if not simulated and given.recordings is None:
        parser.error("expected --recordings FOLDER, found none")
    if simulated:
        cases = {f"simulated-{k}": partial(simulate, k) for k in range(given.cases)}
    else:
        cases = {name: partial(read, Path(given.recordings) / name) for name in NAMES}
    if given.what == "damaged":
        cases = {
            f"{name}/{word}": partial(damage, make, change)
            for name, make in cases.items()
            for word, change in DAMAGES.items()
        }
    lines = list(run_all(cases, given.results or Path("out/certainty") / f"{given.what}.jsonl"))
    tables = {
        "simulated": table_of_regions,
        "recordings": table_of_ratios,
        "damaged": table_of_causes,
    }
    sys.exit(0 if tables[given.what](lines) else 1)


def run_all(cases: dict[str, Any], results: Path) -> Iterator[Line]:
    """Yield the result of each case, and keep it in a file."""
    results.parent.mkdir(parents=True, exist_ok=True)
    kept = results.read_text().splitlines() if results.is_file() else []
    known = {line["case"]: line for line in map(json.loads, kept)}
    for name, make in cases.items():
        if name not in known:
            recording, truth = make()
            known[name] = {"case": name, "groups": []}
            try:
                groups = mc.calibrate(recording).groups
                known[name]["groups"] = [judge_group(group, truth) for group in groups]
            except mc.MocapCalibError as error:
                known[name]["refused"] = str(error)
            with results.open("a") as file:
                file.write(json.dumps(known[name]) + "\n")
        yield known[name]


def simulate(number: int) -> tuple[mc.Recording, CameraRig]:
    """Return a recording of any number of cameras and subjects, any kind, noise and length."""
    rng = np.random.default_rng([number, 9])
    count = int(rng.integers(1, 4, endpoint=True))
    kind = str(rng.choice(ANIMALS)) if rng.random() < ANIMAL_SHARE else ""
    scene = mc.simulate(
        mc.SimulateConfig(
            cameras=int(rng.integers(2, 8, endpoint=True)),
            people=0 if kind else count,
            animals=((kind, count),) if kind else (),
            noise_px=float(rng.choice(NOISE_PX)),
            seed=int(rng.integers(10**6)),
            frames=int(rng.choice(LENGTHS)),
        )
    )
    return mc.Recording.from_keypoints(scene.files, scene.rig.cameras), scene.rig


def read(folder: Path) -> tuple[mc.Recording, CameraRig]:
    """Return a recording with its intrinsics, and its reference calibration."""
    recording = mc.read_recording(folder / "keypoints", folder / "intrinsics.toml")
    return recording, mc.read_rig(folder / "reference.toml")


# --- damaged copies


def damage(make: Callable[[], tuple[mc.Recording, CameraRig]], change: Damage) -> Any:
    """Return a damaged copy of a recording, and its reference calibration."""
    recording, truth = make()
    return change(recording), truth


def at_pixels(change: Callable[[Floats], Floats], views: slice = slice(ONE, ONE + 1)) -> Damage:
    """Return a damage of the positions `[view, frame, instance, keypoint, 2]` of some views."""

    def apply(recording: mc.Recording) -> mc.Recording:
        """Return the damaged recording."""
        positions = recording.positions.copy()
        positions[views] = change(positions[views])
        return replace(recording, positions=positions)

    return apply


def with_camera(change: Callable[[mc.Camera], mc.Camera]) -> Damage:
    """Return a damage of the intrinsics of one view."""

    def apply(recording: mc.Recording) -> mc.Recording:
        """Return the damaged recording."""
        cameras = list(recording.cameras)
        cameras[ONE] = change(cameras[ONE])
        return replace(recording, cameras=tuple(cameras))

    return apply


def off_centre(camera: mc.Camera) -> mc.Camera:
    """Return a camera whose principal point is off by 5 % of the image."""
    matrix = camera.matrix.copy()
    matrix[0, 2] += 0.05 * max(camera.size)
    return replace(camera, matrix=matrix)


def late(recording: mc.Recording) -> mc.Recording:
    """Return a recording of which one view shows what was ten frames before."""
    every = np.arange(len(recording.frames))
    source = np.tile(every, (len(recording.cameras), 1))
    source[ONE] = np.where(every >= 10, every - 10, -1)
    return recording.show(source, recording.frames)


def sparse(recording: mc.Recording) -> mc.Recording:
    """Return a recording without 60 % of the detections."""
    gone = np.random.default_rng(0).random(recording.positions.shape[:3]) < 0.6
    positions = np.where(gone[..., None, None], np.nan, recording.positions)
    return replace(recording, positions=positions)


ALL = slice(None)
DAMAGES: dict[str, Damage] = {
    "sound": lambda recording: recording,
    "two cameras": lambda recording: recording.select(views=np.arange(2)),
    "two, one at half size": lambda recording: at_pixels(lambda pixels: pixels / 2)(
        recording.select(views=np.arange(2))
    ),
    "20 frames": lambda recording: recording.select(frames=np.arange(20)),
    "sparse": sparse,
    "late": late,
    "half size": at_pixels(lambda pixels: pixels / 2),
    "half size, all": at_pixels(lambda pixels: pixels / 2, ALL),
    "squeezed, all": at_pixels(lambda pixels: pixels * [0.75, 1.0], ALL),
    "focal length": with_camera(lambda camera: change_intrinsics(camera, log_focal=0.2, k1=0.0)),
    "principal point": with_camera(off_centre),
    "sides": lambda recording: mc.Sides(recording.names[ONE]).apply(recording),
    "mirrored": lambda recording: mc.Mirrored(recording.names[ONE]).apply(recording),
}


# --- errors and sigmas of one group


def judge_group(group: mc.GroupResult, truth: CameraRig) -> Line:
    """Return the verdict on a group, and errors and sigmas of its cameras.

    Angles are in degrees, lengths in percent of the size of the rig; `*_distance` are the squared
    Mahalanobis distances of the errors of a camera (3 degrees of freedom).
    """
    covariance = group.uncertainty.covariance
    where = [truth.names.index(name.partition(EPOCH_MARK)[0]) for name in group.rig.names]
    placed = {"rotation": truth.rotation[where], "translation": truth.translation[where]}
    error = rig_error(group.rig, replace(group.rig, **placed))
    turn, shift = slice(0, 3), slice(3, 6)
    return {
        "cameras": list(group.rig.names),
        "verdict": group.verdict,
        "causes": [[each.name, each.camera, each.error_deg] for each in group.assessment.causes],
        "rotation_sigma": np.degrees(covariance.rotation_sigma).tolist(),
        "centre_sigma": (100 * covariance.centre_sigma).tolist(),
        "rotation": np.degrees(np.linalg.norm(error[:, turn], axis=1)).tolist(),
        "rotation_distance": mahalanobis(error[:, turn], covariance.matrix[:, turn, :, turn]),
        "centre": (100 * np.linalg.norm(error[:, shift], axis=1)).tolist(),
        "centre_distance": mahalanobis(error[:, shift], covariance.matrix[:, shift, :, shift]),
    }


def rig_error(rig: CameraRig, true: CameraRig) -> Floats:
    """Return by how much cameras must be turned and shifted to be right, `[view, 6]`.

    As `rig_change` defines it. The rigs are first aligned by all of their rotations, which also
    works where the centres are on a line.
    """
    turn = nearest_rotation(np.einsum("vji,vjk->ik", rig.rotation, true.rotation))
    return rig_change(rig, replace(true, rotation=true.rotation @ turn.T))


def mahalanobis(error: Floats, covariance: Floats) -> list[float]:
    """Return e' C^-1 e of errors `[view, 3]`; covariance: `[view, 3, view, 3]`."""
    inverse = np.linalg.pinv(np.einsum("vivj->vij", covariance), hermitian=True)
    return np.einsum("vi,vij,vj->v", error, inverse, error).tolist()


# --- tables: each prints itself, and returns whether its figures are within their bounds


def table_of_regions(lines: Sequence[Line]) -> bool:
    """Print the share of cameras whose 95 % region holds the truth, by the size of the rig."""
    groups = [group for line in lines for group in line["groups"]]
    columns = ("cameras", "rigs", "rotation inside", "centre inside")
    print_header((*columns, "rotation, also not determined"))
    good = True
    for name, (least, most) in RIG_SIZES.items():
        sized = [group for group in groups if least <= len(group["cameras"]) <= most]
        kept = [group for group in sized if group["verdict"] != "not determined"]
        shares = [inside(kept, "rotation"), inside(kept, "centre"), inside(sized, "rotation")]
        good = good and all(INSIDE[0] <= share <= INSIDE[1] for share in shares[:2])
        print_row([name, f"{len(kept)} of {len(sized)}", *(f"{share:.3f}" for share in shares)])
    refused = sum("refused" in line for line in lines)
    print(f"\n{len(lines)} scenes, {refused} refused; bounds {INSIDE[0]} to {INSIDE[1]}")
    return good


def inside(groups: Sequence[Line], what: str) -> float:
    """Return the share of cameras whose error (what: which one) is within the 95 % region."""
    distance = [each for group in groups for each in group[f"{what}_distance"]]
    return float((np.array(distance) <= CHI2_95).mean()) if distance else np.nan


def table_of_ratios(lines: Sequence[Line]) -> bool:
    """Print the RMS errors of the first group of each recording beside their RMS sigmas."""
    print_header(HEADER)
    good = True
    for line in lines:
        group = line["groups"][0]
        cells, ratios = [line["case"], group["verdict"]], []
        for what in ("rotation", "centre"):
            error, stated = (
                np.sqrt(np.mean(np.square(group[each]))) for each in (what, f"{what}_sigma")
            )
            ratios.append(error / stated)
            cells += [f"{error:.3f}", f"{stated:.3f}", f"{ratios[-1]:.2f}"]
        worst = np.max(np.array(group["rotation"]) / group["rotation_sigma"])
        within = all(RATIO[0] <= ratio <= RATIO[1] for ratio in ratios)
        good = good and (within or line["case"] in RATIO_FREE)
        print_row([*cells, f"{worst:.2f}{'' if within else ' **beyond**'}"])
    return good


def table_of_causes(lines: Sequence[Line]) -> bool:
    """Print how many verdicts break their promise, and are timid, by the weight of each cause."""
    halves = [[], []]
    for line in lines:
        halves[NAMES.index(line["case"].partition("/")[0]) % 2] += line["groups"][:1]
    names = sorted({name for half in halves for group in half for name, *_ in group["causes"]})
    columns = ("cause", "weight", "fitted: broken", "timid", "validated: broken", "timid")
    print_header(columns)
    sound = [count(half, "", 1.0) for half in halves]
    print_row(["all", 1.0, *sound[0], *sound[1]])
    for name in names:
        for weight in WEIGHTS:
            counts = [count(half, name, weight) for half in halves]
            if counts != sound:
                print_row([name, weight, *counts[0], *counts[1]])
    print(f"\n{len(lines)} copies; causes and weights that change nothing are left out")
    return sound[0][0] == sound[1][0] == 0


def count(groups: Sequence[Line], cause: str, weight: float) -> tuple[int, int]:
    """Return how many verdicts break their promise, and are timid, by the weight of a cause."""
    broken = timid = 0
    for group in groups:
        causes = [
            Cause(name, camera, error * (weight if name == cause else 1.0), "", "")
            for name, camera, error in group["causes"]
        ]
        word = word_of_error(expected_error(group["cameras"], causes))
        worst, place = max(group["rotation"]), VERDICTS.index(word)
        limits = (*VERDICT_LIMITS_DEG, np.inf)
        broken += worst > PROMISE * limits[place]
        timid += worst < TIMID_DEG and place >= 2
    return int(broken), int(timid)


if __name__ == "__main__":
    main()
