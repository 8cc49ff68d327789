"""A rig and observed points as COLMAP's own record of them, a `pycolmap.Reconstruction`.

Files are written of it (`io.cameras.colmap`), and a benchmark has Ceres adjust it. COLMAP has
(0, 0) at the corner of the first pixel, we have it at its centre: half a pixel is added here.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pycolmap

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraRig


@contextmanager
def silent_colmap() -> Iterator[None]:
    """Keep COLMAP from writing to stderr within the block: what is wrong comes as an exception."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def build_model(rig: CameraRig, points: ObservedPoints) -> pycolmap.Reconstruction:
    """Return a model with an image for each view, numbered from 1, and a track for each point.

    The 2D points of an image are the observations of its view, in their order.
    """
    model = pycolmap.Reconstruction()
    for view, camera in enumerate(rig.cameras):
        number = view + 1
        model.add_camera_with_trivial_rig(_make_colmap_camera(camera, number))
        image = pycolmap.Image(
            name=f"{camera.name}.png",
            keypoints=points.pixels[points.view == view] + CORNER_OFFSET,
            camera_id=number,
            image_id=number,
        )
        rotation = pycolmap.Rotation3d(rig.rotation[view])
        pose = pycolmap.Rigid3d(rotation, rig.translation[view] + 0.0)  # no -0 in text
        model.add_image_with_trivial_frame(image, pose)
    for position, track in zip(points.positions, _make_tracks(points), strict=True):
        model.add_point3D(position, track)
    model.update_point_3d_errors()
    return model


def _make_colmap_camera(camera: Camera, number: int) -> pycolmap.Camera:
    """Return the camera in the smallest model of COLMAP that has its lens."""
    lens = np.pad(camera.distortion, (0, 8))[:8]
    if camera.fisheye:
        model, lens = "OPENCV_FISHEYE", lens[:4]
    elif lens[4:].any():
        model = "FULL_OPENCV"
    else:
        model, lens = "OPENCV", lens[:4]
    focal = camera.matrix[[0, 1], [0, 1]]
    middle = camera.matrix[:2, 2] + CORNER_OFFSET
    width, height = camera.size
    return pycolmap.Camera(
        camera_id=number,
        model=model,
        width=width,
        height=height,
        params=np.concatenate([focal, middle, lens]),
    )


def _make_tracks(points: ObservedPoints) -> Iterator[pycolmap.Track]:
    """Yield the track of each point: the image and the number within it of each observation."""
    within = np.empty(len(points.view), dtype=np.int64)
    for view in np.unique(points.view):
        own = points.view == view
        within[own] = np.arange(own.sum())
    order = np.argsort(points.point, kind="stable")
    image = (points.view[order] + 1).tolist()
    within_image = within[order].tolist()
    ends = np.cumsum(np.bincount(points.point, minlength=len(points.positions))).tolist()
    start = 0
    for end in ends:
        track = pycolmap.Track()
        for k in range(start, end):
            track.add_element(image[k], within_image[k])
        start = end
        yield track
