"""From what was typed to a recording: which file belongs to which camera, and what the files hold.

Imports numpy and the readers: commands import this module when they run, so that --help stays quick.
"""

import hashlib
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.cameras.load import load_cameras, make_rig, parse_content
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.file import decode
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.formats import read_keypoints
from mocap_calib.io.keypoints.items import twins
from mocap_calib.io.keypoints.layouts import parse_layout
from mocap_calib.io.results.results import read_matches_csv
from mocap_calib.recording.joints import (
    SHIPPED,
    choose_skeleton,
    load_aliases,
    load_skeleton,
    match_names,
)
from mocap_calib.recording.meanings import (
    describe_unshared,
    keypoint_meanings,
    unshared_keypoints,
)
from mocap_calib.recording.pairing import match_cameras, views_named, views_with_detections
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.two_view.solve import PairSolver
from mocap_calib.types import (
    Camera,
    CameraRig,
    Ints,
    Keypoints2D,
    LiftedPoses,
    Matches,
    Recording,
    Sample,
    Skeleton,
)
from mocap_calib_cli.options import STDIO
from mocap_calib_cli.progress import Reporter, table


def read_views(
    arguments: Sequence[str],
    reading: Mapping[str, Any] | None = None,
    *,
    single_precision: bool = False,
) -> tuple[Keypoints2D, ...]:
    """The detections of each camera; `reading` is what options.reading gives. Raises FormatError and MismatchError."""
    given = reading or {}
    return read_keypoints(
        arguments,
        given.get("format"),
        replace(read_options(given), single_precision=single_precision),
    )


def read_options(given: Mapping[str, Any]) -> ReadOptions:
    """What options.reading gives, as the readers take it. Raises MismatchError and click's BadParameter."""
    layout, views = given.get("layout"), given.get("views")
    pattern = given.get("camera_regex") or ""
    try:
        re.compile(pattern)
    except re.error as error:
        raise click.BadParameter(
            f"expected a regular expression, found {pattern} ({error})", param_hint="--camera-regex"
        ) from None
    return ReadOptions(
        layout=parse_layout(layout) if layout else (),
        image_size=image_size(given.get("image_size")),
        camera_pattern=pattern,
        frame_offset={
            camera: int(_numbers(text, 1, "--frame-offset")[0])
            for camera, text in _by_camera(given.get("frame_offset", ()), "--frame-offset")
        },
        crop_offset={
            camera: _pair(text, "--crop-offset")
            for camera, text in _by_camera(given.get("crop_offset", ()), "--crop-offset")
        },
        views=tuple(views.split(",")) if views else (),
    )


def image_size(text: str | None) -> tuple[int, int]:
    """(width, height) of `WxH`, (0, 0) where there is none. Raises click's BadParameter."""
    if text is None:
        return 0, 0
    width, height = _numbers(text.lower().replace("x", ","), 2, "--image-size")
    if min(width, height) <= 0:
        raise click.BadParameter(
            f"expected a width and a height above 0, as 1280x720, found {text}",
            param_hint="--image-size",
        )
    return int(width), int(height)


def _by_camera(texts: Sequence[str], option: str) -> list[tuple[str, str]]:
    """(camera, what is said of it)."""
    pairs = [text.rpartition(":") for text in texts]
    if not all(camera for camera, _, _ in pairs):
        raise click.BadParameter(
            f"expected camera:value, found {', '.join(texts)}", param_hint=option
        )
    return [(camera, value) for camera, _, value in pairs]


def _numbers(text: str, count: int, option: str) -> list[float]:
    """`count` numbers with commas between them."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if (
        len(values) != count
        or not all(abs(value) < 2**53 for value in values)
        or (option != "--crop-offset" and any(value % 1 for value in values))
    ):
        raise click.BadParameter(
            f"expected {'a whole number' if count == 1 else 'two numbers'}, found {text}",
            param_hint=option,
        )
    return values


def _pair(text: str, option: str) -> tuple[float, float]:
    x, y = _numbers(text, 2, option)
    return x, y


def read_recording(
    arguments: Sequence[str],
    cameras: tuple[Camera, ...],
    skeleton: Path | None,
    reporter: Reporter,
    reading: Mapping[str, Any] | None = None,
    *,
    model: str | None = None,
    placed: bool = False,
) -> tuple[Recording, str]:
    """Reads the keypoints of the cameras, and says which file went to which camera; with the name of the model, by default the one that fits.

    `skeleton` is a file of other names of joints; `reading` what options.reading gives. `placed`: the cameras are those of a rig, which may have left some
    out; their keypoints are left out too. Raises FormatError and MismatchError.
    """
    views = read_views(arguments, reading, single_precision=True)
    if placed:
        views = views_named(views, cameras) or views
    vocabulary, aliases = _asked(model, skeleton) if model else fitting(views, skeleton)
    recording = make_recording(views, cameras, vocabulary, aliases)
    usable = views_with_detections(views)
    unshared = unshared_keypoints(usable, keypoint_meanings(usable, vocabulary, aliases))
    reporter.say(
        *_mapping(views, cameras, recording, vocabulary.name),
        *([describe_unshared(unshared)] if unshared else []),
        *doubled(arguments),
    )
    return recording, model or vocabulary.name


def _asked(model: str, path: Path | None) -> tuple[Skeleton, dict[str, str]]:
    """The joints of the model that was asked for, and the names that a file gives them. Raises FormatError."""
    from mocap_calib_cli.model import vocabulary

    known = vocabulary(model)
    return known, load_aliases(path, known) if path else {}


def fitting(views: Sequence[Keypoints2D], path: Path | None) -> tuple[Skeleton, dict[str, str]]:
    """The shipped skeleton that knows most of the joints, by the names they have or a file gives them; and those names.

    Raises FormatError where no skeleton has the joints that the file names.
    """
    names = tuple(dict.fromkeys(name for view in views for name in view.keypoints))
    if path is None:
        return choose_skeleton(names), {}
    tried, refusals = [], []
    for shipped in map(load_skeleton, SHIPPED):
        try:
            tried.append((shipped, load_aliases(path, shipped)))
        except FormatError as error:
            refusals.append(error)
    if not tried:
        raise refusals[0]
    return max(
        tried,
        key=lambda each: int(
            (match_names(tuple(each[1].get(name, name) for name in names), each[0]) >= 0).sum()
        ),
    )


def _mapping(
    views: Sequence[Keypoints2D], cameras: tuple[Camera, ...], recording: Recording, model: str
) -> list[str]:
    """Lines that say which file belongs to which camera, which cameras are left out, and which joints the model knows."""
    rows = {}
    for view, name in zip(views, match_cameras(views, cameras), strict=True):
        detections = int(np.isfinite(view.positions[..., 0]).any(-1).sum())
        rows[name] = [name, view.source, str(len(view.frames)), str(detections)]
    nothing = [
        [camera.name, "(no keypoint file)", "-", "-"]
        for camera in cameras
        if camera.name not in rows
    ]
    lines = table(
        ["camera", "keypoints", "frames", "detections"],
        [*(rows[c.name] for c in cameras if c.name in rows), *nothing],
    )
    left = [camera.name for camera in cameras if camera.name not in recording.names]
    lines += [f"left out, nothing detected: {', '.join(left)}"] if left else []
    alone = _detections_alone(views, recording)
    lines += [f"{alone} detections in frames of a single camera are left out"] if alone else []
    strangers = [
        name
        for name, joint in zip(recording.keypoints, recording.vocabulary, strict=True)
        if joint < 0
    ]
    known = len(recording.keypoints) - len(strangers)
    lines += [
        f"{len(recording.frames)} frames; {len(recording.keypoints)} joints, the model of {model} knows {known}"
        + (f", not: {', '.join(strangers)}" if strangers else "")
    ]
    lines += (
        ["the model knows too few joints to help: calibrated by geometry alone"]
        if known < 4
        else []
    )
    return lines


def doubled(arguments: Sequence[str]) -> list[str]:
    """A line that says which files of the folders are left out for their .h5, if any."""
    doubles = [
        str(file) for folder in map(Path, arguments) if folder.is_dir() for file in twins(folder)
    ]
    return [f"left out, the .h5 beside it is read: {', '.join(doubles)}"] if doubles else []


def _detections_alone(views: Sequence[Keypoints2D], recording: Recording) -> int:
    """How many detections are in frames that no second camera has."""
    return sum(
        int(
            np.isfinite(view.positions[~np.isin(view.frames, recording.frames), ..., 0])
            .any(-1)
            .sum()
        )
        for view in views
    )


def cameras_of(path: str) -> tuple[Camera, ...]:
    """The intrinsics in a file or folder, or on stdin. Raises FormatError."""
    return _loaded(path, "--cameras").cameras


def rig_of(path: str, option: str = "--rig") -> CameraRig:
    """The cameras and where they stand in a file, or on stdin. Raises FormatError."""
    return make_rig(_loaded(path, option), "stdin" if path == STDIO else path)


def camera_file(path: str, option: str) -> CameraFile:
    """What a file or folder, or stdin, says of cameras. Raises FormatError."""
    return (
        parse_content(read_stdin(option).encode(), "stdin")
        if path == STDIO
        else load_cameras(Path(path))
    )


def _loaded(path: str, option: str) -> CameraFile:
    """The same; what it lacks is said on stderr."""
    found = camera_file(path, option)
    for note in () if click.get_current_context().params.get("quiet") else found.notes:
        click.echo(note, err=True)
    return found


def matches_of(path: str, recording: Recording) -> Matches:
    """The matches in a file, or on stdin. Raises FormatError and MismatchError."""
    return read_matches_csv(read_stdin("--matches") if path == STDIO else Path(path), recording)


def placed(recording: Recording, rig: CameraRig) -> CameraRig:
    """The rig with the cameras of the recording alone, in their order."""
    found = rig.select(np.array([rig.names.index(name) for name in recording.names]))
    return replace(found, cameras=recording.cameras)


def lifted_sample(
    recording: Recording, model: str, device: str, reporter: Reporter
) -> tuple[Ints, Sample, LiftedPoses]:
    """The frames (indices) that calibration looks at, and their detections, lifted. Raises MismatchError where there is no such device."""
    from mocap_calib.config import SampleConfig
    from mocap_calib.recording.sampling import choose_sample_frames, take_sample
    from mocap_calib.steerpose.lift import lift
    from mocap_calib_cli.model import load_model

    chosen = choose_sample_frames(recording, SampleConfig())
    some = take_sample(recording, chosen)
    return chosen, some, lift(some, load_model(device, model), device=device, progress=reporter)


def pair_solver(solver: str, recording: Recording, model: str) -> PairSolver | None:
    """The paper's way or the five-point way to calibrate a pair, or None for ours. Raises FormatError."""
    if solver == "search":
        return None
    from mocap_calib.config import FivePointConfig, PairwiseConfig, PaperConfig
    from mocap_calib.two_view.five_point_pairs import FivePointPairs
    from mocap_calib.two_view.paper_pairs import PaperPairs
    from mocap_calib_cli.model import load_model

    focal = np.array([camera.focal for camera in recording.cameras])
    if solver == "five-point":
        return FivePointPairs(focal, PairwiseConfig(), FivePointConfig())
    return PaperPairs(
        load_model("cpu", model), recording.vocabulary, focal, PairwiseConfig(), PaperConfig()
    )


def read_stdin(what: str) -> str:
    """All of stdin, for one input of the command."""
    meta = click.get_current_context().meta
    if "stdin" in meta:
        raise click.UsageError(
            f"{meta['stdin']} and {what} cannot both come from stdin; give a file for one of them"
        )
    meta["stdin"] = what
    return decode(sys.stdin.buffer.read(), "stdin")


def plain_paths(arguments: Iterable[str]) -> list[str]:
    """The paths of files, folders and name=path pairs."""
    return [
        argument if "=" not in argument or Path(argument).exists() else argument.partition("=")[2]
        for argument in arguments
    ]


def hashes(paths: Iterable[str | Path]) -> dict[str, str]:
    """Path -> SHA-256 of each regular file and of what lies in each folder; a pipe has been read and is left out.

    A folder within a folder, such as that of a camera's frames, has one for all its files and their names.
    """
    found = [
        each
        for path in map(Path, paths)
        for each in (sorted(path.iterdir()) if path.is_dir() else [path])
    ]
    return {str(path): _hash(path) for path in found if path.is_file() or path.is_dir()}


def _hash(path: Path) -> str:
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = [
        f"{file.relative_to(path)} {_hash(file)}"
        for file in sorted(path.rglob("*"))
        if file.is_file()
    ]
    return hashlib.sha256("\n".join(files).encode()).hexdigest()
