"""mocap-calib example: recordings to begin with."""

from pathlib import Path

import click

from mocap_calib.synthetic.config import EXAMPLES
from mocap_calib_cli import values
from mocap_calib_cli.typed import Typed, as_command

_ABOUT = {
    "people": "two people who walk about and gesture, four cameras",
    "dog": "a dog that walks and trots, four cameras",
    "mouse": "a rodent in an arena, four cameras",
}


def _known(name: str) -> str:
    """Return the name of an example. Raises ValueError."""
    if name not in EXAMPLES:
        raise ValueError(name)
    return name


_NAME = values.Written("[NAME]", f"one of {', '.join(EXAMPLES)}", _known, offers=lambda: _ABOUT)


@as_command(
    "example",
    click.Argument(["name"], required=False, type=_NAME),
    click.Option(
        ["-o", "--output"],
        type=values.FOLDER,
        metavar="DIR",
        help="Folder to write; made when missing.  [default: NAME]",
    ),
    "quiet",
)
def command(typed: Typed) -> None:
    """Lay out an example recording; without NAME, list those that there are.

    These are simulated recordings with keypoints, intrinsics, the true cameras, and a README with
    three commands to run. They are made on the spot, the same bytes every time. `simulate` makes
    others.

    \b
    Example:
      mocap-calib example
      mocap-calib example dog -o dog
    """
    if typed.name is None:
        for known, about in _ABOUT.items():
            click.echo(f"{known:8}{about}")
        return
    from mocap_calib.synthetic.scene import simulate
    from mocap_calib.synthetic.scene_files import check_own_files, scene_files, write_scene
    from mocap_calib_cli.commands.simulate import format_command
    from mocap_calib_cli.screen import Reporter

    config = EXAMPLES[typed.name]
    folder = typed.output or Path(typed.name)
    scene, made_by = simulate(config), format_command(config)
    check_own_files(folder, scene_files(scene, made_by))
    write_scene(folder, scene, made_by)
    Reporter(quiet=typed.quiet).say(
        f"{folder}: {_ABOUT[typed.name]}, {config.frames} frames",
        f"{folder / 'README.md'} has three commands to run there, the first to begin with:",
        f"  cd {folder}",
        "  mocap-calib run keypoints/ --cameras intrinsics.toml -o out",
    )
