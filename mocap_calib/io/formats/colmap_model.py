"""COLMAP's own record of a rig and observed points, a `pycolmap.Reconstruction`: read and built.

COLMAP has (0, 0) at the corner of the first pixel, we have it at its centre: half a pixel is taken
off or added.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    collect_cameras,
    pinhole_matrix,
)
from mocap_calib.io.formats.colmap import LENSES
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraRig

_LENGTHS_OF_QUATERNIONS = (0.5, 2.0)  # what rounding of a unit quaternion may leave, and more
_REMEDY = "export the model again"
_REFUSALS = (ValueError, LookupError, RuntimeError, TypeError, OverflowError)  # of pycolmap
# what COLMAP complains of, by a part of the condition in its code that does not hold
_REASONS = {
    "VerifyParams": "a camera without the parameters of its model",
    "model does not exist": "a camera of a model that it does not know",
    "cameras_.emplace": "two cameras with one CAMERA_ID",
    "camera.width": "a line of cameras.txt that is not CAMERA_ID MODEL WIDTH HEIGHT PARAMS",
    "cam_from_world": "a line of images.txt that is not IMAGE_ID QW ... TZ CAMERA_ID NAME",
    "Rig with ID": "an image whose CAMERA_ID is of no camera",
}


def read(folder: Path, *, with_images: bool, unit: str, source: str) -> CameraFile:
    """Read the images of a model as cameras, with the points that they see.

    folder: with the files of one model. with_images: else the cameras alone, by their numbers.
    unit: of its lengths, "" where it is not known. source: names the model in complaints.

    Raises FormatError.
    """
    with silent_colmap():
        model = _load(folder, source)
    lenses = {number: _lens(model.cameras[number], source) for number in sorted(model.cameras)}
    if not with_images:
        return collect_cameras(lenses.values(), source, unit=unit)
    images = [image for _, image in sorted(model.images.items()) if image.has_pose]
    raws = [_place(image, lenses[image.camera_id], source) for image in images]
    return collect_cameras(raws, source, unit=unit, points=_collect_points(model, images))


def _load(folder: Path, source: str) -> pycolmap.Reconstruction:
    """Return the model. Raises FormatError where COLMAP refuses it, or it is cut."""
    try:
        model = pycolmap.Reconstruction(folder)
    except MemoryError:
        found = "one whose counts no memory holds"
        raise FormatError(source, "a COLMAP model", found, _REMEDY) from None
    except _REFUSALS as error:
        raise _refusal(error, source) from None
    _check_sizes(model, folder, source)
    return model


def _refusal(error: Exception, source: str) -> FormatError:
    """Return the complaint about a model that COLMAP does not take."""
    said = str(error)
    known = (reason for part, reason in _REASONS.items() if part in said)
    reason = next(known, f"maybe it is cut or damaged ({said.rpartition('] ')[2]})")
    return FormatError(
        source, "a COLMAP model", f"one that COLMAP does not read: {reason}", _REMEDY
    )


def _check_sizes(model: pycolmap.Reconstruction, folder: Path, source: str) -> None:
    """Raise FormatError where a binary file is not as long as what COLMAP read of it.

    COLMAP reads on where a file is cut. What it read, written again, has the length of a file that
    is whole.
    """
    files = sorted(folder.glob("*.bin"))
    with tempfile.TemporaryDirectory(dir=folder) as again:
        if files:
            try:
                model.write_binary(again)
            except _REFUSALS as error:  # parts that do not go together show only here
                raise _refusal(error, source) from None
        for file in files:
            expected, found = (Path(at, file.name).stat().st_size for at in (again, folder))
            if expected != found:
                raise FormatError(
                    source,
                    f"{expected} bytes of {file.name}",
                    f"{found}: it is cut or damaged",
                    "copy or export it again",
                )


def _lens(camera: pycolmap.Camera, source: str) -> RawCamera:
    """Return a camera, called by its number. Raises FormatError where we have no such lens."""
    name = camera.model.name
    if name not in LENSES:
        expected = f"one of the camera models {', '.join(LENSES)}"
        where = f"{source}: camera {camera.camera_id}"
        raise FormatError(where, expected, name, "undistort, or choose another model")
    params = camera.params
    focal = params[camera.focal_length_idxs()]
    middle = params[camera.principal_point_idxs()] - CORNER_OFFSET
    return RawCamera(
        name=str(camera.camera_id),
        size=[camera.width, camera.height],
        matrix=pinhole_matrix(focal[0], focal[-1], *middle),
        distortion=params[camera.extra_params_idxs()],  # in OpenCV's order, as many as there are
        fisheye="FISHEYE" in name,
    )


def _place(image: pycolmap.Image, lens: RawCamera, source: str) -> RawCamera:
    """Return the camera of an image, called after it. Raises FormatError."""
    try:
        name = image.name
    except UnicodeDecodeError as error:
        raise FormatError(source, "names of images in UTF-8", error, _REMEDY) from None
    cam_from_world = image.cam_from_world()
    length = cam_from_world.rotation.norm()
    least, most = _LENGTHS_OF_QUATERNIONS
    if not least < length < most:  # nor is NaN
        expected = "a unit quaternion QW QX QY QZ"
        found = f"one of the length {length:.3g}"
        raise FormatError(f"{source}: image {name}", expected, found, _REMEDY)
    cam_from_world.rotation.normalize()
    return replace(
        lens,
        name=camera_of_image(name),
        rotation=cam_from_world.rotation.matrix(),
        translation=cam_from_world.translation,
    )


def _collect_points(
    model: pycolmap.Reconstruction, images: Sequence[pycolmap.Image]
) -> ObservedPoints:
    """Return the points of a model, by their numbers, and what the images see of them."""
    numbers = sorted(model.points3D)
    row = {number: k for k, number in enumerate(numbers)}
    seen = [
        (view, row[point.point3D_id], *point.xy)
        for view, image in enumerate(images)
        for point in image.get_observation_points2D()
        if point.point3D_id in row  # a model may come without its points
    ]
    table = np.array(seen, dtype=np.float64).reshape(-1, 4)
    positions = [model.points3D[number].xyz for number in numbers]
    return ObservedPoints(
        positions=np.array(positions, dtype=np.float64).reshape(-1, 3),
        view=table[:, 0].astype(np.int64),
        point=table[:, 1].astype(np.int64),
        pixels=table[:, 2:] - CORNER_OFFSET,
    )


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
        model.add_camera_with_trivial_rig(_camera_of_model(camera, number))
        image = pycolmap.Image(
            name=f"{camera.name}.png",
            keypoints=points.pixels[points.view == view] + CORNER_OFFSET,
            camera_id=number,
            image_id=number,
        )
        rotation = pycolmap.Rotation3d(rig.rotation[view])
        pose = pycolmap.Rigid3d(rotation, rig.translation[view] + 0.0)  # no -0 in text
        model.add_image_with_trivial_frame(image, pose)
    for position, track in zip(points.positions, _tracks(points), strict=True):
        model.add_point3D(position, track)
    model.update_point_3d_errors()
    return model


def _camera_of_model(camera: Camera, number: int) -> pycolmap.Camera:
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


def _tracks(points: ObservedPoints) -> Iterator[pycolmap.Track]:
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
