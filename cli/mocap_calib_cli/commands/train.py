"""mocap-calib train: weights from 3D poses."""

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib.config import ENCODER_HEADS
from mocap_calib.training import PairsConfig, TrainConfig
from mocap_calib_cli import options, values
from mocap_calib_cli.numbers import COUNT, POSITIVE, SHARE, WholeNumber

if TYPE_CHECKING:
    from mocap_calib.training.model import Model
    from mocap_calib.training.poses import PoseSet, TrainingSource
    from mocap_calib.types import Progress, Skeleton

_DEFAULT = TrainConfig()


def _check_width(_: click.Context, __: click.Parameter, value: int) -> int:
    """Return the width of a token, which heads share."""
    if value % ENCODER_HEADS:
        raise click.BadParameter(
            f"expected a multiple of {ENCODER_HEADS}: a token is shared by as many heads"
        )
    return value


@click.command(name="train")
@click.argument("poses", nargs=-1, type=click.Path(path_type=Path), metavar="[POSES...]")
@options.output_file("Weights to write (.safetensors); the model card is inside.")
@click.option(
    "--from",
    "calibrated",
    type=click.Path(path_type=Path),
    metavar="POSES3D.h5",
    help="Poses that a run found, for a model of that species.",
)
@click.option(
    "--skeleton",
    metavar="NAME|FILE.yaml",
    shell_complete=values.offer_skeletons,
    help="Vocabulary: a shipped skeleton or one of your own. "
    "[default: people; with --from: its own joints]",
)
@click.option(
    "--architecture",
    type=click.Choice(["factorised", "token"]),
    default="factorised",
    help="Ours, or the paper's with its rotation token.",
)
@click.option(
    "--up",
    multiple=True,
    metavar="AXIS",
    help="What points up in the poses: +z (default), -y, ...; once for all files, or once for "
    "each.",
)
@click.option(
    "--procedural",
    type=SHARE,
    metavar="SHARE",
    help="Share of bodies made from the skeleton's file. [default: half beside POSES, all without]",
)
@click.option("--steps", type=COUNT, default=_DEFAULT.steps, help="Batches to train on.")
@click.option("--batch", type=COUNT, default=_DEFAULT.batch, help="Poses in a batch.")
@click.option(
    "--width",
    type=WholeNumber(min=ENCODER_HEADS),
    callback=_check_width,
    default=_DEFAULT.width,
    help=f"Size of a token; a multiple of {ENCODER_HEADS}.",
)
@click.option("--layers", type=COUNT, default=_DEFAULT.layers, help="Layers of the encoder.")
@click.option(
    "--learning-rate",
    type=POSITIVE,
    default=_DEFAULT.learning_rate,
    help="Peak of the schedule.",
)
@options.shared_options("seed", "device", "quiet")
@click.option("--threads", type=COUNT, default=1, help="Threads of torch.")
@click.option(
    "--data",
    default="",
    metavar="TEXT",
    help="For the model card: what the poses are and whom to credit.",
)
@click.option(
    "--terms", default="", metavar="TEXT", help="For the model card: the terms of the data."
)
@options.as_json("Write the held-out errors to stdout.")
def command(
    shared: options.SharedOptions,
    output: Path,
    poses: tuple[Path, ...],
    calibrated: Path | None,
    skeleton: str | None,
    up: tuple[str, ...],
    procedural: float | None,
    architecture: str,
    threads: int,
    data: str,
    terms: str,
    as_json: bool,
    **sizes: float,
) -> None:
    """Train a lifter on 3D poses, on bodies made from the skeleton's file, or on both.

    POSES: npz files with `poses` [pose, joint, 3] and `joints`, or folders with poses3d.npz and
    joints.json; they may lack joints. With `split` (train, val, test) and `subject` in a file,
    the error is measured on poses that were held out. --from takes the poses3d.h5 of a run
    instead; cameras.yaml beside it tells what is up, unless --up does. The weights are for
    `run --model`.

    \b
    Example:
      mocap-calib train poses.npz --skeleton people -o people.safetensors --steps 9000
      mocap-calib train --skeleton quadruped -o quadruped.safetensors --steps 4000
      mocap-calib train --from out/poses3d.h5 -o beetle.safetensors --steps 2000
    """
    from mocap_calib.training import check_device, torch_threads
    from mocap_calib.training.model import TokenConfig, save_model
    from mocap_calib.training.poses import TrainingSource, load_pose_sets, load_vocabulary
    from mocap_calib.training.train import model_card, training_config
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_file(output)
    check_device(shared.device)
    source = TrainingSource(poses, calibrated, skeleton, up, procedural)
    _check_source(source)
    vocabulary, settings = load_vocabulary(source)
    asked = {name: value for name, value in sizes.items() if value != getattr(_DEFAULT, name)}
    if architecture == "token":
        asked = {"width": TokenConfig.width, "layers": TokenConfig.layers} | asked
    config = replace(training_config(settings), seed=shared.seed, **asked)  # type: ignore[arg-type]
    training, testing = load_pose_sets(source, vocabulary, config)
    with torch_threads(threads), Reporter(quiet=shared.quiet) as reporter:
        train = _train_steerer if architecture == "token" else _train_lifter
        network, errors = train(
            training, testing, vocabulary, config, device=shared.device, progress=reporter
        )
    card = model_card(
        config,
        errors,
        command=_typed_command(),
        data=data or source.describe(),
        terms=terms or ("not stated" if source.files else "none: no data"),
    )
    save_model(output, network, vocabulary, card)
    listed = ", ".join(f"{name} {value}" for name, value in errors.items())
    reporter.say(f"held out: {listed}; weights in {output}")
    if as_json:
        click.echo(json.dumps(errors))


def _check_source(source: "TrainingSource") -> None:
    """Raise click's UsageError where what was typed does not go together."""
    from mocap_calib.errors import MismatchError, spell_as_option
    from mocap_calib.training.poses import check_source

    try:
        check_source(source)
    except MismatchError as error:
        raise click.UsageError(error.render(spell_as_option)) from None


def _typed_command() -> str:
    """Return the command as it was typed, for the model card, with files by their names alone."""
    words = [
        Path(word).name if "/" in word or Path(word).exists() else word for word in sys.argv[1:]
    ]
    return shlex.join(["mocap-calib", *words])


# --- the two networks


def _train_lifter(
    training: "PoseSet",
    testing: "PoseSet",
    vocabulary: "Skeleton",
    config: TrainConfig,
    *,
    device: str,
    progress: "Progress",
) -> "tuple[Model, dict[str, float]]":
    """Return our network, trained, and its errors on the poses for testing."""
    from mocap_calib.training.train import held_out_error, train_lifter

    lifter = train_lifter(training, vocabulary, config, device=device, progress=progress)
    return lifter, held_out_error(lifter.cpu(), testing, vocabulary, config)


def _train_steerer(
    training: "PoseSet",
    testing: "PoseSet",
    vocabulary: "Skeleton",
    config: TrainConfig,
    *,
    device: str,
    progress: "Progress",
) -> "tuple[Model, dict[str, float]]":
    """Return the network of the paper, trained, and its errors on the poses for testing."""
    from mocap_calib.training.train import measure_steering_error, train_steerer

    pairs = PairsConfig()
    steerer = train_steerer(training, vocabulary, config, pairs, device=device, progress=progress)
    return steerer, measure_steering_error(steerer.cpu(), testing, vocabulary, pairs)
