"""`run` on small simulated recordings, sound and with one fault in the files of a camera.

Verdict, named faults, identities, errors of the cameras against the truth. E_R is the largest error
of the relative rotation of two cameras in degrees, as `evaluate` measures it.
"""

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import permutations
from pathlib import Path

import golden.scene_files as files
import numpy as np
import pytest
from golden.command import call

IDENTIFIED = 0.97  # least share of the true detections with the right identity; measured 0.99 to 1
RESULTS = {"calibration.toml", "cameras.yaml", "matches.csv", "poses3d.h5", "report.html"}
PEOPLE = ("--cameras", 4, "--people", 2, "--frames", 80, "--seed", 5)
PERSON = ("--cameras", 4, "--people", 1, "--frames", 80, "--seed", 3)
SURE, LESS_SURE = ("well determined",), ("usable", "weak")


@dataclass(frozen=True)
class Case:
    """A simulated recording, what is done to its files, and what `run` must find.

    words: of `simulate`. measured: E_R when the test was written; 1.5 times as much and 0.05
    degrees more are allowed. rotated: the camera whose images were rotated by 90
    degrees, and its axes with them.
    """

    words: tuple[object, ...]
    measured: float
    verdicts: tuple[str, ...] = SURE
    faults: frozenset[tuple[str, str]] = frozenset()
    damage: Callable[[Path], None] = lambda _: None
    intrinsics: bool = True
    rotated: str = ""

    @property
    def largest(self) -> float:
        """The bound of E_R in degrees."""
        return 1.5 * self.measured + 0.05


def faults(word: str, *cameras: str) -> frozenset[tuple[str, str]]:
    """Return the same fault of some cameras."""
    return frozenset((camera, word) for camera in cameras)


CASES = {
    "one person": Case(PERSON, 0.172),
    "three people": Case(("--cameras", 4, "--people", 3, "--frames", 60, "--seed", 1), 0.034),
    "a dog": Case(("--cameras", 4, "--kind", "quadruped", "--frames", 80, "--seed", 2), 0.143),
    "two rats": Case(("--cameras", 4, "--kind", "rodent:2", "--frames", 60, "--seed", 2), 0.079),
    "distorted lenses": Case(
        ("--cameras", 3, "--people", 2, "--frames", 60, "--seed", 4, "--distortion", "brown"),
        0.109,
    ),
    # no third camera checks their intrinsics
    "two cameras": Case(
        ("--cameras", 2, "--people", 2, "--frames", 80, "--seed", 5), 0.054, ("usable",)
    ),
    "no intrinsics": Case(PEOPLE, 0.642, LESS_SURE, intrinsics=False),
    "a mirrored camera": Case(
        PEOPLE,
        0.060,
        faults=faults("mirrored", "cam2"),
        damage=partial(files.mirror, camera="cam2"),
    ),
    "left and right exchanged": Case(
        PEOPLE,
        0.060,
        faults=faults("sides", "cam2"),
        damage=partial(files.name_other_sides, camera="cam2"),
    ),
    "a late camera": Case(
        PEOPLE,
        0.063,
        faults=faults("clock", "cam3"),
        damage=partial(files.delay, camera="cam3", frames=5),
    ),
    # 80 frames hold 2.96 nats for the clock, 3 are asked for: the camera is *inconsistent* there
    "a late camera of one person": Case(
        ("--cameras", 4, "--people", 1, "--frames", 120, "--seed", 3),
        0.154,
        faults=faults("clock", "cam3"),
        damage=partial(files.delay, camera="cam3", frames=5),
    ),
    "a rotated camera": Case(
        PEOPLE,
        0.052,
        faults=faults("rotated", "cam2"),
        damage=partial(files.rotate, camera="cam2"),
        rotated="cam2",
    ),
    "images of half the size": Case(
        PEOPLE, 0.060, faults=faults("resized", "cam2"), damage=partial(files.halve, camera="cam2")
    ),
    "exchanged files": Case(
        PEOPLE,
        0.060,
        faults=faults("exchanged", "cam1", "cam2"),
        damage=partial(files.exchange, a="cam1", b="cam2"),
    ),
    "a camera that is moved": Case(
        PEOPLE,
        0.055,
        faults=faults("moved", "cam2"),
        damage=partial(files.bump, camera="cam2", degrees=6, first_frame=40),
    ),
    "a wrong focal length": Case(
        PEOPLE,
        0.068,
        faults=faults("focal", "cam2"),
        damage=partial(files.scale_focal, camera="cam2", factor=1.25),
    ),
    "cameras side by side": Case(
        ("--cameras", 3, "--people", 1, "--frames", 40, "--seed", 7, "--arc", 10),
        4.84,
        ("not determined", "weak", "usable"),
    ),
}


def calibrate(folder: Path, *intrinsics: str) -> tuple[int, dict]:
    """Run on a scene in a folder; exit status, and what `run.json` says."""
    done = call("run", "keypoints", *intrinsics, "-o", "out", "-q", folder=folder)
    return done.status, json.loads((folder / "out" / "run.json").read_text("utf-8"))


def rotation_errors(folder: Path, rotated: str = "") -> list[float]:
    """Return the errors of the pairs of cameras in degrees.

    Those of a rotated camera are by how much its turn differs from 90 degrees.
    """
    words = ("evaluate", "out/cameras.yaml", "--reference", "reference.toml", "--json")
    done = call(*words, folder=folder)
    assert done.status == 0, done.stderr
    pairs = json.loads(done.stdout)["pairs"]
    return [
        abs(pair["rotation_error_deg"] - 90 * (rotated in (pair["a"], pair["b"]))) for pair in pairs
    ]


def right_identities(scene: Path) -> float:
    """Return the share of the true detections that have the right individual, named at best."""
    with np.load(scene / "truth.npz") as truth:
        ids = truth["ids"]
    cameras = sorted(path.stem for path in (scene / "keypoints").iterdir())
    found = np.full(ids.shape, -1)
    with (scene / "out" / "matches.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            view, frame = cameras.index(row["camera"]), int(row["frame"])
            found[view, frame, int(row["instance"])] = int(row["individual"])
    true = ids[ids >= 0]
    names = found[ids >= 0]
    count = true.max() + 1
    return max(
        float(np.mean(np.array(order)[true] == names)) for order in permutations(range(count))
    )


def test_intrinsics_of_ros_give_the_same_rig(tmp_path):
    """`convert` refuses them, since they do not say where the cameras stand; `run` reads them."""
    words = ("--cameras", 3, "--people", 1, "--frames", 30, "--seed", 3)
    rigs = []
    for name in ("anipose", "ros"):
        assert call("simulate", "-o", name, *words, folder=tmp_path).status == 0
        files.write_ros(tmp_path / name)
        given = "intrinsics.toml" if name == "anipose" else "ros"
        calibrate(tmp_path / name, "--cameras", given)
        rigs.append(rotation_errors(tmp_path / name))
    np.testing.assert_allclose(*rigs, atol=1e-6)


@pytest.fixture
def scene(request, tmp_path):
    """The folder of a scene with the damage of the case, and the case."""
    case = CASES[request.param]
    assert call("simulate", "-o", "scene", *case.words, folder=tmp_path).status == 0
    case.damage(tmp_path / "scene")
    return tmp_path / "scene", case


@pytest.mark.slow
@pytest.mark.parametrize("scene", CASES, indirect=True)
def test_a_scene_is_judged_as_before(scene):
    folder, case = scene
    given = ("--cameras", "intrinsics.toml") if case.intrinsics else ()
    status, found = calibrate(folder, *given)
    verdict = found["verdict"]["rig"]
    assert verdict in case.verdicts
    assert status == (verdict == "not determined")
    named = {(camera["name"], word) for camera in found["cameras"] for word in camera["faults"]}
    assert named == case.faults
    errors = rotation_errors(folder, case.rotated)
    assert max(errors) < case.largest
    assert right_identities(folder) > IDENTIFIED
    assert {path.name for path in (folder / "out").iterdir()} > RESULTS
