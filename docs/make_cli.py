"""Write docs/cli.md from the help texts of the commands."""

import subprocess
import sys
from pathlib import Path

from mocap_calib_cli.main import COMMANDS

_ABOUT = (
    "Made by `make cli-docs` from `--help`. The shell can complete commands, options and names of "
    "formats: [how](completion.md)."
)
TOOL = Path(sys.executable).with_name("mocap-calib")


def make_page() -> str:
    """Return the whole page as Markdown."""
    lines = ["# Command line", "", _ABOUT, ""]
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
