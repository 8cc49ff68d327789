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
    """Write KEYPOINTS with all joints of the model, for instance to compare two detectors.

    A joint that was not seen is put where the network expects it in that view: it is a guess, not a
    measurement. Its confidence is at most half of the detection's, and it has a row in
    filled_in.tsv beside the files (camera, frame, instance, keypoint). Cameras whose detectors know
    different joints get the same ones. Joints that the model does not know are left out.

    \b
    Example, in the folder examples/three_people:
      mocap-calib complete keypoints/ --cameras intrinsics.toml -o completed
    """
    from mocap_calib.errors import count, describe_lost
    from mocap_calib.io.keypoints.filled_table import FILLED_TABLE, format_filled_table
    from mocap_calib.io.keypoints.write import find_written_format, write_keypoints
    from mocap_calib.lift import complete_sample, find_completed
    from mocap_calib.lift.lifter import load_vocabulary
    from mocap_calib.recording.sampling import check_known_joints, take_sample
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    find_written_format(target)
    outputs.check_folder(output)
    with Reporter(quiet=shared.quiet) as reporter:
        camera_file = inputs.load_camera_file(shared.cameras, "--cameras")
        loaded = inputs.read_recording(shared, camera_file, reporter)
        check_known_joints(loaded.recording)
        sample = take_sample(loaded.recording, slice(None))
        lifted = inputs.lift_with_model(sample, loaded.recording.model, shared.device, reporter)
        views = complete_sample(sample, lifted, load_vocabulary(loaded.recording.model))
        filled = find_completed(sample, views)
        table = {FILLED_TABLE: format_filled_table(views, filled)}
        lost = write_keypoints(output, views, target, beside=table)
    reporter.say(
        f"{count(int(filled.sum()), 'keypoint')} filled in, which {FILLED_TABLE} lists; "
        f"results in {output}",
        *describe_lost(target, lost),
    )
