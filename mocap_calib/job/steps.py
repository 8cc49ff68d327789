"""The steps from files to results: read, calibrate, write.

The first and the last touch files; the one between touches none and may be done elsewhere.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.config import Config
from mocap_calib.errors import ClusterError, MismatchError, MocapCalibError
from mocap_calib.io.atomic import replace_folder
from mocap_calib.io.cameras.read import load_cameras, parse_content
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.hashing import hash_file, hash_files
from mocap_calib.io.poses.common import PoseFile, describe_poses
from mocap_calib.io.provenance import date_of_making, provenance
from mocap_calib.io.results.further_formats import (
    WriteOutcome,
    any_holds_points,
    check_formats,
    check_recording,
    write_formats,
)
from mocap_calib.io.results.group import (
    REPORT,
    epoch_provenance,
    group_folder,
    read_outputs,
    remove_earlier_outputs,
    write_group,
)
from mocap_calib.io.results.pair_store import remember_pairs
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.job.load import LoadedRecording, load_recording
from mocap_calib.job.outcome import WrittenGroup
from mocap_calib.job.request import CalibrationRequest
from mocap_calib.judging import judge_cameras
from mocap_calib.multi_view.observed_points import observe_points
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.epochs import (
    Epoch,
    epoch_folder,
    list_epochs,
    own_names,
    recording_of_epoch,
    rig_of_epoch,
)
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.report import run_report
from mocap_calib.steerpose.lifter import Lifter
from mocap_calib.steerpose.loading import load_model
from mocap_calib.steerpose.weights import load_vocabulary
from mocap_calib.two_view.solve import PairSolver, pair_mapper
from mocap_calib.two_view.solvers import choose_pair_solver
from mocap_calib.types import (
    CalibrationResult,
    GroupResult,
    Mapper,
    ObservedPoints,
    Progress,
    silent,
)
from mocap_calib.world.asked import check_world

# in the folder of results: the pairs of a run that is under way or was killed
_UNFINISHED = ".unfinished"


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
    loaded = load_recording(request.keypoints, _load_camera_file(request.cameras))
    check_recording(request.formats, loaded.recording, request.fps, unit)
    config = request.config
    check_world(config.world, loaded.recording, config.matching.individuals)
    lifter = load_model(loaded.recording.model)
    solver = choose_pair_solver(
        request.pair_solver, loaded.recording, lifter, request.config.pairwise
    )
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
    pairwise = mapper or pair_mapper(job.loaded.recording, request.config.pairwise)
    method = request.describe_method(job.loaded.recording.model)
    try:
        kept = remember_pairs(pairwise, request.output / _UNFINISHED, method)
        return calibrate_job(job, progress=progress, mapper=kept)
    except ClusterError:  # not the recording's fault: the next attempt goes on from here
        raise
    except MocapCalibError:
        _remove_unfinished(request.output)
        raise


def write_results(job: Job, result: CalibrationResult) -> tuple[WrittenGroup, ...]:
    """Write all files of a run, as `write_result` does; return what was written of each group."""
    request = job.request
    return write_result(
        request.output,
        result,
        inputs=job.hashes,
        described={"solver": request.pair_solver},
        fingerprint=request.fingerprint(job.hashes, job.loaded.recording.model),
        formats=request.formats,
        fps=request.fps,
    )


def write_result(
    output: Path,
    result: CalibrationResult,
    *,
    inputs: Mapping[str, str],
    described: Mapping[str, Any],
    fingerprint: str | None = None,
    formats: Sequence[str] = (),
    fps: float | None = None,
) -> tuple[WrittenGroup, ...]:
    """Write all files of a run, together or not at all; return what was written of each group.

    What the `run.json` of an earlier run lists and this one did not write is removed: further
    groups, individuals and formats, and a rig reversed in depth.

    output: the folder. inputs: SHA-256 of the files that were read, by path.
    described: further keys of `run.json`. fingerprint: of all that the result follows from, where
        that is known. formats, fps: as in `CalibrationRequest`; what cannot hold the rig or the
        poses of a group is left out.
    """
    earlier = read_outputs(output)
    reports = _report_groups(result, inputs, described)
    further: dict[int, WriteOutcome] = {}
    with replace_folder(output) as work:
        # the first group comes last: its report has the hashes of all other files
        for number in reversed(range(len(result.groups))):
            group, place = result.groups[number], work / group_folder(number)
            place.mkdir(exist_ok=True)
            judged = judge_cameras(reports[number])
            source = provenance("run", seed=result.seed, inputs=inputs, **judged)
            poses = _describe_poses(group, fps)
            write_group(place, group, poses, source, clocks=result.clocks)
            further[number] = _write_further(
                place, group, poses, formats=formats, source=source, config=result.config
            )
            if number == 0:
                reports[0]["fingerprint"] = fingerprint
                reports[0]["outputs"] = hash_files(work)
            text = json.dumps(reports[number], indent=1, allow_nan=False)
            (place / REPORT).write_text(text + "\n", encoding="utf-8", newline="\n")
    _remove_unfinished(output)
    remove_earlier_outputs(output, earlier, kept=reports[0]["outputs"].keys())
    return tuple(
        WrittenGroup(report, further[number].notes, further[number].refused)
        for number, report in enumerate(reports)
    )


def _write_further(
    folder: Path,
    group: GroupResult,
    poses: PoseFile,
    *,
    formats: Sequence[str],
    source: Mapping[str, Any],
    config: Config,
) -> WriteOutcome:
    """Write the further formats of a group: of later epochs the cameras alone."""
    epochs = list_epochs(group.rig.names, group.recording.frames)
    outcomes = []
    for number, epoch in enumerate(epochs):
        points = _observe_points(group, epoch, config) if any_holds_points(formats) else None
        outcomes.append(
            write_formats(
                folder / epoch_folder(number),
                rig_of_epoch(group.rig, epoch),
                None if number else poses,
                formats,
                epoch_provenance(source, epochs, number),
                points=points,
            )
        )
    notes = dict.fromkeys(note for outcome in outcomes for note in outcome.notes)
    refused: dict[str, MismatchError] = {}
    for outcome in reversed(outcomes):
        refused |= outcome.refused
    return WriteOutcome(tuple(notes), refused)


def _observe_points(group: GroupResult, epoch: Epoch, config: Config) -> ObservedPoints:
    """Return the triangulated points of an epoch, and the detections that they were made of."""
    recording = recording_of_epoch(group.recording, epoch)
    frames = np.flatnonzero(np.isin(group.recording.frames, recording.frames))
    matches = group.matches.select(views=epoch.views, frames=frames)
    rig = rig_of_epoch(group.rig, epoch)
    return observe_points(recording, rig, matches, config.triangulate)


def _describe_poses(group: GroupResult, fps: float | None) -> PoseFile:
    """Return the poses of a group with what is known beside them."""
    skeleton = load_vocabulary(group.recording.model)
    edges = edges_of_keypoints(skeleton, group.recording.vocabulary)
    return describe_poses(group.poses, fps, edges=edges)


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
    _remove_unfinished(request.output)
    return report


def _load_camera_file(cameras: Path | bytes | None) -> CameraFile | None:
    """Return what a file or folder, or the content of a file, says of cameras."""
    if cameras is None:
        return None
    return load_cameras(cameras) if isinstance(cameras, Path) else parse_content(cameras, "stdin")


def _report_groups(
    result: CalibrationResult, inputs: Mapping[str, str], described: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return what `run.json` holds of each group, but for the hashes of the results."""
    groups = [
        {"folder": group_folder(number), "cameras": list(own_names(group.rig.names))}
        for number, group in enumerate(result.groups)
    ]
    shared = {"date": date_of_making(), **described, "groups": groups}
    return [
        unsigned_zeros(
            run_report(group, result, seed=result.seed, config=result.config, inputs=inputs)
        )
        | {"model": group.recording.model, **shared}
        for group in result.groups
    ]


def _remove_unfinished(output: Path) -> None:
    """Remove the pairs of an unfinished run, and the folder made for them if it is empty now."""
    if not (output / _UNFINISHED).is_dir():
        return
    shutil.rmtree(output / _UNFINISHED, ignore_errors=True)
    if not any(output.iterdir()):
        output.rmdir()
