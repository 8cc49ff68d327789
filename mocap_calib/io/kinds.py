"""Find out what kind of files are given, and in which format to write them."""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path

from mocap_calib.errors import MismatchError, argument, suggest
from mocap_calib.io.camera_files import CAMERA_FORMATS, looks_like_cameras
from mocap_calib.io.file import check_no_media, plain_path
from mocap_calib.io.format import FormatTable, Kind, ending_of
from mocap_calib.io.keypoints import KEYPOINT_FORMATS, SUFFIXES, looks_like_keypoints
from mocap_calib.io.pose_files import POSE_FORMATS, looks_like_poses

# in the order in which content is looked at
FORMATS: Mapping[Kind, FormatTable] = {
    table.kind: table for table in (POSE_FORMATS, KEYPOINT_FORMATS, CAMERA_FORMATS)
}
OWN_POSES = "poses3d.h5"  # in the folder of a run

Sources = Sequence[str | Path] | bytes


def check_sources(sources: Sequence[str | Path]) -> None:
    """Raise MismatchError where a file or folder (or that of a `name=path` pair) is missing.

    Raises FormatError for a video or an image.
    """
    for path in map(plain_path, sources):
        if not path.is_dir():
            check_no_media(path, SUFFIXES)
        if not path.exists():
            raise MismatchError(path, "a file or folder", "none", "check the path")


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
        if to is not None and format is None and not isinstance(sources, bytes):
            _check_kind(sources, kinds[0], to)
        return kinds[0]
    shown = [kind for kind in kinds if _looks_like(kind, sources)]
    if to is None:
        ending = ending_of(output)
        for kind in shown or sorted(kinds):
            if ending in FORMATS[kind].by_ending:
                return kind
    return shown[0] if shown else "keypoints"


def choose_format(kind: Kind, output: str | Path) -> str:
    """Return the name of the format that the ending of the output says.

    Raises MismatchError where it says none, or several.
    """
    by_ending = FORMATS[kind].by_ending
    names = by_ending.get(ending_of(output), ())
    if len(names) > 1:
        remedy = f"say {' or '.join(argument('to', name) for name in names)}"
        raise MismatchError(output, f"the format of {kind} beside the ending", "none", remedy)
    if not names:
        known = ", ".join(f"{end} ({own[0]})" for end, own in by_ending.items() if len(own) == 1)
        written = ", ".join(FORMATS[kind].written)
        expected = f"an ending of {known}, or {argument('to')} and one of {written}"
        raise MismatchError(output, expected, "neither", "name the format")
    return names[0]


def _kinds_named(format: str | None, to: str | None) -> list[Kind]:
    """Return the kinds that have formats of these names; all where none is named."""
    kinds = list(FORMATS)
    for option, name in ((argument("from"), format), (argument("to"), to)):
        is_read = option == argument("from")
        known = {kind: each.read if is_read else each.names for kind, each in FORMATS.items()}
        having = [kind for kind in FORMATS if name in known[kind]]
        if name is not None and not having:
            expected = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in known.items())
            remedy = suggest(name, chain(*known.values()))
            raise MismatchError(option, f"a format ({expected})", f"{name!r}", remedy)
        fitting = [kind for kind in kinds if name is None or kind in having]
        if not fitting:
            expected = f"a format of {' or '.join(sorted(kinds))}, as {format} is"
            raise MismatchError(option, expected, name, "choose another")
        kinds = fitting
    return kinds


def _check_kind(sources: Sequence[str | Path], kind: Kind, to: str) -> None:
    """Raise MismatchError where the sources show another kind than that of the output's format.

    What shows no kind is left to the reader, which says more.
    """
    if _looks_like(kind, sources):
        return
    other = next((each for each in FORMATS if _looks_like(each, sources)), None)
    if other is not None:
        expected = f"a format of {other}, which INPUT holds"
        remedy = f"choose one of {', '.join(FORMATS[other].written)}"
        raise MismatchError(argument("to", to), expected, f"one of {kind}", remedy)


def _looks_like(kind: Kind, sources: Sources) -> bool:
    """Return whether the first source shows this kind; a pipe that is named is not read for it.

    Content of no other kind is taken for keypoints. Raises FormatError where its JSON, TOML or
    YAML is broken.
    """
    if isinstance(sources, bytes):
        return kind != "keypoints" and _LOOKS_LIKE[kind](sources)
    path = plain_path(sources[0])
    if kind == "keypoints":
        return (path.is_dir() or path.is_file()) and looks_like_keypoints(path)
    files = (path / OWN_POSES, path, *(sorted(path.iterdir()) if path.is_dir() else ()))
    first = next((file for file in files if file.is_file()), None)
    return first is not None and _LOOKS_LIKE[kind](first if kind == "poses" else path)


_LOOKS_LIKE: Mapping[Kind, Callable[[Path | bytes], bool]] = {
    "poses": looks_like_poses,
    "cameras": looks_like_cameras,
}
