"""Read camera files of any format of `io.cameras.formats`.

`read_cameras` returns intrinsics; `read_rig` also where the cameras stand; `load_cameras` all that
a file says.
"""

from dataclasses import replace
from functools import reduce
from itertools import combinations
from pathlib import Path

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.io.cameras.comments import read_comments
from mocap_calib.io.cameras.formats import (
    CAMERA_FORMATS,
    FOLDER_ENDINGS,
    ONE_CAMERA_ENDINGS,
    CameraFormat,
)
from mocap_calib.io.cameras.intrinsics import describe_keys
from mocap_calib.io.cameras.source import CameraFile, Source, join_camera_files, unique
from mocap_calib.io.file import read_bytes
from mocap_calib.io.media import name_media
from mocap_calib.io.names import camera_name
from mocap_calib.io.provenance import read_description
from mocap_calib.io.registry import find_format, format_names
from mocap_calib.io.units import ARBITRARY, known_unit, refuse_unit
from mocap_calib.recording.names import compose_name
from mocap_calib.types import Camera, CameraRig

_OWN = "cameras.yaml"  # what the results of a run are told by, beside one of these
_BESIDE_OWN = {"run.json", "calibration.toml"}
_REMEDY = "give what a calibration program wrote (docs/formats.md), not the keypoints"


def read_cameras(path: str | Path, format: str | None = None) -> tuple[Camera, ...]:
    """Read the intrinsics of the cameras in a file or folder.

    format: name of a camera format; where none is given, the content says it.

    Raises FormatError.
    """
    return load_cameras(path, format).cameras


def read_rig(path: str | Path, format: str | None = None, unit: str | None = None) -> CameraRig:
    """Read the cameras in a file or folder and where they stand.

    format: name of a camera format; where none is given, the content says it.
    unit: what a length of 1 is ("m", "cm", "mm"), where the file does not say.

    Raises FormatError, also where extrinsics are absent, and MismatchError where the file states
    another unit.
    """
    return make_rig(load_cameras(path, format, unit), str(path))


def make_rig(found: CameraFile, source: str) -> CameraRig:
    """Return the rig that a file holds. Raises FormatError where a camera has no extrinsics."""
    bare = [camera.name for camera in found.cameras if camera.name not in found.extrinsics]
    if bare:
        raise FormatError(
            source,
            "extrinsics (rotation and translation) of every camera: where it stands",
            f"none of {', '.join(bare)}",
            "give a calibrated file, as the cameras.yaml of a run, or remove these cameras",
        )
    extrinsics = [found.extrinsics[camera.name] for camera in found.cameras]
    return CameraRig(
        cameras=found.cameras,
        rotation=np.stack([rotation for rotation, _ in extrinsics]),
        translation=np.stack([translation for _, translation in extrinsics]),
        unit=found.unit or ARBITRARY,
        clocks=found.clocks,
        world=found.world,
    )


def load_cameras(
    path: str | Path, format: str | None = None, unit: str | None = None
) -> CameraFile:
    """Read all that a file or a folder says of cameras; the arguments are those of `read_rig`.

    Raises FormatError and MismatchError.
    """
    path = Path(path)
    if path.is_dir():
        return _load_folder(path, format, unit)
    if found := name_media(path):
        raise FormatError(str(path), _expected_formats(), found, _REMEDY)
    return parse_content(read_bytes(path), str(path), format, unit)


def parse_content(
    content: bytes, source: str, format: str | None = None, unit: str | None = None
) -> CameraFile:
    """Return what `load_cameras` does of the content of one file; `source` stands for its path."""
    file = Source(source, {Path(source).name or source: content})
    for each in _candidates(format):
        # a format that is named is taken at its word: its own complaint says more
        if format is not None or each.sniff(file):
            return _complete(_read_judged(each, file), each, source, unit)
    raise _unknown(file)


def looks_like_cameras(path: Path, content: bytes | None = None) -> bool:
    """Return whether a file (or its content) or a folder is of one of the camera formats.

    Raises FormatError where its JSON, TOML or YAML is broken.
    """
    if content is None and path.is_dir():
        return _folder_looks_like_cameras(path)
    file = Source(str(path), {path.name: read_bytes(path) if content is None else content})
    return any(each.sniff(file) for each in CAMERA_FORMATS)


def _folder_looks_like_cameras(path: Path) -> bool:
    """Return whether the names of a folder's files, or the first file, are of a camera format."""
    names = [file.name for file in path.iterdir() if file.suffix.lower() in FOLDER_ENDINGS]
    folder = Source(str(path), dict.fromkeys(names, b""), folder=True)
    if any(each.sniff(folder) for each in CAMERA_FORMATS if each.folder):
        return True
    files = _list_files(path, ONE_CAMERA_ENDINGS)
    return bool(files) and looks_like_cameras(files[0])


def _load_folder(path: Path, format: str | None, unit: str | None) -> CameraFile:
    """Read a folder that is one format's files, a run's results, or has a file per camera."""
    files = _list_files(path, FOLDER_ENDINGS)
    if not files:
        raise _no_camera_files(path, FOLDER_ENDINGS, "none")
    names = {file.name for file in files}
    if _OWN in names and names & _BESIDE_OWN:
        return load_cameras(path / _OWN, format, unit)
    contents = {file.name: read_bytes(file) for file in files}
    folder = Source(str(path), contents, folder=True)
    for each in _candidates(format):
        if each.sniff(folder):
            return _complete(_read_judged(each, folder), each, str(path), unit)
    parts = [
        parse_content(content, f"{path}/{name}", format, unit)
        for name, content in contents.items()
        if name.lower().endswith(ONE_CAMERA_ENDINGS)
    ]
    if not parts:
        raise _no_camera_files(path, ONE_CAMERA_ENDINGS, ", ".join(contents))
    return reduce(lambda found, more: join_camera_files(found, more, str(path)), parts)


def _list_files(path: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the files of a folder that are not hidden and have one of the endings, by name."""
    return sorted(
        file
        for file in path.iterdir()
        if file.suffix.lower() in endings and file.is_file() and not file.name.startswith(".")
    )


def _no_camera_files(path: Path, endings: tuple[str, ...], found: str) -> FormatError:
    expected = f"camera files ({', '.join(endings)}) in the folder"
    return FormatError(str(path), expected, found, "give the file itself")


def _candidates(format: str | None) -> tuple[CameraFormat, ...]:
    """Return the format that is named, or all of them."""
    return CAMERA_FORMATS if format is None else (find_format(CAMERA_FORMATS, format),)


def _unknown(file: Source) -> FormatError:
    """Return the complaint about a file that is of no camera format."""
    if not file.content.strip():
        found = "an empty file"
    elif file.syntax == "json" and isinstance(file.tree, dict):
        found = f"a JSON object with {describe_keys(file.tree)}"
    elif file.syntax != "binary" and file.text.strip():
        found = f"text that begins with {' '.join(file.text.split())[:20]!r}"
    else:
        found = "another file"
    return FormatError(file.path, _expected_formats(), found, _REMEDY)


def _expected_formats() -> str:
    """Return the formats that are read, for complaints."""
    return f"cameras, one of: {', '.join(format_names(CAMERA_FORMATS))}"


def _read_judged(form: CameraFormat, source: Source) -> CameraFile:
    """Return what a source says, with the verdict in its comments where it has none elsewhere.

    Raises FormatError.
    """
    found = _compose_names(form.read(source), source.path)
    if found.judgement:
        return found
    comments = (read_comments(content) for content in source.files.values())
    judged = (read_description(lines) for lines in comments)
    return replace(found, judgement=next(filter(None, judged), {}))


def _compose_names(found: CameraFile, source: str) -> CameraFile:
    """Return what was found under names as they are compared, see `compose_name`.

    Raises FormatError where a name is no text, or two cameras have one name then.
    """
    cameras = (replace(each, name=camera_name(each.name, source)) for each in found.cameras)
    extrinsics = {compose_name(name): placed for name, placed in found.extrinsics.items()}
    return replace(found, cameras=unique(cameras, source), extrinsics=extrinsics)


def _complete(found: CameraFile, form: CameraFormat, source: str, unit: str | None) -> CameraFile:
    """Return what was found with its unit of length, and notes of cameras in one place.

    The unit is what the file states, else the user, else the format. Raises MismatchError where
    the file contradicts the user.
    """
    stated = known_unit(found.unit, source)
    if unit is not None and found.unit.strip().lower() == ARBITRARY:
        raise refuse_unit(source, unit)
    if unit is not None and stated not in (ARBITRARY, unit):
        raise MismatchError(
            source,
            f"lengths in {stated}, as the file says",
            argument("input_unit", unit),
            "leave it out",
        )
    if stated == ARBITRARY:
        stated = unit or form.unit or ARBITRARY
    return replace(found, unit=stated, notes=(*found.notes, *_note_same_places(found)))


def _note_same_places(found: CameraFile) -> list[str]:
    """Return notes of cameras that stand in one place and look one way.

    Such a calibration went wrong, or one camera was copied from the other.
    """
    notes = []
    for (first, here), (second, there) in combinations(found.extrinsics.items(), 2):
        if np.array_equal(here[0], there[0]) and np.array_equal(here[1], there[1]):
            notes.append(
                f"cameras {first} and {second} stand in the same place and look the same way: "
                "one of them is wrong"
            )
    return notes
