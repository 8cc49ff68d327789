"""Write camera files in a format of `io.cameras.formats`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocap_calib.io.atomic import check_no_other_files, write_bytes, write_files
from mocap_calib.io.cameras.comments import add_comments, describe_estimates
from mocap_calib.io.cameras.formats import CAMERA_FORMATS, FOLDER_ENDINGS
from mocap_calib.io.format import Written, find_format
from mocap_calib.io.provenance import describe_judgement
from mocap_calib.io.units import unit_factor
from mocap_calib.results import ObservedPoints
from mocap_calib.types import CameraRig


def format_rig(
    rig: CameraRig,
    format: str,
    provenance: Mapping[str, Any],
    points: ObservedPoints | None = None,
) -> Written:
    """Return the files of a rig in the format, by the names and in the unit that the format has.

    points: that the views see; they are lost where the format has no place for points. A verdict on
    the rig, which a provenance may have, and intrinsics that were estimated stand in comments where
    the files can hold them.

    Raises MismatchError where the format is only read or cannot carry the rig, and where it needs
    a unit of length that is not known.
    """
    known = find_format(CAMERA_FORMATS, format)
    write = known.writer()
    if known.unit:
        factor = unit_factor(rig.unit, known.unit, format)
        rig = replace(rig, translation=rig.translation * factor, unit=known.unit)
    points = points or ObservedPoints.none()
    written = write(rig, provenance, points) if known.points else write(rig, provenance)
    if len(points.positions) and not known.points:
        lost = f"{len(points.positions)} 3D points"
        written = replace(written, lost=(*written.lost, lost))
    remarks = [*describe_judgement(provenance), *describe_estimates(rig)]
    return replace(written, files=add_comments(written.files, remarks))


def write_cameras(
    path: str | Path,
    rig: CameraRig,
    format: str,
    provenance: Mapping[str, Any] | None = None,
    points: ObservedPoints | None = None,
) -> tuple[str, ...]:
    """Write a rig in the format, whole or not at all.

    path: the file, or the folder where the format is several files.
    points: that the views see.

    Returns what of the rig the format does not carry. Raises MismatchError as `format_rig` does,
    and where the folder has files of other cameras.
    """
    path = Path(path)
    written = format_rig(rig, format, provenance or {}, points)
    if find_format(CAMERA_FORMATS, format).folder:
        check_no_other_files(path, written.files, FOLDER_ENDINGS)
        write_files(path, written.files)
    else:
        write_bytes(path, next(iter(written.files.values())))
    return written.lost
