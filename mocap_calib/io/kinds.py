"""Find out what kind of files are given, and in which format to write them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from mocap_calib.errors import MismatchError, argument, suggest
from mocap_calib.io.camera_files import CAMERA_FORMATS, looks_like_cameras
from mocap_calib.io.file import plain_path
from mocap_calib.io.format import FormatTable, Kind, ending_of
from mocap_calib.io.keypoints import KEYPOINT_FORMATS, SUFFIXES, looks_like_keypoints
from mocap_calib.io.media import check_no_media
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
        raise MismatchError(
            output,
            f"the format of {kind} beside the ending",
            "none",
            f"say {' or '.join(argument('to', name) for name in names)}",
        )
    if not names:
        known = ", ".join(f"{end} ({own[0]})" for end, own in by_ending.items() if len(own) == 1)
        written = ", ".join(FORMATS[kind].written)
        raise MismatchError(
            output,
            f"an ending of {known}, or {argument('to')} and one of {written}",
            "neither",
            "name the format",
        )
    return names[0]


def _kinds_named(format: str | None, to: str | None) -> list[Kind]:
    """Return the kinds that have formats of these names; all where none is named."""
    kinds = list(FORMATS)
    for option, name in ((argument("from"), format), (argument("to"), to)):
        if name is None:
            continue
        is_read = option == argument("from")
        known = {kind: each.read if is_read else each.names for kind, each in FORMATS.items()}
        having = [kind for kind in FORMATS if name in known[kind]]
        if not having:
            listed = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in known.items())
            every = [each for names in known.values() for each in names]
            raise MismatchError(option, f"a format ({listed})", f"{name!r}", suggest(name, every))
        fitting = [kind for kind in kinds if kind in having]
        if not fitting:
            raise MismatchError(
                option,
                f"a format of {' or '.join(sorted(kinds))}, as {format} is",
                name,
                "choose another",
            )
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
        names = ", ".join(FORMATS[other].written)
        raise MismatchError(
            argument("to", to),
            f"a format of {other}, which INPUT holds",
            f"one of {kind}",
            f"choose one of {names}",
        )


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
    if kind == "poses" and (path / OWN_POSES).is_file():
        first = path / OWN_POSES
    elif path.is_dir():
        first = min((file for file in path.iterdir() if file.is_file()), default=path)
    if not first.is_file():
        return False
    return looks_like_poses(first) if kind == "poses" else looks_like_cameras(path)


def _content_looks_like(kind: Kind, content: bytes) -> bool:
    """Return whether the content of a file shows this kind; keypoints are told by elimination."""
    if kind == "poses":
        return looks_like_poses(content)
    return kind == "cameras" and looks_like_cameras(content)
