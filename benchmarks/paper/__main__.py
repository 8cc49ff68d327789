"""Measure the tables of the SteerPose paper, all methods alike.

    .venv/bin/python -m benchmarks.paper --poses POSES --recordings RECORDINGS [PART ...]

All cells take an hour or two of one core. A result is a line of JSON in `--results`; a cell that is
there is skipped, so a stopped run continues. PART selects cells by a part of their name. `--list`
prints the cells and their sizes, `--tables` makes the tables from the results alone; these two need
no data. `--quick` takes few pairs and minutes, and writes no page. Poses are of held-out subjects;
only the judge reads references.
"""

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

import torch

from ..common import add_recordings, make_parser
from .cells import QUICK, WHOLE, Cell, Data, Line, measure, plan
from .tables import all_tables, insert_tables

RESULTS = Path(__file__).with_name("results.jsonl")
PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"
STOPPED = 130  # status after an interrupt
KEY = ("group", "what", "scenario", "method", "size")


def main() -> None:
    """Measure what is missing, and write the tables."""
    options = parse()
    cells = plan(QUICK if options.quick else WHOLE, quick=options.quick)
    if options.parts:
        cells = [cell for cell in cells if any(part in cell.name for part in options.parts)]
    if not cells:
        sys.exit(f"expected parts of names that --list prints, found {' '.join(options.parts)}")
    if options.list:
        for cell in cells:
            print(cell.name, cell.size)
        return
    done = options.tables or measure_all(cells, options)
    lines = read_results(options.results)
    print(all_tables(lines))
    if not options.quick:
        text = insert_tables(options.page.read_text("utf-8"), lines)
        options.page.write_text(text, "utf-8", newline="\n")
        tell(f"wrote the tables of {options.page}")
    sys.exit(0 if done else 1)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="these cells alone")
    parser.add_argument("--poses", type=Path, help="folder of sets of 3D poses")
    add_recordings(parser, needed=False)
    parser.add_argument("--quick", action="store_true", help="few pairs; no page is written")
    parser.add_argument("--tables", action="store_true", help="from the results that are there")
    parser.add_argument("--list", action="store_true", help="print the cells and their sizes")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    usual = f"default: {RESULTS.name} beside the program; with --quick, out/paper/quick.jsonl"
    parser.add_argument("--results", type=Path, help=usual)
    parser.add_argument("--page", type=Path, default=PAGE, help="default: docs/benchmarks.md")
    options = parser.parse_args()
    if not (options.list or options.tables) and None in (options.poses, options.recordings):
        parser.error("expected --poses and --recordings: only --list and --tables need no data")
    options.results = options.results or (
        Path("out/paper/quick.jsonl") if options.quick else RESULTS
    )
    return options


def tell(message: str) -> None:
    """Print progress, which is no data."""
    print(message, file=sys.stderr, flush=True)


def measure_all(cells: Sequence[Cell], options: argparse.Namespace) -> bool:
    """Measure the cells that the results lack, each a line; return whether all are there then.

    Cells whose data are missing are left out, with a message for each file that is missing.
    """
    data = Data(options.poses, Path(options.recordings))
    for path in sorted({path for path in map(data.of, cells) if not path.exists()}):
        option = "--recordings" if path.parent == data.recordings else "--poses"
        tell(f"{path}: expected data there, found none; its rows are left out; check {option}")
    ready = [cell for cell in cells if data.of(cell).exists()]
    known = {tuple(line[part] for part in KEY) for line in read_results(options.results)}
    missing = [cell for cell in ready if tuple(getattr(cell, part) for part in KEY) not in known]
    options.results.parent.mkdir(parents=True, exist_ok=True)
    failed = len(cells) - len(ready)
    try:
        for number, (cell, future) in enumerate(measured(missing, data, options.workers), 1):
            try:
                line = future.result()
            except Exception as error:
                failed += 1
                tell(f"{number}/{len(missing)} {cell.name}: {type(error).__name__}: {error}")
            else:
                with options.results.open("a", encoding="utf-8", newline="\n") as file:
                    file.write(json.dumps(line) + "\n")
                tell(f"{number}/{len(missing)} {cell.name}: {line['processor_s']:.0f} s")
    except KeyboardInterrupt:
        tell(f"stopped; results are in {options.results}, and the same command continues")
        sys.exit(STOPPED)
    return not failed


def measured(
    cells: Sequence[Cell], data: Data, workers: int
) -> Iterator[tuple[Cell, "Future[Line]"]]:
    """Yield cells with their results, as they are done."""
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that are started
    start = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, start, torch.set_num_threads, (1,))
    try:
        working = {pool.submit(measure, cell, data): cell for cell in cells}
        for future in as_completed(working):
            yield working[future], future
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def read_results(path: Path) -> list[Line]:
    """Return the lines of a file of results; none where there is no file."""
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text("utf-8").splitlines() if line.strip()]


if __name__ == "__main__":
    main()
