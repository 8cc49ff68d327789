"""The options that commands share, said once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]

STDIO = "-"

keypoints = click.argument("keypoints", nargs=-1, required=True, metavar="KEYPOINTS...")
cameras = click.option("--cameras", required=True, metavar="INTRINSICS", help="File with the cameras' intrinsics (TOML or YAML), or folder of such files.")
rig = click.option("--rig", required=True, metavar="CAMERAS", help="File with cameras and where they stand (cameras.yaml, calibration.toml); - reads stdin.")
matches = click.option("--matches", required=True, metavar="MATCHES", help="File of the command `match`; - reads stdin.")
skeleton = click.option("--skeleton", type=click.Path(path_type=Path), metavar="FILE.yaml", help="Your names of joints: a mapping `aliases`, own name: joint.")
model = click.option(
    "--model", metavar="NAME|FILE|none", help="Network: shipped (see `models`) or one of your own; none: geometry alone. [default: by joint names]"
)
solver = click.option("--solver", type=click.Choice(["search", "paper"]), default="search", help="Of pairs: ours, or the paper's gradient descent (slow).")
seed = click.option("--seed", type=click.IntRange(min=0), default=0, help="The same seed gives the same results.")
device = click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", help="Where the network runs.")
scheduler = click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work (tcp://HOST:PORT); same results.")
quiet = click.option("--quiet", "-q", is_flag=True, help="Say nothing on stderr but errors.")


def output_text(what: str) -> Callable[[Command], Command]:
    """`-o FILE` of a command whose result is text: stdout unless a file is given."""
    return click.option("-o", "--output", default=STDIO, metavar="FILE", help=f"Where to write the {what}; - is stdout.")


def output_file(what: str) -> Callable[[Command], Command]:
    """`-o FILE` of a command whose result is a file."""
    return click.option("-o", "--output", type=click.Path(path_type=Path), required=True, metavar="FILE", help=what)


def as_json(what: str) -> Callable[[Command], Command]:
    """`--json`."""
    return click.option("--json", "as_json", is_flag=True, help=what)
