"""What benchmarks share: command lines, tables, and what a process takes on which machine."""

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
TOOL = ("-m", "mocap_calib_cli")  # arguments of Python
RECORDINGS = "MOCAP_CALIB_RECORDINGS"

Measured = tuple[float, float, float]  # seconds, of the processor, megabytes


def make_parser(text: str | None, *, recordings: bool = False) -> argparse.ArgumentParser:
    """Return a parser whose help is a docstring; recordings: with their folder and names."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if recordings:
        add_recordings(parser)
    return parser


def add_recordings(parser: argparse.ArgumentParser, *, needed: bool = True) -> None:
    """Add `--recordings`, the folder of all recordings; an environment variable may name it."""
    parser.add_argument(
        "--recordings",
        type=_folder,
        metavar="FOLDER",
        default=os.environ.get(RECORDINGS),
        required=needed and RECORDINGS not in os.environ,
        help=f"folder with a folder for each recording (README.md) [default: ${RECORDINGS}]",
    )


def _folder(text: str) -> Path:
    """Return the folder of that name. Raises argparse's error."""
    if not Path(text).is_dir():
        raise argparse.ArgumentTypeError(
            f"expected a folder of recordings, found none at {text}; see benchmarks/README.md"
        )
    return Path(text)


def print_row(cells: Iterable[object]) -> None:
    """Print a row of a table in Markdown."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_header(columns: Sequence[str]) -> None:
    """Print the header of a table in Markdown."""
    print_row(columns)
    print("|---" * len(columns) + "|")


@cache
def describe_machine() -> str:
    """Return the processor, how many of its cores there are, and the operating system."""
    names = [platform.processor() or platform.machine()]
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        found = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
        names = found or names
    return f"{names[0]}, {os.cpu_count()} cores, {platform.system()}"


@cache
def describe_moment() -> dict[str, str]:
    """Return the date, UTC, and the commit of the program; no commit where git knows none."""
    moment = {"date": datetime.now(UTC).date().isoformat()}
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return moment
    return {"commit": said.stdout.strip()} | moment


def measure(*arguments: object) -> Measured:
    """Run Python, and return what it and its children took."""
    command = [sys.executable, "-P", *map(str, arguments)]
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: ended with {process.returncode}")
    return time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
