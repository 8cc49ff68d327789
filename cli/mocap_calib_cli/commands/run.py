"""mocap-calib run: keypoints to cameras and 3D poses."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.types import Calibration
    from mocap_calib_cli.progress import Reporter

_FILES = ("cameras.yaml", "calibration.toml", "matches.csv", "poses3d.h5", "run.json")
_REVERSED = "calibration_reversed.toml"


@click.command(name="run")
@options.keypoints
@options.cameras
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, metavar="OUT", help="Folder to write; made when missing.")
@options.skeleton
@options.model
@options.solver
@options.seed
@options.device
@options.as_json("Write the content of run.json to stdout as well.")
@options.quiet
def command(
    keypoints: tuple[str, ...], cameras: str, output: Path, skeleton: Path | None, model: str | None, solver: str, seed: int, device: str, as_json: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Calibrates the cameras that saw KEYPOINTS, finds who is who, and triangulates the poses.

    Groups of cameras that share too little to be placed against each other are calibrated separately: the results of the
    largest are in OUT, those of the others in OUT/group_2, OUT/group_3, ...

    KEYPOINTS: a folder with one file per camera, or files, or name=path pairs. The name of a camera is the stem of its
    file; it must be a name in INTRINSICS.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib run left=a.json right=b.json --cameras intrinsics.toml -o out --json
    """
    from mocap_calib.config import Config
    from mocap_calib.pipeline import calibrate_groups
    from mocap_calib.report import run_report
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.model import load_model
    from mocap_calib_cli.progress import Reporter

    outputs.check_folder(output)
    with Reporter(quiet=quiet) as reporter:
        recording, network = inputs.read_recording(keypoints, inputs.cameras_of(cameras), skeleton, reporter, model=model)
        solve = inputs.pair_solver(solver, recording, network)
        groups = calibrate_groups(recording, load_model(device, network), Config(), seed=seed, device=device, progress=reporter, solve=solve)
    hashes = inputs.hashes([*(path for _, path in inputs.keypoint_files(keypoints)), cameras, *([skeleton] if skeleton else [])])
    listed = [{"folder": _folder(k), "cameras": list(found.rig.names)} for k, found in enumerate(groups)]
    own = {"model": network, "solver": solver, "groups": listed}
    reports = [run_report(found, seed=seed, config=Config(), inputs=hashes) | own for found in groups]
    _write(output, groups, reports, seed)
    if len(groups) > 1:
        names = " | ".join(", ".join(found.rig.names) for found in groups)
        reporter.say("", f"{len(groups)} groups of cameras that share too little to be placed against each other, each calibrated by itself: {names}")
    for k, (found, report) in enumerate(zip(groups, reports, strict=True)):
        _summarise(reporter, found, report, output / _folder(k))
    if groups[0].left_out:
        reporter.say(f"left out, no other camera confirms what they see: {', '.join(groups[0].left_out)}")
    if as_json:
        click.echo(json.dumps(reports[0], indent=1, allow_nan=False))


def _folder(group: int) -> str:
    """Where in OUT the files of a group go: those of the largest right there."""
    return "." if group == 0 else f"group_{group + 1}"


def _write(output: Path, groups: tuple["Calibration", ...], reports: list[dict[str, Any]], seed: int) -> None:
    """All files of a run, together or not at all; what an earlier run found beyond them is taken away."""
    from mocap_calib.io.atomic import folder

    with folder(output) as work:
        for k, (found, report) in enumerate(zip(groups, reports, strict=True)):
            (work / _folder(k)).mkdir(exist_ok=True)
            _write_group(work / _folder(k), found, report, seed)
    for k, found in enumerate(groups):
        _remove_stale(output / _folder(k), found.matches.individuals, () if found.rival else (_REVERSED,))
    stale = len(groups)
    while (output / _folder(stale) / _FILES[-1]).is_file():
        _remove_stale(output / _folder(stale), 0, (_REVERSED, *_FILES))
        stale += 1


def _write_group(work: Path, found: "Calibration", report: dict[str, Any], seed: int) -> None:
    from mocap_calib.io.atomic import replace_text
    from mocap_calib.io.camera_files import format_calibration_toml, format_cameras_yaml
    from mocap_calib.io.results import matches_csv, poses_csv, write_poses_h5
    from mocap_calib_cli import outputs

    source = outputs.provenance("run", seed=seed, inputs=report["inputs"])
    (work / "cameras.yaml").write_text(format_cameras_yaml(found.rig, source), "utf-8")
    (work / "calibration.toml").write_text(format_calibration_toml(found.rig, source), "utf-8")
    if found.rival is not None:
        (work / _REVERSED).write_text(format_calibration_toml(found.rival, source), "utf-8")
    replace_text(work / "matches.csv", matches_csv(found.recording, found.matches))
    write_poses_h5(work / "poses3d.h5", found.poses, source)
    for individual in range(found.matches.individuals):
        replace_text(outputs.of_individual(work / "poses3d.csv", individual), poses_csv(found.poses, individual))
    (work / "run.json").write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", "utf-8")


def _remove_stale(folder: Path, individuals: int, names: Iterable[str]) -> None:
    """Takes away files that an earlier run wrote, and the folder where nothing else is in it."""
    from mocap_calib_cli import outputs

    outputs.remove_stale(folder / "poses3d.csv", individuals)
    for name in names:
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


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
        if pair["rival_taken"]:
            reporter.say(f"pair {pair['a']}-{pair['b']}: a rival of its own best answer was taken, the one that the cameras between confirm")
        if pair["breaks_loop"]:
            reporter.say(f"pair {pair['a']}-{pair['b']} contradicts the others by {pair['loop_rotation_deg']:.1f} deg and was given little weight")
    weak = [camera["name"] for camera in report["cameras"] if camera["weak"]]
    if weak:
        reporter.say(
            f"weak: {', '.join(weak)} (support below {Config().averaging.weak_score}, good recordings have 0.7 and more): do not trust it without a check"
        )
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
        reporter.say(f"a rig reversed in depth fits as well, nothing seen tells which is right: it is in {output / _REVERSED}")
    people = report["individuals"]
    reporter.say(f"{len(people)} individuals, {report['points']['triangulated']} points; lengths in {report['unit']} units; results in {output}")
