"""mocap-calib scale: set the scale of results by known lengths."""

import click

from mocap_calib_cli import options, values
from mocap_calib_cli.typed import Typed, as_command


@as_command("scale", options.argument("output", values.FILE, "OUT"), *options.SCALE, "quiet")
def command(typed: Typed) -> None:
    """Set the scale of the results in OUT, which a run wrote, by lengths that you know.

    Cameras, 3D poses, run.json and report.html are rewritten, in metres. Several lengths are
    weighed by how sure they are; where they contradict each other, nothing is written. Results of a
    further group of cameras (OUT/group_2) have a scale of their own: give that folder.

    \b
    Example, in the folder examples/three_people:
      mocap-calib scale out --height 0=1.75
      mocap-calib scale out --length left_hip-left_knee=0.42+-0.01 --camera-distance cam1-cam2=3.1
    """
    from mocap_calib.config import WorldConfig
    from mocap_calib.io.results.group import PAGE, REPORT
    from mocap_calib.io.world_fields import world_fields
    from mocap_calib.job.reports import open_results
    from mocap_calib.job.scaling import scale_results
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.commands.report import draw_results
    from mocap_calib_cli.ending import describe_world
    from mocap_calib_cli.screen import Reporter

    output, cues = typed.output, inputs.scale_cues(typed)
    if not cues:
        raise click.UsageError(
            "expected a known length, found none; say --height, --length or --camera-distance"
        )
    if output.is_dir():
        outputs.check_folder(output)
    done = scale_results(output, cues, WorldConfig())
    said = describe_world(world_fields(done.world, "m"))
    reporter = Reporter(quiet=typed.quiet)
    reporter.say(*said, *done.notes)
    if (output / PAGE).is_file() and (output / REPORT).is_file():
        reporter.say(*draw_results(open_results(output), Typed({})))
