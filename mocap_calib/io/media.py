"""Tell videos and images by their endings: they are not read, and too large to be opened for it."""

from collections.abc import Sequence
from pathlib import Path

from mocap_calib.errors import FormatError, one_line

_VIDEOS = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".wmv", ".mpg", ".mpeg", ".mts", ".flv")
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".gif", ".webp")
_ESTIMATORS = "DeepLabCut, SLEAP, Lightning Pose, OpenPose, AlphaPose, MMPose, Ultralytics, ..."
_LISTED = 3  # names of files in a message


def name_media(path: Path) -> str:
    """Return "a video" or "an image" where the ending of a path says so, else ""."""
    ending = path.suffix.lower()
    if ending in _VIDEOS:
        return "a video"
    return "an image" if ending in _IMAGES else ""


def check_no_media(path: Path, endings: Sequence[str]) -> None:
    """Raise FormatError for a video or an image where keypoints are expected.

    endings: of files of keypoints.
    """
    found = name_media(path)
    if found and not path.is_dir():
        raise _expected_keypoints(path, found, endings)


def check_no_media_alone(folder: Path, endings: Sequence[str]) -> None:
    """Raise FormatError for a folder with videos or images, to be called where it has no keypoints.

    endings: of files of keypoints.
    """
    files = [path for path in (*folder.glob("*"), *folder.glob("*/*")) if name_media(path)]
    if files:
        names = ", ".join(sorted(path.name for path in files)[:_LISTED])
        more = ", ..." if len(files) > _LISTED else ""
        kinds = " and ".join(sorted({f"{name_media(path).split()[1]}s" for path in files}))
        raise _expected_keypoints(folder, f"{kinds} ({names}{more})", endings)


def _expected_keypoints(path: Path, found: str, endings: Sequence[str]) -> FormatError:
    """Return the complaint about what a 2D pose estimator has not looked at yet."""
    return FormatError(
        one_line(path, 300),
        "files of 2D keypoints",
        found,
        f"run a 2D pose estimator first ({_ESTIMATORS}), and give the files that it writes: "
        f"{', '.join(endings)} (docs/formats.md)",
    )
