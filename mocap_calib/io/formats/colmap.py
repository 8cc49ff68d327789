"""COLMAP's models, binary and text: folders of cameras, images, points3D, rigs and frames.

pycolmap reads and writes them. It is loaded late, as it takes 0.3 s, and it reads in a process of
its own, as models are other people's files.

* An image is a camera here: a rig that stands still has one image a camera, called after it.
* COLMAP has (0, 0) at the corner of the first pixel, we have it at its centre: half a pixel is
  taken off or added.
* There is no unit of length; a comment `# unit: m` in cameras.txt states ours.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    check_rig,
    collect_cameras,
    lens_terms,
    pinhole_terms,
)
from mocap_calib.io.crash_guard import guard
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.results import ObservedPoints
from mocap_calib.types import ARBITRARY, Camera, CameraRig

if TYPE_CHECKING:
    import pycolmap

_BINARY, _TEXT = ".bin", ".txt"
_CAMERAS, _IMAGES, _POINTS = "cameras", "images", "points3D"
_FILES = (_CAMERAS, _IMAGES, _POINTS, "rigs", "frames")
_EMPTY = {_BINARY: bytes(8), _TEXT: b""}  # a list of nothing
_UNIT = b"# unit:"
_UNIT_LENGTH = 40  # characters at most
# COLMAP leaves out the last image of a text whose line of points is missing
_LINE_OF_POINTS = b"\n\n"
_NAMES = {
    _BINARY: (r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "no control characters"),
    _TEXT: (r"[^\s\x00-\x1f\x7f-\xa0\ud800-\udfff]+", "no spaces (colmap-binary holds them)"),
}
# the camera models that have a lens of ours; those of a FISHEYE have cv2.fisheye's
_LENSES = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"),
    *("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
)
_LENGTHS_OF_QUATERNIONS = (0.5, 2.0)  # what rounding of a unit quaternion may leave, and more
_REMEDY = "export the model again"
# of pycolmap
_REFUSALS = (ValueError, LookupError, RuntimeError, TypeError, OverflowError, MemoryError)
# what COLMAP complains of, by a part of the condition in its code that does not hold
_REASONS = {
    "VerifyParams": "a camera without the parameters of its model",
    "model does not exist": "a camera of a model that it does not know",
    "cameras_.emplace": "two cameras with one CAMERA_ID",
    "camera.width": "a line of cameras.txt that is not CAMERA_ID MODEL WIDTH HEIGHT PARAMS",
    "cam_from_world": "a line of images.txt that is not IMAGE_ID QW ... TZ CAMERA_ID NAME",
    "Rig with ID": "an image whose CAMERA_ID is of no camera",
}


def sniff(document: Document, ending: str) -> bool:
    """Return whether this is a folder with cameras.bin or .txt, or cameras.txt itself."""
    if document.is_folder:
        return _CAMERAS + ending in document.names
    return ending == _TEXT and document.has_line(r"^\d+ +[A-Z_]+ +\d+ +\d+ ")


# --- reading


def read(document: Document, ending: str) -> CameraFile:
    """Read the images of a model as cameras, with the points that they see.

    Without images there are the cameras alone, by their numbers.

    ending: of the files. Raises FormatError.
    """
    files = {_CAMERAS + ending: document.content}
    if document.is_folder:
        files = {each.path.name: each.content for each in document.documents()}
    with_images = _IMAGES + ending in files
    files = {f"{name}{ending}": _EMPTY[ending] for name in (_CAMERAS, _IMAGES, _POINTS)} | files
    files = {name: files[name] for name in (each + ending for each in _FILES) if name in files}
    unit = b""
    if ending == _TEXT:
        files[_IMAGES + _TEXT] += _LINE_OF_POINTS
        lines = files[_CAMERAS + _TEXT].splitlines()
        unit = next((line for line in lines if line.startswith(_UNIT)), b"").removeprefix(_UNIT)
    with tempfile.TemporaryDirectory() as work:
        for name, content in files.items():
            (Path(work) / name).write_bytes(content)
        return guard(
            _read_model,
            Path(work),
            with_images,
            unit.decode("utf-8", "replace").strip()[:_UNIT_LENGTH],
            document.source,
            what="COLMAP model",
            library="COLMAP",
            source=document.source,
            size=sum(map(len, files.values())),
            packed=False,
        )


def _read_model(folder: Path, with_images: bool, unit: str, source: str) -> CameraFile:
    """Read the files of a model in the process that is for it. Raises FormatError."""
    import pycolmap  # noqa: PLC0415 - takes 0.3 s

    try:
        with silent_colmap():
            model = pycolmap.Reconstruction(folder)
            _check_sizes(model, folder, source)
            images = [image for _, image in sorted(model.images.items()) if image.has_pose]
            names = [camera_of_image(image.name) for image in images]
    except _REFUSALS as error:
        known = (reason for part, reason in _REASONS.items() if part in str(error))
        reason = next(known, f"maybe it is cut or damaged ({str(error).rpartition('] ')[2]})")
        found = f"one that COLMAP does not read: {reason}"
        raise FormatError(source, "a COLMAP model", found, _REMEDY) from None
    lenses = {number: _lens(model.cameras[number], source) for number in sorted(model.cameras)}
    if not with_images:
        return collect_cameras(lenses.values(), source, unit=unit)
    raws = [
        replace(
            lenses[image.camera_id], name=name, **_place(image, f"{source}: image {image.name}")
        )
        for image, name in zip(images, names, strict=True)
    ]
    return collect_cameras(raws, source, unit=unit, points=_collect_points(model, images))


def _check_sizes(model: "pycolmap.Reconstruction", folder: Path, source: str) -> None:
    """Raise FormatError where a binary file is not as long as what COLMAP read of it.

    COLMAP reads on where a file is cut. What it read, written again, has the length of a file that
    is whole. Parts that do not go together make it fail.
    """
    files = sorted(folder.glob("*.bin"))
    with tempfile.TemporaryDirectory(dir=folder) as again:
        if files:
            model.write_binary(again)
        for file in files:
            expected, found = (Path(at, file.name).stat().st_size for at in (again, folder))
            if expected != found:
                whole = f"{expected} bytes of {file.name}"
                cut = f"{found}: it is cut or damaged"
                raise FormatError(source, whole, cut, "copy or export it again")


def _lens(camera: "pycolmap.Camera", source: str) -> RawCamera:
    """Return a camera, called by its number. Raises FormatError where we have no such lens."""
    name = camera.model.name
    if name not in _LENSES:
        expected = f"one of the camera models {', '.join(_LENSES)}"
        where = f"{source}: camera {camera.camera_id}"
        raise FormatError(where, expected, name, "undistort, or choose another model")
    params = camera.params
    focal = params[camera.focal_length_idxs()]
    middle = params[camera.principal_point_idxs()] - CORNER_OFFSET
    return RawCamera(
        name=str(camera.camera_id),
        size=[camera.width, camera.height],
        matrix=[focal[0], focal[-1], *middle],
        distortion=params[camera.extra_params_idxs()],  # in OpenCV's order, as many as there are
        fisheye="FISHEYE" in name,
    )


def _place(image: "pycolmap.Image", where: str) -> dict[str, Any]:
    """Return rotation and translation of an image. Raises FormatError."""
    cam_from_world = image.cam_from_world()
    length = cam_from_world.rotation.norm()
    least, most = _LENGTHS_OF_QUATERNIONS
    if not least < length < most:  # nor is NaN
        found = f"one of the length {length:.3g}"
        raise FormatError(where, "a unit quaternion QW QX QY QZ", found, _REMEDY)
    cam_from_world.rotation.normalize()
    rotation = cam_from_world.rotation.matrix()
    return {"rotation": rotation, "translation": cam_from_world.translation}


def _collect_points(
    model: "pycolmap.Reconstruction", images: Sequence["pycolmap.Image"]
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


# --- writing


def write(
    rig: CameraRig, provenance: Mapping[str, Any], points: ObservedPoints, ending: str
) -> Written:
    """Write a model, an image of which is called NAME.png; the text has the unit.

    ending: of the files. Raises MismatchError.
    """
    is_text = ending == _TEXT
    lost = check_rig(
        rig,
        provenance,
        "colmap" if is_text else "colmap-binary",
        fisheye=True,
        sizes="needed",
        names=_NAMES[ending],
        verdict=is_text,
    )
    with silent_colmap(), tempfile.TemporaryDirectory() as work:
        model = build_model(rig, points)
        (model.write_text if is_text else model.write_binary)(work)
        files = {file + ending: (Path(work) / (file + ending)).read_bytes() for file in _FILES}
    if is_text:
        files[_CAMERAS + ending] = (
            b"%s %s\n" % (_UNIT, rig.unit.encode()) + files[_CAMERAS + ending]
        )
    elif rig.unit != ARBITRARY:
        lost = ("the unit of length", *lost)
    if len(points.positions):
        what = "frame, individual and keypoint of a point (the points are in this order)"
        lost = (*lost, what)
    return Written(files, lost)


@contextmanager
def silent_colmap() -> Iterator[None]:
    """Keep COLMAP from writing to stderr within the block: what is wrong comes as an exception."""
    import pycolmap  # noqa: PLC0415 - takes 0.3 s

    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def build_model(rig: CameraRig, points: ObservedPoints) -> "pycolmap.Reconstruction":
    """Return a model with an image for each view, numbered from 1, and a track for each point.

    The 2D points of an image are the observations of its view, in their order.
    """
    import pycolmap  # noqa: PLC0415 - takes 0.3 s

    model = pycolmap.Reconstruction()
    for view, camera in enumerate(rig):
        number = view + 1
        model.add_camera_with_trivial_rig(_camera_of_model(camera, number))
        image = pycolmap.Image(
            name=f"{camera.name}.png",
            keypoints=points.pixels[points.view == view] + CORNER_OFFSET,
            camera_id=number,
            image_id=number,
        )
        rotation = pycolmap.Rotation3d(camera.rotation)
        pose = pycolmap.Rigid3d(rotation, camera.translation + 0.0)  # no -0 in text
        model.add_image_with_trivial_frame(image, pose)
    # the number of an observation within its image
    within = np.empty(len(points.view), dtype=np.int64)
    for view in range(len(rig)):
        own = points.view == view
        within[own] = np.arange(own.sum())
    order = np.argsort(points.point, kind="stable")
    counts = np.bincount(points.point, minlength=len(points.positions))
    tracks = np.split(np.column_stack([points.view + 1, within])[order], np.cumsum(counts))[:-1]
    for position, track in zip(points.positions, tracks, strict=True):
        elements = [pycolmap.TrackElement(*each) for each in track.tolist()]
        model.add_point3D(position, pycolmap.Track(elements))
    model.update_point_3d_errors()
    return model


def _camera_of_model(camera: Camera, number: int) -> "pycolmap.Camera":
    """Return the camera in the smallest model of COLMAP that has its lens."""
    import pycolmap  # noqa: PLC0415 - takes 0.3 s

    is_long = not camera.fisheye and camera.distortion[4:].any()
    model = "OPENCV_FISHEYE" if camera.fisheye else "FULL_OPENCV" if is_long else "OPENCV"
    fx, fy, cx, cy = pinhole_terms(camera)
    params = [fx, fy, cx + CORNER_OFFSET, cy + CORNER_OFFSET]
    params += lens_terms(camera, 8 if is_long else 4).tolist()
    width, height = camera.size
    return pycolmap.Camera(camera_id=number, model=model, width=width, height=height, params=params)


BINARY = Format(
    name="colmap-binary",
    title="COLMAP binary model",
    sniff=partial(sniff, ending=_BINARY),
    read=partial(read, ending=_BINARY),
    write=partial(write, ending=_BINARY),
    folder=True,
    points=True,
)
TEXT = Format(
    name="colmap",
    title="COLMAP text model",
    sniff=partial(sniff, ending=_TEXT),
    read=partial(read, ending=_TEXT),
    write=partial(write, ending=_TEXT),
    folder=True,
    points=True,
)
