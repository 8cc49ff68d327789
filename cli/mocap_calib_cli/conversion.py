"""From one file format to another of its kind: keypoints, cameras, poses."""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.formats import (
    CAMERA_FORMAT_NAMES,
    CAMERA_FORMATS,
    camera_format,
    format_rig,
    write_cameras,
)
from mocap_calib.io.cameras.load import load_cameras, looks_like_cameras, make_rig, parse_content
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.file import read_bytes
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS, looks_like_keypoints, write_keypoints
from mocap_calib.io.poses.common import PoseFile, turned
from mocap_calib.io.poses.formats import (
    POSE_FORMAT_NAMES,
    POSE_FORMATS,
    format_poses,
    parse_poses,
    pose_format,
    sniff_poses,
    together,
    write_poses,
)
from mocap_calib.recording.pairing import check_pixels
from mocap_calib.types import CameraRig, Keypoints2D
from mocap_calib_cli import inputs as reading_inputs
from mocap_calib_cli import outputs
from mocap_calib_cli.options import STDIO

_NAMES: dict[str, tuple[str, ...]] = {
    "poses": POSE_FORMAT_NAMES,
    "cameras": CAMERA_FORMAT_NAMES,
    "keypoints": tuple(KEYPOINT_FORMATS),
}
_WRITTEN = {
    "poses": POSE_FORMAT_NAMES,
    "cameras": tuple(each.name for each in CAMERA_FORMATS if each.write),
    "keypoints": tuple(name for name, each in KEYPOINT_FORMATS.items() if each.write),
}
# of files that are written unnamed; where several formats have one, it is asked for
_ENDINGS = {
    "poses": [(ending, each.name) for each in POSE_FORMATS for ending in each.endings],
    "cameras": [(ending, each.name) for each in CAMERA_FORMATS for ending in each.endings],
    "keypoints": [
        (each.ending, name)
        for name, each in KEYPOINT_FORMATS.items()
        if each.ending and not each.per_frame
    ],
}
_OPTIONS = {
    "poses": {"unit", "fps", "up"},
    "cameras": {"unit", "image_size"},
}  # keypoints have those of reading


@dataclass(frozen=True)
class Wish:
    """What was typed; see the command."""

    inputs: tuple[str, ...]
    output: str
    source: str | None
    target: str | None
    unit: str | None
    fps: float | None
    up: str | None
    reading: Mapping[str, Any]


def convert(wish: Wish) -> list[str]:
    """Reads, converts, writes; lines to say on stderr. Raises FormatError and MismatchError."""
    content = _stdin(wish)
    _check_inputs(wish)
    kind = _kind(wish, content)
    _check_options(wish, kind)
    target = _target(wish, kind)
    if wish.output != STDIO:
        outputs.check_place(Path(wish.output))
    return {"poses": _poses, "cameras": _cameras, "keypoints": _keypoints}[kind](
        wish, target, content
    )


def _stdin(wish: Wish) -> bytes | None:
    if STDIO not in wish.inputs:
        return None
    if wish.source is None or len(wish.inputs) > 1:
        raise click.UsageError("stdin: expected it alone, and the name of its format with --from")
    return sys.stdin.buffer.read()


def _check_inputs(wish: Wish) -> None:
    """Raises MismatchError where a file or folder that is named is not there."""
    for path in reading_inputs.plain_paths(wish.inputs):
        if path != STDIO and not Path(path).exists():
            raise MismatchError(f"{path}: expected a file or folder, found none; check the path")


def _check_options(wish: Wish, kind: str) -> None:
    """Raises click's UsageError for an option that says nothing of this kind of file."""
    given = {"unit": wish.unit, "fps": wish.fps, "up": wish.up, **wish.reading}
    known = _OPTIONS.get(kind, set(wish.reading))
    stray = next(
        (name for name, value in given.items() if value not in (None, ()) and name not in known),
        None,
    )
    if stray is not None:
        raise click.UsageError(
            f"--{stray.replace('_', '-')}: expected an option of {kind}, which INPUT holds, found one of other files; leave it out"
        )


def _kind(wish: Wish, content: bytes | None) -> str:
    """`poses`, `cameras` or `keypoints`: what the formats' names leave, and then what the content shows."""
    kinds = set(_NAMES)
    for option, name in (("--from", wish.source), ("--to", wish.target)):
        if name is not None:
            having = {kind for kind, names in _NAMES.items() if name in names}
            if not having:
                known = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in _NAMES.items())
                raise MismatchError(
                    f"{option}: expected a format ({known}), found {name!r}; use one of these"
                )
            if not kinds & having:
                raise MismatchError(
                    f"{option}: expected a format of {' or '.join(sorted(kinds))}, as {wish.source} is, found {name}; choose another"
                )
            kinds &= having
    return next(iter(kinds)) if len(kinds) == 1 else _shown(wish, content, kinds)


def _shown(wish: Wish, content: bytes | None, kinds: set[str]) -> str:
    """The kind that the content of the first input shows, OUTPUT's ending where it shows several; else that of the ending, or keypoints."""
    ending = Path(wish.output).suffix.lower() if wish.target is None else ""
    shown: list[str] = [
        kind
        for kind in ("poses", "keypoints", "cameras")
        if kind in kinds and _looks_like(kind, wish, content)
    ]
    fitting = [kind for kind in shown or sorted(kinds) if ending in dict(_ENDINGS[kind])]
    return [*fitting, *shown, *(["keypoints"] if "keypoints" in kinds else sorted(kinds))][0]


def _looks_like(kind: str, wish: Wish, content: bytes | None) -> bool:
    """Whether the first input shows this kind; a pipe that is named is not read for it. Raises FormatError where its JSON, TOML or YAML is broken."""
    path = Path(reading_inputs.plain_paths(wish.inputs)[0])
    if kind == "keypoints":
        return content is None and (path.is_dir() or path.is_file()) and looks_like_keypoints(path)
    first = (
        min((file for file in path.iterdir() if file.is_file()), default=None)
        if path.is_dir()
        else path
    )
    if content is None and (first is None or not first.is_file()):
        return False
    if kind == "poses":
        return (
            sniff_poses(read_bytes(first) if content is None and first else content or b"")
            is not None
        )
    return looks_like_cameras(path, content)


def _target(wish: Wish, kind: str) -> str:
    if wish.target is not None:
        return wish.target
    ending = Path(wish.output).suffix.lower()
    names = [name for end, name in _ENDINGS[kind] if end == ending]
    if len(names) > 1:
        raise MismatchError(
            f"{wish.output}: expected the format of {kind} beside the ending, found none; say --to {' or --to '.join(names)}"
        )
    if wish.output == STDIO or not names:
        several = [end for end, _ in _ENDINGS[kind]]
        endings = ", ".join(
            f"{end} ({name})" for end, name in _ENDINGS[kind] if several.count(end) == 1
        )
        expected = f"an ending of {endings}, or --to and one of {', '.join(_WRITTEN[kind])}"
        raise MismatchError(f"{wish.output}: expected {expected}, found neither; name the format")
    return names[0]


def _one(wish: Wish, kind: str) -> Path:
    if len(wish.inputs) > 1:
        raise click.UsageError(
            f"expected one file or folder of {kind}, found {len(wish.inputs)}; give the folder"
        )
    return Path(wish.inputs[0])


def _to_stdout(files: Mapping[str, bytes], target: str) -> None:
    """Raises MismatchError where it is not one file."""
    if len(files) != 1:
        raise MismatchError(
            f"{target}: expected one file for stdout, found {len(files)} ({', '.join(list(files)[:4])}); give a folder"
        )
    sys.stdout.buffer.write(next(iter(files.values())))
    sys.stdout.buffer.flush()


def _said(read: str, target: str, notes: tuple[str, ...], lost: tuple[str, ...]) -> list[str]:
    return [*notes, f"{read} as {target}", *(f"{target} does not hold {what}" for what in lost)]


# --- cameras


def _cameras(wish: Wish, target: str, content: bytes | None) -> list[str]:
    path = _one(wish, "cameras")
    found = (
        load_cameras(path, wish.source, wish.unit)
        if content is None
        else parse_content(content, "stdin", wish.source, wish.unit)
    )
    bare = tuple(camera.name for camera in found.cameras if camera.name not in found.extrinsics)
    notes = found.notes
    if bare and len(bare) < len(found.cameras):
        notes += (f"left out, as nothing says where they stand: {', '.join(bare)}",)
        found = replace(
            found, cameras=tuple(camera for camera in found.cameras if camera.name not in bare)
        )
    rig = make_rig(_sized(found, wish), "stdin" if content is not None else str(path))
    source = outputs.provenance("convert", inputs=reading_inputs.hashes(wish.inputs))
    if wish.output == STDIO:
        written = format_rig(rig, target, source)
        _to_stdout(written.files, target)
        lost = written.lost
    else:
        lost = write_cameras(Path(wish.output), rig, target, source)
    unit = camera_format(target).unit or rig.unit
    return _said(f"{len(rig.cameras)} cameras, lengths in {unit},", target, notes, lost)


def _sized(found: CameraFile, wish: Wish) -> CameraFile:
    """With the image size that the user gives, where the file has none. Raises MismatchError where it has all."""
    size = reading_inputs.image_size(wish.reading.get("image_size"))
    if size != (0, 0) and not any(0 in camera.size for camera in found.cameras):
        raise MismatchError(
            f"{wish.inputs[0]}: expected cameras without an image size, for --image-size, found one for each; leave it out"
        )
    return replace(
        found,
        cameras=tuple(
            replace(camera, size=size) if 0 in camera.size else camera for camera in found.cameras
        ),
    )


# --- poses


def _poses(wish: Wish, target: str, content: bytes | None) -> list[str]:
    file = _read_poses(wish, content)
    if wish.up is not None:
        file = turned(file, wish.up)
    if wish.output == STDIO:
        files, lost = format_poses(file, target, Path("stdout"))
        _to_stdout(files, target)
    else:
        if pose_format(target).single:
            outputs.check_individuals(Path(wish.output), len(file.individuals))
        lost = write_poses(Path(wish.output), file, target)
    frames, individuals, keypoints = file.poses.positions.shape[:3]
    return _said(
        f"{frames} frames, {individuals} individuals, {keypoints} keypoints",
        target,
        file.notes,
        lost,
    )


def _read_poses(wish: Wish, content: bytes | None) -> PoseFile:
    """All individuals, with the rate that the file states, else the user. Raises FormatError and MismatchError."""
    if content is not None:
        file = parse_poses(content, "stdin", wish.source, wish.unit)
    else:
        given = [Path(argument) for argument in wish.inputs]
        endings = {ending for each in POSE_FORMATS for ending in each.endings}
        paths = [
            file
            for path in given
            for file in (
                sorted(f for f in path.iterdir() if f.suffix.lower() in endings)
                if path.is_dir()
                else [path]
            )
        ]
        if not paths:
            raise MismatchError(
                f"{given[0]}: expected files of poses ({', '.join(sorted(endings))}), found none; give the files themselves"
            )
        file = together(
            [parse_poses(read_bytes(path), str(path), wish.source, wish.unit) for path in paths],
            ", ".join(map(str, paths)),
        )
    if wish.fps is None:
        return file
    if np.isfinite(file.rate) and file.rate != wish.fps:
        raise MismatchError(
            f"{wish.inputs[0]}: expected {file.rate:g} frames per second, as the file says, found --fps {wish.fps:g}; leave it out"
        )
    return replace(file, rate=wish.fps)


# --- keypoints


def _keypoints(wish: Wish, target: str, content: bytes | None) -> list[str]:
    given = {**wish.reading, "format": wish.source}
    if content is None:
        views = reading_inputs.read_views(wish.inputs, given)
    else:
        with tempfile.TemporaryDirectory() as work:
            path = Path(work) / "stdin"
            path.write_bytes(content)
            views = reading_inputs.read_views([str(path)], given)
    for view in views:
        check_pixels(view)
    if wish.output == STDIO:
        with tempfile.TemporaryDirectory() as work:
            lost = write_keypoints(Path(work) / "out", views, target)
            files = {
                file.name: file.read_bytes()
                for file in sorted((Path(work) / "out").rglob("*"))
                if file.is_file()
            }
        _to_stdout(files, target)
    else:
        lost = write_keypoints(Path(wish.output), views, target)
    frames = sum(len(view.frames) for view in views)
    notes = (*reading_inputs.doubled(wish.inputs), *_remarks(views))
    return _said(
        f"{len(views)} camera{'s' if len(views) > 1 else ''}, {frames} frames", target, notes, lost
    )


def _remarks(views: Sequence[Keypoints2D]) -> list[str]:
    """What the readers remark, each line once, with the cameras that it is of."""
    cameras: dict[str, list[str]] = {}
    for view in views:
        for remark in view.remarks:
            cameras.setdefault(remark, []).append(view.camera)
    return [f"{', '.join(names)}: {remark}" for remark, names in cameras.items()]


# --- for `run`


def check_formats(names: tuple[str, ...], fps: float | None) -> None:
    """Raises MismatchError where a name is no format that `write_formats` writes, or needs a rate that is not given."""
    for name in names:
        if name not in POSE_FORMAT_NAMES and (
            name not in CAMERA_FORMAT_NAMES or camera_format(name).write is None
        ):
            known = ", ".join(
                (*POSE_FORMAT_NAMES, *(each.name for each in CAMERA_FORMATS if each.write))
            )
            raise MismatchError(f"--write: expected one of {known}, found {name!r}; choose another")
        if name in POSE_FORMAT_NAMES and pose_format(name).timed and fps is None:
            raise MismatchError(
                f"--write {name}: expected the number of frames per second, found none; say it with --fps"
            )


def write_formats(
    output: Path, rig: CameraRig, file: PoseFile, names: tuple[str, ...], source: Mapping[str, Any]
) -> list[str]:
    """Writes further formats into the folder of a run, and says what they do not hold. Raises MismatchError.

    Cameras go to a folder called as the format, poses to poses3d and the ending of the format (SLEAP-anipose: points3d.h5).
    """
    said = []
    for name in names:
        if name in CAMERA_FORMAT_NAMES:
            called = next(iter(format_rig(rig, name, source).files))
            path = output / name if camera_format(name).folder else output / name / called
            lost = write_cameras(path, rig, name, source)
        else:
            path = output / (
                f"poses3d{''.join(pose_format(name).endings)}"
                if pose_format(name).endings
                else "points3d.h5"
            )
            lost = write_poses(path, file, name)
            if pose_format(name).single:
                outputs.remove_stale(path, len(file.individuals))
        said += _said("written", name, (), lost)[1:]
    return said
