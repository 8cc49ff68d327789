"""Which recordings a batch has: their folders, and the options that each has for itself.

Imports the readers: commands import this module when they run, so that --help is quick.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from mocap_calib.errors import MismatchError
from mocap_calib.job.steps import CalibrationRequest
from mocap_calib_cli import inputs, option_files, options
from mocap_calib_cli.commands.run import command as run

# options that a recording may have for itself
OF_RECORDINGS = ({"keypoints"} | {*options.CALIBRATION}) - {*options.VERDICT, "scheduler", "quiet"}


def make_requests(
    context: click.Context,
    shared: options.SharedOptions,
    recordings: Iterable[str],
    output: Path,
) -> list[CalibrationRequest]:
    """Return what is asked for of each recording; its results go to a folder of its name.

    Raises FormatError for a file of options that is wrong: before any work is done.
    """
    requests = []
    for name, folder in _name_recordings(recordings).items():
        files = replace(
            shared,
            keypoints=(_find_keypoints(folder),),
            cameras=_find_cameras(folder, shared.cameras),
        )
        own = _read_own_options(folder)
        with option_files.naming_lines(own.entries, context):
            files = _add_own_options(files, own.values, context)
            requests.append(inputs.calibration_request(files, output / name))
    return requests


def _read_own_options(folder: Path) -> option_files.FileValues:
    """Return what the file of options in the folder of a recording says. Raises FormatError."""
    path = folder / option_files.USUAL_NAME
    if not path.is_file():
        return option_files.FileValues({}, {})
    return option_files.read_values(path, click.Context(run))


def _add_own_options(
    shared: options.SharedOptions, own: dict[str, Any], context: click.Context
) -> options.SharedOptions:
    """Return the options of a recording: its own, but for those that were typed.

    What concerns the whole batch stays as it is: where results go, what is said, who works, which
    verdicts will do.
    """
    holds = {
        name: value
        for name, value in own.items()
        if name in OF_RECORDINGS and not option_files.is_typed(name, context)
    }
    return replace(shared, **holds)


def _name_recordings(recordings: Iterable[str]) -> dict[str, Path]:
    """Return the folder of each recording, by the name that its results will have."""
    found: dict[str, Path] = {}
    for path in map(Path, recordings):
        name = path.resolve().name
        if name in found:
            raise MismatchError(
                "",
                "recordings of different names",
                f"{found[name]} and {path}",
                "rename one, or call batch for each",
            )
        found[name] = path
    return found


def _find_keypoints(folder: Path) -> str:
    """Return the folder with the keypoint files of a recording."""
    inner = folder / "keypoints"
    return str(inner if inner.is_dir() else folder)


def _find_cameras(folder: Path, cameras: str) -> str:
    """Return the cameras in the folder of a recording, else those for all; none where none are."""
    within = folder / cameras
    return str(within) if cameras and within.exists() else cameras
