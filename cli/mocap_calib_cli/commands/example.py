"""mocap-calib example: recordings to begin with."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib.synthetic.config import EXAMPLES
from mocap_calib_cli import options

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_ABOUT = {
    "people": "two people who walk about and gesture, four cameras",
    "dog": "a dog that walks and trots, four cameras",
    "mouse": "a rodent in an arena, four cameras",
}


class _Name(click.ParamType[str]):
    """The name of an example."""

    name = "name"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name. Raises click's BadParameter."""
        if value not in EXAMPLES:
            self.fail(f"expected one of {', '.join(EXAMPLES)}, found {value}", param, ctx)
        return value

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> "list[CompletionItem]":
        """Return the names that begin as what was typed."""
        from click.shell_completion import CompletionItem

        names = (name for name in EXAMPLES if name.startswith(incomplete))
        return [CompletionItem(name, help=_ABOUT[name]) for name in names]


@click.command(name="example")
@click.argument("name", required=False, type=_Name())
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Folder to write; made when missing.  [default: NAME]",
)
@options.shared_options("quiet")
def command(shared: options.SharedOptions, name: str | None, output: Path | None) -> None:
    """Lay out an example recording; without NAME, list those that there are.

    These are simulated recordings with keypoints, intrinsics, the true cameras, and a README with
    three commands to run. They are made on the spot, the same bytes every time. `simulate` makes
    others.

    \b
    Example:
      mocap-calib example
      mocap-calib example dog -o dog
    """
    if name is None:
        for known, about in _ABOUT.items():
            click.echo(f"{known:8}{about}")
        return
    from mocap_calib.io.results.scene import check_own_files, scene_files, write_scene
    from mocap_calib.synthetic import simulate
    from mocap_calib_cli.commands.simulate import format_command
    from mocap_calib_cli.progress import Reporter

    folder = output or Path(name)
    scene = simulate(EXAMPLES[name])
    made_by = format_command(EXAMPLES[name])
    check_own_files(folder, scene_files(scene, made_by))
    write_scene(folder, scene, made_by)
    reporter = Reporter(quiet=shared.quiet)
    reporter.say(
        f"{folder}: {_ABOUT[name]}, {EXAMPLES[name].frames} frames",
        f"{folder / 'README.md'} has three commands to run there, the first to begin with:",
        f"  cd {folder}",
        "  mocap-calib run keypoints/ --cameras intrinsics.toml -o out",
    )
