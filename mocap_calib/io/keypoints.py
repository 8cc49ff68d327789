"""Read and write keypoint files: a camera each, or several; files, or folders of frames."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.errors import FormatError, MismatchError, MocapCalibError, argument
from mocap_calib.io.atomic import check_no_other_files, write_files
from mocap_calib.io.cameras import FILE_NAME, need_names
from mocap_calib.io.crash_guard import end_calls, guard_hdf5
from mocap_calib.io.detections import check_cameras, find_camera, frame_number
from mocap_calib.io.document import Document, as_document
from mocap_calib.io.file import check_no_media, find_repeated, readable_name
from mocap_calib.io.format import FormatTable, Written
from mocap_calib.io.formats import (
    coco,
    dannce,
    deeplabcut,
    deeplabcut_h5,
    dltdv,
    freemocap,
    mmpose,
    movement,
    nwb,
    openpose,
    sleap,
    sleap_csv,
    tables,
    ultralytics,
    ultralytics_results,
    wide_tables,
)
from mocap_calib.io.read_options import ReadOptions, apply_offsets, convert_to_pixels, split_views
from mocap_calib.types import Keypoints2D, Reals

# the first whose sniff says yes reads the file
KEYPOINT_FORMATS = FormatTable(
    "keypoints",
    (
        coco.ANNOTATIONS,
        openpose.FORMAT,
        mmpose.IMAGES,
        mmpose.VIDEO,
        deeplabcut.SUPERANIMAL,
        ultralytics_results.IMAGES,
        ultralytics_results.VIDEO,
        coco.RESULTS,
        coco.ALPHAPOSE,
        deeplabcut_h5.HDF5,
        sleap.ANALYSIS,
        sleap.PROJECT,
        movement.KEYPOINTS,
        nwb.KEYPOINTS,
        dannce.KEYPOINTS,
        freemocap.FORMAT,
        deeplabcut.CSV,
        sleap_csv.FORMAT,
        tables.CALISCOPE,
        tables.PLAIN,
        dltdv.POINTS,
        wide_tables.FORMAT,
        ultralytics.FORMAT,
    ),
)
FOLDER_SUFFIXES = (".json", ".csv", ".h5", ".hdf5", ".nc", ".nwb", ".slp", ".mat", ".npy")
SUFFIXES = (*FOLDER_SUFFIXES, ".txt")  # the last only where there is nothing else
_FILTERED = "_filtered"  # end of the names of files of DeepLabCut's filterpredictions
_REMEDY = "export one of these (docs/formats.md)"


# --- reading


def read_keypoints(
    paths: str | Path | bytes | Sequence[str | Path],
    format: str | None = None,
    options: ReadOptions | None = None,
) -> tuple[Keypoints2D, ...]:
    """Read the detections of each camera from files, folders and `name=path` pairs.

    Positions are pixels as the files have them: x to the right, y down.

    paths: one of these, or several, or the content of one file.
    format: name of a keypoint format; where none is given, the content of each file says it.

    Raises FormatError, in one line, for whatever is wrong with a file, and MismatchError where two
    files are of one camera.
    """
    views, errors = read_what_can(paths, format, options)
    if errors:
        raise errors[0]
    return views


def read_what_can(
    paths: str | Path | bytes | Sequence[str | Path],
    format: str | None = None,
    options: ReadOptions | None = None,
) -> tuple[tuple[Keypoints2D, ...], list[MocapCalibError]]:
    """Read the files that can be read; return also what `read_keypoints` raises of the others.

    Raises MismatchError as `read_keypoints` does.
    """
    options = options or ReadOptions()
    if format is not None:
        KEYPOINT_FORMATS.find(format)
    if isinstance(paths, bytes):
        documents = [as_document(paths)]
    else:
        several = [paths] if isinstance(paths, str | Path) else paths
        documents = list_documents(several, options, format)
    found: list[tuple[Keypoints2D, ...] | MocapCalibError] = []
    try:
        found.extend(_read_all(documents, format, options))
    except BaseException:
        end_calls()  # of threads, which Ctrl-C does not reach
        raise
    errors = [each for each in found if isinstance(each, MocapCalibError)]
    views = [view for each in found if not isinstance(each, MocapCalibError) for view in each]
    cameras = [view.camera for view in views]
    for camera in find_repeated(cameras):
        files = " and ".join(view.source for view in views if view.camera == camera)
        twice, remedy = f"{files} for camera {camera}", "leave one out, or say name=path"
        raise MismatchError("", "one keypoint file per camera", twice, remedy)
    return (tuple(views), errors) if errors else (apply_offsets(views, options), [])


def looks_like_keypoints(path: Path) -> bool:
    """Return whether the first file, or folder of frames, at a path is of one of the formats."""
    try:
        return bool(_sniffed(list_documents([path], ReadOptions())[0]).format)
    except MocapCalibError:
        return False


def _read_all(
    documents: list[Document], format: str | None, options: ReadOptions
) -> Iterator[tuple[Keypoints2D, ...] | MocapCalibError]:
    """Yield the cameras in each document, or what is wrong with it; the list is empty after.

    HDF5, which other processes read, is read side by side. Any other file is held in memory while
    it is read: one at a time.
    """

    def read(document: Document) -> tuple[Keypoints2D, ...] | MocapCalibError:
        try:
            views = guard_hdf5(document, _read, document, format, options)
            if document.is_hdf5:  # what another process hands over lies in memory
                views = tuple(_copy(view, view.positions.dtype) for view in views)
            return views
        except MocapCalibError as error:
            return error

    waiting = (documents.pop(0) for _ in range(len(documents)))  # a document holds its file
    for is_hdf5, some in groupby(waiting, _is_hdf5):
        run = map_in_threads if is_hdf5 else map
        yield from run(read, some)


def _is_hdf5(document: Document) -> bool:
    """Return whether a document is HDF5, as far as it can be read."""
    try:
        return document.is_hdf5
    except MocapCalibError:
        return False


def _read(document: Document, format: str | None, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras in a document. Raises FormatError and MismatchError."""
    source = document.source
    known = KEYPOINT_FORMATS.require(document, format, _REMEDY)
    views, unused = known.read_noted(document, options)
    views = tuple(replace(view, remarks=(*view.remarks, *unused)) for view in views)
    check_cameras([view.camera for view in views], source)
    if document.named:
        if len(views) > 1:
            found, remedy = ", ".join(view.camera for view in views), "give the file without a name"
            raise MismatchError(source, f"the one camera {document.camera}", found, remedy)
        views = (replace(views[0], camera=document.camera),)
    if not all(view.camera for view in views):
        expected = f"a camera in the path by the pattern {options.camera_pattern}"
        raise document.refuse(expected, "none", f"change {argument('camera_regex')}")
    read = []
    for view in (part for whole in views for part in split_views(whole, options.views)):
        scaled = convert_to_pixels(view, options.size_of(view.camera))
        if options.single_precision:
            scaled = _copy(scaled, np.float32)
        names = tuple(readable_name(name, source, "keypoint") for name in view.keypoints)
        read.append(replace(scaled, camera=readable_name(view.camera, source), keypoints=names))
    return tuple(read)


def _copy(view: Keypoints2D, kind: DTypeLike) -> Keypoints2D:
    """Return the view with arrays of a type, copied block by block; long ones lie on disk."""

    def copied(array: Reals) -> Reals:
        cast = np.errstate(over="ignore")(lambda block: array[block].astype(kind))  # to infinity
        return mapped.in_blocks(cast, len(array))

    return replace(view, positions=copied(view.positions), confidence=copied(view.confidence))


# --- the documents in files and folders


def list_documents(
    paths: Sequence[str | Path], options: ReadOptions, format: str | None = None
) -> list[Document]:
    """Return the documents in files, folders and `name=path` pairs.

    A folder holds a file per camera, or folders of them, or, where the format of its first file
    says so, the frames of one camera. Where it has files and folders, and only one of the two shows
    keypoints, the other is something else (notes, 3D poses, results) and is left out.

    The camera is what the pattern of the options finds in the path; else what the user says; else
    the name of the folder that holds the frames or nothing but the file; else the file's stem.

    format: name of the only format that is looked for; None: all of them.

    Raises MismatchError, and FormatError for videos and images.
    """
    files = [Path(path) for path in paths if "=" not in str(path)]
    left_out = {*find_superseded_files([file for file in files if not file.is_dir()])}
    read = [path for path in paths if Path(path) not in left_out]
    return [each for path in read for each in _of_argument(str(path), options, format)]


def find_superseded_files(paths: Sequence[Path]) -> list[Path]:
    """Return the files of folders, and of files, in whose place another one beside them is read.

    That is the .h5 of a .csv, and the `_filtered` of either, as DeepLabCut writes them; its own
    triangulation takes the filtered ones, too.
    """
    files = [each for path in paths for each in (_list_files(path) if path.is_dir() else [path])]
    tables = [file for file in files if file.suffix.lower() in (".h5", ".csv")]
    stems = {file.with_suffix("") for file in tables}
    binary = {file.with_suffix("") for file in tables if file.suffix.lower() == ".h5"}
    return [
        file
        for file in tables
        if file.with_name(f"{file.stem}{_FILTERED}") in stems
        or (file.suffix.lower() == ".csv" and file.with_suffix("") in binary)
    ]


def _of_argument(text: str, options: ReadOptions, format: str | None) -> list[Document]:
    """Return the documents of one argument: a path, or `name=path`."""
    name, equals, rest = text.partition("=")
    if not equals or Path(text).exists():
        return _of_path(Path(text), options, format)
    if not name or not rest:
        raise MismatchError("", "name=path", text, "say which camera the file is of")
    found = _of_argument(rest, options, format)
    if len(found) != 1:
        expected = f"the keypoints of the one camera {name}"
        raise MismatchError(rest, expected, f"{len(found)} files", "name each of them")
    return [replace(found[0], camera=name, named=True)]


def _of_path(path: Path, options: ReadOptions, format: str | None) -> list[Document]:
    """Return the documents of a file or folder; the pattern names their cameras where it is given.

    Raises MismatchError, and FormatError for videos and images.
    """
    found = _of_folder(path, format) if path.is_dir() else []
    if not found:
        check_no_media(path, SUFFIXES)
    if not found and not path.is_dir():
        found = [Document(path, camera=_stem(path))]
    if not found:
        expected = f"keypoint files ({', '.join(SUFFIXES)}) in the folder"
        raise MismatchError(path, expected, "none", "name the files themselves")
    if not options.camera_pattern:
        return found
    # a camera that the pattern does not find in the path may be found by the reader in the file
    return [
        replace(each, camera=find_camera(str(each.path), options.camera_pattern)) for each in found
    ]


def _of_folder(folder: Path, format: str | None) -> list[Document]:
    """Return the documents of a folder: of its files, of its folders, or of both."""
    files, folders = _of_files(folder, format), _of_subfolders(folder, format)
    if files and folders:
        files_show, folders_show = (
            any(_sniffed(each, format).format != "" for each in some) for some in (files, folders)
        )
        if files_show != folders_show:
            return files if files_show else folders
    return files + folders


def _of_files(folder: Path, format: str | None) -> list[Document]:
    """Return a document per file, or one where the files are frames."""
    files = _list_files(folder)
    if not files:
        return []
    frames = Document(folder, camera=_camera_of_folder(folder), members=tuple(files))
    if not frames.is_hdf5:
        frames = _sniffed(frames, format)
        if frames.format and KEYPOINT_FORMATS.find(frames.format).per_frame:
            return [frames]
    return [
        Document(
            file,
            camera=_stem(file),
            format=(frames.format or None) if file.absolute() == frames.file else None,
        )
        for file in sorted({*files} - {*find_superseded_files(files)})
    ]


def _of_subfolders(folder: Path, format: str | None) -> list[Document]:
    """Return the documents in the folders of a folder; one that is alone names its camera."""
    documents: list[Document] = []
    for subfolder in sorted(folder.iterdir()):
        if subfolder.is_dir() and not subfolder.name.startswith("."):
            found = _of_folder(subfolder, format)
            if len(found) == 1:
                found = [replace(found[0], camera=_camera_of_folder(subfolder))]
            documents += found
    return documents


def _camera_of_folder(folder: Path) -> str:
    """Return the camera: OpenPose's folder ends in _json, Ultralytics' holds a folder `labels`."""
    path = folder.absolute()
    return (path.parent if folder.name == "labels" else path).name.removesuffix("_json")


def _list_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold keypoints, by name.

    Texts are mostly notes: they count where there is nothing else, and then only those that are
    numbered, as frames are, where there are any.
    """
    files = sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    )
    data = [file for file in files if file.suffix.lower() != ".txt"]
    numbered = [file for file in files if frame_number(file.name) >= 0]
    return data or numbered or files


def _stem(path: Path) -> str:
    """Return the file's name without its suffix, and without SLEAP's second one."""
    return path.stem.removesuffix(".analysis")


def _sniffed(document: Document, format: str | None = None) -> Document:
    """Return the document with the format that its content shows; as it is where that is known.

    It is left unknown for a damaged file, which is refused when it is read.

    format: name of the only format to try; None: all of them.
    """
    if document.format is not None:
        return document
    try:
        found = guard_hdf5(document, KEYPOINT_FORMATS.sniff, document, format)
    except FormatError:
        return document
    return replace(document, format=found)  # without the content: many need not fit into memory


# --- writing


def format_keypoints(views: tuple[Keypoints2D, ...], format: str) -> Written:
    """Return the files of the cameras in the format, and what of the views they do not hold.

    Raises MismatchError where the format is only read or cannot hold the detections.
    """
    known = KEYPOINT_FORMATS.find(format)
    for view in views:
        if known.followed and not view.tracked and view.positions.shape[1] > 1:
            expected = f"one individual or followed ones, as {known.title} has"
            found, remedy = "detections in any order", "choose csv or coco"
            raise MismatchError(view.source, expected, found, remedy)
    unsigned = (replace(view, positions=view.positions + 0.0) for view in views)  # no -0.0
    files = known.writer()(tuple(unsigned))
    return Written(files, known.lost(views))


def write_keypoints(
    path: str | Path,
    views: tuple[Keypoints2D, ...],
    format: str,
    *,
    beside: Mapping[str, bytes] | None = None,
) -> tuple[str, ...]:
    """Write the cameras in the format, whole or not at all.

    A format with one file for all cameras writes `path`, where that has an ending; others fill the
    folder `path`. Returns what of the views is not held. Raises MismatchError as `format_keypoints`
    does, and where the folder has files of another recording.

    beside: further files, name -> content, of the folder; beside a file they are called
        FILE.NAME.
    """
    path, beside = Path(path), beside or {}
    written = format_keypoints(views, format)
    if len(written.files) == 1 and path.suffix:
        (content,) = written.files.values()
        named = {f"{path.name}.{name}": further for name, further in beside.items()}
        write_files(path.absolute().parent, {path.name: content, **named})
        return written.lost
    for view in views:  # a name may come from inside a file, and lead anywhere
        need_names((view.camera,), *FILE_NAME, view.source)
    check_no_other_files(path, written.files, FOLDER_SUFFIXES)
    write_files(path, {**written.files, **beside})
    return written.lost
