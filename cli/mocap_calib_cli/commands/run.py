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
@options.reading
@options.cameras
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, metavar="OUT", help="Folder to write; made when missing.")
@click.option("--write", "formats", multiple=True, metavar="FORMAT", help="Write this format too (trc, pose2sim, ...: docs/formats.md); may be repeated.")
@click.option("--fps", type=click.FloatRange(min=0, min_open=True), help="Frames per second, for the formats that need it.")
@options.skeleton
@options.seed
@options.device
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
    seed: int,
    device: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Calibrates the cameras that saw KEYPOINTS, finds who is who, and triangulates the poses.

    KEYPOINTS: a folder with a file or a folder per camera, or files, or name=path pairs, or a file of all cameras. The name
    of a camera is that of its file or folder; it must be a name in INTRINSICS. docs/formats.md lists the formats.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib run left=a.json right=b.json --cameras intrinsics.toml -o out --json
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out --write colmap --write movement-3d --fps 60
    """
    from mocap_calib.config import Config
    from mocap_calib.io.pose_formats.common import PoseFile
    from mocap_calib.pipeline import calibrate
    from mocap_calib.report import run_report
    from mocap_calib_cli import conversion, inputs, outputs
    from mocap_calib_cli.model import load_model
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    conversion.check_formats(formats, fps)
    with Reporter(quiet=quiet) as reporter:
        recording, model = inputs.read_recording(keypoints, inputs.cameras_of(cameras), skeleton, reporter, reading)
        found = calibrate(recording, load_model(device, model), Config(), seed=seed, device=device, progress=reporter)
    hashes = inputs.hashes([*inputs.plain_paths(keypoints), cameras, *([skeleton] if skeleton else [])])
    report = run_report(found, seed=seed, config=Config(), inputs=hashes) | {"model": model}
    _write(output, found, report, seed)
    _summarise(reporter, found, report, output)
    poses = PoseFile(found.poses, float("nan") if fps is None else fps)
    reporter.say(*conversion.write_formats(output, found.rig, poses, formats, outputs.provenance("run", seed=seed)))
    if as_json:
        click.echo(json.dumps(report, indent=1, allow_nan=False))


def _write(output: Path, found: "Calibration", report: dict[str, Any], seed: int) -> None:
    """All files of a run, together or not at all; poses of more individuals than this run found are taken away."""
    from mocap_calib.io.atomic import folder, of_individual
    from mocap_calib.io.camera_files import format_calibration_toml, format_cameras_yaml
    from mocap_calib.io.results import format_matches_csv, format_poses_csv, write_poses_h5
    from mocap_calib_cli import outputs

    source = outputs.provenance("run", seed=seed, inputs=report["inputs"])
    with folder(output) as work:
        (work / "cameras.yaml").write_text(format_cameras_yaml(found.rig, source), "utf-8")
        (work / "calibration.toml").write_text(format_calibration_toml(found.rig, source), "utf-8")
        (work / "matches.csv").write_text(format_matches_csv(found.recording, found.matches), "utf-8")
        (work / "run.json").write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", "utf-8")
        write_poses_h5(work / "poses3d.h5", found.poses, source)
        for individual in range(found.matches.individuals):
            of_individual(work / "poses3d.csv", individual).write_text(format_poses_csv(found.poses, individual), "utf-8")
    outputs.remove_stale(output / "poses3d.csv", found.matches.individuals)


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
    people = report["individuals"]
    reporter.say(f"{len(people)} individuals, {report['points']['triangulated']} points; lengths in {report['unit']} units; results in {output}")
