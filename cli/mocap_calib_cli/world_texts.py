"""What the texts of options say of the coordinates of results, and of lengths that are known.

Imports the readers: commands import this module when they run, so that --help is quick.
"""

from collections.abc import Sequence
from pathlib import Path

import click

from mocap_calib.config import CueKind, KnownCamera, Landmark, ScaleCue, WorldConfig
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.landmarks_csv import read_landmarks
from mocap_calib.types import ARBITRARY
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.values import NAME_OR_FILE, wrong_form

_FORMS = {
    "--height": "metres above 0, or individual=metres, as 0=1.75+-0.01",
    "--length": "two joints and metres above 0, as left_hip-left_knee=0.42+-0.01",
    "--camera-distance": "two cameras and metres above 0, as cam1-cam2=3.1+-0.02",
}


def world_config(options: SharedOptions) -> WorldConfig:
    """Return the coordinates that are asked for. Raises FormatError and click's UsageError."""
    given = NAME_OR_FILE.is_file(Path(options.axes))
    cues = scale_cues(options)
    landmarks: tuple[Landmark, ...] = ()
    if options.align is not None:
        if options.axes != WorldConfig.axes:
            raise click.UsageError(
                f"--align: expected the world of the landmarks alone, found --world {options.axes} "
                "too; leave one out"
            )
        landmarks = read_landmarks(options.align)
    cameras, unit = read_known_cameras(Path(options.axes)) if given else ((), ARBITRARY)
    return WorldConfig(
        axes=WorldConfig.axes if given else options.axes,
        cues=cues,
        forward=options.forward,
        cameras=cameras,
        unit=unit,
        landmarks=landmarks,
    )


def scale_cues(options: SharedOptions) -> tuple[ScaleCue, ...]:
    """Return the lengths that are known. Raises click's BadParameter."""
    return (
        *_parse_cues(options.height, "--height", "height"),
        *_parse_cues(options.length, "--length", "length"),
        *_parse_cues(options.camera_distance, "--camera-distance", "camera distance"),
    )


def read_known_cameras(path: Path) -> tuple[tuple[KnownCamera, ...], str]:
    """Return where the cameras of a file stand, and the unit of its lengths. Raises FormatError."""
    rig = read_rig(path)
    cameras = tuple(
        KnownCamera(camera.name, tuple(camera.rotation.ravel()), tuple(camera.translation))
        for camera in rig
    )
    return cameras, rig.unit


def _parse_cues(texts: Sequence[str], option: str, kind: CueKind) -> list[ScaleCue]:
    """Return the cue of each `[OF=]METRES[+-SIGMA]`."""
    cues = []
    for text in texts:
        of, equals, value = text.rpartition("=")
        metres, stated, sigma = value.replace("±", "+-").partition("+-")
        try:
            if of.strip() or (kind == "height" and not equals):
                cues.append(
                    ScaleCue(kind, float(metres), float(sigma if stated else 0), of.strip())
                )
                continue
        except ValueError:
            pass
        raise wrong_form(_FORMS[option], text, option)
    return cues
