"""From paths to what is read in one go: files, folders with a file per camera, folders with a file per frame."""

from collections.abc import Callable, Sequence
from pathlib import Path

from mocap_calib.errors import MismatchError
from mocap_calib.io.document import Item, ReadOptions
from mocap_calib.io.reading import camera_in

FOLDER_SUFFIXES = (".json", ".csv", ".h5", ".hdf5", ".nc", ".nwb", ".slp", ".mat")
SUFFIXES = (*FOLDER_SUFFIXES, ".txt")  # the last only where there is nothing else


def keypoint_items(paths: Sequence[str | Path], options: ReadOptions, per_frame: Callable[[Item], bool]) -> list[Item]:
    """The items in files, folders and `name=path` pairs.

    A folder holds a file per camera, or a folder per camera, or, where `per_frame` says so of its files, the frames of
    one camera. The camera is what the pattern of the options finds in the path; else what the user says; else the name
    of the folder that holds the frames or nothing but the file; else the stem. Raises MismatchError.
    """
    return [item for path in paths for item in _expand(str(path), options, per_frame)]


def twins(folder: Path) -> list[Path]:
    """The .csv files that lie beside an .h5 file of the same name, as DeepLabCut writes them; the .h5 is read."""
    files = _listed(folder)
    binary = {file.stem for file in files if file.suffix.lower() == ".h5"}
    return [file for file in files if file.suffix.lower() == ".csv" and file.stem in binary]


def _expand(argument: str, options: ReadOptions, per_frame: Callable[[Item], bool]) -> list[Item]:
    path = Path(argument)
    name, equals, rest = argument.partition("=")
    if equals and not path.exists():
        if not name or not rest:
            raise MismatchError(f"expected name=path, found {argument}; say which camera the file is of")
        inside = _expand(rest, options, per_frame)
        if len(inside) != 1:
            raise MismatchError(f"{rest}: expected the keypoints of the one camera {name}, found {len(inside)} files; name each of them")
        return [Item(name, inside[0].path, inside[0].members, named=True)]
    items = _folder(path, per_frame) if path.is_dir() else [Item(_stem(path), path)]
    if not options.camera_pattern:
        return items
    return [Item(_pattern(item, options.camera_pattern), item.path, item.members) for item in items]


def _pattern(item: Item, pattern: str) -> str:
    """What the pattern finds in the path; nothing where it finds none: a reader may find it inside the file."""
    return camera_in(str(item.path), pattern)


def _folder(path: Path, per_frame: Callable[[Item], bool]) -> list[Item]:
    files = _listed(path)
    if files:
        frames = Item(_camera(path), path, tuple(files))
        if per_frame(frames):
            return [frames]
        doubles = twins(path)
        return [Item(_stem(file), file) for file in files if file not in doubles]
    items = []
    for folder in sorted(each for each in path.iterdir() if each.is_dir() and not each.name.startswith(".")):
        inside = _folder(folder, per_frame)
        items += [Item(_camera(folder), inside[0].path, inside[0].members)] if len(inside) == 1 else inside
    if not items:
        raise MismatchError(f"{path}: expected keypoint files ({', '.join(SUFFIXES)}) in the folder, found none; name the files themselves")
    return items


def _camera(folder: Path) -> str:
    """The camera of a folder: OpenPose's ends in _json, Ultralytics' holds a folder `labels`."""
    return (folder.absolute().parent if folder.name == "labels" else folder.absolute()).name.removesuffix("_json")


def _listed(folder: Path) -> list[Path]:
    """The files of a folder that may hold keypoints, by name; texts only where there is nothing else, since they mostly are notes."""
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file())
    return [file for file in files if file.suffix.lower() != ".txt"] or files


def _stem(path: Path) -> str:
    """The file's name without its suffix, and without SLEAP's second one."""
    return path.stem.removesuffix(".analysis")
