"""Write docs/cli.md from the help texts of the commands."""

import subprocess
import sys
from pathlib import Path

from mocap_calib_cli.main import COMMANDS

_ABOUT = (
    "Made by `make cli-docs` from `--help`. The shell can complete commands, options and names of "
    "formats: [how](completion.md)."
)
_STATUSES = """\
## Exit status

| status | when |
|---|---|
| 0 | done |
| 1 | files or data are refused; one line on stderr says why, and what to do |
| 1 | the rig is *not determined* (`run`, `batch`, `adjust`); 0 with `--accept not-determined` |
| 1 | with `--strict` also where the rig is *weak* (`run`, `batch`, `adjust`, `verify`) |
| 1 | a camera is named, or the keypoints do not determine the rig (`verify`) |
| 1 | a recording failed, the others are calibrated (`batch`) |
| 1 | a finding is CRITICAL (`inspect`) |
| 2 | the command line is wrong |
| 130 | interrupted |

Whatever the verdict is, all files are written first. A *weak* rig ends with status 0 and a warning
on stderr that `--quiet` does not silence. Where a run finds several groups of cameras, the status
follows from the verdict on the largest: its files lie in OUT, and scripts go on with them. Of the
others there are warnings. In a new folder, `OUT/run.json` is there where a rig is not determined,
and not where data are refused. In Python, `calibrate` raises an error where data are refused, but
not for a verdict.
"""
TOOL = Path(sys.executable).with_name("mocap-calib")


def make_page() -> str:
    """Return the whole page as Markdown."""
    lines = ["# Command line", "", _ABOUT, "", *_STATUSES.splitlines(), ""]
    for name in COMMANDS:
        lines += [f"## mocap-calib {name}", "", "```text", read_help(name), "```", ""]
    return "\n".join(lines)


def read_help(name: str) -> str:
    """Return the help text of a command."""
    command = [TOOL, name, "--help"]
    done = subprocess.run(command, check=True, capture_output=True, encoding="utf-8")
    return done.stdout.rstrip()


if __name__ == "__main__":
    page = Path(__file__).with_name("cli.md")
    page.write_text(make_page(), encoding="utf-8", newline="\n")
