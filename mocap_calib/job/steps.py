"""One run from its request to its files: read, calibrate, write.

The first and the last step touch files; the one between touches none and may run elsewhere.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mocap_calib.compute import identify_program
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import PAIR_SOLVERS, Config
from mocap_calib.errors import ClusterError, MocapCalibError
from mocap_calib.io.camera_files import load_cameras
from mocap_calib.io.file import plain_path
from mocap_calib.io.hashing import hash_file, hash_inputs
from mocap_calib.io.provenance import date_of_making
from mocap_calib.io.results.further_formats import check_formats, check_recording
from mocap_calib.io.results.group import REPORT
from mocap_calib.io.results.pairs_json import remember_pairs
from mocap_calib.job.load import KeypointSource, LoadedRecording, load_recording
from mocap_calib.job.results import UNFINISHED, WrittenGroup, remove_unfinished, write_result
from mocap_calib.lift.lifter import Lifter, identify_model, load_model
from mocap_calib.pairs.solve import PairSolver
from mocap_calib.paper import choose_pair_solver
from mocap_calib.pipeline import calibrate
from mocap_calib.results import CalibrationResult
from mocap_calib.types import Mapper, Progress, silent
from mocap_calib.world.place import check_world


@dataclass(frozen=True)
class CalibrationRequest:
    """Which recording to calibrate, how, and where the results go.

    cameras: a file or folder with the intrinsics, or the content of such a file; None: nothing is
        known of them but the sizes of the images.
    output: the folder of the results.
    pair_solver: how a pair of views is calibrated, one of `config.PAIR_SOLVERS`.
    device: where the network computes, "cpu" or "cuda".
    formats: names of further formats of cameras and 3D poses in which the results are written.
    fps: frames per second, for the formats that need it.
    report: whether report.html is written. reading: the options that say how the keypoints are
        read, as a user typed them, for run.json.
    """

    keypoints: KeypointSource
    cameras: Path | bytes | None
    output: Path
    pair_solver: str = PAIR_SOLVERS[0]
    seed: int = 0
    device: str = "cpu"
    config: Config = field(default_factory=Config)
    formats: tuple[str, ...] = ()
    fps: float | None = None
    report: bool = True
    reading: Mapping[str, Any] = field(default_factory=dict)

    def hash_inputs(self) -> dict[str, str]:
        """Return the SHA-256 of all files that the results follow from, by path."""
        paths = [plain_path(argument) for argument in self.keypoints.paths]
        if isinstance(self.cameras, Path):
            paths.append(self.cameras)
        if self.keypoints.aliases is not None:
            paths.append(self.keypoints.aliases)
        return hash_inputs(paths)

    def fingerprint(self, hashes: Mapping[str, str], model: str) -> str:
        """Return the SHA-256 of all that the results follow from.

        That is what was asked for, the files, the configuration, the weights and the code.

        hashes: of the inputs, by path. model: the one that was chosen.
        """
        files = [self.formats, self.fps]
        asked = [asdict(self.keypoints), self.cameras, self.seed, self.device, *files]
        content = json.dumps([asked, hashes, self.describe_method(model)], default=str)
        return hashlib.sha256(content.encode()).hexdigest()

    def describe_method(self, model: str) -> str:
        """Return how any recording is calibrated: solver, configuration, weights and code."""
        method = [self.pair_solver, asdict(self.config)]
        return json.dumps([*method, model, identify_model(model), identify_program()])


@dataclass(frozen=True)
class Job:
    """A recording that has been read: all that its calibration needs, on any machine.

    hashes: SHA-256 of the inputs, by path.
    """

    request: CalibrationRequest
    hashes: Mapping[str, str]
    loaded: LoadedRecording
    lifter: Lifter
    pair_solver: PairSolver | None


def read_job(request: CalibrationRequest) -> Job:
    """Read the keypoints, the cameras and the model of a request.

    Raises FormatError, and MismatchError also where a further format cannot be written.
    """
    unit = request.config.world.stated_unit
    check_formats(request.formats, request.fps, unit)
    date_of_making()  # so that a bad SOURCE_DATE_EPOCH is said before anything is computed
    hashes = request.hash_inputs()  # first: what changes from now on makes another fingerprint
    camera_file = None if request.cameras is None else load_cameras(request.cameras)
    loaded = load_recording(request.keypoints, camera_file)
    recording, config = loaded.recording, request.config
    check_recording(request.formats, recording, request.fps, unit)
    check_world(config.world, recording, config.matching.individuals)
    lifter = load_model(recording.model, pair_solver=request.pair_solver)
    solver = choose_pair_solver(request.pair_solver, recording, lifter, config.pairwise)
    return Job(request, hashes, loaded, lifter, solver)


def calibrate_job(
    job: Job, *, progress: Progress = silent, mapper: Mapper | None = None
) -> CalibrationResult:
    """Calibrate the groups of cameras of a recording; touch no file.

    mapper: where the pairs are calibrated, see `pipeline.calibrate`.

    Raises DegenerateError, and MismatchError where there is no such device.
    """
    request = job.request
    return calibrate(
        job.loaded.recording,
        job.lifter,
        request.config,
        seed=request.seed,
        device=request.device,
        progress=progress,
        mapper=mapper,
        pair_solver=job.pair_solver,
    )


def calibrate_job_resumably(
    job: Job, *, progress: Progress = silent, mapper: Mapper | None = None
) -> CalibrationResult:
    """Calibrate as `calibrate_job` does, with the pairs kept beside the results.

    A run that was killed need not find them again. They are removed with the first results, or
    where the recording cannot be calibrated.
    """
    request = job.request
    method = request.describe_method(job.loaded.recording.model)
    try:
        kept = remember_pairs(mapper or map_in_threads, request.output / UNFINISHED, method)
        return calibrate_job(job, progress=progress, mapper=kept)
    except ClusterError:  # not the recording's fault: the next attempt goes on from here
        raise
    except MocapCalibError:
        remove_unfinished(request.output)
        raise


def write_results(job: Job, result: CalibrationResult) -> tuple[WrittenGroup, ...]:
    """Write all files of a run, as `write_result` does; return what was written of each group."""
    request = job.request
    return write_result(
        request.output,
        result,
        inputs=job.hashes,
        described={"solver": request.pair_solver, "reading": dict(request.reading)},
        fingerprint=request.fingerprint(job.hashes, job.loaded.recording.model),
        formats=request.formats,
        fps=request.fps,
        page=request.report,
    )


def find_finished(request: CalibrationRequest) -> dict[str, Any] | None:
    """Return what `run.json` holds where the results are those of the request, and whole.

    None where they are to be made. A run may have been killed while it moved its files into
    place: every one of them must be what `run.json` says.
    """
    try:
        report = json.loads((request.output / REPORT).read_bytes())
        if report["fingerprint"] != request.fingerprint(request.hash_inputs(), report["model"]):
            return None
        for name, content in report["outputs"].items():
            if hash_file(request.output / name) != content:
                return None
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    # if it was killed at the very end, the run did not come to this
    remove_unfinished(request.output)
    return report
