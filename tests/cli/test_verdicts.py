"""What a verdict makes of exit status, files and messages; the verdicts are given here."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from mocap_calib.errors import MocapCalibError
from mocap_calib.geometry.rotation import Similarity
from mocap_calib.io.cameras.read import load_cameras
from mocap_calib.job import steps
from mocap_calib.job.load import KeypointSource
from mocap_calib.job.steps import CalibrationRequest
from mocap_calib.report import run_report
from mocap_calib.results import VERDICTS, CalibrationResult, Cause, Verdict
from mocap_calib.verdict import verdict
from mocap_calib.world.place import move_group
from mocap_calib_cli.commands import adjust, batch, run
from mocap_calib_cli.main import group
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.progress import Reporter
from mocap_calib_cli.verdicts import exit_status

WHY = "cam1 may be turned by 4.0 deg"
REMEDY = "cam1 and cam2 face each other: add a camera between them"
REASON = f"{WHY}. Next: {REMEDY}."
STILL = Similarity(1.0, np.eye(3), np.zeros(3))
FILES = {"cameras.yaml", "calibration.toml", "matches.csv", "poses3d.h5", "run.json"}


@pytest.fixture(scope="module")
def found(small, tmp_path_factory) -> CalibrationResult:
    """What a run finds of a small recording."""
    request = CalibrationRequest(
        keypoints=KeypointSource((str(small / "keypoints"),)),
        cameras=small / "intrinsics.toml",
        output=tmp_path_factory.mktemp("nothing") / "out",
    )
    return steps.calibrate_job(steps.read_job(request))


def judged(result: CalibrationResult, *verdicts: str) -> CalibrationResult:
    """The result with a group of each verdict."""
    (group,) = result.groups
    degrees = dict(zip(VERDICTS, (0.5, 2.0, 5.0, 20.0), strict=True))
    groups = (
        replace(group, assessment=Verdict(degrees[each], (Cause("bones", "", 5.0, WHY, REMEDY),)))
        for each in verdicts
    )
    return replace(result, groups=tuple(groups))


def call(command, *words: object) -> Result:
    """Call a command; what it raises for a user's mistake is the result's exception."""
    done = CliRunner().invoke(command, [*map(str, words)])
    if not isinstance(done.exception, SystemExit | MocapCalibError | None):
        raise done.exception
    return done


@pytest.fixture
def run_with(small, found, monkeypatch, tmp_path):
    """Call `run`, which finds groups of these verdicts."""

    def run_with(verdicts: tuple[str, ...], *options: object) -> Result:
        result = judged(found, *verdicts)
        monkeypatch.setattr(steps, "calibrate_job_resumably", lambda *_, **__: result)
        cameras = small / "intrinsics.toml"
        out = tmp_path / "out"
        return call(run.command, small / "keypoints", "--cameras", cameras, "-o", out, *options)

    return run_with


@pytest.mark.parametrize(
    ("verdict", "usual", "strict", "accepted"),
    [
        ("well determined", 0, 0, 0),
        ("usable", 0, 0, 0),
        ("weak", 0, 1, 0),
        ("not determined", 1, 1, 0),
    ],
)
def test_the_status_follows_from_the_verdict_after_all_files_were_written(
    verdict, usual, strict, accepted, run_with, tmp_path
):
    for options, expected in (
        ((), usual),
        (("--strict",), strict),
        (("--accept", "not-determined"), accepted),
    ):
        done = run_with((verdict,), "--quiet", "--json", *options)
        assert done.exit_code == expected
        assert json.loads(done.stdout)["verdict"]["rig"] == verdict
        assert {path.name for path in (tmp_path / "out").iterdir()} >= FILES
        assert load_cameras(tmp_path / "out").judgement["verdict"] == verdict
        doubtful = verdict in ("weak", "not determined")
        lines = done.stderr.splitlines()
        assert bool(lines) == doubtful  # also with --quiet
        if doubtful:
            assert lines[0].startswith(f"mocap-calib: {tmp_path / 'out'}: rig {verdict}: ")
            assert ("all files are written, and the exit status is 1" in lines[0]) == expected
            assert lines[1:] == [f"  {REASON}"]


def test_what_cannot_be_had_of_the_world_ends_a_run_after_all_files_were_written(
    run_with, found, monkeypatch, tmp_path
):
    """A format in metres is left out then, also of a further group, where it is no error."""
    unmet = replace(found.groups[0].rig.world, scale_unmet="--height 9: expected 0, found 9; ask")
    placed = judged(found, "usable", "usable")
    groups = [move_group(group, STILL, "arbitrary", unmet) for group in placed.groups]
    monkeypatch.setattr(
        "test_verdicts.judged", lambda *_: replace(placed, groups=(groups[0], placed.groups[1]))
    )
    done = run_with(("usable",), "--write", "trc", "--height", "9=1.7", "--fps", "30")
    assert done.exit_code == 1
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {*FILES, "group_2"}
    said = done.stderr.splitlines()[-1]
    assert "--height 9: expected 0, found 9; ask; all files but trc are written" in said
    assert "mocap-calib scale OUT" in said
    assert done.stderr.count("trc is not written: ") == 1
    report = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))
    assert report["world"]["scale_unmet"] == unmet.scale_unmet


def test_every_verdict_has_a_status():
    assert [exit_status(word, SharedOptions()) for word in VERDICTS] == [0, 0, 0, 1]


def test_the_largest_group_counts_and_the_others_are_warned_of(run_with, tmp_path):
    done = run_with(("usable", "not determined"))
    assert done.exit_code == 0
    second = tmp_path / "out" / "group_2"
    warning = f"mocap-calib: {second}: rig not determined: do not measure with it\n"
    assert warning in done.stderr
    assert f"{tmp_path / 'out'}: rig usable: read the reasons" in done.stderr.split(warning)[1]
    assert run_with(("not determined", "usable")).exit_code == 1


def test_each_group_has_a_report_unless_it_is_not_wanted(run_with, tmp_path):
    pages = [tmp_path / "out" / name for name in ("report.html", "group_2/report.html")]
    run_with(("usable", "weak"))
    assert all(page.is_file() for page in pages)
    run_with(("usable", "weak"), "--no-report")
    assert not any(page.is_file() for page in pages)
    listed = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))["outputs"]
    assert not any("report" in name for name in listed)


def test_reasons_are_said_once_and_stand_in_the_files(run_with, tmp_path):
    said = run_with(("weak",)).stderr
    assert said.splitlines()[-1] == f"  {REASON}"
    assert said.count(WHY) == said.count(REMEDY) == said.count("rig weak") == 1
    for name in ("cameras.yaml", "calibration.toml"):
        assert f"#   {REASON}\n" in (tmp_path / "out" / name).read_text("utf-8")


@pytest.mark.parametrize("command", ["run", "batch", "adjust"])
def test_one_cannot_refuse_and_accept(command):
    files = ["--rig", "r", "--matches", "m"] if command == "adjust" else ["-o", "out"]
    asked = [command, "k", *files, "--strict", "--accept", "not-determined"]
    done = call(group, *asked)
    assert done.exit_code == 2
    assert "--strict: expected it without --accept" in done.stderr


# batch


@pytest.fixture
def batch_with(small, found, monkeypatch, tmp_path):
    """Call `batch` on recordings that are called by their verdicts."""

    def batch_with(*options: object) -> Result:
        names = [word.replace(" ", "_") for word in VERDICTS]
        for name in (*names, "broken"):
            (tmp_path / name).mkdir(exist_ok=True)
            for file in (small / "keypoints").iterdir():
                (tmp_path / name / file.name).write_bytes(file.read_bytes())
        (tmp_path / "broken" / "cam1.json").write_text("no JSON")

        def calibrate(job, **_) -> CalibrationResult:
            return judged(found, Path(job.request.output).name.replace("_", " "))

        monkeypatch.setattr(steps, "calibrate_job_resumably", calibrate)
        chosen = names if "--whole" in options else [*names, "broken"]
        folders = [tmp_path / name for name in chosen]
        options = tuple(option for option in options if option != "--whole")
        cameras = small / "intrinsics.toml"
        return call(batch.command, *folders, "--cameras", cameras, "-o", tmp_path / "out", *options)

    return batch_with


def test_a_batch_counts_the_verdicts_apart(batch_with, tmp_path):
    done = batch_with("--json")
    summary = json.loads(done.stdout)
    assert summary["verdicts"] == dict.fromkeys((*VERDICTS, "refused"), 1)
    assert (done.exit_code, summary["failed"]) == (1, 1)
    assert (
        "4 of 5 recordings calibrated: 1 well determined, 1 usable, 1 weak, 1 not determined, "
        f"1 refused; results in {tmp_path / 'out'}\n"
    ) in done.stderr
    assert [each.get("reasons") for each in summary["recordings"]] == [[], *[[REASON]] * 3, None]
    assert done.stderr.count(f"  {REASON}\n") == 3


def test_a_batch_ends_as_a_run_does(batch_with, tmp_path):
    done = batch_with("--whole", "-q")
    assert done.exit_code == 1
    weak, because, not_determined, again = done.stderr.splitlines()
    assert weak.startswith(f"mocap-calib: {tmp_path / 'out' / 'weak'}: rig weak: check")
    assert not_determined.startswith(
        f"mocap-calib: {tmp_path / 'out' / 'not_determined'}: rig not determined: do not"
    )
    assert because == again == f"  {REASON}"
    kept = batch_with("--whole", "-q", "--accept", "not-determined")
    assert kept.exit_code == 0
    assert kept.stderr.count("mocap-calib: ") == 2  # also of what was kept
    assert batch_with("--whole", "-q", "--strict").exit_code == 1


# adjust


@pytest.fixture(scope="module")
def start(small, found, tmp_path_factory) -> list[object]:
    """The words for `adjust` on the small recording, with the matches of a run."""
    folder = tmp_path_factory.mktemp("start")
    request = CalibrationRequest(
        keypoints=KeypointSource((str(small / "keypoints"),)),
        cameras=small / "intrinsics.toml",
        output=folder / "out",
    )
    steps.write_results(steps.read_job(request), found)
    rig, matches = folder / "out" / "cameras.yaml", folder / "out" / "matches.csv"
    return [small / "keypoints", "--rig", rig, "--matches", matches]


def test_adjust_tells_errors_and_verdict_as_run_does(start, found, tmp_path):
    done = call(adjust.command, *start, "-o", tmp_path / "a.yaml")
    assert done.exit_code == 0
    table = done.stderr[done.stderr.index("camera  detections  matched  error px") :].splitlines()
    assert [line.split()[0] for line in table[1:4]] == list(found.groups[0].rig.names)
    assert table[5].startswith("least sure pair: cam")
    assert table[6].startswith(f"{tmp_path / 'a.yaml'}: rig ")
    judgement = load_cameras(tmp_path / "a.yaml").judgement
    assert judgement["verdict"] in done.stderr
    error = run_report(found.groups[0], found)["points"]["mean_error_px"]
    assert judgement["reprojection_error_px"] == pytest.approx(error, rel=0.2)  # measured 0.01


def test_adjust_ends_as_run_does(start, monkeypatch, tmp_path):
    conclude = verdict.conclude_without_pairs
    for options, expected in (((), 1), (("--accept", "not-determined"), 0)):
        monkeypatch.setattr(
            verdict,
            "conclude_without_pairs",
            lambda *args, **kwargs: judged(conclude(*args, **kwargs), "not determined"),
        )
        done = call(adjust.command, *start, "-o", tmp_path / "a.yaml", "-q", *options)
        assert done.exit_code == expected
        assert done.stderr.startswith(f"mocap-calib: {tmp_path / 'a.yaml'}: rig not determined: do")
        assert load_cameras(tmp_path / "a.yaml").judgement["verdict"] == "not determined"


def test_a_quiet_reporter_still_warns(capsys):
    reporter = Reporter(quiet=True)
    reporter.say("nothing")
    reporter.warn("something")
    assert capsys.readouterr().err == "something\n"
