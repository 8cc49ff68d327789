"""mocap-calib complete: fill the keypoints that were not seen."""

from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="complete")
@options.keypoints
@options.reading
@options.cameras
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="OUT",
    help="Folder to write a keypoint file per camera to.",
)
@click.option(
    "--to", "target", default="coco", metavar="FORMAT", help="Format to write (docs/formats.md)."
)
@options.skeleton
@options.model
@options.device
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    cameras: str,
    output: Path,
    target: str,
    skeleton: Path | None,
    model: str | None,
    device: str,
    quiet: bool,
) -> None:
    """Writes KEYPOINTS with all joints of the model: what was not seen is put where the network, which turns nothing, expects it.

    Bridges skeletons: cameras whose detectors know different joints get the same ones. A joint that was filled in has at most half of
    the detection's confidence. Joints that the model does not know are left out.

    \b
    Example:
      mocap-calib complete keypoints/ --cameras intrinsics.toml -o completed
    """
    import numpy as np

    from mocap_calib.errors import MismatchError
    from mocap_calib.io.keypoints.write import write_keypoints
    from mocap_calib.recording.sampling import take_sample
    from mocap_calib.steerpose.completion import complete_sample
    from mocap_calib.steerpose.lift import lift
    from mocap_calib.types import Keypoints2D
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.model import load_model, vocabulary
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    with Reporter(quiet=quiet) as reporter:
        recording, network = inputs.read_recording(
            keypoints, inputs.cameras_of(cameras), skeleton, reporter, reading, model=model
        )
        if (recording.vocabulary >= 0).sum() < 4:
            raise MismatchError(
                f"expected at least 4 joints that a model knows, found {', '.join(recording.keypoints)}; map them with --skeleton"
            )
        some = take_sample(recording, slice(None))
        positions, confidence = complete_sample(
            some, lift(some, load_model(device, network), device=device, progress=reporter)
        )
        joints = vocabulary(network).keypoints
        views = tuple(
            Keypoints2D(
                camera.name,
                joints,
                some.frames,
                positions[v],
                confidence[v],
                bool(some.tracked[v]),
                camera.size,
                str(output),
            )
            for v, camera in enumerate(some.cameras)
        )
        lost = write_keypoints(output, views, target)
        filled = int(
            np.isfinite(positions[..., 0]).sum() - some.seen[..., recording.vocabulary >= 0].sum()
        )
        reporter.say(
            f"{filled} keypoints filled in; results in {output}",
            *(f"{target} does not hold {what}" for what in lost),
        )
