"""From paths to what is read in one go: files, folders with a file per camera, folders with a file per frame."""

from collections.abc import Callable, Sequence
from enum import Enum, auto
from pathlib import Path

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import find_camera, frame_number
from mocap_calib.io.keypoints.document import Item, ReadOptions

FOLDER_SUFFIXES = (".json", ".csv", ".h5", ".hdf5", ".nc", ".nwb", ".slp", ".mat")
SUFFIXES = (*FOLDER_SUFFIXES, ".txt")  # the last only where there is nothing else


class Holds(Enum):
    """What a file shows of itself: keypoints of a camera, of a single frame, or none of any format."""

    A_CAMERA = auto()
    A_FRAME = auto()
    NOTHING = auto()


Look = Callable[[Item], Holds]


def keypoint_items(paths: Sequence[str | Path], options: ReadOptions, look: Look) -> list[Item]:
    """The items in files, folders and `name=path` pairs.

    A folder holds a file per camera, or folders of them, or, where `look` says so of its first file, the frames of one camera. Where
    it has files and folders, and only one of the two shows keypoints, the other is none of our business (notes, 3D poses, results). The
    camera is what the pattern of the options finds in the path; else what the user says; else the name of the folder that holds the
    frames or nothing but the file; else the stem. Raises MismatchError.
    """
    return [item for path in paths for item in _expand(str(path), options, look)]


def twins(folder: Path) -> list[Path]:
    """The .csv files that lie beside an .h5 file of the same name, as DeepLabCut writes them; the .h5 is read."""
    files = _listed(folder)
    binary = {file.stem for file in files if file.suffix.lower() == ".h5"}
    return [file for file in files if file.suffix.lower() == ".csv" and file.stem in binary]


def _expand(argument: str, options: ReadOptions, look: Look) -> list[Item]:
    path = Path(argument)
    name, equals, rest = argument.partition("=")
    if equals and not path.exists():
        if not name or not rest:
            raise MismatchError(
                f"expected name=path, found {argument}; say which camera the file is of"
            )
        inside = _expand(rest, options, look)
        if len(inside) != 1:
            raise MismatchError(
                f"{rest}: expected the keypoints of the one camera {name}, found {len(inside)} files; name each of them"
            )
        return [Item(name, inside[0].path, inside[0].members, named=True)]
    items = _folder(path, look) if path.is_dir() else [Item(_stem(path), path)]
    if not items:
        raise MismatchError(
            f"{path}: expected keypoint files ({', '.join(SUFFIXES)}) in the folder, found none; name the files themselves"
        )
    if not options.camera_pattern:
        return items
    return [Item(_pattern(item, options.camera_pattern), item.path, item.members) for item in items]


def _pattern(item: Item, pattern: str) -> str:
    """What the pattern finds in the path; nothing where it finds none: a reader may find it inside the file."""
    return find_camera(str(item.path), pattern)


def _folder(path: Path, look: Look) -> list[Item]:
    own, inside = _files(path, look), _folders(path, look)
    if own and inside:
        shown = [any(look(item) is not Holds.NOTHING for item in items) for items in (own, inside)]
        if shown[0] != shown[1]:
            return own if shown[0] else inside
    return own + inside


def _files(path: Path, look: Look) -> list[Item]:
    """A file per camera, or one item of all that are frames."""
    files = _listed(path)
    frames = Item(_camera(path), path, tuple(files))
    if files and not frames.document.is_hdf5 and look(frames) is Holds.A_FRAME:
        return [frames]
    doubles = twins(path)
    return [Item(_stem(file), file) for file in files if file not in doubles]


def _folders(path: Path, look: Look) -> list[Item]:
    items = []
    for folder in sorted(
        each for each in path.iterdir() if each.is_dir() and not each.name.startswith(".")
    ):
        inside = _folder(folder, look)
        items += (
            [Item(_camera(folder), inside[0].path, inside[0].members)]
            if len(inside) == 1
            else inside
        )
    return items


def _camera(folder: Path) -> str:
    """The camera of a folder: OpenPose's ends in _json, Ultralytics' holds a folder `labels`."""
    return (
        folder.absolute().parent if folder.name == "labels" else folder.absolute()
    ).name.removesuffix("_json")


def _listed(folder: Path) -> list[Path]:
    """The files of a folder that may hold keypoints, by name.

    Texts mostly are notes: they count where there is nothing else, and then those that are numbered, as frames are.
    """
    files = sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    )
    numbered = [file for file in files if frame_number(file.name) >= 0]
    return [file for file in files if file.suffix.lower() != ".txt"] or numbered or files


def _stem(path: Path) -> str:
    """The file's name without its suffix, and without SLEAP's second one."""
    return path.stem.removesuffix(".analysis")
