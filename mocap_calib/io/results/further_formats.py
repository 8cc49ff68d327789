"""Write a run's cameras and 3D poses in further formats, beside its own files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError, argument, describe_lost, suggest
from mocap_calib.io.camera_files import CAMERA_FORMATS, format_rig, write_cameras
from mocap_calib.io.format import Format
from mocap_calib.io.pose_files import POSE_FORMATS, format_poses, write_poses
from mocap_calib.io.poses import PoseFile, bare_poses, describe_poses
from mocap_calib.io.units import ARBITRARY
from mocap_calib.results import ObservedPoints
from mocap_calib.types import CameraRig, Recording


@dataclass(frozen=True)
class WriteOutcome:
    """What was lost or left out when further formats were written.

    notes: a line for each format that was written: what it does not hold.
    refused: format -> why it was not written: it cannot hold the rig or the poses.
    """

    notes: tuple[str, ...]
    refused: Mapping[str, MismatchError]


_FORMATS = {each.name: each for each in (*POSE_FORMATS, *CAMERA_FORMATS) if each.write is not None}


def check_formats(names: Sequence[str], fps: float | None, unit: str = ARBITRARY) -> None:
    """Hold the names of further formats to what a run can write, before it starts.

    unit: of the lengths that it will have.

    Raises MismatchError for a name that is not known, a format that needs `fps` where there are
    none, one whose packages are not installed, and one that needs a unit of length where
    none is stated.
    """
    for name in names:
        if name not in _FORMATS:
            expected = f"one of {', '.join(_FORMATS)}"
            raise MismatchError(argument("write"), expected, f"{name!r}", suggest(name, _FORMATS))
        known = _FORMATS[name]
        known.writer()
        if unit == ARBITRARY:
            _check_unit(known)
        if known.timed and fps is None:
            owner, remedy = argument("write", name), f"say it with {argument('fps')}"
            raise MismatchError(owner, "the number of frames per second", "none", remedy)


def check_recording(
    names: Sequence[str], recording: Recording, fps: float | None, unit: str = ARBITRARY
) -> None:
    """Hold a recording to what the further formats can hold, before it is calibrated.

    Each format is tried on its cameras and keypoints, which stand at the origin.

    names, fps, unit: that `check_formats` has passed.

    Raises MismatchError where a format has no place for a lens, or for a name.
    """
    count = len(recording.cameras)
    rotations, origins = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    rig = CameraRig(recording.cameras, rotations, origins, unit)
    positions = np.zeros((1, 1, len(recording.keypoints), 3))
    poses = bare_poses(recording.keypoints, np.zeros(1, int), positions, unit=unit)
    file = describe_poses(poses, fps, rig=rig)
    for name in names:
        if name in CAMERA_FORMATS.written:
            format_rig(rig, name, {})
        else:
            format_poses(file, name, Path("poses"))


def _check_unit(known: Format) -> None:
    """Raise MismatchError where a format needs a unit of length, with the way to write it."""
    if not known.unit:
        return
    file = "cameras.yaml" if known.name in CAMERA_FORMATS.names else "poses3d.h5"
    rate = " --fps FPS" if known.timed else ""
    raise MismatchError(
        argument("write", known.name),
        "a format that leaves the unit of length open",
        f"one in {known.unit}, and a run does not know lengths",
        f"say one ({argument('height')}, {argument('length')}, {argument('camera_distance')}), or "
        "afterwards: mocap-calib scale OUT --height 1.75; mocap-calib convert "
        f"OUT/{file} NEW --to {known.name}{rate}",
    )


def any_holds_points(names: Sequence[str]) -> bool:
    """Return whether any format of these names has a place for observed points."""
    return any(_FORMATS[name].points for name in names)


def write_formats(
    output: Path,
    rig: CameraRig,
    file: PoseFile | None,
    names: Sequence[str],
    provenance: Mapping[str, Any],
    *,
    points: ObservedPoints | None = None,
) -> WriteOutcome:
    """Write a rig and poses in further formats into the folder of a run.

    file: the poses, None where cameras alone are to be written.
    points: for the camera formats that hold them, see `any_holds_points`.
    Cameras go to a folder that is called as the format, poses to poses3d and the ending of the
    format (SLEAP-anipose: points3d.h5). A format that cannot hold them is left out.
    """
    notes: list[str] = []
    refused: dict[str, MismatchError] = {}
    for known in map(_FORMATS.__getitem__, names):
        try:
            if known in CAMERA_FORMATS:
                lost = _write_rig(output / known.name, rig, known, provenance, points)
            elif file is not None:
                path = output / (known.result or f"poses3d{known.endings[0]}")
                lost = write_poses(path, replace(file, rig=rig), known.name)
            else:
                continue
            notes += describe_lost(known.name, lost)
        except MismatchError as error:
            refused[known.name] = error
    return WriteOutcome(tuple(notes), refused)


def _write_rig(
    folder: Path,
    rig: CameraRig,
    known: Format,
    provenance: Mapping[str, Any],
    points: ObservedPoints | None,
) -> tuple[str, ...]:
    """Write the files of a camera format into a folder; return what they do not hold."""
    if known.folder:
        held = points if known.points else None  # that others do not hold points need not be said
        return write_cameras(folder, rig, known.name, provenance, held)
    name = next(iter(format_rig(rig, known.name, provenance).files))
    return write_cameras(folder / name, rig, known.name, provenance)
