"""Convert files of keypoints, cameras or 3D poses to another format of their kind.

`choose_kind` and `choose_format` find out what is not said; `convert_keypoints`, `convert_cameras`
and `convert_poses` read, convert and write. Sources are paths, or the content of one file; without
an output the result holds the new files.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import check_no_further_individual
from mocap_calib.io.cameras.formats import CAMERA_FORMATS
from mocap_calib.io.cameras.read import load_cameras, looks_like_cameras, make_rig, parse_content
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.cameras.write import format_rig, write_cameras
from mocap_calib.io.file import plain_path, read_bytes
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.read import looks_like_keypoints, read_keypoints
from mocap_calib.io.keypoints.write import format_keypoints, write_keypoints
from mocap_calib.io.poses.common import PoseFile, turn_up_axis
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.poses.read import join_individuals, looks_like_poses, parse_poses
from mocap_calib.io.poses.write import format_poses, write_poses
from mocap_calib.io.registry import (
    AnyFormat,
    Kind,
    ending_of,
    find_format,
    format_names,
    names_by_ending,
    written_names,
)
from mocap_calib.recording.pairing import check_pixels
from mocap_calib.types import Keypoints2D

# in the order in which content is looked at
FORMATS: Mapping[Kind, tuple[AnyFormat, ...]] = {
    "poses": POSE_FORMATS,
    "keypoints": KEYPOINT_FORMATS,
    "cameras": CAMERA_FORMATS,
}
_NAMELESS = "stdin"  # what complaints call content that comes without a path

Sources = Sequence[str | Path] | bytes


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


def check_sources(sources: Sequence[str | Path]) -> None:
    """Raise MismatchError where a file or folder (or that of a `name=path` pair) is missing."""
    for path in map(plain_path, sources):
        if not path.exists():
            raise MismatchError(f"{path}: expected a file or folder, found none; check the path")


def choose_kind(
    sources: Sources, output: str | Path, *, format: str | None = None, to: str | None = None
) -> Kind:
    """Return what the sources hold: "keypoints", "cameras" or "poses".

    The names of formats tell (`format` of the sources, `to` of the output), else the content of
    the first source. Where that shows several kinds, or none, the ending of the output tells, if
    `to` is not given; else it is keypoints.

    Raises MismatchError for names of no format, or of two kinds, and FormatError where the JSON,
    TOML or YAML of the source is broken.
    """
    kinds = _kinds_named(format, to)
    if len(kinds) == 1:
        return kinds[0]
    shown = [kind for kind in kinds if _looks_like(kind, sources)]
    if to is None:
        ending = ending_of(output)
        for kind in shown or sorted(kinds):
            if ending in names_by_ending(FORMATS[kind]):
                return kind
    return shown[0] if shown else "keypoints"


def choose_format(kind: Kind, output: str | Path) -> str:
    """Return the name of the format that the ending of the output says.

    Raises MismatchError where it says none, or several.
    """
    by_ending = names_by_ending(FORMATS[kind])
    names = by_ending.get(ending_of(output), ())
    if len(names) > 1:
        raise MismatchError(
            f"{output}: expected the format of {kind} beside the ending, found none; "
            f"say --to {' or --to '.join(names)}"
        )
    if not names:
        known = ", ".join(f"{end} ({own[0]})" for end, own in by_ending.items() if len(own) == 1)
        written = ", ".join(written_names(FORMATS[kind]))
        raise MismatchError(
            f"{output}: expected an ending of {known}, or --to and one of {written}, "
            "found neither; name the format"
        )
    return names[0]


def convert_cameras(
    source: Path | bytes,
    output: Path | None,
    to: str,
    *,
    format: str | None = None,
    unit: str | None = None,
    image_size: tuple[int, int] = (0, 0),
    provenance: Mapping[str, Any] | None = None,
) -> Conversion:
    """Convert cameras and where they stand to the format `to`.

    source: a file, a folder, or the content of a file.
    output: the file or folder to write; None: the files are returned.
    format: of the source, where the content is not to say it.
    unit: what a length of 1 is, where the source does not say.
    image_size: (width, height) in pixels of cameras whose size the source does not say; (0, 0):
        not known.
    provenance: how the cameras came about, for formats that have a place for it.

    Cameras without extrinsics are left out, and that is noted, unless all are: FormatError. Raises
    FormatError and MismatchError as `load_cameras` and `write_cameras` do.
    """
    if isinstance(source, bytes):
        name = _NAMELESS
        found = parse_content(source, name, format, unit)
    else:
        name = str(source)
        found = load_cameras(source, format, unit)
    found = _leave_out_unplaced(found)
    rig = make_rig(_fill_sizes(found, image_size, name), name)
    known = find_format(CAMERA_FORMATS, to)
    summary = f"{len(rig.cameras)} cameras, lengths in {known.unit or rig.unit}, as {to}"
    if output is None:
        written = format_rig(rig, to, provenance or {})
        return Conversion(summary, found.notes, written.lost, written.files)
    return Conversion(summary, found.notes, write_cameras(output, rig, to, provenance))


def convert_poses(
    sources: Sequence[Path] | bytes,
    output: Path | None,
    to: str,
    *,
    format: str | None = None,
    unit: str | None = None,
    fps: float | None = None,
    up: str | None = None,
) -> Conversion:
    """Convert 3D poses to the format `to`.

    sources: files of one recording, folders of them, or the content of a file.
    output: the file to write; None: the files are returned.
    format: of the sources, where the content is not to say it.
    unit: what a length of 1 is, where the sources do not say.
    fps: frames per second, where the sources do not say.
    up: the axis of the sources' world that points up (x, y, z, -x, -y, -z); the poses are turned
        so that it is y. None: the axes are kept.

    Raises FormatError and MismatchError as `read_poses` and `write_poses` do, and MismatchError
    where the sources contradict `fps`.
    """
    if isinstance(sources, bytes):
        name = _NAMELESS
        file = parse_poses(sources, name, format, unit)
    else:
        name = str(sources[0])
        file = _read_individuals(sources, format, unit)
    if fps is not None:
        file = _fill_rate(file, fps, name)
    if up is not None:
        file = turn_up_axis(file, up)
    frames, individuals, keypoints = file.poses.positions.shape[:3]
    summary = f"{frames} frames, {individuals} individuals, {keypoints} keypoints as {to}"
    if output is None:
        written = format_poses(file, to, Path("stdout"))
        return Conversion(summary, file.notes, written.lost, written.files)
    if find_format(POSE_FORMATS, to).single:
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
    if isinstance(sources, bytes):
        views = _read_keypoint_content(sources, format, options)
    else:
        views = read_keypoints(sources, format, options)
    for view in views:
        check_pixels(view)
    frames = sum(len(view.frames) for view in views)
    summary = f"{len(views)} camera{'s' if len(views) > 1 else ''}, {frames} frames as {to}"
    notes = _collect_remarks(views)
    if output is None:
        written = format_keypoints(views, to)
        return Conversion(summary, notes, written.lost, written.files)
    return Conversion(summary, notes, write_keypoints(output, views, to))


# --- which kind


def _kinds_named(format: str | None, to: str | None) -> list[Kind]:
    """Return the kinds that have formats of these names; all where none is named."""
    kinds = list(FORMATS)
    for option, name in (("--from", format), ("--to", to)):
        if name is None:
            continue
        having = [kind for kind in FORMATS if name in format_names(FORMATS[kind])]
        if not having:
            known = "; ".join(
                f"{kind}: {', '.join(format_names(FORMATS[kind]))}" for kind in FORMATS
            )
            raise MismatchError(
                f"{option}: expected a format ({known}), found {name!r}; use one of these"
            )
        fitting = [kind for kind in kinds if kind in having]
        if not fitting:
            raise MismatchError(
                f"{option}: expected a format of {' or '.join(sorted(kinds))}, as {format} is, "
                f"found {name}; choose another"
            )
        kinds = fitting
    return kinds


def _looks_like(kind: Kind, sources: Sources) -> bool:
    """Return whether the first source shows this kind; a pipe that is named is not read for it.

    Raises FormatError where its JSON, TOML or YAML is broken.
    """
    if isinstance(sources, bytes):
        return _content_looks_like(kind, sources)
    path = plain_path(sources[0])
    if kind == "keypoints":
        return (path.is_dir() or path.is_file()) and looks_like_keypoints(path)
    first = path
    if path.is_dir():
        first = min((file for file in path.iterdir() if file.is_file()), default=path)
    if not first.is_file():
        return False
    return looks_like_poses(read_bytes(first)) if kind == "poses" else looks_like_cameras(path)


def _content_looks_like(kind: Kind, content: bytes) -> bool:
    """Return whether the content of a file shows this kind; keypoints are told by elimination."""
    if kind == "poses":
        return looks_like_poses(content)
    return kind == "cameras" and looks_like_cameras(Path(_NAMELESS), content)


# --- cameras


def _leave_out_unplaced(found: CameraFile) -> CameraFile:
    """Return the cameras that have extrinsics, with a note of the others; all where none has."""
    placed = tuple(camera for camera in found.cameras if camera.name in found.extrinsics)
    if not placed or len(placed) == len(found.cameras):
        return found
    bare = [camera.name for camera in found.cameras if camera.name not in found.extrinsics]
    note = f"left out, as nothing says where they stand: {', '.join(bare)}"
    return replace(found, cameras=placed, notes=(*found.notes, note))


def _fill_sizes(found: CameraFile, size: tuple[int, int], source: str) -> CameraFile:
    """Return the cameras with the image size that the user gives, where they have none.

    Raises MismatchError where a size is given and all have one.
    """
    if size == (0, 0):
        return found
    if not any(0 in camera.size for camera in found.cameras):
        raise MismatchError(
            f"{source}: expected cameras without an image size, for --image-size, "
            "found one for each; leave it out"
        )
    cameras = (
        replace(camera, size=size) if 0 in camera.size else camera for camera in found.cameras
    )
    return replace(found, cameras=tuple(cameras))


# --- poses


def _read_individuals(sources: Sequence[Path], format: str | None, unit: str | None) -> PoseFile:
    """Read all individuals in files and folders of files. Raises FormatError and MismatchError."""
    endings = names_by_ending(POSE_FORMATS)
    paths: list[Path] = []
    for source in sources:
        if source.is_dir():
            paths += sorted(file for file in source.iterdir() if ending_of(file) in endings)
        else:
            paths.append(source)
    if not paths:
        raise MismatchError(
            f"{sources[0]}: expected files of poses ({', '.join(sorted(endings))}), found none; "
            "give the files themselves"
        )
    files = [parse_poses(read_bytes(path), str(path), format, unit) for path in paths]
    return join_individuals(files, ", ".join(map(str, paths)))


def _fill_rate(file: PoseFile, fps: float, source: str) -> PoseFile:
    """Return the poses with the user's frames per second. Raises MismatchError where they have others."""
    if np.isfinite(file.rate) and file.rate != fps:
        raise MismatchError(
            f"{source}: expected {file.rate:g} frames per second, as the file says, "
            f"found --fps {fps:g}; leave it out"
        )
    return replace(file, rate=fps)


# --- keypoints


def _read_keypoint_content(
    content: bytes, format: str | None, options: ReadOptions | None
) -> tuple[Keypoints2D, ...]:
    """Read the content of a keypoint file: readers ask for a path."""
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / _NAMELESS
        path.write_bytes(content)
        return read_keypoints([path], format, options)


def _collect_remarks(views: Sequence[Keypoints2D]) -> tuple[str, ...]:
    """Return what the readers remark, each line once, with the cameras that it is of."""
    cameras: dict[str, list[str]] = {}
    for view in views:
        for remark in view.remarks:
            cameras.setdefault(remark, []).append(view.camera)
    return tuple(f"{', '.join(names)}: {remark}" for remark, names in cameras.items())
