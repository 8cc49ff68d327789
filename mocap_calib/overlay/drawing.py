"""Draw what a run found on one image: floor, cameras, bodies and detections.

Pixels have their centres at integers, as in OpenCV. Lenses are applied to all that is drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.geometry.lens import pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import rig_size
from mocap_calib.notebook.colours import colour_of, rgb
from mocap_calib.types import Camera, CameraRig, Floats

Image = Any  # numpy's array of uint8 [height, width, 3], blue green red
_SHIFT = 4  # bits of a pixel that OpenCV draws with
_PIECES = 24  # of a line, so that a lens may bend it
_MARGIN = 1.1  # by which what is drawn may lie outside the image, as an angle
_WHITE = "#ffffff"
_LARGEST = 2**20  # pixels that OpenCV can be given


@dataclass(frozen=True)
class View:
    """Where world points are in the images of a camera.

    camera: of the size of the images. rotation: `[3, 3]`, translation: `[3]` cam_from_world.
    widest: the largest angle from the axis in radians that an image shows: beyond it, the formula
        of a lens may lead back into the image.
    near: the depth from which on lines are drawn. mirrored: the images are, left for right.
    """

    camera: Camera
    rotation: Floats
    translation: Floats
    widest: float
    near: float
    mirrored: bool = False

    @classmethod
    def of(cls, rig: CameraRig, name: str, size: tuple[int, int], *, mirrored: bool) -> "View":
        """Return the view of a camera of a rig in images of a size (width, height)."""
        view = rig.names.index(name)
        camera = resize(rig.cameras[view], size)
        return cls(
            camera=camera,
            rotation=rig.rotation[view],
            translation=rig.translation[view],
            widest=_widest_angle(camera),
            near=1e-3 * (rig_size(rig) or 1.0),
            mirrored=mirrored,
        )

    def project(self, points: Floats) -> Floats:
        """Return the pixels `[..., 2]` of world points `[..., 3]`, NaN where none shows them."""
        return self._project(points @ self.rotation.T + self.translation)

    def bend(self, lines: Floats) -> Floats:
        """Return the pixels `[line, point, 2]` of lines `[line, 2, 3]`, NaN where none shows them.

        A line that passes the camera begins at the near plane.
        """
        ends = lines @ self.rotation.T + self.translation
        depth = ends[..., 2]
        behind = depth < self.near
        with np.errstate(divide="ignore", invalid="ignore"):
            part = (self.near - depth[:, :1]) / (depth[:, 1:] - depth[:, :1])
            cut = ends[:, 0] + part * (ends[:, 1] - ends[:, 0])
        ends = np.where((behind & ~behind[:, ::-1])[..., None], cut[:, None], ends)
        ends[behind.all(1)] = np.nan
        weight = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
        return self._project(ends[:, :1] * (1 - weight) + ends[:, 1:] * weight)

    def _project(self, points: Floats) -> Floats:
        """Return the pixels of points in the camera's axes."""
        angle = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
        pixels = pixels_from_points(self.camera, points)
        pixels[~(angle <= self.widest)] = np.nan
        if self.mirrored:
            pixels[..., 0] = self.camera.size[0] - 1 - pixels[..., 0]
        return pixels


def resize(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the intrinsics of a camera whose images were resized to (width, height)."""
    if size == camera.size or not all(camera.size):
        return replace(camera, size=size)
    scale = np.array([size[0] / camera.size[0], size[1] / camera.size[1], 1.0])
    corner = np.array([CORNER_OFFSET, CORNER_OFFSET, 0.0])[:, None] * (0.0, 0.0, 1.0)
    return replace(camera, size=size, matrix=scale[:, None] * (camera.matrix + corner) - corner)


def _widest_angle(camera: Camera) -> float:
    """Return the largest angle from the axis at the border of an image, with a margin."""
    width, height = camera.size
    along, down = np.linspace(0, width - 1, 20), np.linspace(0, height - 1, 20)
    border = [np.stack([along, np.full(20, y)], 1) for y in (0, height - 1)]
    border += [np.stack([np.full(20, x), down], 1) for x in (0, width - 1)]
    rays = rays_from_pixels(camera, np.concatenate(border))
    angles = np.arccos(np.clip(rays[:, 2], -1, 1))
    return _MARGIN * float(np.nanmax(angles)) if np.isfinite(angles).any() else np.pi / 3


def draw_lines(image: Image, lines: Floats, colour: str, width: int) -> None:
    """Draw lines `[line, point, 2]`, broken where a point is NaN."""
    drawable = np.asarray((np.abs(lines) < _LARGEST).all(-1))  # NaN is not
    both = drawable[:, 1:] & drawable[:, :-1]
    pieces = np.stack([lines[:, :-1][both], lines[:, 1:][both]], axis=1)
    if len(pieces):
        cv2.polylines(image, _fixed(pieces), False, _bgr(colour), width, cv2.LINE_AA, _SHIFT)


def draw_points(image: Image, points: Floats, colour: str, radius: float, width: int) -> None:
    """Draw rings around points `[point, 2]`, discs where the width is -1."""
    drawable = (np.abs(points) < _LARGEST).all(1)  # NaN is not
    reach = round(radius * 2**_SHIFT)
    for x, y in _fixed(points[drawable]).tolist():
        cv2.circle(image, (x, y), reach, _bgr(colour), width, cv2.LINE_AA, _SHIFT)


def draw_body(
    image: Image, joints: Floats, edges: Sequence[tuple[int, int]], individual: int, unit: int
) -> None:
    """Draw the pixels `[keypoint, 2]` of a body, its bones, and its number above it."""
    colour = colour_of(individual)
    draw_lines(image, joints[np.array(edges, dtype=int).reshape(-1, 2)], colour, 2 * unit)
    draw_points(image, joints, colour, 2 * unit, -1)
    seen = joints[np.isfinite(joints).all(1)]
    if len(seen):
        draw_text(image, str(individual), seen[seen[:, 1].argmin()] - (0, 8 * unit), unit, colour)


def draw_text(image: Image, text: str, place: Floats, unit: int, colour: str = _WHITE) -> None:
    """Write a text on dark edges, with its lower left corner at a pixel."""
    if not (np.abs(place) < _LARGEST).all():  # also NaN
        return
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5 * unit
    # not a thicker text below: where fonts have weights, its letters stand elsewhere
    edges = [(-unit, 0), (unit, 0), (0, -unit), (0, unit)]
    for shade, shift in (*(("#000000", edge) for edge in edges), (colour, (0, 0))):
        x, y = np.round(place + np.array(shift)).astype(int).tolist()
        cv2.putText(image, text, (x, y), font, size, _bgr(shade), unit, cv2.LINE_AA)


def _fixed(pixels: Floats) -> Any:
    """Return pixels as the whole numbers that OpenCV draws with."""
    return np.round(pixels * 2**_SHIFT).astype(np.int32)


def _bgr(colour: str) -> tuple[int, int, int]:
    """Return a colour in OpenCV's order."""
    red, green, blue = rgb(colour)
    return blue, green, red
