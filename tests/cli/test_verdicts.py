"""What a verdict makes of exit status, files and messages; the verdicts are given here."""

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from golden.command import call

import mocap_calib as mc
from mocap_calib.results import VERDICTS, Cause, Verdict

WHY = "cam1 may be turned by 4.0 deg"
REMEDY = "cam1 and cam2 face each other: add a camera between them"
REASON = f"{WHY}. Next: {REMEDY}."
FILES = {"cameras.yaml", "calibration.toml", "matches.csv", "poses3d.h5", "run.json"}


def judged(result: mc.CalibrationResult, *verdicts: str) -> mc.CalibrationResult:
    """The result with a group of each verdict."""
    degrees = dict(zip(VERDICTS, (0.5, 1.5, 5.0, 20.0), strict=True))
    groups = (
        replace(
            result.groups[0],
            assessment=Verdict(degrees[each], (Cause("bones", "", 5.0, WHY, REMEDY),)),
        )
        for each in verdicts
    )
    return replace(result, groups=tuple(groups))


@pytest.fixture
def here(tmp_path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the command in this process."""

    def run(*words: object) -> subprocess.CompletedProcess[str]:
        done = call(*words, folder=tmp_path)
        said = "".join(f"{line}\n" for line in done.stderr)
        return subprocess.CompletedProcess(words, done.status, done.stdout.decode(), said)

    return run


@pytest.fixture(scope="module")
def found(small) -> mc.CalibrationResult:
    """What a run finds of a small recording."""
    return mc.calibrate(mc.read_recording(small / "keypoints", small / "intrinsics.toml"))


@pytest.fixture
def finds(found, monkeypatch):
    """Makes runs find groups of these verdicts; without any, that which their folder is named."""

    def finds(*verdicts: str, change=lambda result: result) -> None:
        def calibrate(job, **_) -> mc.CalibrationResult:
            own = verdicts or (Path(job.request.output).name.replace("_", " "),)
            return change(judged(found, *own))

        monkeypatch.setattr("mocap_calib.job.steps.calibrate_job_resumably", calibrate)

    return finds


@pytest.fixture
def run(small, finds, here, tmp_path):
    """Calls `run`, which finds groups of these verdicts."""

    def run(verdicts: tuple[str, ...], *options: object, **more):
        finds(*verdicts, **more)
        cameras = small / "intrinsics.toml"
        return here(
            "run", small / "keypoints", "--cameras", cameras, "-o", tmp_path / "out", *options
        )

    return run


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
    verdict, usual, strict, accepted, run, tmp_path
):
    for options, expected in (
        ((), usual),
        (("--strict",), strict),
        (("--accept", "not-determined"), accepted),
    ):
        done = run((verdict,), "--quiet", "--json", *options)
        assert done.returncode == expected
        assert json.loads(done.stdout)["verdict"]["rig"] == verdict
        assert {path.name for path in (tmp_path / "out").iterdir()} >= FILES
        written = yaml.safe_load((tmp_path / "out" / "cameras.yaml").read_text("utf-8"))
        assert written["provenance"]["verdict"] == verdict
        lines = done.stderr.splitlines()
        assert bool(lines) == (verdict in ("weak", "not determined"))  # also with --quiet
        if lines:
            assert lines[0].startswith(f"mocap-calib: {tmp_path / 'out'}: rig {verdict}: ")
            assert ("all files are written, and the exit status is 1" in lines[0]) == expected
            assert lines[1:] == [f"  {REASON}"]


def test_what_cannot_be_had_of_the_world_ends_a_run_after_all_files_were_written(run, tmp_path):
    """A format in metres is left out then, also of a further group, where it is no error."""
    unmet = "--height 9: expected 0, found 9; ask"

    def place(result: mc.CalibrationResult) -> mc.CalibrationResult:
        group = result.groups[0]
        world = replace(group.rig.world, scale_unmet=unmet)
        poses = replace(group.poses, world=replace(group.poses.world, scale_unmet=unmet))
        adjusted = replace(group.adjusted, rig=replace(group.rig, world=world))
        first = replace(group, adjusted=adjusted, poses=poses)
        return replace(result, groups=(first, *result.groups[1:]))

    options = ("--write", "trc", "--height", "9=1.7", "--fps", "30")
    done = run(("usable", "usable"), *options, change=place)
    assert done.returncode == 1
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {*FILES, "group_2"}
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"mocap-calib: {unmet}; all files but trc are written")
    assert "mocap-calib scale OUT" in last
    assert done.stderr.count("trc is not written: ") == 1
    report = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))
    assert report["world"]["scale_unmet"] == unmet


def test_the_largest_group_counts_and_the_others_are_warned_of(run, tmp_path):
    done = run(("usable", "not determined"))
    assert done.returncode == 0
    second = tmp_path / "out" / "group_2"
    warning = f"mocap-calib: {second}: rig not determined: do not measure with it\n"
    assert warning in done.stderr
    assert f"{tmp_path / 'out'}: rig usable: read the reasons" in done.stderr.split(warning)[1]
    assert run(("not determined", "usable")).returncode == 1


def test_each_group_has_a_report_unless_it_is_not_wanted(run, tmp_path):
    pages = [tmp_path / "out" / name for name in ("report.html", "group_2/report.html")]
    run(("usable", "weak"))
    assert all(page.is_file() for page in pages)
    run(("usable", "weak"), "--no-report")
    assert not any(page.is_file() for page in pages)
    listed = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))["outputs"]
    assert not any("report" in name for name in listed)


def test_reasons_are_said_once_and_stand_in_the_files(run, tmp_path):
    said = run(("weak",)).stderr
    assert said.splitlines()[-1] == f"  {REASON}"
    assert said.count(WHY) == said.count(REMEDY) == said.count("rig weak") == 1
    for name in ("cameras.yaml", "calibration.toml"):
        assert f"#   {REASON}\n" in (tmp_path / "out" / name).read_text("utf-8")


@pytest.fixture
def batch(small, finds, here, tmp_path):
    """Calls `batch` on recordings that are called by their verdicts, and on further ones."""
    names = [word.replace(" ", "_") for word in VERDICTS]
    for name in (*names, "broken"):
        (tmp_path / name).mkdir()
        for file in (small / "keypoints").iterdir():
            (tmp_path / name / file.name).write_bytes(file.read_bytes())
    (tmp_path / "broken" / "cam1.json").write_text("no JSON")

    def batch(*options: object, further: tuple[str, ...] = ()):
        finds()
        folders = [tmp_path / name for name in (*names, *further)]
        cameras = small / "intrinsics.toml"
        return here("batch", *folders, "--cameras", cameras, "-o", tmp_path / "out", *options)

    return batch


def test_a_batch_counts_the_verdicts_apart(batch, tmp_path):
    done = batch("--json", further=("broken",))
    summary = json.loads(done.stdout)
    assert summary["verdicts"] == dict.fromkeys((*VERDICTS, "refused"), 1)
    assert (done.returncode, summary["failed"]) == (1, 1)
    assert (
        "4 of 5 recordings calibrated: 1 well determined, 1 usable, 1 weak, 1 not determined, "
        f"1 refused; results in {tmp_path / 'out'}\n"
    ) in done.stderr
    assert [each.get("reasons") for each in summary["recordings"]] == [[], *[[REASON]] * 3, None]
    assert done.stderr.count(f"  {REASON}\n") == 3


def test_a_batch_ends_as_a_run_does(batch, tmp_path):
    done = batch("-q")
    assert done.returncode == 1
    weak, because, not_determined, again = done.stderr.splitlines()
    assert weak.startswith(f"mocap-calib: {tmp_path / 'out' / 'weak'}: rig weak: check")
    assert not_determined.startswith(
        f"mocap-calib: {tmp_path / 'out' / 'not_determined'}: rig not determined: do not"
    )
    assert because == again == f"  {REASON}"
    kept = batch("-q", "--accept", "not-determined")
    assert kept.returncode == 0
    assert kept.stderr.count("mocap-calib: ") == 2  # also of what was kept
    assert batch("-q", "--strict").returncode == 1


def test_adjust_ends_as_run_does(done, small, here, monkeypatch, tmp_path):
    """Errors, verdict and exit status are those of the frames that calibration samples."""
    out = done[0]
    files = ("--rig", out / "cameras.yaml", "--matches", out / "matches.csv")
    words = ("adjust", small / "keypoints", *files, "-o", tmp_path / "a.yaml")
    said = here(*words)
    assert said.returncode == 0
    table = said.stderr[said.stderr.index("camera  detections  matched  error px") :].splitlines()
    report = json.loads((out / "run.json").read_text("utf-8"))
    assert [line.split()[0] for line in table[1:4]] == ["cam1", "cam2", "cam3"]
    assert table[5].startswith("least sure pair: cam")
    assert table[6].startswith(f"{tmp_path / 'a.yaml'}: rig ")
    judgement = yaml.safe_load((tmp_path / "a.yaml").read_text("utf-8"))["provenance"]
    assert judgement["verdict"] in said.stderr
    error = report["points"]["mean_error_px"]
    assert judgement["reprojection_error_px"] == pytest.approx(error, rel=0.2)  # measured 0.01

    conclude = mc.bundle_adjust

    def doubt(*arguments, **more):
        result, matches = conclude(*arguments, **more)
        return judged(result, "not determined"), matches

    monkeypatch.setattr("mocap_calib.stages.bundle_adjust", doubt)
    for options, expected in (((), 1), (("--accept", "not-determined"), 0)):
        said = here(*words, "-q", *options)
        assert said.returncode == expected
        assert said.stderr.startswith(f"mocap-calib: {tmp_path / 'a.yaml'}: rig not determined: do")
        written = yaml.safe_load((tmp_path / "a.yaml").read_text("utf-8"))
        assert written["provenance"]["verdict"] == "not determined"


# --- what counts as finished, and what a run says while it works


def damage(name: str, change=lambda content: content[: len(content) // 2]):
    def spoil(folder: Path, _) -> None:
        (folder / name).write_bytes(change((folder / name).read_bytes()))

    return spoil


def other_program(name: str):
    """As after a change of the checkout, or of the weights."""
    other = f"mocap_calib.job.steps.{name}"
    return lambda _, monkeypatch: monkeypatch.setattr(other, lambda *_: "0" * 64)


KEPT = [("--no-report",), ("--strict",), ("--jobs", "1")]
OTHER = [
    *(("--seed", "1"), ("--solver", "paper"), ("--model", "none"), ("--image-size", "1280x720")),
    *(("--views", "A,B"), ("--frame-offset", "cam1:0"), ("--format", "coco"), ("--write", "npz")),
    *(("--fps", "30"), ("--mirrored", "cam1"), ("--camera-regex", "cam."), ("--sync", "off")),
    *(damage(f"out/usable/{name}") for name in ("cameras.yaml", "poses3d.h5", "run.json")),
    lambda folder, _: (folder / "out/usable/matches.csv").unlink(),
    damage("usable/cam1.json", lambda content: content + b"\n"),
    other_program("identify_model"),
    other_program("identify_program"),
]


@pytest.mark.parametrize(
    ("change", "expected"),
    [*((each, "kept") for each in KEPT), *((each, "done") for each in OTHER)],
)
def test_finished_is_told_by_content(change, expected, small, finds, here, monkeypatch, tmp_path):
    """By the files, the options, the weights and the code that results follow from."""
    finds()
    (tmp_path / "usable").mkdir()
    for file in (small / "keypoints").iterdir():
        (tmp_path / "usable" / file.name).write_bytes(file.read_bytes())
    cameras = ("--cameras", small / "intrinsics.toml")
    words = ("batch", tmp_path / "usable", *cameras, "-o", tmp_path / "out", "-q", "--json")
    status = [
        json.loads(here(*words, *options).stdout)["recordings"][0]["status"] for options in ((), ())
    ]
    assert status == ["done", "kept"]
    options = change if isinstance(change, tuple) else change(tmp_path, monkeypatch) or ()
    done = here(*words, *options)
    found = json.loads(done.stdout)["recordings"][0]["status"]
    assert (found == "kept") == (expected == "kept")


def test_a_long_stage_says_how_long_it_takes_yet(small, here, found, monkeypatch, tmp_path):
    """And that it was interrupted, with what is kept."""
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])

    def calibrate(job, *, progress, **_) -> mc.CalibrationResult:
        progress("match all", 0, 10)
        now[0] += 40
        progress("match all (cam1)", 4, 10)
        progress("adjust", 2, 6)
        progress("smooth", 7, 7)
        kept = Path(job.request.output) / ".unfinished"
        if not kept.is_dir():
            kept.mkdir(parents=True)
            for number in range(3):
                (kept / f"{number}.json").touch()
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr("mocap_calib.job.steps.calibrate_job_resumably", calibrate)
    cameras = ("--cameras", small / "intrinsics.toml")
    words = ("run", small / "keypoints", *cameras, "-o", tmp_path / "out", "--smooth", "off")
    done = here(*words)
    assert done.returncode == 130
    assert [line for line in done.stderr.splitlines() if line][-6:] == [
        "match all (cam1): 4 of 10, about 60 s left",
        "match all (cam1): done in 40.0 s (needed 4 of at most 10 steps)",
        "adjust: done in 0.0 s (needed 2 of at most 6 steps)",
        "smooth: done in 0.0 s",
        f"3 pairs of cameras kept in {tmp_path / 'out' / '.unfinished'}: the same command goes on "
        "from there",
        "mocap-calib: interrupted",
    ]
    assert here(*words).returncode == 0
