"""mocap-calib batch: many recordings."""

import json
import traceback
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.types import CalibrationResult
    from mocap_calib_cli.jobs import Job, Order
    from mocap_calib_cli.progress import Reporter

    Groups = CalibrationResult

Outcome = dict[str, Any]


@click.command(name="batch")
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDINGS...")
@click.option(
    "--cameras",
    required=True,
    metavar="INTRINSICS",
    help="As for `run`; first looked for in each recording's folder, then as a path for all.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="OUT",
    help="Folder to write: OUT/NAME of recording NAME.",
)
@options.skeleton
@options.model
@options.solver
@options.seed
@options.device
@options.scheduler
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, help="Recordings at a time on this machine."
)
@options.as_json("Write the summary to stdout.")
@options.quiet
@click.pass_context
def command(
    context: click.Context,
    recordings: tuple[str, ...],
    cameras: str,
    output: Path,
    skeleton: Path | None,
    model: str | None,
    solver: str,
    seed: int,
    device: str,
    scheduler: str | None,
    jobs: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrates many recordings as `run` does, one after the other, in processes, or on a cluster.

    RECORDINGS: a folder of keypoint files each, or a folder with such a folder named `keypoints` in it. Results that are
    there and follow from the same files, options, weights and version are kept; call it again to go on. A recording that
    fails is reported and the others go on; the exit status is 1 then.

    \b
    Example:
      mocap-calib batch sessions/* --cameras intrinsics.toml -o out
      mocap-calib batch sessions/* --cameras intrinsics.toml -o out --scheduler tcp://node1:8786
    """
    from mocap_calib_cli import outputs
    from mocap_calib_cli.engine import engine
    from mocap_calib_cli.jobs import Order
    from mocap_calib_cli.progress import Reporter

    if scheduler and jobs > 1:
        raise click.UsageError(
            "--jobs is for this machine, --scheduler for others; give one of them"
        )
    outputs.check_folder(output)
    folders = _by_name(recordings)
    orders = {
        name: Order(
            (_keypoints(path),),
            _cameras(path, cameras),
            skeleton,
            model,
            solver,
            seed,
            device,
            output / name,
        )
        for name, path in folders.items()
    }
    with (
        Reporter(quiet=quiet) as reporter,
        engine(reporter, scheduler=scheduler, jobs=min(jobs, len(orders))) as there,
    ):
        batch = _Batch(reporter, len(orders))
        batch.work_off(orders, there.completed if there else _one_by_one, away=there is not None)
    outcomes = [batch.outcomes[name] for name in orders]
    failed = sum(outcome["status"] == "failed" for outcome in outcomes)
    reporter.say(
        "",
        *_table(outcomes),
        f"{len(outcomes) - failed} of {len(outcomes)} recordings calibrated; results in {output}",
    )
    if as_json:
        click.echo(
            json.dumps({"recordings": outcomes, "failed": failed}, indent=1, allow_nan=False)
        )
    context.exit(1 if failed else 0)


def _by_name(recordings: Iterable[str]) -> dict[str, Path]:
    """Folder of each recording, by the name its results will have."""
    from mocap_calib.errors import MismatchError

    found: dict[str, Path] = {}
    for path in map(Path, recordings):
        name = path.resolve().name
        if name in found:
            raise MismatchError(
                f"expected recordings of different names, found {found[name]} and {path}; rename one, or call batch for each"
            )
        found[name] = path
    return found


def _keypoints(folder: Path) -> str:
    inner = folder / "keypoints"
    return str(inner if inner.is_dir() else folder)


def _cameras(folder: Path, cameras: str) -> str:
    own = folder / cameras
    return str(own) if own.exists() else cameras


def _read(order: "Order") -> "Job":
    from mocap_calib.errors import MismatchError
    from mocap_calib_cli import jobs
    from mocap_calib_cli.progress import Reporter

    if not Path(order.keypoints[0]).is_dir():
        raise MismatchError(
            f"{order.keypoints[0]}: expected the folder of a recording, found none; check the path"
        )
    return jobs.read(order, Reporter(quiet=True))


def _one_by_one(
    function: "Callable[[Job], Groups]", items: "Iterable[Job]"
) -> "Iterator[tuple[Job, Callable[[], Groups]]]":
    """Each item with a call that does its work, here and now."""
    return ((item, partial(function, item)) for item in items)


class _Batch:
    """What has become of the recordings so far."""

    def __init__(self, reporter: "Reporter", total: int) -> None:
        self.reporter = reporter
        self.total = total
        self.outcomes: dict[str, Outcome] = {}

    def work_off(
        self,
        orders: "dict[str, Order]",
        completed: "Callable[..., Iterator[tuple[Job, Callable[[], Groups]]]]",
        *,
        away: bool,
    ) -> None:
        """Calibrates what is not finished; a failure is one recording's own."""
        from mocap_calib_cli import jobs

        self.reporter("batch", 0, self.total)
        for job, result in completed(
            jobs.solve if away else jobs.solve_here, self._unfinished(orders)
        ):
            try:
                report = jobs.write(job, result())[0]
            except Exception as error:
                self._failed(job.order, error)
            else:
                self._done(job.order, "done", report)

    def _unfinished(self, orders: "dict[str, Order]") -> "Iterator[Job]":
        """Reads the recordings without results, one by one when they are asked for."""
        from mocap_calib_cli import jobs

        for order in orders.values():
            try:
                report = jobs.finished(order)
                job = None if report else _read(order)
            except Exception as error:
                self._failed(order, error)
                continue
            if report:
                self._done(order, "kept", report)
            if job:
                yield job

    def _done(self, order: "Order", status: str, report: dict[str, Any]) -> None:
        cameras, individuals, verdict = (
            len(report["cameras"]),
            len(report["individuals"]),
            report["verdict"],
        )
        difference = verdict["split_half_angle_deg"]["median"]
        outcome = {
            "cameras": cameras,
            "left_out": report["left_out"],
            "individuals": individuals,
            "rig": verdict["rig"],
            "split_half_angle_deg": difference,
        }
        self.reporter.say(
            f"{order.output.name} {status}: {cameras} cameras, {individuals} individuals, rig {verdict['rig']}"
        )
        groups = len(report["groups"])
        if groups > 1:
            self.reporter.say(
                f"{order.output.name}: {groups} groups of cameras that share too little, each calibrated by itself; counted is the largest"
            )
        self._note(order, {"status": status, "error": None, "groups": groups} | outcome)

    def _failed(self, order: "Order", error: Exception) -> None:
        """A line for a mistake of the user; one of the program keeps its traceback, and does not stop the others either."""
        from mocap_calib_cli.mistakes import explained

        line = explained(error)
        if line is None:
            click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
            line = " ".join(f"{type(error).__name__}: {error}".split())
        click.echo(f"mocap-calib: {order.output.name}: {line}", err=True)
        self._note(order, {"status": "failed", "error": line})

    def _note(self, order: "Order", outcome: Outcome) -> None:
        self.outcomes[order.output.name] = {
            "name": order.output.name,
            "output": str(order.output),
        } | outcome
        self.reporter("batch", len(self.outcomes), self.total)


def _table(outcomes: Iterable[Outcome]) -> list[str]:
    from mocap_calib_cli.progress import figure, table

    none: Outcome = {"cameras": "-", "individuals": "-", "rig": "-", "split_half_angle_deg": None}
    rows = [none | outcome for outcome in outcomes]
    header = ["recording", "status", "cameras", "individuals", "halves deg", "rig"]
    return table(
        header,
        [
            [
                r["name"],
                r["status"],
                str(r["cameras"]),
                str(r["individuals"]),
                figure(r["split_half_angle_deg"]),
                r["rig"],
            ]
            for r in rows
        ],
    )
