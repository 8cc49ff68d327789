"""mocap-calib verify: whether a calibration still goes with what the cameras see."""

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import names, options, values
from mocap_calib_cli.options import AS_JSON, argument, option
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from pathlib import Path

    from mocap_calib.results import Verification
    from mocap_calib.types import CameraRig
    from mocap_calib_cli.screen import Line, Table


_ANGLES = ("turn", "turn_sigma")
_FIGURES = ("shift", "shift_sigma", "relative_shift", "error_px", "refitted_px")


@as_command(
    "verify",
    option("-o --output", values.OUTPUT, metavar="FILE"),
    option("--to", names.WRITTEN_CAMERA_FORMAT),
    argument("rig", values.INPUT, "CAMERAS"),
    "keypoints",
    *options.READING,
    *options.MODEL,
    "centre_uncertainty",
    "focal_uncertainty",
    "sync",
    "sync_window",
    "seed",
    "strict",
    "quiet",
    AS_JSON,
)
def command(typed: Typed) -> int:
    """Judge the calibration CAMERAS by KEYPOINTS of moving subjects, and say which camera moved.

    CAMERAS: anyone's, by a board, a wand or keypoints, in any camera format with extrinsics and in
    any unit. Identities need not be known. KEYPOINTS: see `run`.

    Each camera is compared with where the others and the keypoints have it. It is named where its
    pose differs by more than errors explain, where it has another focal length, or where its
    detections fit no pose. The verdict is that of `run`, on CAMERAS with the named cameras where
    they are now. Of two cameras both are named. `-`: not known.

    The exit status is 0 where no camera is named and the keypoints determine that, else 1.

    \b
    Example, in the folder examples/three_people:
      mocap-calib verify board.toml keypoints/
      mocap-calib verify board.toml keypoints/ -o mended.toml --to anipose
      mocap-calib verify board.toml keypoints/ --json --strict

    rig: Calibration, then the keypoints to judge it by: CAMERAS KEYPOINTS...
    output: Where to write CAMERAS with the cameras that moved where they are now; all else,
        coordinates and unit too, stays as given.
    to: Format of FILE, where its ending does not say it (docs/formats.md).
    as_json: Figures as JSON instead of a table.
    """
    from mocap_calib.config import Config
    from mocap_calib.io.kinds import choose_format
    from mocap_calib.verdict.verify import verify
    from mocap_calib_cli import ending, inputs, screen

    if typed.to and typed.output is None:
        raise click.UsageError("--to: expected a file to write, found none; give -o FILE")
    form = typed.output and (typed.to or choose_format("cameras", typed.output))
    with screen.Reporter(quiet=typed.quiet) as reporter:
        given, camera_file = inputs.read_rig(typed.rig, "CAMERAS")
        rig, loaded = inputs.read_recording_of(given, camera_file, typed, reporter)
        found = verify(
            loaded.recording,
            rig,
            config=Config(
                sync=inputs.sync_config(typed),
                uncertainty=inputs.uncertainty_config(typed),
            ),
            seed=typed.seed,
            device=typed.device,
            progress=reporter,
        )
    absent = [name for name in given.names if name not in rig.names]
    if typed.as_json:
        figures = _figures(found) | {"without_keypoints": absent}
        echo(json.dumps(figures, indent=1, allow_nan=False))
    else:
        screen.show(*_describe(found, absent), err=False)
    if form:
        _write(typed.output, form, given, rig, found)
    return 1 if found.named else ending.exit_status(found.verdict, typed)


def _figures(found: "Verification") -> dict[str, Any]:
    """Return the figures under the keys of `--json`, None where one of a camera is not known."""
    import numpy as np

    from mocap_calib.report import describe_assessment

    cameras = []
    for camera in found.cameras:
        angles = {f"{name}_deg": np.rad2deg(getattr(camera, name)) for name in _ANGLES}
        figures = angles | {name: getattr(camera, name) for name in _FIGURES}
        figures["focal_change"] = np.expm1(camera.focal_change)
        known = {key: float(each) if np.isfinite(each) else None for key, each in figures.items()}
        cameras.append({"name": camera.name, "place": camera.word} | known)
    return {
        "verdict": found.verdict,
        **describe_assessment(found.assessment),
        "passes": found.passes,
        "named": list(found.named),
        "reasons": _reasons(found),
        "unit": found.rig.unit,
        "cameras": cameras,
    }


def _reasons(found: "Verification") -> list[str]:
    """Return the reasons for the verdict, a line each."""
    from mocap_calib.errors import spell_as_option

    return [reason.render(spell_as_option) for reason in found.reasons]


def _describe(found: "Verification", absent: list[str]) -> "list[Table | Line]":
    """Return the cameras as a table, the verdict, and what to do."""
    from mocap_calib.faults.hypotheses import clock_faults
    from mocap_calib_cli.ending import STYLES, explain
    from mocap_calib_cli.screen import Line, format_number

    notes = [f"not checked, no keypoints: {', '.join(absent)}"] if absent else []
    notes += [
        f"{fault.camera}: {fault.says}, in these keypoints; taken into account"
        for fault in clock_faults(found.clocks, applied=found.clocks.changed)
    ]
    named = f"; named: {', '.join(found.named)}" if found.named else "; no camera is named"
    expected = f"{found.verdict}, expected error {format_number(found.assessment.error_deg)} deg"
    verdict = Line(f"calibration: {expected}{named}", STYLES[found.verdict])
    return [_camera_table(found), *map(Line, notes), verdict, *explain(_reasons(found))]


def _camera_table(found: "Verification") -> "Table":
    """Return a table of the cameras: how far each is from where it is given, and its errors."""
    from mocap_calib.types import ARBITRARY
    from mocap_calib_cli.screen import Table, format_length, format_number

    unit = "" if found.rig.unit == ARBITRARY else f" {found.rig.unit}"
    rows = []
    for camera in _figures(found)["cameras"]:
        share = camera["relative_shift"]
        angles = (camera["turn_deg"], camera["turn_sigma_deg"], share and 100 * share)
        lengths = map(format_length, (camera["shift"], camera["shift_sigma"]))
        errors = map(format_number, (camera["error_px"], camera["refitted_px"]))
        cells = (*map(format_number, angles), *lengths, *errors)
        rows.append((camera["name"], *cells, camera["place"]))
    header = ("camera", "turn deg", "+- deg", "shift %", f"shift{unit}", f"+-{unit}", "error px")
    return Table((*header, "refitted px", "place"), rows, "place")


def _write(
    output: "Path", form: str, given: "CameraRig", checked: "CameraRig", found: "Verification"
) -> None:
    """Write the calibration with the cameras that moved where they are now.

    checked: the rig that was verified, whose cameras are turned as the images are.
    Cameras that nothing places are left out. Of two cameras the poses are not known.
    """
    from mocap_calib.io.camera_files import write_cameras
    from mocap_calib.io.provenance import provenance

    if len(found.cameras) == 2 and found.named:
        echo(f"{output}: not written, nobody can say which of two cameras moved", err=True)
        return
    lost = [camera.name for camera in found.cameras if camera.word == "inconsistent"]
    rig = _mend(given, checked, found).select([name for name in given.names if name not in lost])
    notes = write_cameras(output, rig, form, provenance("verify", **found.provenance))
    for note in (*notes, *([f"{', '.join(lost)}, which nothing places"] if lost else [])):
        echo(f"{output}: without {note}", err=True)


def _mend(given: "CameraRig", checked: "CameraRig", found: "Verification") -> "CameraRig":
    """Return the rig of the file with the cameras that moved where they are now."""
    import numpy as np

    rotation, translation = given.rotation.copy(), given.translation.copy()
    cameras = list(given.cameras)
    for name in found.named:
        view, pose = given.names.index(name), found.rig[name]
        back = given.rotation[view] @ checked[name].rotation.T
        if found[name].word == "focal":
            back = np.eye(3)  # its intrinsics are those of the images
            (cameras[view],) = found.rig.select([name]).cameras
        rotation[view], translation[view] = back @ pose.rotation, back @ pose.translation
    return replace(given, cameras=tuple(cameras), rotation=rotation, translation=translation)
