"""mocap-calib train: weights from 3D poses."""

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib.config import PairsConfig, TrainConfig
from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.steerpose.steer import Model
    from mocap_calib.steerpose.training.poses import PoseSet, Split
    from mocap_calib.types import Skeleton

_DEFAULT = TrainConfig()
_COUNT = click.IntRange(min=1)


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
    help="Vocabulary: a shipped skeleton or one of your own. [default: people; with --from: its own joints]",
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
    help="What points up in the poses: +z (default), -y, ...; once for all files, or once for each.",
)
@click.option(
    "--procedural",
    type=click.FloatRange(0, 1),
    metavar="SHARE",
    help="Of bodies made from the skeleton's file; half beside data, all without.",
)
@click.option("--steps", type=_COUNT, default=_DEFAULT.steps, help="Batches to train on.")
@click.option("--batch", type=_COUNT, default=_DEFAULT.batch, help="Poses in a batch.")
@click.option(
    "--width",
    type=click.IntRange(min=4),
    default=_DEFAULT.width,
    help="Size of a token; a multiple of 4.",
)
@click.option("--layers", type=_COUNT, default=_DEFAULT.layers, help="Layers of the encoder.")
@click.option(
    "--learning-rate",
    type=click.FloatRange(min=0, min_open=True),
    default=_DEFAULT.learning_rate,
    help="Peak of the schedule.",
)
@options.seed
@options.device
@click.option("--threads", type=_COUNT, default=1, help="Threads of torch.")
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
@options.quiet
def command(
    poses: tuple[Path, ...],
    output: Path,
    calibrated: Path | None,
    skeleton: str | None,
    architecture: str,
    up: tuple[str, ...],
    procedural: float | None,
    seed: int,
    device: str,
    threads: int,
    data: str,
    terms: str,
    as_json: bool,
    quiet: bool,
    **fields: float,
) -> None:
    """Trains a lifter on 3D poses, on bodies made from the skeleton's file, or on both.

    POSES: npz files with `poses` [pose, joint, 3] and `joints`, or folders with poses3d.npz and joints.json; they may lack joints.
    With `split` (train, val, test) and `subject` in a file, the error is measured on poses that were held out.
    --from takes the poses3d.h5 of a run instead, whose cameras.yaml beside it tells what is up unless --up does; the weights are
    for `run --model`.

    \b
    Example:
      mocap-calib train poses.npz --skeleton people -o people.safetensors --steps 9000
      mocap-calib train --skeleton quadruped -o quadruped.safetensors --steps 4000
      mocap-calib train --from out/poses3d.h5 -o beetle.safetensors --steps 2000
    """
    from mocap_calib.steerpose.checkpoint import save_lifter
    from mocap_calib.steerpose.training.evaluation import held_out_error, steering_error
    from mocap_calib.steerpose.training.train import (
        model_card,
        train_lifter,
        train_steerer,
        training_config,
    )
    from mocap_calib_cli import outputs
    from mocap_calib_cli.model import check_device, use_threads
    from mocap_calib_cli.progress import Reporter

    if fields["width"] % 4:
        raise click.BadParameter(
            "expected a multiple of 4: a token is shared by four heads", param_hint="--width"
        )
    outputs.check_file(output)
    check_device(device)
    use_threads(threads)
    chosen = {name: value for name, value in fields.items() if value != getattr(_DEFAULT, name)}
    vocabulary, settings = _vocabulary(calibrated, skeleton)
    config = replace(training_config(settings), seed=seed, **chosen)  # type: ignore[arg-type]
    if calibrated:
        if poses or procedural:
            raise click.UsageError("expected POSES or --procedural, or --from, found both")
        training, testing = (
            _own_poses(calibrated, vocabulary, up, split) for split in ("train", "test")
        )
    else:
        training, testing = (
            _pose_set(poses, up, skeleton or "people", procedural, split, config)
            for split in ("train", "test")
        )
    lifter: Model
    with Reporter(quiet=quiet) as reporter:
        if architecture == "token":
            # the paper's size, unless another is asked for
            config = replace(
                config, width=int(chosen.get("width", 32)), layers=int(chosen.get("layers", 5))
            )
            lifter = train_steerer(
                training, vocabulary, config, PairsConfig(), device=device, progress=reporter
            )
            errors = steering_error(lifter.cpu(), testing, vocabulary, PairsConfig())
        else:
            lifter = train_lifter(training, vocabulary, config, device=device, progress=reporter)
            errors = held_out_error(lifter.cpu(), testing, vocabulary, config)
    typed = shlex.join(
        [
            "mocap-calib",
            *(
                Path(word).name if "/" in word or Path(word).exists() else word
                for word in sys.argv[1:]
            ),
        ]
    )
    save_lifter(
        output,
        lifter,
        vocabulary,
        model_card(
            config,
            errors,
            command=typed,
            data=data
            or ", ".join(p.name for p in (*poses, *([calibrated] if calibrated else [])))
            or "procedural bodies",
            terms=terms or ("not stated" if poses or calibrated else "none: no data"),
        ),
    )
    reporter.say(
        f"held out: {', '.join(f'{name} {value}' for name, value in errors.items())}; weights in {output}"
    )
    if as_json:
        click.echo(json.dumps(errors))


def _vocabulary(calibrated: Path | None, skeleton: str | None) -> tuple["Skeleton", dict[str, Any]]:
    """The joints to train for, and settings that differ from the defaults. Raises FormatError."""
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.recording.joints import load_section, load_skeleton
    from mocap_calib.steerpose.training.own_species import TRAINING, own_skeleton

    if calibrated and skeleton is None:
        return own_skeleton(calibrated.stem, read_poses(calibrated, "poses-h5").poses), TRAINING
    return load_skeleton(skeleton or "people"), load_section(skeleton or "people", "training")


def _own_poses(
    calibrated: Path, vocabulary: "Skeleton", up: tuple[str, ...], split: "Split"
) -> "PoseSet":
    """The poses of a calibrated recording. Raises FormatError and DegenerateError; a usage error where nothing tells what is up."""
    from mocap_calib.io.cameras.read import read_rig
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.steerpose.training.own_species import own_poses, up_direction, up_of_rig

    rig = calibrated.with_name("cameras.yaml")
    if not up and not rig.is_file():
        raise click.UsageError(f"expected {rig} beside the poses, or --up, found neither")
    return own_poses(
        read_poses(calibrated, "poses-h5").poses,
        vocabulary,
        up_direction(up[0]) if up else up_of_rig(read_rig(rig)),
        split,
    )


def _pose_set(
    poses: tuple[Path, ...],
    up: tuple[str, ...],
    skeleton: str,
    procedural: float | None,
    split: "Split",
    config: TrainConfig,
) -> "PoseSet":
    """What to train or test on. Raises FormatError and MismatchError; a usage error where there is nothing."""
    from mocap_calib.recording.joints import load_section, load_skeleton
    from mocap_calib.steerpose.training.poses import (
        load_poses,
        mix,
        procedural_poses,
        shares_by_size,
    )

    if len(up) not in (0, 1, len(poses)):
        raise click.UsageError(
            f"--up: expected it once, or once for each of {len(poses)} files, found it {len(up)} times"
        )
    vocabulary, body = load_skeleton(skeleton), load_section(skeleton, "body")
    axes = up if len(up) == len(poses) else (up or ("+z",)) * len(poses)
    sets = [
        load_poses(path, vocabulary, split, up=axis) for path, axis in zip(poses, axes, strict=True)
    ]
    share = procedural if procedural is not None else (0.5 if sets else 1.0) * bool(body)
    if (share and not body) or not (sets or share):
        raise click.UsageError(
            f"expected POSES, or a skeleton with a section `body` to make some from, found neither in {skeleton}; see docs/skeletons.md"
        )
    if not share:
        return sets[0] if len(sets) == 1 else mix(sets, shares_by_size(sets))
    made = procedural_poses(vocabulary, body, config.bodies, seed=config.seed + (split == "test"))
    sizes = shares_by_size(sets)
    return (
        mix([*sets, made], [*(size / sum(sizes) * (1 - share) for size in sizes), share])
        if sets
        else mix([made], [1.0])
    )
