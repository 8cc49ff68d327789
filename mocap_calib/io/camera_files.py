"""Read and write files of cameras: the table of formats, and what all of them share.

`read_cameras` returns intrinsics; `read_rig` also where the cameras stand; `load_cameras` all that
a file says. Lengths keep the unit that the file states or that the format is defined in; a format
without either leaves it open ("arbitrary") until someone says it.
"""

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, takewhile
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.io.atomic import check_no_other_files, write_bytes, write_files
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.crash_guard import guard_hdf5
from mocap_calib.io.document import Document, as_document
from mocap_calib.io.file import find_repeated, name_media, readable_name
from mocap_calib.io.format import Format, FormatTable, Written
from mocap_calib.io.formats import (
    anipose,
    colmap,
    dannce,
    dltdv,
    json_rigs,
    mc_calib,
    metashape,
    multical,
    opencap,
    opencv,
    openmvg,
    opensfm,
    own_cameras,
    qualisys,
    vicon,
)
from mocap_calib.io.provenance import describe_judgement, read_description
from mocap_calib.io.units import ARBITRARY, known_unit, refuse_unit, unit_factor
from mocap_calib.recording.names import compose_name
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraRig, EstimatedCamera

# in the order in which they are tried: what is particular comes first
CAMERA_FORMATS = FormatTable(
    "cameras",
    (
        own_cameras.FORMAT,
        anipose.CALISCOPE,
        anipose.FREEMOCAP,
        anipose.POSE2SIM,
        anipose.ANIPOSE,
        qualisys.FORMAT,
        vicon.FORMAT,
        metashape.FORMAT,
        opencap.FORMAT,
        dltdv.COEFFICIENTS,
        mc_calib.FORMAT,
        opencv.JARVIS,
        opencv.EASYMOCAP,
        opencv.KALIBR,
        opencv.ROS,
        opencv.OPENCV,
        colmap.BINARY,
        colmap.TEXT,
        multical.FORMAT,
        json_rigs.PANOPTIC,
        json_rigs.VOXELPOSE,
        json_rigs.FOUR_D_ASSOCIATION,
        json_rigs.NERFSTUDIO,
        openmvg.FORMAT,
        opensfm.FORMAT,
        json_rigs.MULTIVIEW_CALIB,
        dannce.CAMERAS,
    ),
)

# endings of files that may be one of several in a folder, and all that are looked at in a folder
ONE_CAMERA_ENDINGS = (".yml", ".yaml", ".toml", ".json", ".mat", ".xcp", ".xml", ".pickle")
FOLDER_ENDINGS = (*ONE_CAMERA_ENDINGS, ".txt", ".bin")  # the last two are COLMAP's


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
    path: str | Path | bytes, format: str | None = None, unit: str | None = None
) -> CameraFile:
    """Read all that a file or a folder says of cameras; the arguments are those of `read_rig`.

    path: or the content of a file.

    Raises FormatError and MismatchError.
    """
    document = as_document(path)
    if document.given is None and document.path.is_dir():
        return _say_lensless(_load_folder(document.path, format, unit), document.source)
    if found := name_media(document.path):
        raise document.refuse(CAMERA_FORMATS.expected, found, _REMEDY)
    return _say_lensless(load_document(document, format, unit), document.source)


def _say_lensless(found: CameraFile, source: str) -> CameraFile:
    """Return what a source holds, with a note of the cameras whose lens it does not state."""
    if not found.lensless:
        return found
    cameras = ", ".join(found.lensless)
    note = f"{source}: no lens distortion recognised for {cameras}: taken as none"
    return replace(found, notes=(note, *found.notes), lensless=())


def load_document(document: Document, format: str | None, unit: str | None) -> CameraFile:
    """Read all that a document says of cameras, see `load_cameras`."""
    # a format that is named is taken at its word: its own complaint says more
    if format is not None and not document.is_folder:
        document = replace(document, format=format)
    known = guard_hdf5(document, CAMERA_FORMATS.require, document, format, _REMEDY)
    found, unused = known.read_noted(document)
    found = replace(found, notes=(*found.notes, *unused))
    return _complete(found, known, document, unit)


def looks_like_cameras(path: Path | bytes) -> bool:
    """Return whether a file (or its content) or a folder is of one of the camera formats.

    Raises FormatError where its JSON, TOML or YAML is broken.
    """
    if isinstance(path, bytes) or not path.is_dir():
        return bool(CAMERA_FORMATS.sniff(as_document(path)))
    files = _list_files(path, FOLDER_ENDINGS)
    if files and CAMERA_FORMATS.sniff(Document(path, members=tuple(files))):
        return True
    single = _list_files(path, ONE_CAMERA_ENDINGS)
    return bool(single) and looks_like_cameras(single[0])


def _load_folder(path: Path, format: str | None, unit: str | None) -> CameraFile:
    """Read a folder that is one format's files, a run's results, or has a file per camera."""
    files = _list_files(path, FOLDER_ENDINGS)
    folder = Document(path, members=tuple(files))
    if _OWN in folder.names and set(folder.names) & _BESIDE_OWN:
        return load_cameras(path / _OWN, format, unit)
    if files and (shown := CAMERA_FORMATS.sniff(folder, format)):
        return load_document(replace(folder, format=shown), format, unit)
    single = [file for file in files if file.suffix.lower() in ONE_CAMERA_ENDINGS]
    single = single or [file for file in files if CAMERA_FORMATS.sniff(Document(file), format)]
    if not single:
        expected = f"camera files ({', '.join(FOLDER_ENDINGS)}) in the folder"
        raise folder.refuse(expected, ", ".join(folder.names) or "none", "give the file itself")
    parts = [load_document(Document(file), format, unit) for file in single]
    units = sorted({each.unit for each in parts})
    if len(units) > 1:
        found = " and ".join(units)
        raise folder.refuse("files in one unit of length", found, "convert one of them")
    judged = parts[0].judgement
    return CameraFile(
        cameras=_unique((camera for each in parts for camera in each.cameras), str(path)),
        extrinsics={name: given for each in parts for name, given in each.extrinsics.items()},
        unit=units[0],
        notes=tuple(dict.fromkeys(note for each in parts for note in each.notes)),
        lensless=tuple(name for each in parts for name in each.lensless),
        judgement=judged if all(each.judgement == judged for each in parts) else {},
    )


def _list_files(path: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the files of a folder that are not hidden and have one of the endings, by name."""
    return sorted(
        file
        for file in path.iterdir()
        if file.suffix.lower() in endings and file.is_file() and not file.name.startswith(".")
    )


def _unique(cameras: Iterable[Camera], source: str) -> tuple[Camera, ...]:
    """Return the cameras. Raises FormatError where there is none, or two have one name."""
    kept = tuple(cameras)
    if twice := find_repeated(camera.name for camera in kept):
        found = f"{', '.join(twice)} twice"
        raise FormatError(source, "each camera name once", found, "rename one of them")
    if not kept:
        raise FormatError(source, "at least one camera", "none", "export the cameras again")
    return kept


def _complete(found: CameraFile, form: Format, document: Document, unit: str | None) -> CameraFile:
    """Return what a format found, with names as they are compared (`compose_name`) and a unit.

    The unit is what the file states, else the user, else the format; the verdict is that of the
    file's comments, where it has none elsewhere. Raises FormatError where a name is no text, or
    two cameras have one name then, and MismatchError where the file contradicts the user.
    """
    source = document.source
    cameras = (replace(each, name=readable_name(each.name, source)) for each in found.cameras)
    extrinsics = {compose_name(name): placed for name, placed in found.extrinsics.items()}
    stated = known_unit(found.unit, source)
    if unit and found.unit.strip().lower() == ARBITRARY:
        raise refuse_unit(source, unit)
    if unit and stated not in (ARBITRARY, unit):
        expected = f"lengths in {stated}, as the file says"
        raise MismatchError(source, expected, argument("input_unit", unit), "leave it out")
    comments = (_read_comments(each.content) for each in document.documents())
    judged = map(read_description, comments)
    # cameras in one place that look one way: one was copied from the other
    alike = [
        f"cameras {first} and {second} stand in the same place and look the same way: "
        "one of them is wrong"
        for (first, here), (second, there) in combinations(extrinsics.items(), 2)
        if np.array_equal(here[0], there[0]) and np.array_equal(here[1], there[1])
    ]
    return replace(
        found,
        cameras=_unique(cameras, source),
        extrinsics=extrinsics,
        unit=(unit or form.unit or ARBITRARY) if stated == ARBITRARY else stated,
        notes=(*found.notes, *alike),
        judgement=found.judgement or next(filter(None, judged), {}),
    )


# --- writing


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
    known = CAMERA_FORMATS.find(format)
    write = known.writer()
    if known.unit:
        factor = unit_factor(rig.unit, known.unit, format)
        rig = replace(rig, translation=rig.translation * factor, unit=known.unit)
    points = points or ObservedPoints.none()
    written = write(rig, provenance, points) if known.points else write(rig, provenance)
    if len(points.positions) and not known.points:
        lost = f"{len(points.positions)} 3D points"
        written = replace(written, lost=(*written.lost, lost))
    remarks = [*describe_judgement(provenance), *_describe_estimates(rig)]
    return replace(written, files=_add_comments(written.files, remarks))


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
    if CAMERA_FORMATS.find(format).folder:
        check_no_other_files(path, written.files, FOLDER_ENDINGS)
        write_files(path, written.files)
    else:
        write_bytes(path, next(iter(written.files.values())))
    return written.lost


# --- comments at the head of files, where their syntax has comments

_WITH_COMMENTS = (".toml", ".yaml", ".yml", ".txt")
_MARK = b"# "
_FILE_STORAGE = b"%YAML:1.0\n---\n"  # OpenCV's header comes before any comment


def _describe_estimates(rig: CameraRig) -> list[str]:
    """Return a line for each camera whose intrinsics were estimated from the recording."""
    lines = []
    for camera in rig.cameras:
        if isinstance(camera, EstimatedCamera):
            focal = f"focal length {camera.focal:.1f} +- {camera.focal_sigma:.1f} px"
            k1 = f", k1 {camera.distortion[0]:.3f} +- {camera.k1_sigma:.3f}"
            lens = k1 if camera.k1_sigma else ""
            lines.append(
                f"camera {camera.name}: intrinsics estimated from the recording, {focal}{lens}"
            )
    return lines


def _add_comments(files: Mapping[str, bytes], lines: Sequence[str]) -> dict[str, bytes]:
    """Return the files (relative path -> content) with the lines at their head, as comments.

    JSON and binary files stay as they are.
    """
    comment = b"".join(_MARK + line.encode() + b"\n" for line in lines)
    written = dict(files)
    for name, content in files.items():
        if PurePath(name).suffix in _WITH_COMMENTS:
            header = _FILE_STORAGE if content.startswith(_FILE_STORAGE) else b""
            written[name] = header + comment + content.removeprefix(header)
    return written


def _read_comments(content: bytes) -> list[str]:
    """Return the lines of the comments at the head of a file, none where it has no comments."""
    lines = io.BytesIO(content.removeprefix(_FILE_STORAGE))  # not all of them: files may be large
    comments = takewhile(lambda line: line.startswith(_MARK), lines)
    return [line.strip(b"\r\n").removeprefix(_MARK).decode(errors="replace") for line in comments]
