"""mocap-calib complete: fill the keypoints that were not seen."""

from mocap_calib_cli import names, options
from mocap_calib_cli.typed import Typed, as_command


@as_command(
    "complete",
    options.OUTPUT_FOLDER,
    options.option("--to", names.WRITTEN_KEYPOINT_FORMAT, default="coco"),
    "cameras",
    *options.MODEL,
    *options.KEYPOINTS,
    "quiet",
)
def command(typed: Typed) -> None:
    """Write KEYPOINTS with all joints of the model, for instance to compare two detectors.

    A joint that was not seen is put where the network expects it in that view: it is a guess, not a
    measurement. Its confidence is at most half of the detection's, and it has a row in
    filled_in.tsv beside the files (camera, frame, instance, keypoint). Cameras whose detectors know
    different joints get the same ones. Joints that the model does not know are left out.

    \b
    Example, in the folder examples/three_people:
      mocap-calib complete keypoints/ --cameras intrinsics.toml -o completed

    output: Folder to write a keypoint file per camera to.
    to: Format to write (docs/formats.md).
    """
    from mocap_calib.errors import count, describe_lost
    from mocap_calib.io.filled_table import FILLED_TABLE, format_filled_table
    from mocap_calib.io.keypoints import KEYPOINT_FORMATS, write_keypoints
    from mocap_calib.lift import complete_sample, find_completed, lift
    from mocap_calib.lift.lifter import load_model, load_vocabulary
    from mocap_calib.recording.sampling import check_known_joints, take_sample
    from mocap_calib.training import on_device
    from mocap_calib_cli import inputs
    from mocap_calib_cli.screen import Reporter

    KEYPOINT_FORMATS.find(typed.to).writer()
    with Reporter(quiet=typed.quiet) as reporter:
        camera_file = inputs.load_camera_file(typed.cameras, "--cameras")
        recording = inputs.read_recording(typed, camera_file, reporter).recording
        check_known_joints(recording)
        sample = take_sample(recording, slice(None))
        lifter = on_device(load_model(recording.model), typed.device)
        lifted = lift(sample, lifter, progress=reporter)
        views = complete_sample(sample, lifted, load_vocabulary(recording.model))
        filled = find_completed(sample, views)
        table = {FILLED_TABLE: format_filled_table(views, filled)}
        lost = write_keypoints(typed.output, views, typed.to, beside=table)
    reporter.say(
        f"{count(int(filled.sum()), 'keypoint')} filled in, which {FILLED_TABLE} lists; "
        f"results in {typed.output}",
        *describe_lost(typed.to, lost),
    )
