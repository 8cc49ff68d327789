"""What run.json holds, and that docs/run-json.md describes it."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import calibrated, gaps, with_labels

import mocap_calib as mc
from mocap_calib.report import run_report
from mocap_calib.results import Clocks, TimeOffsets

DESCRIPTION = Path(__file__).parents[1] / "docs" / "run-json.md"
# their keys are files, stages, cameras or constants
BY_NAME = {
    *("config", "inputs", "outputs", "reading", "seconds", "cameras", "fault_evidence", "evidence")
}
STATISTIC = {"median", "max", "p95"}


def described() -> set[str]:
    """Return the fields that the page describes, as cameras[].name: a section has a table."""
    fields, prefix = set(), ""
    for line in DESCRIPTION.read_text("utf-8").splitlines():
        if heading := re.match(r"## (?:`(.+)`)?", line):
            prefix = f"{heading[1]}." if heading[1] else ""
        elif row := re.match(r"\| `(\w+)` \|.*\|.*\|$", line):
            fields.add(prefix + row[1])
    return fields


def fields_of(report: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Return the fields of a report that hold values, those of lists as cameras[].name."""
    for key, value in report.items():
        path = prefix + key
        if isinstance(value, list) and value and isinstance(value[0], dict):
            for entry in value:
                yield from fields_of(entry, f"{path}[].")
        elif isinstance(value, dict) and key not in BY_NAME and not set(value) <= STATISTIC:
            yield from fields_of(value, f"{path}.")
        elif value != []:
            yield path


def test_every_field_of_run_json_is_described_and_nothing_else(done):
    """Lists that are empty in this run have no fields; faults have their own evidence."""
    report = json.loads((done[0] / "run.json").read_text("utf-8"))
    empty = ("unused_pairs", "world.landmarks", "pairs[].alternatives", "left_out")
    empty += ("cameras[].fault", "clocks[].table", "epochs[].moved", "verdict.reasons")
    empty += ("world.cues[]",)
    expected = {field for field in described() if not field.startswith(empty)}
    found = {field for field in fields_of(report) if not field.startswith(empty)}
    assert len(found) > 40
    assert found == expected


def result_of(group: mc.GroupResult) -> mc.CalibrationResult:
    return mc.CalibrationResult((group,), (), (), clocks=Clocks.of_one(group.recording))


def reported(group: mc.GroupResult) -> dict[str, Any]:
    return run_report(group, result_of(group), inputs={})


def test_offsets_of_clocks_are_reported_where_they_are_used():
    offsets = TimeOffsets(
        tau=np.array([0.0, 0.3, 0.04, np.nan]),
        sigma=np.array([0.0, 0.02, 0.03, np.nan]),
        used=np.array([False, True, False, False]),
    )
    found = replace(calibrated(), time_offsets=offsets)
    assert found.clock_offsets == {"cam2": -0.3}
    clocks = [camera["clock"] for camera in reported(found)["cameras"]]
    assert clocks[1] == {"subframe_offset": -0.3, "sigma": 0.02, "used": True}
    assert clocks[2] == {"subframe_offset": -0.04, "sigma": 0.03, "used": False}
    assert clocks[3] == {"subframe_offset": None, "sigma": None, "used": False}


def test_what_is_wrong_with_a_camera_is_in_its_faults():
    uncertainty = replace(
        calibrated().uncertainty,
        outlier_cameras=np.array([False, True, False, False]),
        weak_perspective=np.array([False, False, True, True]),
    )
    report = reported(replace(calibrated(), uncertainty=uncertainty))
    assert [camera["faults"] for camera in report["cameras"]] == [[], ["inconsistent"], [], []]
    assert report["verdict"]["translation"] == "not observable"


def test_a_rig_reversed_in_depth_is_written_beside_the_other(tmp_path):
    """The other has cameras elsewhere here; without one there is no such file."""
    found = calibrated()
    other = replace(found.rig, translation=2 * found.rig.translation)
    reversible = replace(found, adjusted=replace(found.adjusted, depth_reversed_rig=other))
    for name, group in (("one", found), ("two", reversible)):
        mc.write(result_of(group), tmp_path / name)
    one, two = ({path.name for path in (tmp_path / name).iterdir()} for name in ("one", "two"))
    (more,) = two - one
    back = mc.read_rig(tmp_path / "two" / more)
    np.testing.assert_allclose(back.centres, other.centres, atol=1e-9)
    own = mc.read_rig(tmp_path / "two" / "calibration.toml")
    np.testing.assert_allclose(own.centres, found.rig.centres, atol=1e-9)


def test_the_error_is_what_anipose_calls_one():
    """The median over the points of the mean over the views, as CameraGroup.average_error has it.

    The mean over two to four views is below their root mean square.
    """
    group = calibrated()
    points = reported(group)["points"]
    error = np.linalg.norm(
        gaps(group.rig, group.recording, group.matches, group.poses.raw), axis=-1
    )
    views = np.isfinite(error).sum(0)
    expected = np.median(np.nansum(error, axis=0)[views > 0] / views[views > 0])
    assert points["mean_error_px"] == pytest.approx(expected, rel=1e-5)
    assert points["mean_error_px"] < points["reprojection_error_px"]["median"]


def test_individuals_are_counted_by_camera():
    labels = calibrated().matches.labels.copy()
    labels[0][labels[0] == 1] = -1
    report = reported(with_labels(calibrated(), labels))
    names = calibrated().rig.names
    for each in report["individuals"]:
        seen = (labels == each["individual"]).any(-1).sum(1)
        counts = dict(zip(names, seen.tolist(), strict=True))
        assert each["cameras"] == {name: count for name, count in counts.items() if count}
    assert "cam1" not in report["individuals"][1]["cameras"]
