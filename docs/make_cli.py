"""Writes docs/cli.md from the commands' own help."""

import subprocess
import sys
from pathlib import Path

from mocap_calib_cli.main import COMMANDS

TOOL = Path(sys.executable).with_name("mocap-calib")


def page() -> str:
    """The whole page."""
    parts = ["# Command line", "", "Made by `make cli-docs` from `--help`.", ""]
    for name in COMMANDS:
        said = subprocess.run(
            [TOOL, name, "--help"], check=True, capture_output=True, text=True
        ).stdout
        parts += [f"## mocap-calib {name}", "", "```text", said.rstrip(), "```", ""]
    return "\n".join(parts)


if __name__ == "__main__":
    Path(__file__).with_name("cli.md").write_text(page(), "utf-8")
