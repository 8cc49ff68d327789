"""Reading one camera's 2D keypoints. The format is recognised by content, never by the file's name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mocap_calib.io import coco, deeplabcut_csv, deeplabcut_h5
from mocap_calib.io.reading import malformed, read_bytes
from mocap_calib.types import Keypoints2D

_HEAD = 4096


@dataclass(frozen=True)
class Reader:
    """One format: `sniff` says from a file's first bytes whether it is meant; `load(content, camera, source)` reads it."""

    name: str
    sniff: Callable[[bytes], bool]
    load: Callable[[bytes, str, str], Keypoints2D]


READERS = (
    Reader("DeepLabCut .h5", deeplabcut_h5.sniff, deeplabcut_h5.load),
    Reader("DeepLabCut .csv", deeplabcut_csv.sniff, deeplabcut_csv.load),
    Reader("COCO annotations .json", coco.sniff, coco.load),
)


def read_keypoints(path: Path, camera: str) -> Keypoints2D:
    """The detections in the file at `path`, of the camera called `camera`; x right, y down, in pixels as the file has them.

    Raises FormatError, in one line, for whatever is wrong with the file.
    """
    content = read_bytes(path)
    for reader in READERS:
        if reader.sniff(content[:_HEAD]):
            return reader.load(content, camera, str(path))
    found = f"content that begins with {content[:16]!r}" if content else "an empty file"
    raise malformed(str(path), f"one of: {', '.join(reader.name for reader in READERS)}", found, "export one of these")
