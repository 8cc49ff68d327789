"""What the user says of keypoint files that do not say it themselves."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from mocap_calib.recording.names import compose_name


@dataclass(frozen=True)
class ReadOptions:
    """What a file does not say itself.

    layout: names of the keypoints, in the file's order.
    image_size: (width, height) in pixels, where the file has none; positions that are shares of
        the image are multiplied by it. image_sizes: camera -> its own.
    camera_pattern: regular expression that finds the camera's name in a path (its group `camera`,
        or its first group, or all of it), and perhaps the frame number (group `frame`).
    frame_offset: camera -> added to its frame numbers.
    crop_offset: camera -> (x, y) in pixels added to its positions.
    views: suffixes of keypoint names that stand for views (`paw_top`, `paw_bot`), each of which
        becomes a camera.
    single_precision: keep float32, a ten-thousandth of a pixel, of each file: long recordings need
        half the memory.
    """

    layout: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)
    camera_pattern: str = ""
    frame_offset: Mapping[str, int] = field(default_factory=dict)
    crop_offset: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    views: tuple[str, ...] = ()
    single_precision: bool = False
    image_sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def size_of(self, camera: str) -> tuple[int, int]:
        """Return the size of the images of a camera, (0, 0) where the user does not say."""
        sizes = {compose_name(name): size for name, size in self.image_sizes.items()}
        return sizes.get(compose_name(camera), self.image_size)
