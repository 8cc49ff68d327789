"""List the documents of keypoints: files, or folders of frames."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.crash_guard import guard_hdf5
from mocap_calib.io.document import Document
from mocap_calib.io.file import find_camera, frame_number
from mocap_calib.io.format import find_format, sniff
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.media import check_no_media, check_no_media_alone

FOLDER_SUFFIXES = (".json", ".csv", ".h5", ".hdf5", ".nc", ".nwb", ".slp", ".mat")
SUFFIXES = (*FOLDER_SUFFIXES, ".txt")  # the last only where there is nothing else


def keypoint_items(
    paths: Sequence[str | Path], options: ReadOptions, format: str | None
) -> list[Document]:
    """Return the items in files, folders and `name=path` pairs.

    A folder holds a file per camera, or folders of them, or, where the format of its first file
    says so, the frames of one camera. Where it has files and folders, and only one of the two shows
    keypoints, the other is something else (notes, 3D poses, results) and is left out.

    The camera is what the pattern of the options finds in the path; else what the user says; else
    the name of the folder that holds the frames or nothing but the file; else the file's stem.

    format: name of the only format that is looked for; None: all of them.

    Raises MismatchError, and FormatError for videos and images.
    """
    items: list[Document] = []
    for path in paths:
        items += _items_of_argument(str(path), options, format)
    return items


def find_superseded_files(folder: Path) -> list[Path]:
    """Return the .csv files beside an .h5 file of the same name, as DeepLabCut writes them.

    The .h5 is read in their place.
    """
    files = _list_files(folder)
    binary = {file.stem for file in files if file.suffix.lower() == ".h5"}
    return [file for file in files if file.suffix.lower() == ".csv" and file.stem in binary]


def _items_of_argument(argument: str, options: ReadOptions, format: str | None) -> list[Document]:
    """Return the items of one argument: a path, or `name=path`."""
    name, equals, rest = argument.partition("=")
    if not equals or Path(argument).exists():
        return _items_of_path(Path(argument), options, format)
    if not name or not rest:
        raise MismatchError("", "name=path", argument, "say which camera the file is of")
    items = _items_of_argument(rest, options, format)
    if len(items) != 1:
        raise MismatchError(
            rest,
            f"the keypoints of the one camera {name}",
            f"{len(items)} files",
            "name each of them",
        )
    return [replace(items[0], camera=name, named=True)]


def _items_of_path(path: Path, options: ReadOptions, format: str | None) -> list[Document]:
    """Return the items of a file or folder; the pattern names their cameras where it is given.

    Raises MismatchError, and FormatError for videos and images.
    """
    check_no_media(path, SUFFIXES)
    items = (
        _items_of_folder(path, format) if path.is_dir() else [Document(path, camera=_stem(path))]
    )
    if not items:
        check_no_media_alone(path, SUFFIXES)
        raise MismatchError(
            path,
            f"keypoint files ({', '.join(SUFFIXES)}) in the folder",
            "none",
            "name the files themselves",
        )
    if not options.camera_pattern:
        return items
    # a camera that the pattern does not find in the path may be found by the reader in the file
    return [
        replace(item, camera=find_camera(str(item.path), options.camera_pattern)) for item in items
    ]


def _items_of_folder(folder: Path, format: str | None) -> list[Document]:
    """Return the items of a folder: of its files, of its folders, or of both."""
    files = _items_of_files(folder, format)
    folders = _items_of_subfolders(folder, format)
    if files and folders:
        files, files_show = _sniff_until_keypoints(files, format)
        folders, folders_show = _sniff_until_keypoints(folders, format)
        if files_show != folders_show:
            return files if files_show else folders
    return files + folders


def _sniff_until_keypoints(
    items: list[Document], format: str | None
) -> tuple[list[Document], bool]:
    """Return the items, sniffed up to the first that shows keypoints, and whether one does."""
    sniffed: list[Document] = []
    for number, item in enumerate(items, 1):
        sniffed.append(sniff_keypoints(item, format))
        if sniffed[-1].format != "":
            return sniffed + items[number:], True
    return sniffed, False


def _items_of_files(folder: Path, format: str | None) -> list[Document]:
    """Return an item per file, or one item where the files are frames."""
    files = _list_files(folder)
    if not files:
        return []
    frames = Document(folder, camera=_camera_of_folder(folder), members=tuple(files))
    if not frames.is_hdf5:
        frames = sniff_keypoints(frames, format)
        if _shows_single_frame(frames):
            return [frames]
    superseded = find_superseded_files(folder)
    return [
        Document(
            file,
            camera=_stem(file),
            format=frames.format if file.absolute() == frames.file else None,
        )
        for file in files
        if file not in superseded
    ]


def _items_of_subfolders(folder: Path, format: str | None) -> list[Document]:
    """Return the items in the folders of a folder; one with a single item names its camera."""
    subfolders = sorted(
        path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")
    )
    items: list[Document] = []
    for subfolder in subfolders:
        found = _items_of_folder(subfolder, format)
        if len(found) == 1:
            found = [replace(found[0], camera=_camera_of_folder(subfolder))]
        items += found
    return items


def _camera_of_folder(folder: Path) -> str:
    """Return the camera: OpenPose's folder ends in _json, Ultralytics' holds a folder `labels`."""
    path = folder.absolute()
    if folder.name == "labels":
        path = path.parent
    return path.name.removesuffix("_json")


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


def sniff_keypoints(document: Document, format: str | None = None) -> Document:
    """Return the document with the format that its content shows; as it is where that is known.

    It is left unknown for a damaged file, which is complained of when it is read.

    format: name of the only format to try; None: all of them.
    """
    if document.format is not None:
        return document
    try:
        found = guard_hdf5(document, sniff, KEYPOINT_FORMATS, document, format)
    except FormatError:
        return document
    # without the content: many documents need not fit into memory
    return replace(document, format=found)


def _shows_single_frame(document: Document) -> bool:
    """Return whether a sniffed document is of a format that has a file per frame."""
    if not document.format:
        return False
    return find_format(KEYPOINT_FORMATS, document.format).per_frame
