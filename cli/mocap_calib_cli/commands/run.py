"""mocap-calib run: keypoints to cameras and 3D poses."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.types import GroupResult
    from mocap_calib_cli.progress import Reporter

_FILES = ("cameras.yaml", "calibration.toml", "matches.csv", "poses3d.h5", "run.json")
_REVERSED = "calibration_reversed.toml"


@click.command(name="run")
@options.keypoints
@options.reading
@options.cameras
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="OUT",
    help="Folder to write; made when missing.",
)
@click.option(
    "--write",
    "formats",
    multiple=True,
    metavar="FORMAT",
    help="Write this format too (colmap, movement-3d, ...: docs/formats.md); may be repeated. Lengths are arbitrary: see `convert --unit`.",
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    help="Frames per second, for the formats that need it.",
)
@options.skeleton
@options.model
@options.solver
@options.seed
@options.device
@options.scheduler
@options.as_json("Write the content of run.json to stdout as well.")
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    cameras: str,
    output: Path,
    formats: tuple[str, ...],
    fps: float | None,
    skeleton: Path | None,
    model: str | None,
    solver: str,
    seed: int,
    device: str,
    scheduler: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrates the cameras that saw KEYPOINTS, finds who is who, and triangulates the poses.

    KEYPOINTS: a folder with a file or a folder per camera, or files, or name=path pairs, or a file of all cameras. The name
    of a camera is that of its file or folder; it must be a name in INTRINSICS. docs/formats.md lists the formats. A run that was
    killed picks up the pairs of cameras it had finished.

    Groups of cameras that share too little to be placed against each other are calibrated separately: the results of the
    largest are in OUT, those of the others in OUT/group_2, OUT/group_3, ...

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib run left=a.json right=b.json --cameras intrinsics.toml -o out --json
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --write colmap --write movement-3d --fps 60
    """
    from mocap_calib.io.poses.common import PoseFile
    from mocap_calib.io.results.further_formats import check_formats, write_formats
    from mocap_calib_cli import jobs, outputs
    from mocap_calib_cli.engine import engine
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    check_formats(formats, fps)
    with Reporter(quiet=quiet) as reporter, engine(reporter, scheduler=scheduler) as there:
        job = jobs.read(
            jobs.Order(keypoints, cameras, skeleton, model, solver, seed, device, output, reading),
            reporter,
        )
        result = jobs.solve_here(job, progress=reporter, mapper=there)
    reports = jobs.write(job, result)
    groups = result.groups
    if len(groups) > 1:
        names = " | ".join(", ".join(found.rig.names) for found in groups)
        reporter.say(
            "",
            f"{len(groups)} groups of cameras that share too little to be placed against each other, each calibrated by itself: {names}",
        )
    for k, (found, report) in enumerate(zip(groups, reports, strict=True)):
        here = output / jobs.group_folder(k)
        _summarise(reporter, found, report, here)
        poses = PoseFile(found.poses, float("nan") if fps is None else fps)
        reporter.say(
            *write_formats(here, found.rig, poses, formats, outputs.provenance("run", seed=seed))
        )
    if result.left_out:
        reporter.say(
            f"left out, no other camera confirms what they see: {', '.join(result.left_out)}"
        )
    if as_json:
        click.echo(json.dumps(reports[0], indent=1, allow_nan=False))


def _summarise(
    reporter: "Reporter", found: "GroupResult", report: dict[str, Any], output: Path
) -> None:
    """What a person wants to see at the end, on stderr."""
    from mocap_calib.config import Config
    from mocap_calib_cli.progress import figure, table

    rows = [
        [
            c["name"],
            str(c["detections"]),
            str(c["matched"]),
            *(figure(c["reprojection_error_px"][k]) for k in ("median", "p95")),
            figure(c["support"]),
        ]
        for c in report["cameras"]
    ]
    reporter.say(
        "", *table(["camera", "detections", "matched", "median px", "95 % px", "support"], rows)
    )
    for pair in report["pairs"]:
        if pair["alternative_taken"]:
            reporter.say(
                f"pair {pair['a']}-{pair['b']}: a rival of its own best answer was taken, the one that the cameras between confirm"
            )
        if pair["breaks_loop"]:
            reporter.say(
                f"pair {pair['a']}-{pair['b']} contradicts the others by {pair['loop_rotation_deg']:.1f} deg and was given little weight"
            )
    weak = [camera["name"] for camera in report["cameras"] if camera["weak"]]
    if weak:
        reporter.say(
            f"weak: {', '.join(weak)} (support below {Config().averaging.weak_score}, good recordings have 0.7 and more): do not trust it without a check"
        )
    if not found.adjusted.converged:
        reporter.say(
            f"matches still changed after {found.adjusted.rounds} rounds of adjustment; look at matches.csv with care"
        )
    odd = [camera["name"] for camera in report["cameras"] if camera["inconsistent"]]
    if odd:
        reporter.say(
            f"inconsistent: {', '.join(odd)}: errors several times those of the other cameras; out of step (shift it with --frame-offset), "
            "moved, or with other intrinsics"
        )
    determined = report["verdict"]
    apart = determined["halves_differ_deg"]
    reporter.say(
        f"rig: {determined['rig']}; halves of the joints give rigs {apart['median']:.1f} deg apart, {apart['max']:.1f} at most"
    )
    affine = [camera["name"] for camera in report["cameras"] if camera["near_affine"]]
    if affine:
        reporter.say(
            f"translation not observable: {', '.join(affine)} so far away or of such long focal length that images show no perspective; "
            "distances follow from the focal lengths alone"
        )
    if found.adjusted.depth_reversed_rig is not None:
        reporter.say(
            f"a rig reversed in depth fits as well, nothing seen tells which is right: it is in {output / _REVERSED}"
        )
    people = report["individuals"]
    reporter.say(
        f"{len(people)} individuals, {report['points']['triangulated']} points; lengths in {report['unit']} units; results in {output}"
    )
