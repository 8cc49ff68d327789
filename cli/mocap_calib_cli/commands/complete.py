"""mocap-calib complete: fill the keypoints that were not seen."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.types import Floats, Keypoints2D, Recording, Sample


@click.command(name="complete")
@options.output_folder("Folder to write a keypoint file per camera to.")
@click.option(
    "--to", "target", default="coco", metavar="FORMAT", help="Format to write (docs/formats.md)."
)
@options.shared_options("cameras", *options.MODEL, *options.KEYPOINTS, "quiet")
def command(shared: options.SharedOptions, output: Path, target: str) -> None:
    """Write KEYPOINTS with all joints of the model.

    A joint that was not seen is put where the network expects it in that view; it has at most
    half of the detection's confidence. Cameras whose detectors know different joints get the same
    ones. Joints that the model does not know are left out.

    \b
    Example:
      mocap-calib complete keypoints/ --cameras intrinsics.toml -o completed
    """
    import numpy as np

    from mocap_calib.io.keypoints.write import write_keypoints
    from mocap_calib.recording.sampling import take_sample
    from mocap_calib.steerpose.checkpoint import load_vocabulary
    from mocap_calib.steerpose.completion import complete_sample
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    with Reporter(quiet=shared.quiet) as reporter:
        camera_file = inputs.load_camera_file(shared.cameras, "--cameras")
        loaded = inputs.read_recording(shared, camera_file, reporter)
        _check_joints(loaded.recording)
        sample = take_sample(loaded.recording, slice(None))
        lifted = inputs.lift_with_model(sample, loaded.model, shared.device, reporter)
        positions, confidence = complete_sample(sample, lifted)
        joints = load_vocabulary(loaded.model).keypoints
        views = _make_views(sample, joints, positions, confidence, str(output))
        lost = write_keypoints(output, views, target)
    seen = int(sample.seen[..., sample.vocabulary >= 0].sum())
    filled = int(np.isfinite(positions[..., 0]).sum()) - seen
    reporter.say(
        f"{filled} keypoints filled in; results in {output}",
        *(f"{target} does not hold {what}" for what in lost),
    )


def _check_joints(recording: "Recording") -> None:
    """Raise MismatchError where the model knows too few joints to lift a body."""
    from mocap_calib.config import LEAST_JOINTS
    from mocap_calib.errors import MismatchError

    if (recording.vocabulary >= 0).sum() < LEAST_JOINTS:
        raise MismatchError(
            f"expected at least {LEAST_JOINTS} joints that a model knows, "
            f"found {', '.join(recording.keypoints)}; map them with --skeleton"
        )


def _make_views(
    sample: "Sample",
    joints: tuple[str, ...],
    positions: "Floats",
    confidence: "Floats",
    source: str,
) -> "tuple[Keypoints2D, ...]":
    """Return completed keypoints as those of one file per camera.

    positions: `[view, frame, instance, joint, 2]` pixels. confidence: `[view, frame, instance,
    joint]`.
    """
    from mocap_calib.types import Keypoints2D

    return tuple(
        Keypoints2D(
            camera=camera.name,
            keypoints=joints,
            frames=sample.frames,
            positions=positions[view],
            confidence=confidence[view],
            tracked=bool(sample.tracked[view]),
            image_size=camera.size,
            source=source,
        )
        for view, camera in enumerate(sample.cameras)
    )
