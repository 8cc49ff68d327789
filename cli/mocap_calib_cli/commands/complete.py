"""mocap-calib complete: fill the keypoints that were not seen."""

from pathlib import Path

import click

from mocap_calib_cli import options, values


@click.command(name="complete")
@options.output_folder("Folder to write a keypoint file per camera to.")
@click.option(
    "--to",
    "target",
    default="coco",
    metavar="FORMAT",
    shell_complete=values.offer_written_keypoint_formats,
    help="Format to write (docs/formats.md).",
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
    from mocap_calib.recording.counting import count
    from mocap_calib.recording.sampling import take_sample
    from mocap_calib.recording.synchronise import check_known_joints
    from mocap_calib.steerpose.checkpoint import load_vocabulary
    from mocap_calib.steerpose.completion import complete_sample
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    with Reporter(quiet=shared.quiet) as reporter:
        camera_file = inputs.load_camera_file(shared.cameras, "--cameras")
        loaded = inputs.read_recording(shared, camera_file, reporter)
        check_known_joints(loaded.recording)
        sample = take_sample(loaded.recording, slice(None))
        lifted = inputs.lift_with_model(sample, loaded.model, shared.device, reporter)
        views = complete_sample(sample, lifted, load_vocabulary(loaded.model))
        lost = write_keypoints(output, views, target)
    seen = int(sample.seen[..., sample.vocabulary >= 0].sum())
    filled = sum(int(np.isfinite(view.positions[..., 0]).sum()) for view in views) - seen
    reporter.say(
        f"{count(filled, 'keypoint')} filled in; results in {output}",
        *(f"{target} does not hold {what}" for what in lost),
    )
