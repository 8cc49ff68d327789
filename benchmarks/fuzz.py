"""Damaged files of every kind that the program reads, as many as time allows.

    .venv/bin/python benchmarks/fuzz.py LOG --files 50000 --jobs 2
    .venv/bin/python benchmarks/fuzz.py LOG --again 1234   # one of them, with its traceback

The law: a damaged file is read, or refused in one line; no traceback, no hang, no memory without
bounds. File number N is always the same: its kind and damage follow from N. LOG is a folder outside
the repository; it keeps which files are done and what was found, so that a stopped run continues,
and `--files 1000000` later continues from there too. Files are read in processes of their own: one
that ends its process, or hangs, is found like any other.

The exit status is 1 where a file broke the law.
"""

import json
import random
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

from common import ROOT, make_parser

sys.path[:0] = [str(ROOT), *(str(ROOT / place) for place in ("benchmarks", "cli", "tests"))]

from damaged_kinds import KINDS, make_results, try_damaged  # noqa: E402

from mocap_calib.compute.worker import Worker, WorkerEndedError  # noqa: E402

Broken = dict[str, Any]

CPU_SECONDS, MEMORY = 60, 4 << 30  # of all calls on one file
BLOCK = 1000  # files after which the log notes how far it is


def main() -> int:
    """Run or repeat; return the exit status."""
    parser = make_parser(__doc__)
    parser.add_argument("log", type=Path, metavar="LOG")
    parser.add_argument("--files", type=int, default=50_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="kinds whose names have this in them")
    parser.add_argument("--again", type=int, metavar="N", help="try file N alone")
    options = parser.parse_args()
    log: Path = options.log.resolve()
    if log.is_relative_to(ROOT):
        sys.exit(f"{log}: expected a folder outside the repository; choose another")
    results = log / "results"
    if not (results / "pairs.json").is_file():
        results.mkdir(parents=True, exist_ok=True)
        make_results(results)
    if options.again is not None:
        kind, text = try_file(results, options.only, options.again)
        print(kind, text, sep="\n")
        return int(bool(text))
    # of other kinds, the same numbers are other files
    done, found = (log / f"{name}{options.only}" for name in ("done", "found"))
    found.touch()
    first = int(done.read_text()) if done.is_file() else 0
    start, workers = time.perf_counter(), [Worker() for _ in range(options.jobs)]
    for begin in range(first, options.files, BLOCK):
        numbers = range(begin, min(begin + BLOCK, options.files))
        lines = [json.dumps(each) for each in try_block(workers, results, options.only, numbers)]
        with found.open("a") as file:
            file.writelines(f"{line}\n" for line in lines)
        done.write_text(str(numbers.stop))
    count = max(options.files - first, 0)
    broke = [json.loads(line) for line in found.read_text().splitlines()]
    rate = count / (time.perf_counter() - start)
    print(f"{count} files, {rate:.0f} a second; {len(broke)} of all broke the law")
    kinds = Counter((each["kind"], each["text"].splitlines()[-1][:150]) for each in broke)
    for (kind, text), count in kinds.most_common():
        number = next(each["file"] for each in broke if text in each["text"])
        print(f"{count:6d} x {kind}: {text} (first: --again {number})")
    return int(bool(broke))


def try_block(workers: list[Worker], results: Path, only: str, numbers: range) -> list[Broken]:
    """Return the files that broke the law."""

    def work(job: int) -> list[Broken]:
        broke: list[Broken] = []
        for number in numbers[job :: len(workers)]:
            kind, arguments = "", (results, only, number)
            try:
                kind, text = workers[job].call(
                    try_file, *arguments, cpu_seconds=CPU_SECONDS, memory_bytes=MEMORY
                )
            except WorkerEndedError as error:
                text = f"ended its process ({error})"
            if text:
                broke.append({"file": number, "kind": kind, "text": text})
        return broke

    with ThreadPoolExecutor(len(workers)) as pool:
        return [each for some in pool.map(work, range(len(workers))) for each in some]


def try_file(results: Path, only: str, number: int) -> tuple[str, str]:
    """Return the kind of a damaged file, and the end of the traceback where it broke the law."""
    kinds = _kinds(results, only)
    name = list(kinds)[number % len(kinds)]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            try_damaged(kinds[name], Path(folder), random.Random(number))
        except Exception as error:
            return name, "".join(traceback.format_exception(error)[-6:]).strip()
    return name, ""


@cache
def _kinds(results: Path, only: str) -> dict[str, object]:
    return {name: make(results) for name, make in KINDS.items() if only in name}


if __name__ == "__main__":
    from fuzz import main as run  # functions that processes find by the name of the module

    sys.exit(run())
