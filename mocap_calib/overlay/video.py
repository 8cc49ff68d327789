"""Read videos frame by frame, and refuse those whose frames cannot be told by their number."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.types import Camera

_SAME_ASPECT = 0.01  # relative difference of the ratios of width and height
_STEADY = 0.5  # of the usual interval: by how much one may differ


@dataclass(frozen=True)
class Video:
    """A video that can be opened.

    size: (width, height) in pixels. rate: frames per second. frames: how many, as it says.
    """

    path: Path
    size: tuple[int, int]
    rate: float
    frames: int


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Give OpenCV's capture of a video. Raises FormatError."""
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise FormatError(
                path,
                "a video that OpenCV can read",
                "something else",
                f"convert it: ffmpeg -i {path.name} -c:v libx264 -crf 18 new.mp4",
            )
        yield capture
    finally:
        capture.release()


def open_video(path: Path) -> Video:
    """Return what is known of a video. Raises FormatError, and MismatchError where none is."""
    if not path.is_file():
        raise MismatchError(path, "a video", "no such file", "check the path")
    asked = ("FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "FRAME_COUNT")
    with _opened(path) as capture:
        width, height, rate, frames = (
            capture.get(getattr(cv2, f"CAP_PROP_{each}")) for each in asked
        )
    return Video(path, (int(width), int(height)), rate if rate > 0 else 30.0, int(max(frames, 0)))


def check_size(video: Video, camera: Camera) -> str:
    """Return a note where a video is resized against the camera's images, "" where it is not.

    Raises MismatchError where width and height have another ratio.
    """
    (width, height), (own_width, own_height) = video.size, camera.size
    if video.size == camera.size or not (own_width and own_height):
        return ""
    if abs(width * own_height / (height * own_width) - 1) > _SAME_ASPECT:
        raise MismatchError(
            video.path,
            f"images of {own_width} x {own_height} as the keypoints of {camera.name} have, or "
            "resized ones",
            f"{width} x {height}",
            "give the video in which they were detected",
        )
    return (
        f"{camera.name}: its video has {width} x {height} pixels and its keypoints are of "
        f"{own_width} x {own_height}: all is drawn {width / own_width:.3g} times as large"
    )


def read_frames(video: Video, wanted: frozenset[int] | None) -> Iterator[tuple[int, Any]]:
    """Yield the index, from 0, and the image of each frame, one in memory at a time.

    wanted: the indices of those that are yielded; None: all. What lies between is decoded, as a
        seek does not find the right frame in many videos.

    Raises MismatchError where the frames are not equally far apart in time.
    """
    last = np.inf if wanted is None else max(wanted, default=-1)
    usual = 1000 / video.rate
    with _opened(video.path) as capture:
        index, before = 0, np.nan
        while index <= last and capture.grab():
            time = float(capture.get(cv2.CAP_PROP_POS_MSEC))
            if index and not np.isclose(time - before, usual, rtol=_STEADY, atol=1.0):
                raise MismatchError(
                    video.path,
                    f"frames {usual:.1f} ms apart",
                    f"{time - before:.1f} ms before frame {index}: with a variable frame rate "
                    "the frame of a detection is not known",
                    f"make it constant, and detect again: ffmpeg -i {video.path.name} -fps_mode "
                    f"cfr -r {video.rate:.6g} new.mp4",
                )
            before = time
            if wanted is None or index in wanted:
                whole, image = capture.retrieve()
                if not whole:
                    return
                yield index, image
            index += 1
