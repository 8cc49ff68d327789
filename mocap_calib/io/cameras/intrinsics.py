"""From whatever a file says of a camera to a `Camera`, or to a complaint; and the fields of our own files."""

from typing import Any

import numpy as np

from mocap_calib.geometry.rotation import matrix_from_vector, nearest_rotation
from mocap_calib.io.file import malformed
from mocap_calib.types import Camera, Floats

_PINHOLE_LENGTHS = (4, 5, 8)
_LONG_LENGTHS = (12, 14)  # OpenCV's thin prism and tilt, which bundle adjustment does not have
_NOT_A_ROTATION = 1e-2  # real files round to three or four digits
_ROUNDED = 1e-9
_UNSEEN = 0.05  # pixels, well below what any detector resolves
_SKEWED = 1e-3  # of the focal length, wherever the principal point may be


def numbers(value: Any, expected: str, source: str) -> Floats:
    """Nested lists, or a `rows`, `cols`, `data` matrix as OpenCV and ROS write it, as an array. Raises FormatError."""
    try:
        if isinstance(value, dict):
            return np.array(value["data"], dtype=np.float64).reshape(
                int(value["rows"]), int(value["cols"])
            )
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise malformed(source, expected, f"an error ({error})", "mend the numbers") from None
    return array


def make_camera(
    name: str, size: Any, matrix: Any, distortion: Any, fisheye: bool, source: str
) -> Camera:
    """A camera from raw fields, checked; `source` names file and camera in the complaint. Raises FormatError."""
    known_size = _size(size, source)
    return Camera(
        name,
        known_size,
        _matrix(matrix, known_size, source),
        _distortion(distortion, fisheye, source),
        fisheye,
    )


def skew_in_pixels(matrix: Floats, height: int = 0) -> float:
    """By how much the skew of a `[3, 3]` camera matrix moves what is seen at the edge; without a height the principal point is in the middle."""
    fy, cy = matrix[1, 1:]
    with np.errstate(all="ignore"):  # numbers of a damaged file
        return float(abs(matrix[0, 1]) * max(abs(cy), abs(height - cy) if height else 0.0) / fy)


def make_extrinsics(rotation: Any, translation: Any, source: str) -> tuple[Floats, Floats]:
    """`[3, 3]` rotation and `[3]` translation of cam_from_world, from a matrix or a rotation vector. Raises FormatError."""
    given = numbers(rotation, "a rotation (3 x 3, or a vector of 3)", source)
    offset = numbers(translation, "a translation of 3 numbers", source).reshape(-1)
    # no entry of a rotation is above 1, and no rotation vector needs to be above pi
    plausible = np.isfinite(offset).all() and (np.abs(given) < 100).all()
    if not (given.shape == (3, 3) or given.size == 3) or offset.shape != (3,) or not plausible:
        found = (
            f"shapes {given.shape} and {offset.shape}" if plausible else "numbers that cannot be"
        )
        raise malformed(
            source,
            "a rotation (3 x 3, or a vector of 3) and a translation of 3",
            found,
            "mend the extrinsics",
        )
    if given.size == 3:
        return matrix_from_vector(given.reshape(3)), offset
    excess = float(np.abs(given @ given.T - np.eye(3)).max())
    if excess > _NOT_A_ROTATION or np.linalg.det(given) < 0:
        raise malformed(
            source,
            "a rotation (orthonormal, determinant 1)",
            "another matrix",
            "check the axes and the order of the rows",
        )
    return (nearest_rotation(given) if excess > _ROUNDED else given), offset


def camera_fields(camera: Camera) -> dict[str, Any]:
    """The fields of a camera in our own files."""
    return {
        "name": camera.name,
        "size": list(camera.size),
        "model": "fisheye" if camera.fisheye else "opencv",
        "K": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
    }


def camera_from_fields(fields: Any, source: str) -> Camera:
    """The inverse of `camera_fields`; the model `pinhole` has no distortion. Raises FormatError."""
    if not isinstance(fields, dict) or not {"name", "K"} <= fields.keys():
        raise malformed(
            source,
            "cameras with name, size, model, K, distortion",
            describe_keys(fields),
            "write the file again",
        )
    model = fields.get("model", "opencv")
    if model not in ("opencv", "fisheye", "pinhole"):
        raise malformed(
            f"{source}: camera {fields['name']}",
            "the model opencv, fisheye or pinhole",
            model,
            "convert the camera",
        )
    name, distortion = (
        str(fields["name"]),
        [] if model == "pinhole" else fields.get("distortion", []),
    )
    return make_camera(
        name,
        fields.get("size"),
        fields["K"],
        distortion,
        model == "fisheye",
        f"{source}: camera {name}",
    )


def describe_keys(fields: Any) -> str:
    """What came instead of a mapping with the right keys."""
    return (
        ", ".join(map(str, list(fields)[:8])) if isinstance(fields, dict) else type(fields).__name__
    )


def _size(value: Any, source: str) -> tuple[int, int]:
    """(width, height); (0, 0) where the file does not say."""
    if value is None:
        return (0, 0)
    size = numbers(value, "a size [width, height]", source).reshape(-1)
    if (
        size.shape != (2,)
        or not np.isfinite(size).all()
        or (size != size.round()).any()
        or (size < 0).any()
        or (size > 1e6).any()
    ):
        raise malformed(source, "a size [width, height] in pixels", value, "mend the size")
    return int(size[0]), int(size[1])


def _matrix(value: Any, size: tuple[int, int], source: str) -> Floats:
    """`[3, 3]` camera matrix; a skew that nobody sees is set to 0. Raises FormatError."""
    matrix = numbers(value, "a 3 x 3 camera matrix", source)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise malformed(
            source,
            "a finite 3 x 3 camera matrix",
            f"shape {matrix.shape}",
            "mend the camera matrix",
        )
    if (matrix[2, :2] != 0).any() or matrix[2, 2] != 1 or matrix[1, 0] != 0:
        raise malformed(
            source,
            "a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            matrix.tolist(),
            "transpose it if it came from MATLAB",
        )
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise malformed(
            source,
            "positive focal lengths",
            matrix[[0, 1], [0, 1]].tolist(),
            "mend the camera matrix",
        )
    # OpenCV's pinhole model has no skew and drops it silently; COLMAP's fisheye model has none either
    moved = skew_in_pixels(matrix, size[1])
    if moved > _UNSEEN or abs(matrix[0, 1]) > _SKEWED * matrix[0, 0]:
        found = f"skew {matrix[0, 1]:.6g}, which moves pixels by up to {moved:.2g}"
        raise malformed(
            source,
            "a camera matrix without skew",
            found,
            "calibrate without skew, or write 0 where that is near enough",
        )
    matrix[0, 1] = 0.0
    return matrix


def _distortion(value: Any, fisheye: bool, source: str) -> Floats:
    """As many coefficients as the model takes; missing ones are 0, and zeros too many are dropped. Raises FormatError."""
    given = numbers([] if value is None else value, "distortion coefficients", source).reshape(-1)
    if not fisheye and len(given) in _LONG_LENGTHS:
        given = _without_prism(given, source)
    lengths = (4,) if fisheye else _PINHOLE_LENGTHS
    used = int(np.flatnonzero(given).max(initial=-1)) + 1
    room = 4 if fisheye else 5
    # k1, k2 alone are clear; three may be k1 k2 k3 or k1 k2 p1
    fits = len(given) in lengths or used <= 2 or (used <= room and (fisheye or len(given) > room))
    if not fits or not np.isfinite(given).all():
        model = "the fisheye model" if fisheye else "OpenCV's model"
        raise malformed(
            source,
            f"{' or '.join(map(str, lengths))} finite distortion coefficients of {model}",
            given.tolist(),
            "calibrate with one of them",
        )
    if len(given) in lengths:
        return given
    padded = np.zeros(room)
    padded[:used] = given[:used]
    return padded


def _without_prism(given: Floats, source: str) -> Floats:
    """The first 8 of `[12 | 14]` coefficients, where the others are 0. Raises FormatError."""
    if (given[8:] != 0).any():
        found = f"thin-prism or tilt terms {given[8:].tolist()}"
        raise malformed(
            source,
            "at most 8 distortion coefficients that are not 0",
            found,
            "calibrate without thin prism and tilt",
        )
    return given[:8]
