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
from mocap_calib_cli import names, numbers, values
from mocap_calib_cli.options import AS_JSON, OUTPUT_FILE, argument, option
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command, refused_as_usage

if TYPE_CHECKING:
    from mocap_calib.training.model import Model

_DEFAULT = TrainConfig()


def _check_width(_: click.Context, __: click.Parameter, value: int) -> int:
    """Return the width of a token, which heads share."""
    if value % ENCODER_HEADS:
        raise click.BadParameter(
            f"expected a multiple of {ENCODER_HEADS}: a token is shared by as many heads"
        )
    return value


_WIDTH = numbers.Number(whole=True, min=ENCODER_HEADS)
_SIZES = (
    option("--steps", numbers.COUNT, _DEFAULT),
    option("--batch", numbers.COUNT, _DEFAULT),
    option("--width", _WIDTH, _DEFAULT, callback=_check_width),
    option("--layers", numbers.COUNT, _DEFAULT),
    option("--learning-rate", numbers.POSITIVE, _DEFAULT),
)


@as_command(
    "train",
    argument("poses", values.FILE, "[POSES...]", several=True, required=False),
    OUTPUT_FILE,
    option("--from calibrated", values.FILE, metavar="POSES3D.h5"),
    option("--skeleton", names.SKELETON),
    option("--architecture", ("factorised", "token"), default="factorised"),
    option("--up", click.STRING, multiple=True, metavar="AXIS"),
    option("--procedural", numbers.SHARE, metavar="SHARE"),
    *_SIZES,
    "seed",
    "device",
    "quiet",
    option("--threads", numbers.COUNT, default=1),
    option("--data", click.STRING, default="", metavar="TEXT"),
    option("--terms", click.STRING, default="", metavar="TEXT"),
    AS_JSON,
)
def command(typed: Typed) -> None:
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

    output: Weights to write (.safetensors); the model card is inside.
    calibrated: Poses that a run found, for a model of that species.
    skeleton: Vocabulary: a shipped skeleton or one of your own. [default: people; with --from: its
        own joints]
    architecture: Ours, or the paper's with its rotation token.
    up: What points up in the poses: +z (default), -y, ...; once for all files, or once for each.
    procedural: Share of bodies made from the skeleton's file. [default: half beside POSES, all
        without]
    steps: Batches to train on.
    batch: Poses in a batch.
    width: Size of a token; a multiple of 4.
    layers: Layers of the encoder.
    learning_rate: Peak of the schedule.
    threads: Threads of torch.
    data: For the model card: what the poses are and whom to credit.
    terms: For the model card: the terms of the data.
    as_json: Write the held-out errors to stdout.
    """
    from mocap_calib.training import check_device, torch_threads
    from mocap_calib.training.model import TokenConfig, save_model
    from mocap_calib.training.poses import (
        TrainingSource,
        check_source,
        load_pose_sets,
        load_vocabulary,
    )
    from mocap_calib.training.train import (
        held_out_error,
        measure_steering_error,
        model_card,
        train_lifter,
        train_steerer,
        training_config,
    )
    from mocap_calib_cli.screen import Reporter

    check_device(typed.device)
    source = TrainingSource(
        typed.poses, typed.calibrated, typed.skeleton, typed.up, typed.procedural
    )
    with refused_as_usage():
        check_source(source)
    vocabulary, settings = load_vocabulary(source)
    is_token = typed.architecture == "token"
    sizes = {str(option.name): getattr(typed, str(option.name)) for option in _SIZES}
    asked = {name: value for name, value in sizes.items() if value != getattr(_DEFAULT, name)}
    if is_token:
        asked = {"width": TokenConfig.width, "layers": TokenConfig.layers} | asked
    config = replace(training_config(settings), seed=typed.seed, **asked)
    training, testing = load_pose_sets(source, vocabulary, config)
    with torch_threads(typed.threads), Reporter(quiet=typed.quiet) as reporter:
        known = {"device": typed.device, "progress": reporter}
        if is_token:
            pairs = PairsConfig()
            network: Model = train_steerer(training, vocabulary, config, pairs, **known)
            errors = measure_steering_error(network.cpu(), testing, vocabulary, pairs)
        else:
            network = train_lifter(training, vocabulary, config, **known)
            errors = held_out_error(network.cpu(), testing, vocabulary, config)
    card = model_card(
        config,
        errors,
        command=_typed_command(),
        data=typed.data or source.describe(),
        terms=typed.terms or ("not stated" if source.files else "none: no data"),
    )
    save_model(typed.output, network, vocabulary, card)
    listed = ", ".join(f"{name} {value}" for name, value in errors.items())
    reporter.say(f"held out: {listed}; weights in {typed.output}")
    if typed.as_json:
        echo(json.dumps(errors))


def _typed_command() -> str:
    """Return the command as it was typed, for the model card, with files by their names alone."""
    words = [
        Path(word).name if "/" in word or Path(word).exists() else word for word in sys.argv[1:]
    ]
    return shlex.join(["mocap-calib", *words])
