"""On what machine a figure was measured, when, of which commit, and what a process took."""

import os
import platform
import subprocess
import sys
import time
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]

Measured = tuple[float, float, float]  # seconds, of the processor, megabytes


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
