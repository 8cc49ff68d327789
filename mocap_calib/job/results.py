"""Write the folder of a run: all files of all groups of cameras, together or not at all."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.config import Config
from mocap_calib.errors import MismatchError, spell_as_option
from mocap_calib.html_report.page import report_page
from mocap_calib.html_report.source import source_of_group
from mocap_calib.io.atomic import replace_folder, write_bytes
from mocap_calib.io.file import unsigned_zeros
from mocap_calib.io.hashing import hash_files
from mocap_calib.io.poses import PoseFile, describe_poses
from mocap_calib.io.provenance import date_of_making, provenance
from mocap_calib.io.results.further_formats import WriteOutcome, any_holds_points, write_formats
from mocap_calib.io.results.group import (
    PAGE,
    epoch_provenance,
    group_folder,
    read_outputs,
    remove_earlier_outputs,
    write_group,
    write_run_json,
)
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.recording.epochs import (
    Epoch,
    epoch_folder,
    list_epochs,
    own_names,
    recording_of_epoch,
    rig_of_epoch,
)
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.report import run_report, verdict_of_cameras
from mocap_calib.results import CalibrationResult, GroupResult, ObservedPoints
from mocap_calib.rig.triangulate import observe_points
from mocap_calib.types import ARBITRARY
from mocap_calib.world.floor import stated_joints


@dataclass(frozen=True)
class WrittenGroup:
    """What was written of a group of cameras.

    report: what `run.json` holds.
    notes: a line for each further format: what it does not hold.
    refused: further formats that were not written, as they cannot hold the group, and why.
    """

    report: dict[str, Any]
    notes: tuple[str, ...]
    refused: Mapping[str, MismatchError]

    @property
    def complaint(self) -> str:
        """What was asked for of this group and could not be had, "" where all was."""
        return complain(self.report, self.refused)


def complain(report: Mapping[str, Any], refused: Mapping[str, MismatchError]) -> str:
    """Return what was asked for and could not be had, though the rest was; "" where all was.

    report: what `run.json` holds. refused: further formats that were not written.
    """
    world = report["world"]
    unmet = [world[key] for key in ("axes_unmet", "scale_unmet") if world[key]]
    if not unmet:
        return next((each.render(spell_as_option) for each in refused.values()), "")
    how = []
    if world["axes_unmet"]:
        on_floor = world["kind"] == "floor"
        how.append("on the floor" if on_floor else f"in the axes of camera {world['camera']}")
    if world["unit"] == ARBITRARY:
        how.append("with arbitrary lengths (`mocap-calib scale OUT --height 1.75` sets the scale)")
    but = f" but {', '.join(refused)}" if refused else ""
    return " ".join(["; ".join(unmet) + f"; all files{but} are written", *how])


# in the folder of results: the pairs of a run that is under way or was killed
UNFINISHED = ".unfinished"


def write_result(
    output: Path,
    result: CalibrationResult,
    *,
    inputs: Mapping[str, str],
    described: Mapping[str, Any],
    fingerprint: str | None = None,
    formats: Sequence[str] = (),
    fps: float | None = None,
    page: bool = True,
) -> tuple[WrittenGroup, ...]:
    """Write all files of a run, together or not at all; return what was written of each group.

    What the `run.json` of an earlier run lists and this one did not write is removed: further
    groups, individuals and formats, and a rig reversed in depth.

    output: the folder. inputs: SHA-256 of the files that were read, by path.
    described: further keys of `run.json`. fingerprint: of all that the result follows from, where
        that is known. formats, fps: as in `CalibrationRequest`; what cannot hold the rig or the
        poses of a group is left out.
    page: whether report.html is written.
    """
    earlier = read_outputs(output)
    reports = _report_groups(result, inputs, described)
    further: dict[int, WriteOutcome] = {}
    with replace_folder(output) as work:
        # the first group comes last: its report has the hashes of all other files
        for number in reversed(range(len(result.groups))):
            group, place = result.groups[number], work / group_folder(number)
            place.mkdir(exist_ok=True)
            judged = verdict_of_cameras(reports[number])
            source = provenance("run", seed=result.seed, inputs=inputs, **judged)
            poses = _describe_poses(group, fps)
            write_group(place, group, poses, source, clocks=result.clocks)
            further[number] = _write_further(
                place, group, poses, formats=formats, source=source, config=result.config
            )
            if page:
                seen = source_of_group(
                    group,
                    reports[number],
                    title=name_results(output, number),
                    edges=tuple(poses.edges),
                    fps=poses.rate,
                )
                write_bytes(place / PAGE, report_page(seen).encode())
            if number == 0:
                reports[0]["fingerprint"] = fingerprint
                reports[0]["outputs"] = hash_files(work)
            write_run_json(place, reports[number])
    remove_unfinished(output)
    remove_earlier_outputs(output, earlier, kept=reports[0]["outputs"].keys())
    return tuple(
        WrittenGroup(report, further[number].notes, further[number].refused)
        for number, report in enumerate(reports)
    )


def name_results(output: Path, number: int) -> str:
    """Return what the report of a group, counted from 0, is called: by the folder of the run."""
    name = output.resolve().name
    return f"{name}/{group_folder(number)}" if number else name


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
    return describe_poses(group.poses, fps, edges=edges, joints=stated_joints(group.recording))


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
        unsigned_zeros(run_report(group, result, inputs=inputs))
        | {"model": group.recording.model, **shared}
        for group in result.groups
    ]


def remove_unfinished(output: Path) -> None:
    """Remove the pairs of an unfinished run, and the folder made for them if it is empty now."""
    if not (output / UNFINISHED).is_dir():
        return
    shutil.rmtree(output / UNFINISHED, ignore_errors=True)
    if not any(output.iterdir()):
        output.rmdir()
