"""Convert files of keypoints, cameras or 3D poses to another format of their kind.

Sources are paths, or the content of one file; without an output the result holds the new files.
Where it is not said what the sources hold, or how to write them, ask `io.kinds`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError, argument, count
from mocap_calib.io.atomic import check_no_further_individual
from mocap_calib.io.camera_files import (
    CAMERA_FORMATS,
    format_rig,
    load_cameras,
    make_rig,
    read_rig,
    write_cameras,
)
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.detections import collect_remarks
from mocap_calib.io.document import NAMELESS
from mocap_calib.io.format import ending_of
from mocap_calib.io.keypoints import format_keypoints, read_keypoints, write_keypoints
from mocap_calib.io.kinds import OWN_POSES, Sources
from mocap_calib.io.pose_files import (
    POSE_FORMATS,
    format_poses,
    join_individuals,
    load_poses,
    write_poses,
)
from mocap_calib.io.poses import PoseFile, convert_unit, turn_up_axis
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.units import ARBITRARY, unit_factor
from mocap_calib.recording.names import check_pixels

_OWN_CAMERAS = "cameras.yaml"  # in the folder of a run


@dataclass(frozen=True)
class Conversion:
    """What a conversion did.

    summary: what was converted, in a few words.
    notes: what a person should know of what was read, a line each.
    lost: what the new format does not hold, in words that follow "does not hold".
    files: relative path -> content, where they were not written.
    """

    summary: str
    notes: tuple[str, ...]
    lost: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)


def convert_cameras(
    source: Path | bytes,
    output: Path | None,
    to: str,
    *,
    format: str | None = None,
    unit: str | None = None,
    input_unit: str | None = None,
    image_size: tuple[int, int] = (0, 0),
    provenance: Mapping[str, Any] | None = None,
) -> Conversion:
    """Convert cameras and where they stand to the format `to`.

    source: a file, a folder, or the content of a file.
    output: the file or folder to write; None: the files are returned.
    format: of the source, where the content is not to say it.
    unit: of the lengths in the output; None: as the source or the format has it.
    input_unit: what a length of 1 is in the source, where that does not say.
    image_size: (width, height) in pixels of cameras whose size the source does not say; (0, 0):
        not known.
    provenance: how the cameras came about, for formats that have a place for it.

    Cameras without extrinsics are left out, and that is noted, unless all are: FormatError. What
    the source says of how far the cameras can be trusted is handed on. Raises
    FormatError and MismatchError as `load_cameras` and `write_cameras` do.
    """
    name = NAMELESS if isinstance(source, bytes) else str(source)
    found = load_cameras(source, format, input_unit)
    found = _leave_out_unplaced(found)
    rig = make_rig(_fill_sizes(found, image_size, name), name)
    points = found.points
    if unit is not None:
        factor = unit_factor(rig.unit, unit, f"{name}: {argument('unit', unit)}")
        rig = rig.scale(factor, unit)
        points = replace(points, positions=factor * points.positions)
    provenance = {**(provenance or {}), **found.judgement}
    known = CAMERA_FORMATS.find(to)
    stated = known.unit or rig.unit
    lengths = "arbitrary lengths" if stated == ARBITRARY else f"lengths in {stated}"
    summary = f"{count(len(rig.cameras), 'camera')}, {lengths}, as {to}"
    if output is None:
        written = format_rig(rig, to, provenance, points)
        return Conversion(summary, found.notes, written.lost, written.files)
    lost = write_cameras(output, rig, to, provenance, points)
    return Conversion(summary, found.notes, lost)


def convert_poses(
    sources: Sequence[Path] | bytes,
    output: Path | None,
    to: str,
    *,
    format: str | None = None,
    unit: str | None = None,
    input_unit: str | None = None,
    fps: float | None = None,
    up: str | None = None,
) -> Conversion:
    """Convert 3D poses to the format `to`.

    sources: files of one recording, folders of them, or the content of a file.
    output: the file to write; None: the files are returned.
    format: of the sources, where the content is not to say it.
    unit: of the lengths in the output; None: as the sources or the format have it.
    input_unit: what a length of 1 is in the sources, where these do not say.
    fps: frames per second, where the sources do not say.
    up: the axis of the sources' world that points up (x, y, z, -x, -y, -z); the poses are turned
        so that it is y. None: where the sources say what is up, they are turned so that it is the
        axis that the new format takes for up; else the axes are kept.

    Formats that show cameras show those of a run, whose folder or poses3d.h5 is the source.

    Raises FormatError and MismatchError as `load_poses` and `write_poses` do, and MismatchError
    where the sources contradict `fps`.
    """
    if isinstance(sources, bytes):
        name = NAMELESS
        file = _fill_rate(load_poses(sources, format, input_unit), fps, name)
    else:
        name = str(sources[0])
        file = load_pose_sources(sources, format, fps, input_unit)
        if POSE_FORMATS.find(to).rig:
            file = _add_cameras(file, sources[0])
    if unit is not None:
        file = convert_unit(file, unit, f"{name}: {argument('unit', unit)}")
    if up is not None:
        file = turn_up_axis(file, up)
    frames, individuals, keypoints = file.poses.positions.shape[:3]
    counts = [(frames, "frame"), (individuals, "individual"), (keypoints, "keypoint")]
    summary = f"{', '.join(count(*each) for each in counts)} as {to}"
    if output is None:
        written = format_poses(file, to, Path("stdout"))
        return Conversion(summary, file.notes, written.lost, written.files)
    if POSE_FORMATS.find(to).single:
        check_no_further_individual(output, individuals)
    return Conversion(summary, file.notes, write_poses(output, file, to))


def convert_keypoints(
    sources: Sources,
    output: Path | None,
    to: str,
    *,
    format: str | None = None,
    options: ReadOptions | None = None,
) -> Conversion:
    """Convert the 2D keypoints of one or more cameras to the format `to`.

    sources: files, folders and `name=path` pairs, or the content of a file.
    output: the file or folder to write; None: the files are returned.
    format: of the sources, where the content is not to say it.
    options: what the sources do not say themselves.

    Raises FormatError and MismatchError as `read_keypoints` and `write_keypoints` do, and
    MismatchError where positions are shares of the image.
    """
    views = read_keypoints(sources, format, options)
    for view in views:
        check_pixels(view)
    frames = sum(len(view.frames) for view in views)
    summary = f"{count(len(views), 'camera')}, {count(frames, 'frame')} as {to}"
    notes = collect_remarks(views)
    if output is None:
        written = format_keypoints(views, to)
        return Conversion(summary, notes, written.lost, written.files)
    return Conversion(summary, notes, write_keypoints(output, views, to))


# --- cameras


def _leave_out_unplaced(found: CameraFile) -> CameraFile:
    """Return the cameras that have extrinsics, with a note of the others; all where none has."""
    placed = tuple(camera for camera in found.cameras if camera.name in found.extrinsics)
    bare = [camera.name for camera in found.cameras if camera not in placed]
    if not placed or not bare:
        return found
    note = f"left out, as nothing says where they stand: {', '.join(bare)}"
    return replace(found, cameras=placed, notes=(*found.notes, note))


def _fill_sizes(found: CameraFile, size: tuple[int, int], source: str) -> CameraFile:
    """Return the cameras with the image size that the user gives, where they have none.

    Raises MismatchError where a size is given and all have one.
    """
    if size == (0, 0):
        return found
    if not any(0 in camera.size for camera in found.cameras):
        expected = f"cameras without an image size, for {argument('image_size')}"
        raise MismatchError(source, expected, "one for each", "leave it out")
    filled = (replace(each, size=size) if 0 in each.size else each for each in found.cameras)
    return replace(found, cameras=tuple(filled))


# --- poses


def _add_cameras(file: PoseFile, source: Path) -> PoseFile:
    """Return the poses with the cameras of their run, where the source is of a run.

    Cameras in another unit are left out, and that is noted.
    """
    folder = source if source.is_dir() else source.parent
    cameras = folder / _OWN_CAMERAS
    if not cameras.is_file() or not (source.is_dir() or source.name == OWN_POSES):
        return file
    rig = read_rig(cameras)
    if rig.unit == file.poses.unit:
        return replace(file, rig=rig)
    note = f"{cameras}: left out, as its lengths are not in the unit of the poses"
    return replace(file, notes=(*file.notes, note))


def load_pose_sources(
    sources: Sequence[Path],
    format: str | None = None,
    fps: float | None = None,
    unit: str | None = None,
) -> PoseFile:
    """Read all individuals in files, folders of files and folders of runs.

    The arguments are those of `convert_poses`. Raises FormatError and MismatchError.
    """
    endings = {end for each in POSE_FORMATS if each.read for end in each.endings}
    paths: list[Path] = []
    for source in sources:
        if (source / OWN_POSES).is_file():  # the folder of a run
            paths.append(source / OWN_POSES)
        elif source.is_dir():
            paths += sorted(file for file in source.iterdir() if ending_of(file) in endings)
        else:
            paths.append(source)
    if not paths:
        expected = f"files of poses ({', '.join(sorted(endings))})"
        raise MismatchError(sources[0], expected, "none", "give the files themselves")
    files = [load_poses(path, format, unit) for path in paths]
    return _fill_rate(join_individuals(files, ", ".join(map(str, paths))), fps, str(sources[0]))


def _fill_rate(file: PoseFile, fps: float | None, source: str) -> PoseFile:
    """Return the poses with the user's frames per second, where there are any.

    Raises MismatchError where they have others.
    """
    if fps is None or file.rate == fps:
        return file
    if np.isfinite(file.rate):
        expected = f"{file.rate:g} frames per second, as the file says"
        raise MismatchError(source, expected, argument("fps", f"{fps:g}"), "leave it out")
    return replace(file, rate=fps)
