"""mocap-calib run: keypoints to cameras and 3D poses."""

import gc
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from mocap_calib_cli import option_files, options
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from mocap_calib.job.results import WrittenGroup
    from mocap_calib_cli.screen import Reporter

_NEXT_STEP = "look at the poses over the videos: mocap-calib overlay {} --video CAM=FILE -o overlay"


@as_command(
    "run",
    options.OUTPUT_FOLDER,
    "keypoints",
    options.CAMERAS_IF_ANY,
    *options.CALIBRATION,
    options.AS_JSON,
    option_files.CONFIG,
    option_files.SAVE_CONFIG,
)
def command(typed: Typed) -> int:
    """Calibrate the cameras that saw KEYPOINTS, find identities, and triangulate the poses.

    KEYPOINTS: a folder with a file or a folder per camera, or files, or name=path pairs, or a
    file of all cameras. The name of a camera is that of its file or folder; it must be a name in
    INTRINSICS, where there are any. docs/formats.md lists the formats. A run that was killed goes
    on from the pairs of cameras it had finished.

    Groups of cameras that share too little to be placed against each other are calibrated
    separately: the results of the largest are in OUT, those of the others in OUT/group_2,
    OUT/group_3, ... Where a camera was moved during the recording, OUT has the cameras up to
    then, and OUT/epoch_2, OUT/epoch_3, ... those from each move on.

    The exit status is 1 where the recording does not determine the rig of the largest group, or
    does not show a floor or a length that was asked for, after all files were written; with
    --strict also where that rig is weak.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib run left=a.json right=b.json --cameras intrinsics.toml -o out --json
      mocap-calib run keypoints/ --image-size 1920x1080 -o out
      mocap-calib run keypoints/ --cameras rough.toml --refine focal --focal-uncertainty 5% -o out
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --write colmap
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --write movement-3d --fps 60
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --fps 60 --fps cam2:30
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --sync check
      mocap-calib run keypoints/ --image-size 1920x1080 -o out --save-config recording.yaml
      mocap-calib run --config recording.yaml

    cameras: File or folder with the cameras' intrinsics, in any format of docs/formats.md; - reads
        stdin. Without it they are estimated from the recording.
    as_json: Write the content of run.json to stdout as well.
    config: Read options from a file, usually recording.yaml (docs/recording-yaml.md); those of the
        command line win.
    save_config: Write all options that were given to a file for --config, with the others as
        comments.
    """
    gc.disable()  # what is imported stays: to look for garbage among it takes a seventh of the time
    from mocap_calib.errors import count
    from mocap_calib.job.results import UNFINISHED
    from mocap_calib.job.steps import calibrate_job_resumably, read_job, write_results
    from mocap_calib_cli import describe, ending, inputs
    from mocap_calib_cli.screen import Reporter
    from mocap_calib_cli.workers import open_workers

    gc.freeze()
    gc.enable()
    ending.check_demands(typed)
    request = inputs.calibration_request(typed, typed.output)
    if typed.save_config:
        option_files.save_options(click.get_current_context(), typed.save_config)
    with (
        Reporter(quiet=typed.quiet) as reporter,
        open_workers(reporter, scheduler=typed.scheduler) as workers,
    ):
        job = read_job(request)
        reporter.say(*describe.describe_recording(job.loaded.summary))
        try:
            result = calibrate_job_resumably(job, progress=reporter, mapper=workers)
        except KeyboardInterrupt:
            if kept := len(list((typed.output / UNFINISHED).rglob("*.json"))):
                reporter.warn(
                    f"{count(kept, 'pair')} of cameras kept in {typed.output / UNFINISHED}: "
                    "the same command goes on from there"
                )
            raise
    written = write_results(job, result)

    reporter.say("", *describe.describe_groups(result))
    _say_groups(reporter, written, typed)
    if typed.as_json:
        echo(json.dumps(written[0].report, indent=1, allow_nan=False))
    if complaint := written[0].complaint:
        echo(f"mocap-calib: {complaint}", err=True)
        return 1
    return ending.exit_status(result.groups[0].verdict, typed)


def _say_groups(reporter: "Reporter", written: Sequence["WrittenGroup"], typed: Typed) -> None:
    """Say what was found of each group of cameras, the largest last."""
    from mocap_calib.io.results.group import group_folder
    from mocap_calib_cli import ending

    for number in reversed(range(len(written))):  # the largest group, which counts, comes last
        files, folder = written[number], typed.output / group_folder(number)
        reporter.show(ending.camera_table(files.report))
        reporter.say(*ending.describe_group(files.report, folder), *files.notes)
        if number:  # what of the largest group cannot be had ends the run, in an error
            reporter.say(*(f"{name} is not written: {why}" for name, why in files.refused.items()))
        ending.conclude(
            reporter,
            files.report["verdict"],
            folder,
            typed,
            counts=number == 0,
            next_step=_NEXT_STEP.format(folder),
        )
