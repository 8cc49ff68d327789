"""What run.json holds, and that docs/run-json.md describes it."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scenes import calibrated

from mocap_calib.config import Config
from mocap_calib.report import run_report
from mocap_calib.types import CalibrationResult
from mocap_calib_cli.describe import describe_group

DESCRIPTION = Path(__file__).parents[1] / "docs" / "run-json.md"
BY_NAME = {"config", "inputs", "outputs", "seconds"}  # their keys are files, stages or constants
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
    """Lists that are empty in this run have no fields."""
    report = json.loads((done[0] / "run.json").read_text("utf-8"))
    empty = ("unused_pairs", "pairs[].alternatives", "left_out", "cameras[].faults")
    expected = {field for field in described() if not field.startswith(empty)}
    found = {field for field in fields_of(report) if not field.startswith(empty)}
    assert len(found) > 40
    assert found == expected


def test_what_is_wrong_with_a_camera_is_in_its_faults():
    found = calibrated()
    uncertainty = replace(
        found.uncertainty,
        outlier_cameras=np.array([False, True, True, False]),
        weak_perspective=np.array([False, False, True, True]),
    )
    found = replace(found, uncertainty=uncertainty)
    result = CalibrationResult(groups=(found,), left_out=(), unused_pairs=())
    report = run_report(found, result, seed=0, config=Config(), inputs={})
    faults = [camera["faults"] for camera in report["cameras"]]
    assert faults == [
        [],
        ["inconsistent"],
        ["inconsistent"],
        [],
    ]
    assert report["verdict"]["rig"] == "weak"
    assert report["verdict"]["translation"] == "not observable"
    words = {fault for of_camera in faults for fault in of_camera}
    assert all(f"| `{word}` |" in DESCRIPTION.read_text("utf-8") for word in words)
    said = "\n".join(describe_group(found, report, Path("out")))
    assert "inconsistent: cam2, cam3" in said
    assert "weak perspective, translation not observable: cam3, cam4" in said
    assert "rig: weak" in said


def test_every_finding_of_a_report_is_said():
    """Each at its worst gives a line more than a sound rig; what nobody says nobody mends."""
    found = calibrated()
    result = CalibrationResult(groups=(found,), left_out=(), unused_pairs=())
    report = run_report(found, result, seed=0, config=Config(), inputs={})
    sound = describe_group(found, report, Path("out"))
    camera, pair = report["cameras"][0], report["pairs"][0]
    for entry, worst in (
        (camera, {"weak": True}),
        (camera, {"faults": ["inconsistent"]}),
        (camera, {"weak_perspective": True}),
        (pair, {"breaks_loop": True}),
        (pair, {"alternative_taken": True}),
    ):
        before = {key: entry[key] for key in worst}
        entry.update(worst)
        assert len(describe_group(found, report, Path("out"))) == len(sound) + 1, worst
        entry.update(before)
    restless = replace(found, adjusted=replace(found.adjusted, converged=False))
    assert len(describe_group(restless, report, Path("out"))) == len(sound) + 1
    reversible = replace(found, adjusted=replace(found.adjusted, depth_reversed_rig=found.rig))
    assert len(describe_group(reversible, report, Path("out"))) == len(sound) + 1
