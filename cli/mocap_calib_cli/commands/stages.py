"""The stages of `run`, one at a time: each reads records, calls a function, and writes."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mocap_calib_cli import options, values
from mocap_calib_cli.options import OUTPUT_FILE, OUTPUT_TEXT, argument, option
from mocap_calib_cli.outputs import STDIO
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from mocap_calib.results import Poses3D


@as_command(
    "pairwise",
    OUTPUT_TEXT,
    "cameras",
    *options.MODEL,
    "pairs",
    "solver",
    "seed",
    *options.KEYPOINTS,
    "quiet",
)
def pairwise(typed: Typed) -> None:
    """Find the relative poses of pairs of cameras, and who matches whom.

    This is the first stage of `run`. The file it writes is for `average`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml -o pairs.json
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml --solver five-point -o b.json

    output: Where to write the pairs (JSON); - is stdout.
    """
    from mocap_calib.config import Config, ViewGraphConfig
    from mocap_calib.io.results.pairs_json import pairs_to_json
    from mocap_calib.stages import pairwise
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    with Reporter(quiet=typed.quiet) as reporter:
        camera_file = inputs.load_camera_file(typed.cameras, "--cameras")
        recording = inputs.read_recording(typed, camera_file, reporter).recording
        pairs = pairwise(
            recording,
            config=Config(view_graph=ViewGraphConfig(pairs=typed.pairs)),
            solver=typed.solver,
            seed=typed.seed,
            device=typed.device,
            progress=reporter,
        )
    outputs.write_text(typed.output, [pairs_to_json(pairs, recording.cameras).encode()])


@as_command("average", argument("pairs", values.INPUT), OUTPUT_TEXT, "quiet")
def average(typed: Typed) -> None:
    """Find where all cameras stand (the rig) from PAIRS, the file of `pairwise`; - reads stdin.

    Cameras that are in no pair are left out and named.

    \b
    Example, in the folder examples/three_people:
      mocap-calib average pairs.json -o rig.yaml
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml | mocap-calib average -

    pairs: File that `pairwise` wrote; - reads stdin.
    output: Where to write the cameras (YAML); - is stdout.
    """
    from mocap_calib.io.file import decode, read_bytes
    from mocap_calib.io.formats.own_cameras import format_cameras_yaml
    from mocap_calib.io.provenance import provenance
    from mocap_calib.io.results.pairs_json import pairs_from_json
    from mocap_calib.stages import average
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.describe import describe_unused_cameras
    from mocap_calib_cli.screen import Reporter

    source = inputs.open_input(typed.pairs, "PAIRS")
    name = "stdin" if typed.pairs == STDIO else typed.pairs
    content = read_bytes(source) if isinstance(source, Path) else source
    pairs, cameras = pairs_from_json(decode(content, name), name)
    rig = average(pairs, cameras)
    left_out = [camera.name for camera in cameras if camera.name not in rig.names]
    Reporter(quiet=typed.quiet).say(*describe_unused_cameras(left_out))
    outputs.write_text(typed.output, [format_cameras_yaml(rig, provenance("average")).encode()])


@as_command("match", OUTPUT_TEXT, "rig", *options.MODEL, "individuals", *options.KEYPOINTS, "quiet")
def match(typed: Typed) -> None:
    """Label every detection with its individual, given where the cameras stand.

    MATCHES has a row for each detection: camera, frame, its number in the frame, and the number of
    the individual (-1 is nobody). It is for `adjust` and `triangulate`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib match keypoints/ --rig out/cameras.yaml -o matches.csv

    output: Where to write the matches (CSV); - is stdout.
    """
    from mocap_calib.config import Config, MatchingConfig
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.stages import match
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, _, _ = inputs.read_recording_of_rig(typed, reporter)
        config = Config(matching=MatchingConfig(individuals=typed.individuals))
        matches = match(
            loaded.recording, rig, config=config, device=typed.device, progress=reporter
        )
    outputs.write_text(typed.output, matches_csv(loaded.recording, matches, loaded.clocks))


@as_command(
    "adjust",
    OUTPUT_TEXT,
    option("--matches-out", values.OUTPUT, metavar="FILE"),
    "rig",
    "matches",
    *options.MODEL,
    *options.KEYPOINTS,
    *options.VERDICT,
    "quiet",
)
def adjust(typed: Typed) -> int:
    """Adjust the cameras and match again, in turn, until no match changes (bundle adjustment).

    Errors and verdict are those of the frames that calibration looks at. The exit status is 1
    where the rig is not determined, as that of `run`.

    \b
    Example:
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv -o cameras.yaml
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv --matches-out new.csv

    output: Where to write the adjusted cameras (YAML); - is stdout.
    matches_out: Where to write the matches that the adjusted cameras imply.
    """
    from mocap_calib.io.camera_files import format_rig
    from mocap_calib.io.provenance import hold_for, provenance
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.report import run_report, verdict_of_cameras
    from mocap_calib.stages import bundle_adjust
    from mocap_calib_cli import ending, inputs, outputs
    from mocap_calib_cli.screen import Reporter

    ending.check_demands(typed)
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, matches, frames = inputs.read_recording_of_rig(typed, reporter)
        result, matches = bundle_adjust(
            loaded.recording, rig, matches, device=typed.device, progress=reporter
        )
    if typed.matches_out is not None:
        table = matches_csv(loaded.recording, matches, loaded.clocks)
        outputs.write_text(typed.matches_out, table)
    (group,) = result.groups
    report = run_report(group, result)
    judged = verdict_of_cameras(report)
    if frames is not None:  # a camera was moved
        judged = hold_for(judged, frames)
    (content,) = format_rig(group.rig, "mocap-calib", provenance("adjust", **judged)).files.values()
    outputs.write_text(typed.output, [content])
    reporter.say("")
    reporter.show(ending.camera_table(report))
    reporter.say(*ending.describe_rig(report))
    place = "adjusted cameras" if str(typed.output) == STDIO else typed.output
    ending.conclude(reporter, report["verdict"], place, typed)
    return ending.exit_status(group.verdict, typed)


@as_command("triangulate", OUTPUT_FILE, "rig", "matches", "skeleton", *options.KEYPOINTS, "quiet")
def triangulate(typed: Typed) -> None:
    """Triangulate the 3D poses of all individuals in all frames.

    \b
    Example, in the folder examples/three_people:
      mocap-calib triangulate keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5

    output: Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv,
        ...).
    """
    from mocap_calib.rig.triangulate import triangulate

    _make_poses(typed, "triangulate", triangulate)


@as_command(
    "smooth", OUTPUT_FILE, "rig", "matches", "skeleton", "smooth", *options.KEYPOINTS, "quiet"
)
def smooth(typed: Typed) -> None:
    """Triangulate the 3D poses of all individuals, and fit them to motion and bones.

    How strongly, held-out detections say. Short gaps are bridged, and joints that a single camera
    saw are completed; docs/poses.md has how, and which. `run` does the same.

    \b
    Example, in the folder examples/three_people:
      mocap-calib smooth keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
      mocap-calib smooth keypoints/ --rig rig.toml --matches matches.csv --smooth bones -o p.h5

    output: Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv,
        ...).
    """
    from mocap_calib.config import Config, PosesConfig
    from mocap_calib.stages import smooth

    config = Config(poses=PosesConfig(smooth=typed.smooth))
    _make_poses(typed, "smooth", partial(smooth, config=config))


def _make_poses(typed: Typed, stage: str, make: "Callable[..., Poses3D]") -> None:
    """Make the 3D poses of a recording with a rig and identities, and write them."""
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    outputs.check_poses(typed.output)
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, matches, _ = inputs.read_recording_of_rig(typed, reporter)
        outputs.check_individuals(typed.output, matches.individuals)
        poses = make(loaded.recording, rig, matches, progress=reporter)
    outputs.write_poses(typed.output, poses, loaded.recording, stage)
