"""Set the scale of a folder of results by known lengths, after a run.

What lies there is rewritten together or not at all: cameras, 3D poses, and run.json. Further
formats stay as they were, and are named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.config import ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError, argument, count
from mocap_calib.geometry.rotation import rig_size
from mocap_calib.io.atomic import numbered_file, replace_folder, write_pieces
from mocap_calib.io.camera_files import format_rig, load_cameras, make_rig, read_rig
from mocap_calib.io.formats import own_cameras, own_poses
from mocap_calib.io.formats.anipose_csv import poses_csv
from mocap_calib.io.formats.own_cameras import SUBFRAME
from mocap_calib.io.formats.own_poses import write_poses_h5
from mocap_calib.io.hashing import hash_files
from mocap_calib.io.pose_files import load_poses
from mocap_calib.io.results.group import PAGE, REPORT, read_outputs, write_run_json
from mocap_calib.io.results.run_json import read_run_json
from mocap_calib.io.world_fields import world_fields
from mocap_calib.recording.epochs import own_name
from mocap_calib.report import SCHEMA
from mocap_calib.results import RigCovariance
from mocap_calib.types import ARBITRARY, CameraRig, World
from mocap_calib.world.floor import find_joints
from mocap_calib.world.lengths import Scale, find_scale, measurable, scaled_world

_CAMERAS = "cameras.yaml"
_POSES = "poses3d.h5"
_FORMATS = {_CAMERAS: "mocap-calib", "calibration.toml": "anipose"}
_OWN = ("matches.csv", REPORT, PAGE)  # hold no lengths, or are written last


@dataclass(frozen=True)
class Scaled:
    """What was done to a folder of results.

    world: of the cameras. notes: what was not rewritten, a line each.
    """

    world: World
    notes: tuple[str, ...]


def scale_results(folder: Path, cues: Sequence[ScaleCue], config: WorldConfig) -> Scaled:
    """Set the scale of a folder of results; lengths are in metres then.

    folder: of a run, or of a further group of cameras within it.

    Raises FormatError and MismatchError where it is no such folder, a length cannot be measured,
    or lengths contradict each other.
    """
    if folder.is_file():
        raise MismatchError(
            folder, "the folder of a run", "a file", "give the folder that `run -o` wrote"
        )
    for name in (_CAMERAS, _POSES):
        if not (folder / name).is_file():
            raise MismatchError(
                folder,
                f"the results of a run, with {_CAMERAS} and {_POSES}",
                f"no {name}",
                "give the folder that `run -o` wrote",
            )
    cameras, file = load_cameras(folder / _CAMERAS), load_poses(folder / _POSES)
    rig = make_rig(cameras, str(folder / _CAMERAS))
    _refuse_known_unit(folder, rig, file.poses.unit)
    verdict = str(cameras.judgement.get("verdict", ""))
    covariance = _covariance_of(rig, cameras.judgement.get("centre_sigma_percent", {}))
    joints = find_joints(file.spelt)
    on = measurable(file.poses, joints, rig, covariance, config, verdict=verdict)
    scale = find_scale(cues, replace(on, individuals=file.individuals), config)
    if scale is None:
        raise MismatchError(
            "scale",
            "a known length",
            "none",
            f"use {argument('height')}, {argument('length')} or {argument('camera_distance')}",
        )
    with replace_folder(folder) as work:
        for place in _camera_folders(folder):
            (work / place).mkdir(parents=True, exist_ok=True)
            _scale_cameras(folder / place, work / place, scale)
        scaled = file.poses.scale(scale.factor, "m")
        scaled = replace(scaled, world=scaled_world(scaled.world, scale))
        stored = own_poses.stored_provenance(folder / _POSES)
        write_poses_h5(work / _POSES, replace(file, poses=scaled), stored)
        for individual in range(scaled.positions.shape[1]):
            own = numbered_file(Path("poses3d.csv"), individual)
            if (folder / own).is_file():
                write_pieces(work / own, poses_csv(scaled, individual))
        left = _scale_report(folder, work, rig, scale)
    world = scaled_world(rig.world.scale(scale.factor), scale)
    return Scaled(world, left)


def _covariance_of(rig: CameraRig, percent: Mapping[str, float]) -> RigCovariance:
    """Return the covariance of centres that are independent and as uncertain in all directions.

    percent: of the size of the rig, by the names of cameras: RMS distance from the true centre.
    """
    own = [float(percent.get(own_name(name, rig.names), 0.0)) / 100 for name in rig.names]
    variance = np.array(own)[:, None] ** 2 / 3 * np.array([0, 0, 0, 1, 1, 1])
    matrix = np.diag(variance.ravel()).reshape(len(rig), 6, len(rig), 6)
    return RigCovariance(matrix, rig_size(rig))


def _refuse_known_unit(folder: Path, rig: CameraRig, unit: str) -> None:
    """Raise MismatchError where something better than a known length said the unit already.

    unit: of the poses.
    """
    if rig.unit != unit:
        raise MismatchError(
            folder,
            "cameras and poses in one unit",
            f"{rig.unit} and {unit}",
            "give the folder as `run -o` wrote it",
        )
    if unit != ARBITRARY and not rig.world.cues:
        by = {"landmarks": " by landmarks", "file": " by cameras whose places were given"}
        raise MismatchError(
            folder,
            "lengths that are arbitrary, or scaled by known ones",
            f"them in {unit}{by.get(rig.world.kind, '')}",
            "`mocap-calib convert --unit` writes others",
        )


def _camera_folders(folder: Path) -> list[Path]:
    """Return the folders with cameras of the same group: that of each epoch."""
    found = [path.parent for path in sorted(folder.glob(f"epoch_*/{_CAMERAS}"))]
    return [Path("."), *(path.relative_to(folder) for path in found)]


def _scale_cameras(source: Path, target: Path, scale: Scale) -> None:
    """Write the files of cameras that lie in a folder, scaled, into another.

    What they say of how they came about is that of cameras.yaml.
    """
    rig = read_rig(source / _CAMERAS)
    rig = rig.scale(scale.factor, "m")
    rig = replace(rig, world=scaled_world(rig.world, scale))
    provenance = own_cameras.stored_provenance(source / _CAMERAS)
    for name, format in _FORMATS.items():
        if (source / name).is_file():
            own = {key: provenance[key] for key in provenance if key != SUBFRAME}
            own = provenance if name == _CAMERAS else own
            (content,) = format_rig(rig, format, own).files.values()
            (target / name).write_bytes(content)


def _scale_report(folder: Path, work: Path, rig: CameraRig, scale: Scale) -> tuple[str, ...]:
    """Write run.json anew, if there is one; return a note of the results that stay as they were.

    It is no longer that of the command: it loses its fingerprint.
    """
    path, outputs = folder / REPORT, read_outputs(folder)
    report = read_run_json(path, SCHEMA) if path.is_file() else {}
    written = hash_files(work)
    left = [name for name in outputs if name not in written and Path(name).name not in _OWN]
    if report:
        world = scaled_world(rig.world.scale(scale.factor), scale)
        report |= {"unit": "m", "world": world_fields(world, "m")}
        _scale_figures([*report["cameras"], *report["pairs"]], rig, scale)
        if "fingerprint" in report:
            report |= {"fingerprint": None, "outputs": outputs | written}
        write_run_json(work, report)
    if not left:
        return ()
    some = ", ".join(left[:3]) + (", ..." if len(left) > 3 else "")
    return (
        f"not rewritten: {count(len(left), 'file')} of other formats or groups ({some}); "
        "write formats anew with `convert`, scale groups by themselves",
    )


def _scale_figures(described: list[dict[str, Any]], rig: CameraRig, scale: Scale) -> None:
    """Scale in place what run.json says in lengths: how sure the centres of its cameras are.

    described: cameras and pairs of cameras.

    Lengths that were arbitrary had no figure: it follows from the percentage of the rig's size.
    """
    size = rig_size(rig)
    for each in described:
        known, percent = each.get("centre_sigma"), each.get("centre_sigma_percent")
        if known is None and percent is not None:
            known = percent / 100 * size
        each["centre_sigma"] = None if known is None else float(scale.factor * known)
