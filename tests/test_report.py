"""What run.json holds, and that docs/run-json.md describes it."""

import json
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import calibrated

from mocap_calib.config import Config
from mocap_calib.geometry.lens import project_views
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.results.group import REVERSED_RIG, write_group
from mocap_calib.report import run_report, verdict_of_cameras
from mocap_calib.results import FAULT_WORDS, CalibrationResult, Clocks, TimeOffsets
from mocap_calib.rig import gather_tracks
from mocap_calib.verdict.verdict import assess
from mocap_calib_cli.ending import camera_table, describe_group

DESCRIPTION = Path(__file__).parents[1] / "docs" / "run-json.md"
# their keys are files, stages, cameras or constants
BY_NAME = {
    *("config", "inputs", "outputs", "reading", "seconds", "cameras", "fault_evidence", "evidence")
}
STATISTIC = {"median", "max", "p95"}
NAMES = tuple(enumerate(("cam1", "cam2", "cam3", "cam4")))


def rows_of(report: dict[str, Any]) -> list[dict[str, str]]:
    """Return the table that the command ends with, a mapping a row."""
    table = camera_table(report)
    return [dict(zip(table.header, row, strict=True)) for row in table.rows]


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
    empty = (
        "unused_pairs",
        "world.landmarks",
        "pairs[].alternatives",
        "left_out",
        "cameras[].fault",
        "clocks[].table",
        "epochs[].moved",
        "verdict.reasons",
        "world.cues[]",
    )
    expected = {field for field in described() if not field.startswith(empty)}
    found = {field for field in fields_of(report) if not field.startswith(empty)}
    assert len(found) > 40
    assert found == expected


@pytest.mark.slow
def test_offsets_of_clocks_are_reported_where_they_are_used(tmp_path):
    found = calibrated()
    offsets = TimeOffsets(
        tau=np.array([0.0, 0.3, 0.04, np.nan]),
        sigma=np.array([0.0, 0.02, 0.03, np.nan]),
        used=np.array([False, True, False, False]),
    )
    found = replace(found, time_offsets=offsets)
    assert found.clock_offsets == {"cam2": -0.3}
    clocks = Clocks.of_one(found.recording)
    result = CalibrationResult(groups=(found,), left_out=(), unused_pairs=(), clocks=clocks)
    report = run_report(found, result, inputs={})
    clocks = [camera["clock"] for camera in report["cameras"]]
    assert clocks[1] == {"subframe_offset": -0.3, "sigma": 0.02, "used": True}
    assert clocks[2] == {"subframe_offset": -0.04, "sigma": 0.03, "used": False}
    assert clocks[3] == {"subframe_offset": None, "sigma": None, "used": False}
    assert not any(camera["faults"] for camera in report["cameras"])
    assert [row["clock"] for row in rows_of(report)] == ["-", "-0.30", "-", "-"]
    assert "clock: frames late beside cam1; " in "\n".join(describe_group(report, tmp_path))


@pytest.mark.slow
def test_what_is_wrong_with_a_camera_is_in_its_faults():
    found = calibrated()
    uncertainty = replace(
        found.uncertainty,
        outlier_cameras=np.array([False, True, False, False]),
        weak_perspective=np.array([False, False, True, True]),
    )
    found = replace(found, uncertainty=uncertainty)
    result = CalibrationResult(
        groups=(found,), left_out=(), unused_pairs=(), clocks=Clocks.of_one(found.recording)
    )
    report = run_report(found, result, inputs={})
    faults = [camera["faults"] for camera in report["cameras"]]
    assert faults == [[], ["inconsistent"], [], []]
    assert report["verdict"]["translation"] == "not observable"
    words = {fault for of_camera in faults for fault in of_camera}
    assert all(f"| `{word}` |" in DESCRIPTION.read_text("utf-8") for word in words)
    said = [row["faults"] for row in rows_of(report)]
    assert said == ["-", "inconsistent", "weak perspective", "weak perspective"]


def test_each_word_for_a_fault_is_described():
    page = DESCRIPTION.read_text("utf-8")
    assert [word for word in FAULT_WORDS if f"| `{word}` |" not in page] == []


def test_every_finding_of_a_report_is_said_in_one_place():
    """In the row of its camera, in a line or in the reasons; what nobody says nobody mends."""
    found = calibrated()
    result = CalibrationResult(
        groups=(found,), left_out=(), unused_pairs=(), clocks=Clocks.of_one(found.recording)
    )
    report = run_report(found, result, inputs={})
    sound = describe_group(report, Path("out"))
    camera, pair = report["cameras"][0], report["pairs"][0]
    for entry, worst, word, lines in (
        (camera, {"weak": True}, "low pair score", 0),
        (camera, {"faults": ["inconsistent"]}, "inconsistent", 0),
        (camera, {"weak_perspective": True}, "weak perspective", 1),
        (pair, {"breaks_loop": True}, "-", 1),
    ):
        before = {key: entry[key] for key in worst}
        entry.update(worst)
        assert rows_of(report)[0]["faults"] == word
        assert len(describe_group(report, Path("out"))) == len(sound) + lines, worst
        entry.update(before)
    reversible = replace(found.adjusted, depth_reversed_rig=found.rig)
    reasons = assess(replace(found, adjusted=reversible), (), Config()).reasons
    assert len([each for each in reasons if "reversed in depth" in each.meaning]) == 1


def test_a_rig_reversed_in_depth_is_written_beside_the_other(tmp_path):
    """The other has cameras elsewhere here; without one there is no such file."""
    found = calibrated()
    other = replace(found.rig, translation=2 * found.rig.translation)
    reversible = replace(found, adjusted=replace(found.adjusted, depth_reversed_rig=other))
    poses, clocks = PoseFile(found.poses), Clocks.of_one(found.recording)
    for group, folder in ((found, tmp_path / "one"), (reversible, tmp_path / "two")):
        folder.mkdir()
        write_group(folder, group, poses, {}, clocks=clocks)
    assert not (tmp_path / "one" / REVERSED_RIG).exists()
    back = read_rig(tmp_path / "two" / REVERSED_RIG)
    np.testing.assert_allclose(back.centres, other.centres, atol=1e-9)
    np.testing.assert_allclose(
        read_rig(tmp_path / "two" / "calibration.toml").centres, found.rig.centres, atol=1e-9
    )


def test_files_say_the_verdict_and_what_explains_it():
    found = calibrated()
    uncertainty = replace(
        found.uncertainty,
        outlier_cameras=np.array([False, True, False, False]),
        weak_perspective=np.array([False, False, True, False]),
    )
    adjusted = replace(found.adjusted, depth_reversed_rig=found.rig)
    found = replace(found, uncertainty=uncertainty, adjusted=adjusted)
    found = replace(found, assessment=assess(found, (), Config()))
    result = CalibrationResult(
        groups=(found,), left_out=("cam9",), unused_pairs=(), clocks=Clocks.of_one(found.recording)
    )
    report = run_report(found, result, inputs={})
    judged = verdict_of_cameras(report)
    assert list(report)[:2] == ["schema", "verdict"]
    assert (judged["adjusted"], judged["verdict"]) == (True, report["verdict"]["rig"])
    assert judged["reprojection_error_px"] == report["points"]["mean_error_px"]
    said = "\n".join(judged["remarks"])
    for expected in (
        "camera rotations (1 SD): 0.",
        "a rig reversed in depth fits as well",
        "cameras left out: cam9",
    ):
        assert expected in said


def test_the_error_is_what_anipose_calls_one():
    """The median over the points of the mean over the views, as CameraGroup.average_error has it.

    The mean over two to four views is below their root mean square.
    """
    found = calibrated()
    result = CalibrationResult(
        groups=(found,), left_out=(), unused_pairs=(), clocks=Clocks.of_one(found.recording)
    )
    points = run_report(found, result, inputs={})["points"]
    pixels = gather_tracks(found.recording, found.matches, np.arange(60)).pixels
    images = project_views(found.rig, found.poses.raw.reshape(-1, 3).T)
    error = np.linalg.norm(images - pixels, axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # points without any view
        expected = np.nanmedian(np.nanmean(error, axis=0))
    assert points["mean_error_px"] == pytest.approx(expected, rel=1e-12)
    assert points["mean_error_px"] < points["reprojection_error_px"]["median"]


def test_individuals_are_counted_by_camera():
    found = calibrated()
    labels = found.matches.labels.copy()
    labels[0][labels[0] == 1] = -1
    found = replace(found, matches=replace(found.matches, labels=labels))
    result = CalibrationResult(
        groups=(found,), left_out=(), unused_pairs=(), clocks=Clocks.of_one(found.recording)
    )
    report = run_report(found, result, inputs={})
    assert "cam1" in report["individuals"][0]["cameras"]
    assert "cam1" not in report["individuals"][1]["cameras"]
    for each in report["individuals"]:
        seen = {name: int((labels[v] == each["individual"]).any(-1).sum()) for v, name in NAMES}
        assert each["cameras"] == {name: count for name, count in seen.items() if count}
    assert "3 individuals in 60 of 60 frames, " in describe_group(report, Path("out"))[-1]
