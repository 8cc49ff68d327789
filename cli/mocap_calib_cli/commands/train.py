"""mocap-calib train: weights from 3D poses."""

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import click

from mocap_calib.config import TrainConfig
from mocap_calib_cli import options

_DEFAULT = TrainConfig()
_COUNT = click.IntRange(min=1)


@click.command(name="train")
@click.argument("poses", type=click.Path(path_type=Path), metavar="POSES.npz")
@options.output_file("Weights to write (.safetensors); the model card is inside.")
@click.option("--skeleton", default="people", metavar="NAME|FILE.yaml", help="Vocabulary: a shipped skeleton or one of your own.")
@click.option("--steps", type=_COUNT, default=_DEFAULT.steps, help="Batches to train on.")
@click.option("--batch", type=_COUNT, default=_DEFAULT.batch, help="Poses in a batch.")
@click.option("--width", type=click.IntRange(min=4), default=_DEFAULT.width, help="Size of a token; a multiple of 4.")
@click.option("--layers", type=_COUNT, default=_DEFAULT.layers, help="Layers of the encoder.")
@click.option("--learning-rate", type=click.FloatRange(min=0, min_open=True), default=_DEFAULT.learning_rate, help="Peak of the schedule.")
@options.seed
@options.device
@click.option("--threads", type=_COUNT, default=1, help="Threads of torch.")
@click.option("--data", default="", metavar="TEXT", help="For the model card: what the poses are and whom to credit.")
@click.option("--terms", default="", metavar="TEXT", help="For the model card: the terms of the data.")
@options.as_json("Write the held-out errors to stdout.")
@options.quiet
def command(
    poses: Path, output: Path, skeleton: str, seed: int, device: str, threads: int, data: str, terms: str, as_json: bool, quiet: bool, **fields: float
) -> None:
    """Trains a lifter on the 3D poses of an npz file: `poses` [pose, joint, 3] with z up, `joints` names.

    With `split` (train, val, test) and `subject` in the file, the error is measured on poses that were held out.

    \b
    Example:
      mocap-calib train poses.npz --skeleton people -o people.safetensors --steps 9000
    """
    from mocap_calib.skeleton import load_skeleton
    from mocap_calib.steerpose.checkpoint import save_lifter
    from mocap_calib.steerpose.dataset import load_poses
    from mocap_calib.steerpose.train import held_out_error, model_card, train_lifter
    from mocap_calib_cli import outputs
    from mocap_calib_cli.model import check_device, use_threads
    from mocap_calib_cli.progress import Reporter

    outputs.check_file(output)
    check_device(device)
    use_threads(threads)
    vocabulary = load_skeleton(skeleton)
    config = replace(_DEFAULT, seed=seed, **fields)  # type: ignore[arg-type]
    with Reporter(quiet=quiet) as reporter:
        lifter = train_lifter(load_poses(poses, vocabulary, "train"), vocabulary, config, device=device, progress=reporter)
    errors = held_out_error(lifter.cpu(), load_poses(poses, vocabulary, "test"), vocabulary, config)
    typed = shlex.join(["mocap-calib", *(Path(word).name if Path(word).exists() else word for word in sys.argv[1:])])
    save_lifter(output, lifter, vocabulary, model_card(config, errors, command=typed, data=data or poses.name, terms=terms or "not stated"))
    reporter.say(f"held out: {', '.join(f'{name} {value}' for name, value in errors.items())}; weights in {output}")
    if as_json:
        click.echo(json.dumps(errors))
