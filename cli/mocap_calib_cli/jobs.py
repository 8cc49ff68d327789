"""One recording from its files to its results, in steps that `run` takes here and `batch` may have done elsewhere."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mocap_calib import __version__
from mocap_calib.config import Config
from mocap_calib.errors import ClusterError, MocapCalibError
from mocap_calib.io.atomic import (
    folder,
    individual_file,
    remove_further_individuals,
    replace_text,
)
from mocap_calib.io.cameras.own import format_calibration_toml, format_cameras_yaml
from mocap_calib.io.results.matches_csv import matches_csv
from mocap_calib.io.results.pair_store import remember_pairs
from mocap_calib.io.results.poses_csv import poses_csv
from mocap_calib.io.results.poses_h5 import write_poses_h5
from mocap_calib.pipeline import calibrate
from mocap_calib.report import run_report
from mocap_calib.steerpose.checkpoint import digest
from mocap_calib.steerpose.model import Lifter
from mocap_calib.two_view.solve import PairSolver, pair_mapper
from mocap_calib.types import CalibrationResult, GroupResult, Mapper, Progress, Recording, silent
from mocap_calib_cli import inputs, outputs
from mocap_calib_cli.model import NONE, check_device, load_model, use_threads
from mocap_calib_cli.progress import Reporter

_RIVAL = "calibration_reversed.toml"
_FILES = (
    "cameras.yaml",
    "calibration.toml",
    _RIVAL,
    "matches.csv",
    "poses3d.h5",
    "run.json",
)  # of a group; and _POSES of each individual
_POSES = "poses3d.csv"
_UNFINISHED = (
    ".unfinished"  # in the folder of results: the pairs of a run that is under way or was killed
)


@dataclass(frozen=True)
class Order:
    """What was typed: which files, how, and where the results go."""

    keypoints: tuple[str, ...]
    cameras: str
    skeleton: Path | None
    model: str | None
    solver: str
    seed: int
    device: str
    output: Path
    reading: Mapping[str, Any] | None = None  # what options.reading gives

    def hashes(self) -> dict[str, str]:
        """Path -> SHA-256 of all files that the results follow from."""
        return inputs.hashes(
            [
                *inputs.plain_paths(self.keypoints),
                self.cameras,
                *([self.skeleton] if self.skeleton else []),
            ]
        )

    def fingerprint(self, hashes: Mapping[str, str], model: str) -> str:
        """SHA-256 of all that the results follow from: what was typed, the files, the configuration, the weights and the version."""
        reading = {name: value for name, value in (self.reading or {}).items() if value}
        typed = [
            self.keypoints,
            self.cameras,
            str(self.skeleton),
            self.model,
            self.seed,
            self.device,
            reading,
        ]
        return hashlib.sha256(json.dumps([typed, hashes, self.method(model)]).encode()).hexdigest()

    def method(self, model: str) -> str:
        """How any recording is calibrated: solver, configuration, weights and version."""
        return json.dumps(
            [
                self.solver,
                asdict(Config()),
                model,
                NONE if model == NONE else digest(model),
                __version__,
            ]
        )


@dataclass(frozen=True)
class Job:
    """A recording that has been read: all that calibrating it needs, on any machine."""

    order: Order
    hashes: Mapping[str, str]
    recording: Recording
    model: str
    lifter: Lifter
    solver: PairSolver | None


def read(order: Order, reporter: Reporter) -> Job:
    """Raises FormatError and MismatchError."""
    hashes = order.hashes()  # first: what changes from now on makes another fingerprint
    recording, model = inputs.read_recording(
        order.keypoints,
        inputs.cameras_of(order.cameras),
        order.skeleton,
        reporter,
        order.reading,
        model=order.model,
    )
    return Job(
        order,
        hashes,
        recording,
        model,
        load_model("cpu", model),
        inputs.pair_solver(order.solver, recording, model),
    )


def solve(
    job: Job, *, progress: Progress = silent, mapper: Mapper | None = None
) -> CalibrationResult:
    """Calibrates the groups of cameras of a recording; touches no file. Raises MismatchError and DegenerateError."""
    use_threads(1)  # such small networks are slower on more, and one is reproducible
    check_device(job.order.device)
    seed, device = job.order.seed, job.order.device
    return calibrate(
        job.recording,
        job.lifter,
        Config(),
        seed=seed,
        device=device,
        progress=progress,
        mapper=mapper,
        pair_solver=job.solver,
    )


def solve_here(
    job: Job, *, progress: Progress = silent, mapper: Mapper | None = None
) -> CalibrationResult:
    """`solve`, with the pairs kept beside the results until those are written: a run that is killed need not find them again."""
    try:
        store = remember_pairs(
            mapper or pair_mapper(job.recording, Config().pairwise),
            job.order.output / _UNFINISHED,
            job.order.method(job.model),
        )
        return solve(job, progress=progress, mapper=store)
    except MocapCalibError as error:
        if not isinstance(error, ClusterError):  # it would end there again
            _forget(job.order.output)
        raise


def write(job: Job, result: CalibrationResult) -> list[dict[str, Any]]:
    """Writes all files of a run, together or not at all, and returns what each group's run.json holds.

    What an earlier run found and this one did not, further groups and individuals and a rival rig, is taken away.
    """
    order, groups = job.order, result.groups
    listed = [
        {"folder": group_folder(k), "cameras": list(found.rig.names)}
        for k, found in enumerate(groups)
    ]
    own = {"model": job.model, "solver": order.solver, "groups": listed}
    reports = [
        run_report(found, result, seed=order.seed, config=Config(), inputs=job.hashes) | own
        for found in groups
    ]
    with folder(order.output) as work:
        for k in reversed(
            range(len(groups))
        ):  # the first last: its run.json has the hashes of all other files
            here = work / group_folder(k)
            here.mkdir(exist_ok=True)
            _write_group(
                here, groups[k], outputs.provenance("run", seed=order.seed, inputs=job.hashes)
            )
            if k == 0:
                reports[0] |= {
                    "fingerprint": order.fingerprint(job.hashes, job.model),
                    "outputs": _contents(work),
                }
            (here / "run.json").write_text(
                json.dumps(reports[k], indent=1, allow_nan=False) + "\n", "utf-8"
            )
    _clear(order.output, reports[0])
    return reports


def group_folder(group: int) -> str:
    """Where in OUT the files of a group go: those of the largest right there."""
    return "." if group == 0 else f"group_{group + 1}"


def _write_group(work: Path, found: GroupResult, source: Mapping[str, Any]) -> None:
    (work / "cameras.yaml").write_text(format_cameras_yaml(found.rig, source), "utf-8")
    (work / "calibration.toml").write_text(format_calibration_toml(found.rig, source), "utf-8")
    if found.adjusted.depth_reversed_rig is not None:
        (work / _RIVAL).write_text(
            format_calibration_toml(found.adjusted.depth_reversed_rig, source), "utf-8"
        )
    replace_text(work / "matches.csv", matches_csv(found.recording, found.matches))
    write_poses_h5(work / "poses3d.h5", found.poses, source)
    for individual in range(found.matches.individuals):
        replace_text(individual_file(work / _POSES, individual), poses_csv(found.poses, individual))


def finished(order: Order) -> dict[str, Any] | None:
    """What run.json holds where the results are those of this order and whole; None where they are to be made.

    A run may have been killed while it moved its files into place: every one of them must be what run.json says.
    """
    try:
        report = json.loads((order.output / "run.json").read_bytes())
        same = report["fingerprint"] == order.fingerprint(order.hashes(), report["model"])
        whole = same and all(
            _digest(order.output / name) == content for name, content in report["outputs"].items()
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    if not whole:
        return None
    _clear(order.output, report)  # which the run did not come to if it was killed at the very end
    return report


def _contents(work: Path) -> dict[str, str]:
    return {
        file.relative_to(work).as_posix(): _digest(file)
        for file in sorted(work.rglob("*"))
        if file.is_file()
    }


def _digest(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _clear(output: Path, report: Mapping[str, Any]) -> None:
    """Takes away what earlier runs left that these results do not replace: their files, and folders of groups where nothing else is."""
    kept = {"run.json", *report["outputs"]}
    number = len(report["groups"])
    while (output / group_folder(number) / "run.json").is_file():
        number += 1
    for here in [output / group_folder(k) for k in range(number)]:
        individual = 0
        while individual_file(here / _POSES, individual).relative_to(output).as_posix() in kept:
            individual += 1
        remove_further_individuals(here / _POSES, individual)
        for file in (here / name for name in _FILES):
            if file.relative_to(output).as_posix() not in kept:
                file.unlink(missing_ok=True)
        if not any(here.iterdir()):
            here.rmdir()
    _forget(output)


def _forget(output: Path) -> None:
    """Takes the pairs of an unfinished run away, and the folder that was made for them if there are no results."""
    if (output / _UNFINISHED).is_dir():
        shutil.rmtree(output / _UNFINISHED, ignore_errors=True)
        if not any(output.iterdir()):
            output.rmdir()
