"""mocap-calib simulate: a synthetic recording with truth."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib.synthetic.config import ANIMAL_MOTION, SimulateConfig
from mocap_calib_cli import options
from mocap_calib_cli.numbers import COUNT, NOT_NEGATIVE, POSITIVE, SEED, SHARE, Number

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_DEFAULT = SimulateConfig()
_FLAGS = {"noise_px": "--noise", "arc_deg": "--arc"}  # where the field is not called as the option
_KINDS = ("people", *ANIMAL_MOTION)
_SAID_APART = ("people", "animals", "size", "shuffle", "seed")


class _Kind(click.ParamType[tuple[str, int]]):
    """A kind of body and a number of them, `quadruped:2`."""

    name = "kind"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int]:
        """Return the kind and the number. Raises click's BadParameter."""
        kind, colon, number = value.partition(":")
        if kind not in _KINDS:
            found = kind or "nothing"
            self.fail(f"expected one of {', '.join(_KINDS)}, found {found}", param, ctx)
        if colon and not number:
            self.fail(f"expected a number after the colon, as {kind}:2, found none", param, ctx)
        return kind, COUNT.convert(number, param, ctx) if colon else 1

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> "list[CompletionItem]":
        """Return the kinds that begin as what was typed."""
        from click.shell_completion import CompletionItem

        return [CompletionItem(kind) for kind in _KINDS if kind.startswith(incomplete)]


@click.command(
    name="simulate",
    context_settings={"show_default": True},
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="OUT",
    help="Folder to write; made when missing.",
)
@click.option(
    "--cameras", type=COUNT, default=_DEFAULT.cameras, help="Number of cameras around the room."
)
@click.option(
    "--people",
    type=COUNT,
    help="Number of people who walk about and gesture.  [default: 3; with --kind: none]",
)
@click.option(
    "--kind",
    "kinds",
    type=_Kind(),
    multiple=True,
    metavar="KIND[:N]",
    help="Who goes about, and how many: people, quadruped (a dog), rodent (a rat) or bird (a "
    "pigeon); may be repeated.",
)
@click.option("--frames", type=COUNT, default=_DEFAULT.frames, help="Length of the recording.")
@click.option("--fps", type=POSITIVE, default=_DEFAULT.fps, help="Frames a second.")
@click.option(
    "--noise",
    "noise_px",
    type=NOT_NEGATIVE,
    default=_DEFAULT.noise_px,
    metavar="PIXELS",
    help="RMS error of a coordinate.",
)
@click.option(
    "--missing", type=SHARE, default=_DEFAULT.missing, help="Share of joints that are not found."
)
@click.option(
    "--outliers",
    type=SHARE,
    default=_DEFAULT.outliers,
    help="Share of joints that are found somewhere else.",
)
@click.option(
    "--false-detections",
    type=SHARE,
    default=_DEFAULT.false_detections,
    help="Share of images with a detection of nobody.",
)
@click.option(
    "--distortion",
    type=click.Choice(["none", "brown", "fisheye"]),
    default=_DEFAULT.distortion,
    help="Distortion of the lenses.",
)
@click.option(
    "--layout",
    type=click.Choice(["coco17", "all"]),
    default=_DEFAULT.layout,
    help="Joints of people that the detector finds; of animals it finds all.",
)
@click.option(
    "--radius",
    type=POSITIVE,
    metavar="METRES",
    help="From the middle to the cameras.  [default: 4.5; less for animals alone]",
)
@click.option(
    "--arc",
    "arc_deg",
    type=Number(min=0, max=360),
    default=_DEFAULT.arc_deg,
    metavar="DEGREES",
    help="Over which cameras are spread.",
)
@click.option(
    "--shuffle/--no-shuffle",
    default=_DEFAULT.shuffle,
    help="Put the detections of each image in random order.",
)
@click.option(
    "--seed",
    type=SEED,
    default=_DEFAULT.seed,
    help="The same seed gives the same bytes.",
)
@options.shared_options("quiet")
def command(
    shared: options.SharedOptions,
    output: Path,
    people: int | None,
    kinds: tuple[tuple[str, int], ...],
    **fields: Any,
) -> None:
    """Make a recording of synthetic people or animals with its truth.

    These are keypoints (COCO), cameras, who is who, and the true 3D poses.

    \b
    Example:
      mocap-calib simulate -o scene --cameras 6 --people 2 --distortion brown
      mocap-calib simulate -o scene --kind rodent:2
      mocap-calib simulate -o scene --kind people:2 --kind quadruped
    """
    from mocap_calib.errors import count
    from mocap_calib.io.results.scene import describe_kinds, write_scene
    from mocap_calib.synthetic import simulate
    from mocap_calib_cli.progress import Reporter

    config = SimulateConfig(**fields, **_count_kinds(people, kinds))
    scene = simulate(config)
    write_scene(output, scene, format_command(config))
    detections = int((scene.identity >= 0).sum())
    reporter = Reporter(quiet=shared.quiet)
    reporter.say(
        f"{output}: {count(config.cameras, 'camera')}, {count(config.frames, 'frame')}, "
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
    numbers: dict[str, int] = {}
    for kind, number in kinds:
        numbers[kind] = numbers.get(kind, 0) + number
    default = 0 if kinds else _DEFAULT.people
    found = numbers.pop("people", default) if people is None else people
    return {"people": found, "animals": tuple(numbers.items())}


def format_command(config: SimulateConfig) -> str:
    """Return the command that makes the same scene, without options that have their defaults."""
    words = ["mocap-calib simulate -o OUT"]
    for name, value in vars(config).items():
        if name in _SAID_APART or value == getattr(_DEFAULT, name):
            continue
        words.append(f"{_FLAGS.get(name, '--' + name.replace('_', '-'))} {value}")
    if config.people and (config.animals or config.people != _DEFAULT.people):
        words.append(f"--people {config.people}")
    words += [f"--kind {kind}:{number}" for kind, number in config.animals]
    if not config.shuffle:
        words.append("--no-shuffle")
    words.append(f"--seed {config.seed}")
    return " ".join(words)
