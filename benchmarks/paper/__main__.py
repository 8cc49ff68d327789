"""Measure the tables of the SteerPose paper and draw its figures, all methods alike.

    .venv/bin/python -m benchmarks.paper --poses POSES --recordings RECORDINGS [PART ...]

All cells take an hour or two of one core. A result is a line of JSON in `--results`; a cell that is
there is skipped without `--again`, so a stopped run continues. PART selects cells by a part of
their name. `--list` prints the cells and their costs, `--tables` makes the tables from the results
alone; these two need no data. `--quick` takes few pairs and minutes, and writes no page. Poses are
of held-out subjects; only the judge reads references.
"""

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import torch

from ..common import add_recordings, make_parser
from .cells import QUICK, WHOLE, Cell, Data, Line, Sizes, measure, plan
from .tables import all_tables, insert_tables

RESULTS = Path(__file__).with_name("results.jsonl")
PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"
STOPPED = 130  # status after an interrupt


def main() -> None:
    """Measure what is not there yet, and write tables and figures."""
    options = parse()
    cells = [cell for cell in plan(sizes(options), quick=options.quick) if chosen(cell, options)]
    if options.list:
        print_costs(cells, read_results(options.results))
        return
    if not cells:
        sys.exit(f"expected parts of names that --list prints, found {' '.join(options.parts)}")
    done = options.tables or measure_with_data(cells, options)
    lines = read_results(options.results)
    print(all_tables(lines))
    if not options.quick:
        text = insert_tables(options.page.read_text("utf-8"), lines)
        options.page.write_text(text, "utf-8", newline="\n")
        tell(f"wrote the tables of {options.page}")
    if not options.tables:
        draw(data_of(options), options)
    sys.exit(0 if done else 1)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="these cells alone")
    parser.add_argument("--poses", type=Path, help="folder of sets of 3D poses")
    add_recordings(parser, needed=False)
    parser.add_argument("--quick", action="store_true", help="few pairs; no page is written")
    parser.add_argument("--tables", action="store_true", help="from the results that are there")
    parser.add_argument("--again", action="store_true", help="also cells that are there")
    parser.add_argument("--list", action="store_true", help="print the cells, sizes and costs")
    parser.add_argument(
        "--pairs", type=int, help="in a cell; of slow methods and of scenes never more than usual"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--out", type=Path, default=Path("out/paper"), help="folder of the figures")
    parser.add_argument(
        "--results", type=Path, help=f"default: {RESULTS.name}; with --quick, in the folder --out"
    )
    parser.add_argument("--page", type=Path, default=PAGE, help="default: docs/benchmarks.md")
    options = parser.parse_args()
    measures = not (options.list or options.tables)
    if measures and None in (options.poses, options.recordings):
        parser.error("expected --poses and --recordings: only --list and --tables need no data")
    if options.results is None:
        options.results = options.out / "quick.jsonl" if options.quick else RESULTS
    return options


def sizes(options: argparse.Namespace) -> Sizes:
    """Return how much is measured."""
    given = QUICK if options.quick else WHOLE
    if options.pairs is None:
        return given
    names = ("slow_pairs", "token_pairs", "scenes")
    fewer = {name: min(options.pairs, getattr(given, name)) for name in names}
    return replace(given, pairs=options.pairs, **fewer)


def chosen(cell: Cell, options: argparse.Namespace) -> bool:
    """Return whether a cell was asked for."""
    return not options.parts or any(part in cell.name for part in options.parts)


def print_costs(cells: Sequence[Cell], lines: Sequence[Line]) -> None:
    """Print a line for each cell: its name, its size, and the seconds that it will take.

    The seconds are the processor's, from the largest measurement that there is; - where none is.
    """
    largest = {tuple(x[k] for k in KEY[:-1]): x for x in sorted(lines, key=lambda x: x["size"])}
    known = []
    for cell in cells:
        line = largest.get(tuple(getattr(cell, part) for part in KEY[:-1]))
        if line is None:
            print(cell.name, cell.size, "-")
        else:
            known.append(line["processor_s"] * cell.size / line["size"])
            print(cell.name, cell.size, f"{known[-1]:.0f}")
    tell(f"{sum(known):.0f} s of the processor for {len(known)} of {len(cells)} cells")


def data_of(options: argparse.Namespace) -> Data:
    """Return where the data are."""
    return Data(options.poses, options.recordings)


def measure_with_data(cells: Sequence[Cell], options: argparse.Namespace) -> bool:
    """Measure the cells whose data are there; return whether nothing is left to be measured."""
    ready = with_data(cells, data_of(options))
    return len(ready) == len(cells) and measure_all(ready, data_of(options), options)


def with_data(cells: Sequence[Cell], data: Data) -> list[Cell]:
    """Return the cells whose data are there, and tell of the others: a line for each that lacks."""
    paths = {cell: data.of(cell) for cell in cells}
    for path in sorted({path for path in paths.values() if not path.exists()}):
        option = "--recordings" if path.parent == data.recordings else "--poses"
        tell(f"{path}: expected data there, found none; its rows are left out; check {option}")
    return [cell for cell, path in paths.items() if path.exists()]


def tell(message: str) -> None:
    """Say something that is no data."""
    print(message, file=sys.stderr, flush=True)


# --- measuring


def measure_all(cells: Sequence[Cell], data: Data, options: argparse.Namespace) -> bool:
    """Measure the cells that the results lack, each a line; return whether all are there then."""
    there = [] if options.again else read_results(options.results)
    known = {tuple(line[part] for part in KEY) for line in there}
    missing = [cell for cell in cells if tuple(getattr(cell, part) for part in KEY) not in known]
    options.results.parent.mkdir(parents=True, exist_ok=True)
    failed = 0
    try:
        for number, (cell, line) in enumerate(measured(missing, data, options.workers), 1):
            if isinstance(line, Exception):
                failed += 1
                result = f"{type(line).__name__}: {line}"
            else:
                with options.results.open("a", encoding="utf-8", newline="\n") as file:
                    file.write(json.dumps(line) + "\n")
                result = f"{line['processor_s']:.0f} s"
            tell(f"{number}/{len(missing)} {cell.name}: {result}")
    except KeyboardInterrupt:
        tell(f"stopped; results are in {options.results}, and the same command continues")
        sys.exit(STOPPED)
    return not failed


KEY = ("group", "what", "scenario", "method", "size")


def measured(
    cells: Iterable[Cell], data: Data, workers: int
) -> Iterator[tuple[Cell, Line | Exception]]:
    """Yield cells with what was found of them, or why nothing was."""
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that are started
    start = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, start, torch.set_num_threads, (1,))
    try:
        working: dict[Future[Line], Cell] = {pool.submit(measure, c, data): c for c in cells}
        for future in as_completed(working):
            error = future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            yield working[future], error or future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def read_results(path: Path) -> list[Line]:
    """Return the lines of a file of results; of none where there is no file."""
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text("utf-8").splitlines() if line.strip()]


def draw(data: Data, options: argparse.Namespace) -> None:
    """Draw the figures, where matplotlib is there."""
    try:
        from .figures import draw_all  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        tell(f"no figures: {error.name} is missing; pip install 'mocap-calib[figures]'")
        return
    for path in draw_all(data, options.out):
        tell(f"drew {path}")


if __name__ == "__main__":
    main()
