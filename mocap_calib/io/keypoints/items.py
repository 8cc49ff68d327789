"""Turn paths into what is read in one go.

That is a file, a folder with a file per camera, or a folder with a file per frame.
"""

from collections.abc import Callable, Sequence
from enum import Enum, auto
from pathlib import Path

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import find_camera, frame_number
from mocap_calib.io.keypoints.document import Item, ReadOptions

FOLDER_SUFFIXES = (".json", ".csv", ".h5", ".hdf5", ".nc", ".nwb", ".slp", ".mat")
SUFFIXES = (*FOLDER_SUFFIXES, ".txt")  # the last only where there is nothing else


class Holds(Enum):
    """What a file shows of itself: keypoints of a camera, of a single frame, or none."""

    A_CAMERA = auto()
    A_FRAME = auto()
    NOTHING = auto()


Look = Callable[[Item], Holds]


def keypoint_items(paths: Sequence[str | Path], options: ReadOptions, look: Look) -> list[Item]:
    """Return the items in files, folders and `name=path` pairs.

    A folder holds a file per camera, or folders of them, or, where `look` says so of its first
    file, the frames of one camera. Where it has files and folders, and only one of the two shows
    keypoints, the other is something else (notes, 3D poses, results) and is left out.

    The camera is what the pattern of the options finds in the path; else what the user says; else
    the name of the folder that holds the frames or nothing but the file; else the file's stem.

    Raises MismatchError.
    """
    items: list[Item] = []
    for path in paths:
        items += _items_of_argument(str(path), options, look)
    return items


def twins(folder: Path) -> list[Path]:
    """Return the .csv files beside an .h5 file of the same name, as DeepLabCut writes them.

    The .h5 is read in their place.
    """
    files = _list_files(folder)
    binary = {file.stem for file in files if file.suffix.lower() == ".h5"}
    return [file for file in files if file.suffix.lower() == ".csv" and file.stem in binary]


def _items_of_argument(argument: str, options: ReadOptions, look: Look) -> list[Item]:
    """Return the items of one argument: a path, or `name=path`."""
    name, equals, rest = argument.partition("=")
    if not equals or Path(argument).exists():
        return _items_of_path(Path(argument), options, look)
    if not name or not rest:
        raise MismatchError(
            f"expected name=path, found {argument}; say which camera the file is of"
        )
    items = _items_of_argument(rest, options, look)
    if len(items) != 1:
        raise MismatchError(
            f"{rest}: expected the keypoints of the one camera {name}, "
            f"found {len(items)} files; name each of them"
        )
    return [Item(name, items[0].path, items[0].members, named=True)]


def _items_of_path(path: Path, options: ReadOptions, look: Look) -> list[Item]:
    """Return the items of a file or folder; the pattern names their cameras where it is given."""
    items = _items_of_folder(path, look) if path.is_dir() else [Item(_stem(path), path)]
    if not items:
        raise MismatchError(
            f"{path}: expected keypoint files ({', '.join(SUFFIXES)}) in the folder, found none; "
            "name the files themselves"
        )
    if not options.camera_pattern:
        return items
    # a camera that the pattern does not find in the path may be found by the reader in the file
    return [
        Item(find_camera(str(item.path), options.camera_pattern), item.path, item.members)
        for item in items
    ]


def _items_of_folder(folder: Path, look: Look) -> list[Item]:
    """Return the items of a folder: of its files, of its folders, or of both."""
    files = _items_of_files(folder, look)
    folders = _items_of_subfolders(folder, look)
    if files and folders:
        files_show = _show_keypoints(files, look)
        folders_show = _show_keypoints(folders, look)
        if files_show != folders_show:
            return files if files_show else folders
    return files + folders


def _show_keypoints(items: list[Item], look: Look) -> bool:
    return any(look(item) is not Holds.NOTHING for item in items)


def _items_of_files(folder: Path, look: Look) -> list[Item]:
    """Return an item per file, or one item where the files are frames."""
    files = _list_files(folder)
    frames = Item(_camera_of_folder(folder), folder, tuple(files))
    if files and not frames.document.is_hdf5 and look(frames) is Holds.A_FRAME:
        return [frames]
    unread = twins(folder)
    return [Item(_stem(file), file) for file in files if file not in unread]


def _items_of_subfolders(folder: Path, look: Look) -> list[Item]:
    """Return the items in the folders of a folder; one with a single item names its camera."""
    subfolders = sorted(
        path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")
    )
    items: list[Item] = []
    for subfolder in subfolders:
        found = _items_of_folder(subfolder, look)
        if len(found) == 1:
            found = [Item(_camera_of_folder(subfolder), found[0].path, found[0].members)]
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
