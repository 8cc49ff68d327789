"""Damaged files of every kind that the program reads, as many as time allows.

    .venv/bin/python benchmarks/fuzz.py LOG --files 50000 --jobs 2
    .venv/bin/python benchmarks/fuzz.py LOG --again 1234   # one of them, with its traceback

The law: a damaged file is read, or refused in one line; no traceback, no hang, no memory without
bounds. File number N is always the same one: its kind, its damage and how it is read follow from
N. LOG is a folder outside the repository; it keeps what was done and what was found, so that a run
that was stopped goes on, and `--files 1000000` later goes on from there too. A file that ends its
process, or hangs in it, is found by the process that watches.

The exit status is 1 where a file broke the law.
"""

import argparse
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import TextIO

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), *(str(ROOT / place) for place in ("cli", "tests"))]

from damaged_kinds import KINDS, try_damaged  # noqa: E402
from damaged_kinds import make_results as fill_results  # noqa: E402

HANG = 60  # seconds by the clock, of all calls on one file
ADDRESSES = 8 << 30  # bytes; kernels and threads take 2 to 3 GB of addresses, not of memory


class Hang(BaseException):
    """A file took longer than any file may; no reader catches it."""


def main() -> int:
    """Run or repeat; return the exit status."""
    options = parse()
    log: Path = options.log.resolve()
    if log.is_relative_to(ROOT):
        sys.exit(f"{log}: expected a folder outside the repository; choose another")
    results = make_results(log)
    if options.again is not None:
        with Bench(results, options.only) as bench:
            bench.try_file(options.again)
        return 0
    begun, processor = time.perf_counter(), sum(os.times()[:4])
    done = watch(log, results, options)
    print(summary(log, done, time.perf_counter() - begun, sum(os.times()[:4]) - processor))
    return 1 if found_in(log) else 0


def parse() -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, metavar="LOG")
    parser.add_argument("--files", type=int, default=50_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="kinds whose names have this in them")
    parser.add_argument("--again", type=int, metavar="N", help="try file N alone")
    return parser.parse_args()


def make_results(log: Path) -> Path:
    """Return a folder that `run` wrote, with the file of `pairwise` beside; made once."""
    out = log / "results"
    if (out / "pairs.json").is_file():
        return out
    out.mkdir(parents=True, exist_ok=True)
    return fill_results(out)


# --- one file


class Bench:
    """A folder in which files are damaged, one at a time."""

    def __init__(self, results: Path, only: str) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="fuzz"))
        self.kinds = {name: make(results) for name, make in KINDS.items() if only in name}

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def kind_of(self, number: int) -> str:
        """Return the kind of a file."""
        return list(self.kinds)[number % len(self.kinds)]

    def try_file(self, number: int) -> None:
        """Raise what a reader raises of a file that is no complaint."""
        name = self.kind_of(number)
        try_damaged(self.kinds[name], self.folder / name, random.Random(number))


# --- many files


def work(log: Path, results: Path, options: argparse.Namespace, job: int) -> None:
    """Try the files of a job from where it was stopped: job, job + jobs, job + 2 jobs, ..."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, _hang)
    warnings.simplefilter("error")
    with Bench(results, options.only) as bench, _begun(log, job).open("r+") as begun:
        for number in range(_next(log, job), options.files, options.jobs):
            _note(begun, number)
            signal.alarm(HANG)
            try:
                bench.try_file(number)
            except (Exception, Hang) as error:
                signal.alarm(0)
                text = "".join(traceback.format_exception(error)[-6:])
                report(log, number, bench.kind_of(number), text)
            signal.alarm(0)
        _note(begun, options.files + options.jobs)


def _hang(_: int, __: FrameType | None) -> None:
    raise Hang(f"more than {HANG} s")


def watch(log: Path, results: Path, options: argparse.Namespace) -> int:
    """Run the jobs, each anew after the file that ended it; return how many files were tried."""
    plan = {"jobs": options.jobs, "only": options.only}
    _check_plan(log, plan)
    starts = [_next(log, job) for job in range(options.jobs)]
    context = multiprocessing.get_context("spawn")
    running = {job: _start(context, log, results, options, job) for job in range(options.jobs)}
    while running:
        time.sleep(0.2)
        for job, process in list(running.items()):
            stuck = time.time() - _begun(log, job).stat().st_mtime > 3 * HANG
            if process.is_alive() and not stuck:
                continue
            process.kill()
            process.join()
            del running[job]
            number = _next(log, job)
            if number < options.files:
                report(log, number, "", f"ended its process ({process.exitcode})")
                _begun(log, job).write_text(f"{number + options.jobs:12d}")
                running[job] = _start(context, log, results, options, job)
    ends = [min(_next(log, job), options.files) for job in range(options.jobs)]
    return sum(max(b - a, 0) // options.jobs for a, b in zip(starts, ends, strict=True))


def _start(
    context: multiprocessing.context.SpawnContext,
    log: Path,
    results: Path,
    options: argparse.Namespace,
    job: int,
) -> multiprocessing.process.BaseProcess:
    _begun(log, job).touch()
    process = context.Process(target=work, args=(log, results, options, job))
    process.start()
    return process


def _check_plan(log: Path, plan: dict[str, object]) -> None:
    """End where a log is of other jobs or kinds, whose numbers mean other files."""
    path = log / "plan.json"
    if not path.is_file():
        path.write_text(json.dumps(plan))
    if json.loads(path.read_text()) != plan:
        sys.exit(f"{log}: expected a log of {plan}, found {path.read_text()}; choose another LOG")


def _begun(log: Path, job: int) -> Path:
    return log / f"job_{job}"


def _next(log: Path, job: int) -> int:
    """Return the first file of a job that is not done."""
    path = _begun(log, job)
    return int(path.read_text() or job) if path.is_file() else job


def _note(begun: TextIO, number: int) -> None:
    begun.seek(0)
    begun.write(f"{number:12d}")
    begun.flush()


def report(log: Path, number: int, kind: str, text: str) -> None:
    """Add a file that broke the law to what was found."""
    with (log / "found.jsonl").open("a") as file:
        file.write(json.dumps({"file": number, "kind": kind, "text": text}) + "\n")


def found_in(log: Path) -> list[dict[str, str]]:
    """Return what was found, each file once."""
    path = log / "found.jsonl"
    lines = path.read_text().splitlines() if path.is_file() else []
    return list({each["file"]: each for each in map(json.loads, lines)}.values())


def summary(log: Path, done: int, seconds: float, processor: float) -> str:
    """Return how many files, how fast, and what was found, by what it says last."""
    found = found_in(log)
    kinds = Counter((each["kind"], each["text"].strip().splitlines()[-1][:150]) for each in found)
    first = {(e["kind"], e["text"].strip().splitlines()[-1][:150]): e["file"] for e in found[::-1]}
    rate = done / max(seconds, 1e-9)
    lines = [
        f"{done} files in {seconds:.0f} s ({processor:.0f} s of processors): {rate:.0f} files/s; "
        f"a million take {1e6 / max(rate, 1e-9) / 3600:.1f} h; {len(found)} broke the law"
    ]
    for (kind, text), count in kinds.most_common():
        lines.append(f"{count:6d} x {kind}: {text} (first: --again {first[kind, text]})")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
