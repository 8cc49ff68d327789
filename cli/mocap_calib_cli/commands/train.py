"""mocap-calib train: weights from 3D poses."""

import json
import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib.config import PairsConfig, TrainConfig
from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.steerpose.steer import Model
    from mocap_calib.steerpose.training.poses import PoseSet, Split
    from mocap_calib.types import Progress, Skeleton

_DEFAULT = TrainConfig()
_COUNT = click.IntRange(min=1)
_HEADS = 4  # of the encoder, which share a token
_TOKEN_SIZE = {"width": 32, "layers": 5}  # of the paper's network


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
    type=click.FloatRange(0, 1),
    metavar="SHARE",
    help="Share of bodies made from the skeleton's file. [default: half beside POSES, all without]",
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
@options.shared_options("seed", "device", "quiet")
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
    from mocap_calib.steerpose.checkpoint import save_lifter
    from mocap_calib.steerpose.device import check_device, use_threads
    from mocap_calib.steerpose.training.train import model_card, training_config
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter

    if sizes["width"] % _HEADS:
        raise click.BadParameter(
            "expected a multiple of 4: a token is shared by four heads", param_hint="--width"
        )
    outputs.check_file(output)
    check_device(shared.device)
    use_threads(threads)
    source = _Source(poses, calibrated, skeleton, up, procedural)
    vocabulary, settings = _load_vocabulary(source)
    asked = {name: value for name, value in sizes.items() if value != getattr(_DEFAULT, name)}
    if architecture == "token":
        asked = _TOKEN_SIZE | asked
    config = replace(training_config(settings), seed=shared.seed, **asked)  # type: ignore[arg-type]
    training, testing = _load_poses(source, vocabulary, config)
    with Reporter(quiet=shared.quiet) as reporter:
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
    save_lifter(output, network, vocabulary, card)
    listed = ", ".join(f"{name} {value}" for name, value in errors.items())
    reporter.say(f"held out: {listed}; weights in {output}")
    if as_json:
        click.echo(json.dumps(errors))


@dataclass(frozen=True)
class _Source:
    """What to train on, as it was typed."""

    poses: tuple[Path, ...]
    calibrated: Path | None
    skeleton: str | None
    up: tuple[str, ...]
    procedural: float | None

    @property
    def files(self) -> tuple[Path, ...]:
        """The files with poses."""
        return self.poses if self.calibrated is None else (*self.poses, self.calibrated)

    @property
    def skeleton_name(self) -> str:
        """The vocabulary, where the poses of a run do not bring their own."""
        return self.skeleton or "people"

    def describe(self) -> str:
        """Return what a model card says of the data where nobody says more."""
        return ", ".join(path.name for path in self.files) or "procedural bodies"


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
    from mocap_calib.steerpose.training.train import held_out_error, train_lifter

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
    from mocap_calib.steerpose.training.train import steering_error, train_steerer

    pairs = PairsConfig()
    steerer = train_steerer(training, vocabulary, config, pairs, device=device, progress=progress)
    return steerer, steering_error(steerer.cpu(), testing, vocabulary, pairs)


# --- what they are trained on


def _load_vocabulary(source: _Source) -> tuple["Skeleton", dict[str, Any]]:
    """Return the joints to train for, and settings other than the defaults. Raises FormatError."""
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.recording.joints import load_section, load_skeleton
    from mocap_calib.steerpose.training.own_species import TRAINING, own_skeleton

    if source.calibrated is not None and source.skeleton is None:
        poses = read_poses(source.calibrated, "poses-h5").poses
        return own_skeleton(source.calibrated.stem, poses), TRAINING
    name = source.skeleton_name
    return load_skeleton(name), load_section(name, "training")


def _load_poses(
    source: _Source, vocabulary: "Skeleton", config: TrainConfig
) -> "tuple[PoseSet, PoseSet]":
    """Return the poses to train and to test on.

    Raises FormatError, MismatchError, DegenerateError, and click's UsageError where what was
    typed does not go together.
    """
    if source.calibrated is None:
        return _pose_set(source, "train", config), _pose_set(source, "test", config)
    if source.poses or source.procedural:
        raise click.UsageError("expected POSES or --procedural, or --from, found both")
    splits: tuple[Split, Split] = ("train", "test")
    training, testing = (
        _poses_of_run(source.calibrated, vocabulary, source.up, split) for split in splits
    )
    return training, testing


def _poses_of_run(
    calibrated: Path, vocabulary: "Skeleton", up: tuple[str, ...], split: "Split"
) -> "PoseSet":
    """Return the poses that a run found; nothing may tell what is up but --up or its cameras."""
    from mocap_calib.io.cameras.read import read_rig
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.steerpose.training.own_species import axis, own_poses, up_of_rig

    rig_file = calibrated.with_name("cameras.yaml")
    if not up and not rig_file.is_file():
        raise click.UsageError(f"expected {rig_file} beside the poses, or --up, found neither")
    direction = axis(up[0]) if up else up_of_rig(read_rig(rig_file))
    return own_poses(read_poses(calibrated, "poses-h5").poses, vocabulary, direction, split)


def _pose_set(source: _Source, split: "Split", config: TrainConfig) -> "PoseSet":
    """Return the poses of the files, and bodies made from the skeleton's file, mixed."""
    from mocap_calib.recording.joints import load_section, load_skeleton
    from mocap_calib.steerpose.training.poses import by_size, load_poses, mix, procedural_poses

    name = source.skeleton_name
    vocabulary = load_skeleton(name)
    body = load_section(name, "body")
    sets = [
        load_poses(path, vocabulary, split, up=axis)
        for path, axis in zip(source.poses, _up_axes(source), strict=True)
    ]
    share = _procedural_share(source, has_body=bool(body))
    if not share:
        return sets[0] if len(sets) == 1 else mix(sets, by_size(sets))
    made = procedural_poses(vocabulary, body, config.bodies, seed=config.seed + (split == "test"))
    if not sets:
        return mix([made], [1.0])
    sizes = by_size(sets)
    total = sum(sizes)
    return mix([*sets, made], [*(size / total * (1 - share) for size in sizes), share])


def _up_axes(source: _Source) -> tuple[str, ...]:
    """Return what points up in each file. Raises click's UsageError."""
    files = len(source.poses)
    if len(source.up) not in (0, 1, files):
        raise click.UsageError(
            f"--up: expected it once, or once for each of {files} files, "
            f"found it {len(source.up)} times"
        )
    return source.up if len(source.up) == files else (source.up or ("+z",)) * files


def _procedural_share(source: _Source, *, has_body: bool) -> float:
    """Return the share of bodies that are made. Raises click's UsageError where there is nothing.

    has_body: the skeleton's file says how its bodies are made.
    """
    share = source.procedural
    if share is None:
        share = (0.5 if source.poses else 1.0) * has_body
    if (share and not has_body) or not (source.poses or share):
        raise click.UsageError(
            "expected POSES, or a skeleton with a section `body` to make some from, "
            f"found neither in {source.skeleton_name}; see docs/skeletons.md"
        )
    return share
