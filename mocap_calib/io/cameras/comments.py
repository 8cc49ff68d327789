"""Comments at the head of camera files, where their syntax has comments."""

import io
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import PurePath

from mocap_calib.types import CameraRig, EstimatedCamera

_WITH_COMMENTS = (".toml", ".yaml", ".yml", ".txt")
_MARK = b"# "
_FILE_STORAGE = b"%YAML:1.0\n---\n"  # OpenCV's header comes before any comment


def describe_estimates(rig: CameraRig) -> list[str]:
    """Return a line for each camera whose intrinsics were estimated from the recording."""
    return [
        f"camera {camera.name}: intrinsics estimated from the recording, "
        f"focal length {camera.focal:.1f} +- {camera.focal_sigma:.1f} px{_describe_k1(camera)}"
        for camera in rig.cameras
        if isinstance(camera, EstimatedCamera)
    ]


def _describe_k1(camera: EstimatedCamera) -> str:
    """Return what is known of the lens, nothing where it was not estimated."""
    if not camera.k1_sigma:
        return ""
    return f", k1 {camera.distortion[0]:.3f} +- {camera.k1_sigma:.3f}"


def add_comments(files: Mapping[str, bytes], lines: Sequence[str]) -> dict[str, bytes]:
    """Return the files (relative path -> content) with the lines at their head, as comments.

    JSON and binary files stay as they are.
    """
    comment = b"".join(_MARK + line.encode() + b"\n" for line in lines)
    return {name: _put_at_head(name, content, comment) for name, content in files.items()}


def read_comments(content: bytes) -> list[str]:
    """Return the lines of the comments at the head of a file, none where it has no comments."""
    lines = io.BytesIO(content.removeprefix(_FILE_STORAGE))  # not all of them: files may be large
    comments = takewhile(lambda line: line.startswith(_MARK), lines)
    return [line.strip(b"\r\n").removeprefix(_MARK).decode(errors="replace") for line in comments]


def _put_at_head(name: str, content: bytes, comment: bytes) -> bytes:
    """Return the content of one file with a comment at its head, if its syntax has comments."""
    if PurePath(name).suffix not in _WITH_COMMENTS:
        return content
    header = _FILE_STORAGE if content.startswith(_FILE_STORAGE) else b""
    return header + comment + content.removeprefix(header)
