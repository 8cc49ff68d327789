"""On what machine a figure was measured."""

import os
import platform
from functools import cache
from pathlib import Path


@cache
def describe_machine() -> str:
    """Return the processor, how many of its cores there are, and the operating system."""
    names = [platform.processor() or platform.machine()]
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        found = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
        names = found or names
    return f"{names[0]}, {os.cpu_count()} cores, {platform.system()}"
