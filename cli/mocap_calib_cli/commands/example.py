"""mocap-calib example: recordings to begin with."""

from pathlib import Path

from mocap_calib.synthetic.config import EXAMPLES
from mocap_calib_cli import values
from mocap_calib_cli.options import Word, argument, option
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command

_ABOUT = {
    "people": "two people who walk about and gesture, four cameras",
    "dog": "a dog that walks and trots, four cameras",
    "mouse": "a rodent in an arena, four cameras",
}


@as_command(
    "example",
    argument("name", Word(tuple(EXAMPLES)), "[NAME]", required=False),
    option("-o --output", values.OUTPUT_FOLDER, metavar="DIR"),
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

    output: Folder to write; made when missing. [default: NAME]
    """
    if typed.name is None:
        for known, about in _ABOUT.items():
            echo(f"{known:8}{about}")
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
