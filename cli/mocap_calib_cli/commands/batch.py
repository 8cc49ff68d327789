"""mocap-calib batch: many recordings."""

import json
import traceback
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import numbers, option_files, options, values
from mocap_calib_cli.commands.run import command as run
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Texts, Typed, as_command, explain

if TYPE_CHECKING:
    from mocap_calib.compute.cluster import Cluster
    from mocap_calib.compute.parallel import Processes
    from mocap_calib.job.steps import CalibrationRequest, Job
    from mocap_calib_cli.screen import Reporter, Table

Outcome = dict[str, Any]

# options that a recording may have for itself
OF_RECORDINGS = frozenset({"keypoints", "cameras", *options.CALIBRATION}) - {
    *options.VERDICT,
    "scheduler",
    "quiet",
}

_REFUSED = "refused"  # stands for the verdict where files or data do not allow a calibration


@as_command(
    "batch",
    options.OUTPUT_FOLDER,
    options.argument("recordings", values.INPUT, several=True),
    options.CAMERAS_IF_ANY,
    *options.CALIBRATION,
    options.option("--jobs", numbers.COUNT, default=1),
    options.AS_JSON,
)
def command(typed: Typed) -> int:
    """Calibrate many recordings as `run` does: one after the other, in processes, or on a cluster.

    RECORDINGS: a folder of keypoint files each, or a folder with such a folder named `keypoints`
    in it. A `recording.yaml` in that folder holds options of this recording, as `run --config`
    reads them; those of the command line win. Results that are there already are kept if they
    follow from the same files, options, weights and version: call it again to go on. A recording
    that fails is reported and the others go on; the exit status is 1 then, as it is where the rig
    of a recording is not determined, and with --strict also where one is weak.

    \b
    Example:
      mocap-calib batch sessions/* --cameras intrinsics.toml -o out
      mocap-calib batch sessions/* --cameras intrinsics.toml -o out --layout body_25 --jobs 4
      mocap-calib batch sessions/* --cameras intrinsics.toml -o out --scheduler tcp://node1:8786

    recordings: Folder for each recording, with its keypoint files.
    output: Folder to write: OUT/NAME of recording NAME.
    cameras: As for `run`; first looked for in each recording's folder, then as a path for all.
    jobs: Recordings at a time, in processes of this machine.
    as_json: Write the summary to stdout.
    """
    from mocap_calib.errors import count
    from mocap_calib_cli import ending
    from mocap_calib_cli.screen import Reporter
    from mocap_calib_cli.workers import open_workers

    ending.check_demands(typed)
    if typed.scheduler and typed.jobs > 1:
        raise click.UsageError(
            "--jobs is for this machine, --scheduler for others; give one of them"
        )
    requests = _make_requests(typed)
    processes = min(typed.jobs, len(requests))
    with (
        Reporter(quiet=typed.quiet) as reporter,
        open_workers(reporter, scheduler=typed.scheduler, processes=processes) as workers,
    ):
        found = _Batch(reporter, len(requests), typed).work_off(requests, workers)
    outcomes = [found[request.output.name] for request in requests]
    counts = _count_verdicts(outcomes)
    failed = sum(outcome["status"] == "failed" for outcome in outcomes)
    verdicts = ", ".join(f"{number} {word}" for word, number in counts.items() if number)
    calibrated = f"{len(outcomes) - failed} of {count(len(outcomes), 'recording')} calibrated"
    reporter.say("")
    reporter.show(_outcome_table(outcomes))
    summary = f"{calibrated}: {verdicts}" if verdicts else calibrated
    reporter.say(f"{summary}; results in {typed.output}")
    if typed.as_json:
        document = {"recordings": outcomes, "failed": failed, "verdicts": counts}
        echo(json.dumps(document, indent=1, allow_nan=False))
    return int(any(each["error"] or ending.exit_status(each["rig"], typed) for each in outcomes))


# --- which recordings there are, and the options that each has for itself


def _make_requests(typed: Typed) -> "list[CalibrationRequest]":
    """Return what is asked for of each recording; its results go to a folder of its name.

    Raises FormatError for a file of options that is wrong: before any work is done.
    """
    from mocap_calib_cli import inputs

    requests = []
    for name, folder in _name_recordings(typed.recordings).items():
        keypoints, cameras = folder / "keypoints", folder / (typed.cameras or "")
        texts: Texts = {"keypoints": (str(keypoints if keypoints.is_dir() else folder),)}
        if typed.cameras and cameras.exists():
            texts["cameras"] = str(cameras)
        own = folder / option_files.USUAL_NAME
        read = option_files.read_file(own, click.Context(run)) if own.is_file() else {}
        holds = OF_RECORDINGS - typed.texts.keys()
        texts |= {option: text for option, text in read.items() if option in holds}
        requests.append(inputs.calibration_request(typed.replace(texts), typed.output / name))
    return requests


def _name_recordings(recordings: Iterable[str]) -> dict[str, Path]:
    """Return the folder of each recording, by the name that its results will have."""
    from mocap_calib.errors import MismatchError

    found: dict[str, Path] = {}
    for path in map(Path, recordings):
        known = found.setdefault(path.resolve().name, path)
        if known is not path:
            remedy = "rename one, or call batch for each"
            raise MismatchError("", "recordings of different names", f"{known} and {path}", remedy)
    return found


# --- what becomes of them


class _Batch:
    """Calibrates recordings, and keeps what has become of each."""

    def __init__(self, reporter: "Reporter", total: int, typed: Typed) -> None:
        self.reporter, self.total, self.typed = reporter, total, typed
        self.outcomes: dict[str, Outcome] = {}

    def work_off(
        self, requests: "Iterable[CalibrationRequest]", workers: "Cluster | Processes | None"
    ) -> dict[str, Outcome]:
        """Calibrate what is not finished; a failure is one recording's own.

        Returns the outcomes by the names of the recordings.
        """
        from mocap_calib.job.steps import calibrate_job, calibrate_job_resumably, write_results

        self.reporter("batch", 0, self.total)
        jobs = self._read_unfinished(requests)
        # the workers of a scheduler cannot reach the folder of results
        calibrate = calibrate_job if self.typed.scheduler else calibrate_job_resumably
        one_by_one = ((job, partial(calibrate, job)) for job in jobs)
        for job, get_result in workers.completed(calibrate, jobs) if workers else one_by_one:
            try:
                first = write_results(job, get_result())[0]
                self._note_result(job.request, "done", first.report, first.complaint)
            except Exception as error:
                self._note_failure(job.request, error)
        return self.outcomes

    def _read_unfinished(self, requests: "Iterable[CalibrationRequest]") -> "Iterator[Job]":
        """Read the recordings without results, one by one when they are asked for."""
        from mocap_calib.errors import MismatchError
        from mocap_calib.job.results import complain
        from mocap_calib.job.steps import find_finished, read_job

        for request in requests:
            folder, job = request.keypoints.paths[0], None
            try:
                if report := find_finished(request):
                    self._note_result(request, "kept", report, complain(report, {}))
                elif Path(folder).is_dir():
                    job = read_job(request)
                else:
                    raise MismatchError(
                        folder, "the folder of a recording", "none", "check the path"
                    )
            except Exception as error:
                self._note_failure(request, error)
            if job:
                yield job

    def _note_result(
        self,
        request: "CalibrationRequest",
        status: str,
        report: "Mapping[str, Any]",
        complaint: str,
    ) -> None:
        """Note what was found of the largest group, and what of it could not be had."""
        from mocap_calib.errors import count
        from mocap_calib_cli.ending import conclude

        name, verdict, groups = request.output.name, report["verdict"], len(report["groups"])
        cameras, individuals = len(report["cameras"]), len(report["individuals"])
        outcome = {
            "status": status,
            "error": complaint or None,
            "groups": groups,
            "cameras": cameras,
            "left_out": report["left_out"],
            "individuals": individuals,
            "rig": verdict["rig"],
            "reasons": verdict["reasons"],
            "rotation_sigma_deg": verdict["rotation_sigma_deg"]["max"],
        }
        further = f", the largest of {groups} groups of cameras" if groups > 1 else ""
        self.reporter.say(
            f"{name} {status}: {count(cameras, 'camera')}, "
            f"{count(individuals, 'individual')}{further}"
        )
        conclude(self.reporter, verdict, request.output, self.typed)
        if complaint:
            echo(f"mocap-calib: {name}: {complaint}", err=True)
        self._note(request, outcome)

    def _note_failure(self, request: "CalibrationRequest", error: Exception) -> None:
        """Note a failure, in a line on stderr.

        An error of the program also keeps its traceback; neither stops the other recordings.
        """
        from mocap_calib.errors import MocapCalibError

        line = explain(error)
        if line is None:
            echo("".join(traceback.format_exception(error)), err=True, end="")
            line = " ".join(f"{type(error).__name__}: {error}".split())
        echo(f"mocap-calib: {request.output.name}: {line}", err=True)
        rig = _REFUSED if isinstance(error, MocapCalibError) else None
        self._note(request, {"status": "failed", "error": line, "rig": rig})

    def _note(self, request: "CalibrationRequest", outcome: Outcome) -> None:
        """Keep the outcome of a recording."""
        name = request.output.name
        self.outcomes[name] = {"name": name, "output": str(request.output)} | outcome
        self.reporter("batch", len(self.outcomes), self.total)


def _outcome_table(outcomes: Iterable[Outcome]) -> "Table":
    """Return the outcomes as a table."""
    from mocap_calib_cli.screen import Table, format_number

    header = ("recording", "status", "cameras", "individuals", "sigma deg", "rig")
    rows = []
    for outcome in outcomes:
        counts = [str(outcome.get(name, "-")) for name in ("cameras", "individuals")]
        angle = format_number(outcome.get("rotation_sigma_deg"))
        rows.append((outcome["name"], outcome["status"], *counts, angle, outcome["rig"] or "-"))
    return Table(header, rows)


def _count_verdicts(outcomes: Iterable[Outcome]) -> dict[str, int]:
    """Return how many recordings have each verdict, and how many were refused."""
    from mocap_calib.results import VERDICTS

    found = [outcome["rig"] for outcome in outcomes]
    return {word: found.count(word) for word in (*VERDICTS, _REFUSED)}
