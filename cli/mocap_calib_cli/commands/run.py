"""mocap-calib run: keypoints to cameras and 3D poses."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.types import Calibration
    from mocap_calib_cli.progress import Reporter


@click.command(name="run")
@options.keypoints
@options.cameras
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, metavar="OUT", help="Folder to write; made when missing.")
@options.skeleton
@options.model
@options.solver
@options.seed
@options.device
@options.scheduler
@options.as_json("Write the content of run.json to stdout as well.")
@options.quiet
def command(
    keypoints: tuple[str, ...],
    cameras: str,
    output: Path,
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

    KEYPOINTS: a folder with one file per camera, or files, or name=path pairs. The name of a camera is the stem of its
    file; it must be a name in INTRINSICS. A run that was killed picks up the pairs of cameras it had finished.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib run left=a.json right=b.json --cameras intrinsics.toml -o out --json
    """
    from mocap_calib_cli import jobs, outputs
    from mocap_calib_cli.engine import engine
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    with Reporter(quiet=quiet) as reporter, engine(reporter, scheduler=scheduler) as there:
        job = jobs.read(jobs.Order(keypoints, cameras, skeleton, model, solver, seed, device, output), reporter)
        found = jobs.solve_here(job, progress=reporter, mapper=there or map)
    report = jobs.write(job, found)
    _summarise(reporter, found, report, output)
    if as_json:
        click.echo(json.dumps(report, indent=1, allow_nan=False))


def _summarise(reporter: "Reporter", found: "Calibration", report: dict[str, Any], output: Path) -> None:
    """What a person wants to see at the end, on stderr."""
    from mocap_calib.config import Config
    from mocap_calib_cli.progress import figure, table

    rows = [
        [c["name"], str(c["detections"]), str(c["matched"]), *(figure(c["reprojection_error_px"][k]) for k in ("median", "p95")), figure(c["support"])]
        for c in report["cameras"]
    ]
    reporter.say("", *table(["camera", "detections", "matched", "median px", "95 % px", "support"], rows))
    for pair in report["pairs"]:
        if pair["breaks_loop"]:
            reporter.say(f"pair {pair['a']}-{pair['b']} contradicts the others by {pair['loop_rotation_deg']:.1f} deg and was given little weight")
    weak = [camera["name"] for camera in report["cameras"] if camera["weak"]]
    if weak:
        reporter.say(
            f"weak: {', '.join(weak)} (support below {Config().averaging.weak_score}, good recordings have 0.7 and more): do not trust it without a check"
        )
    if found.left_out:
        reporter.say(f"left out, no other camera confirms what they see: {', '.join(found.left_out)}")
    if not found.converged:
        reporter.say(f"matches still changed after {found.rounds} rounds of adjustment; look at matches.csv with care")
    determined = report["verdict"]
    reporter.say(f"rig: {determined['rig']}; two halves of the joints give rigs {determined['halves_differ_deg']['median']:.1f} deg apart")
    affine = [camera["name"] for camera in report["cameras"] if camera["near_affine"]]
    if affine:
        reporter.say(
            f"translation not observable: {', '.join(affine)} so far away or of such long focal length that images show no perspective; "
            "distances follow from the focal lengths alone"
        )
    if found.rival is not None:
        reporter.say(f"a rig reversed in depth fits as well, nothing seen tells which is right: it is in {output / 'calibration_reversed.toml'}")
    people = report["individuals"]
    reporter.say(f"{len(people)} individuals, {report['points']['triangulated']} points; lengths in {report['unit']} units; results in {output}")
