"""The folder of a run: which files each group of cameras has, where they lie, which are stale.

The files of the largest group lie in the folder itself, those of the others in `group_2`,
`group_3`, ... Where a camera was moved, the cameras of the first epoch lie there, and those of the
later ones in `epoch_2`, `epoch_3`, ... `run.json` of the largest group lists all files by their
hashes. The poses of the individuals are in poses3d_0.csv, poses3d_1.csv, ..., and all together in
poses3d.h5.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from mocap_calib.io.atomic import numbered_file, write_bytes, write_pieces
from mocap_calib.io.camera_files import format_rig
from mocap_calib.io.formats.anipose_csv import poses_csv
from mocap_calib.io.formats.own_cameras import SUBFRAME
from mocap_calib.io.formats.own_poses import write_poses_h5
from mocap_calib.io.hashing import hash_file
from mocap_calib.io.poses import PoseFile
from mocap_calib.io.provenance import hold_for
from mocap_calib.io.results.matches_csv import matches_csv
from mocap_calib.recording.epochs import (
    Epoch,
    epoch_folder,
    list_epochs,
    rig_of_epoch,
)
from mocap_calib.results import Clocks, GroupResult
from mocap_calib.types import CameraRig

REPORT = "run.json"
PAGE = "report.html"
REVERSED_RIG = "calibration_reversed.toml"
_POSES = "poses3d.csv"  # with the number of the individual: poses3d_0.csv, ...
_REVERSED = "this is the rig reversed in depth, which fits as well as that of calibration.toml"


def group_folder(group: int) -> str:
    """Return the folder of a group, counted from 0, relative to the folder of the run."""
    return "." if group == 0 else f"group_{group + 1}"


def write_group(
    folder: Path,
    group: GroupResult,
    poses: PoseFile,
    provenance: Mapping[str, Any],
    *,
    clocks: Clocks,
) -> None:
    """Write the cameras, matches and poses of a group into a folder that exists.

    poses: of the group, with what is known beside. provenance: what the files say of how they
        came about. clocks: of all cameras.
    """
    epochs = list_epochs(group.rig.names, group.recording.frames)
    reversed_rig = group.adjusted.depth_reversed_rig
    for number, epoch in enumerate(epochs):
        place = folder / epoch_folder(number)
        place.mkdir(exist_ok=True)
        own = epoch_provenance(provenance, epochs, number)
        rig = rig_of_epoch(group.rig, epoch)
        parts = _clock_offsets(group, epoch)
        with_clocks = {**own, SUBFRAME: parts} if parts else own
        _write_cameras(place / "cameras.yaml", rig, "mocap-calib", with_clocks)
        _write_cameras(place / "calibration.toml", rig, "anipose", own)
        if reversed_rig is not None:
            remarked = {**own, "remarks": [_REVERSED, *own.get("remarks", [])]}
            reversed_epoch = rig_of_epoch(reversed_rig, epoch)
            _write_cameras(place / REVERSED_RIG, reversed_epoch, "anipose", remarked)
    write_pieces(folder / "matches.csv", matches_csv(group.recording, group.matches, clocks))
    write_poses_h5(folder / "poses3d.h5", poses, provenance)
    for individual in range(group.matches.individuals):
        path = numbered_file(folder / _POSES, individual)
        write_pieces(path, poses_csv(poses.poses, individual))


def _clock_offsets(group: GroupResult, epoch: Epoch) -> dict[str, float]:
    """Return the offsets of the clocks of an epoch's cameras, by their own names."""
    views = {
        name: group.rig.names[view] for name, view in zip(epoch.names, epoch.views, strict=True)
    }
    offsets = group.clock_offsets
    return {name: offsets[view] for name, view in views.items() if view in offsets}


def epoch_provenance(
    provenance: Mapping[str, Any], epochs: Sequence[Epoch], number: int
) -> dict[str, Any]:
    """Return what files of an epoch (index) say of how they came about, and when they hold."""
    if len(epochs) == 1:
        return dict(provenance)
    epoch = epochs[number]
    remarks = []
    if number:
        remarks.append(f"moved at frame {epoch.first}: {', '.join(epoch.moved)}")
    if number + 1 < len(epochs):
        remarks.append(f"the rig from frame {epochs[number + 1].first} on: another folder epoch_N")
    return hold_for(provenance, (epoch.first, epoch.last), *remarks)


def write_run_json(folder: Path, report: Mapping[str, Any]) -> None:
    """Write what run.json holds of a group into its folder."""
    text = json.dumps(report, indent=1, allow_nan=False)
    write_bytes(folder / REPORT, f"{text}\n".encode())


def read_outputs(folder: Path) -> dict[str, str]:
    """Return the hash of each file that `run.json` in a folder lists; none where it lists none."""
    try:
        outputs = json.loads((folder / REPORT).read_bytes())["outputs"]
        return {str(name): str(content) for name, content in outputs.items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}


def remove_earlier_outputs(folder: Path, earlier: Mapping[str, str], kept: Collection[str]) -> None:
    """Remove the files that an earlier run wrote, unless they are kept or were changed since.

    Other files stay, whatever their names. A folder that is empty then goes too.

    earlier: hash of each, by path within the folder. kept: paths within the folder.
    """
    root = folder.resolve()
    for name, content in earlier.items():
        path = (root / name).resolve()
        if name in kept or not path.is_relative_to(root) or not path.is_file():
            continue
        if hash_file(path) == content:
            path.unlink()
            _remove_empty_folders(path.parent, root)


def _remove_empty_folders(path: Path, root: Path) -> None:
    """Remove a folder and those around it, up to the root, as long as they are empty."""
    while path != root and not any(path.iterdir()):
        path.rmdir()
        path = path.parent


def _write_cameras(path: Path, rig: CameraRig, format: str, provenance: Mapping[str, Any]) -> None:
    """Write a rig in a format that is one file."""
    (content,) = format_rig(rig, format, provenance).files.values()
    path.write_bytes(content)
