"""mocap-calib simulate: a synthetic recording with truth."""

from collections import Counter
from dataclasses import replace
from typing import Any

import click

from mocap_calib.synthetic.config import ANIMAL_MOTION, SimulateConfig
from mocap_calib_cli import numbers, values
from mocap_calib_cli.options import OUTPUT_FOLDER, option
from mocap_calib_cli.typed import Typed, as_command

_DEFAULT = SimulateConfig()
_FLAGS = {"noise_px": "--noise", "arc_deg": "--arc"}  # where the field is not called as the option
_KINDS = ("people", *ANIMAL_MOTION)
_SAID_APART = ("people", "animals", "size", "shuffle", "seed")


def _read_kind(text: str) -> tuple[str, int]:
    """Return the kind of `quadruped:2`, and the number. Raises click's BadParameter."""
    kind, colon, number = text.partition(":")
    if kind not in _KINDS:
        raise click.BadParameter(f"expected one of {', '.join(_KINDS)}, found {kind or 'nothing'}")
    if colon and not number:
        raise click.BadParameter(f"expected a number after the colon, as {kind}:2, found none")
    return kind, numbers.COUNT.convert(number, None, None) if colon else 1


_KIND = values.Written("KIND[:N]", read=_read_kind, offers=lambda: dict.fromkeys(_KINDS, ""))


@as_command(
    "simulate",
    OUTPUT_FOLDER,
    option("--cameras", numbers.COUNT, _DEFAULT),
    option("--people", numbers.COUNT),
    option("--kind", _KIND, multiple=True),
    option("--frames", numbers.COUNT, _DEFAULT),
    option("--fps", numbers.POSITIVE, _DEFAULT),
    option("--noise noise_px", numbers.NOT_NEGATIVE, _DEFAULT, metavar="PIXELS"),
    option("--missing", numbers.SHARE, _DEFAULT),
    option("--outliers", numbers.SHARE, _DEFAULT),
    option("--false-detections", numbers.SHARE, _DEFAULT),
    option("--distortion", ("none", "brown", "fisheye"), _DEFAULT),
    option("--layout", ("coco17", "all"), _DEFAULT),
    option("--radius", numbers.POSITIVE, _DEFAULT, metavar="METRES"),
    option("--arc arc_deg", numbers.Number(min=0, max=360), _DEFAULT, metavar="DEGREES"),
    option("--shuffle/--no-shuffle", default=_DEFAULT.shuffle),
    option("--seed", numbers.SEED, _DEFAULT),
    "quiet",
)
def command(typed: Typed) -> None:
    """Make a recording of synthetic people or animals with its truth.

    These are keypoints (COCO), cameras, identities, and the true 3D poses.

    \b
    Example:
      mocap-calib simulate -o scene --cameras 6 --people 2 --distortion brown
      mocap-calib simulate -o scene --kind rodent:2
      mocap-calib simulate -o scene --kind people:2 --kind quadruped

    cameras: Number of cameras around the room.
    people: Number of people who walk about and gesture. [default: 3; with --kind: none]
    kind: Who goes about, and how many: people, quadruped (a dog), rodent (a rat) or bird (a
        pigeon); may be repeated.
    frames: Length of the recording.
    fps: Frames a second.
    noise_px: RMS error of a coordinate.
    missing: Share of joints that are not found.
    outliers: Share of joints that are found somewhere else.
    false_detections: Share of images with a detection of nobody.
    distortion: Distortion of the lenses.
    layout: Joints of people that the detector finds; of animals it finds all.
    radius: From the middle to the cameras. [default: 4.5; less for animals alone]
    arc_deg: Over which cameras are spread.
    shuffle: Put the detections of each image in random order.
    seed: The same seed gives the same bytes.
    """
    from mocap_calib.errors import count
    from mocap_calib.synthetic.scene import simulate
    from mocap_calib.synthetic.scene_files import describe_kinds, write_scene
    from mocap_calib_cli.screen import Reporter

    bodies = _count_kinds(typed.people, typed.kind)
    fields = {name: value for name, value in vars(typed).items() if hasattr(_DEFAULT, name)}
    config = replace(_DEFAULT, **(fields | bodies))
    scene = simulate(config)
    write_scene(typed.output, scene, format_command(config))
    detections = int((scene.identity >= 0).sum())
    reporter = Reporter(quiet=typed.quiet)
    reporter.say(
        f"{typed.output}: {count(config.cameras, 'camera')}, {count(config.frames, 'frame')}, "
        f"{describe_kinds(scene.kinds)}, {count(detections, 'detection')} of them"
    )
    if len(set(scene.kinds)) > 1:
        reporter.say(
            "a run lifts all bodies by one model: choose that of most of them, "
            f"mocap-calib run --model {Counter(scene.kinds).most_common(1)[0][0]}"
        )


def _count_kinds(people: int | None, kinds: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """Return the fields `people` and `animals` of the scene. Raises click's UsageError."""
    if people is not None and "people" in dict(kinds):
        raise click.UsageError("expected --people or --kind people, found both; leave one out")
    numbers = Counter[str]()
    for kind, number in kinds:
        numbers[kind] += number
    default = 0 if kinds else _DEFAULT.people
    found = numbers.pop("people", default) if people is None else people
    return {"people": found, "animals": tuple(numbers.items())}


def format_command(config: SimulateConfig) -> str:
    """Return the command that makes the same scene, without options that have their defaults."""
    words = [
        f"{_FLAGS.get(name, '--' + name.replace('_', '-'))} {value}"
        for name, value in vars(config).items()
        if name not in _SAID_APART and value != getattr(_DEFAULT, name)
    ]
    if config.people and (config.animals or config.people != _DEFAULT.people):
        words.append(f"--people {config.people}")
    words += [f"--kind {kind}:{number}" for kind, number in config.animals]
    if not config.shuffle:
        words.append("--no-shuffle")
    return " ".join(["mocap-calib simulate -o OUT", *words, f"--seed {config.seed}"])
