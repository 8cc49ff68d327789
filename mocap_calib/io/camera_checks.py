"""Make a `Camera` of whatever a file says of one, or a complaint.

Everything here raises FormatError for what cannot be.
"""

from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import matrix_from_vector, nearest_rotation
from mocap_calib.types import Camera, Floats

_PINHOLE_LENGTHS = (4, 5, 8)
_FISHEYE_LENGTHS = (4,)
_LONG_LENGTHS = (12, 14)  # OpenCV's thin prism and tilt, which bundle adjustment does not have
_LARGEST_SIZE = 1e6  # pixels
_LARGEST_ROTATION = 100  # no entry of a matrix is above 1, no vector needs to be longer than pi
_NOT_A_ROTATION = 1e-2  # real files round to three or four digits
_ROUNDED = 1e-9
_UNSEEN = 0.05  # pixels, well below what any detector resolves
_SKEWED = 1e-3  # of the focal length, wherever the principal point may be


def numbers(value: Any, expected: str, source: str) -> Floats:
    """Return numbers as an array `[...]`: nested lists, or a matrix as OpenCV and ROS write it.

    value: lists, or a mapping of `rows`, `cols` and `data`. expected: for the complaint.
    """
    try:
        if isinstance(value, dict):
            shape = int(value["rows"]), int(value["cols"])
            return np.array(value["data"], dtype=np.float64).reshape(shape)
        return np.array(value, dtype=np.float64)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise FormatError(source, expected, f"an error ({error})", "correct the numbers") from None


def make_camera(
    *, name: str, size: Any, matrix: Any, distortion: Any, fisheye: bool, source: str
) -> Camera:
    """Return a camera of raw fields, checked.

    size: (width, height) in pixels, or None. matrix: `[3, 3]`. distortion: `[coefficient]` in
    OpenCV's order. source: names file and camera in complaints.
    """
    known_size = _check_size(size, source)
    return Camera(
        name=name,
        size=known_size,
        matrix=_check_matrix(matrix, known_size, source),
        distortion=_check_distortion(distortion, fisheye, source),
        fisheye=fisheye,
    )


def skew_in_pixels(matrix: Floats, height: int = 0) -> float:
    """Return by how much the skew of a `[3, 3]` camera matrix moves what is seen at the edge.

    height: of the image; 0: not known, and the principal point is taken to be in the middle.
    """
    fy, cy = matrix[1, 1:]
    with np.errstate(all="ignore"):  # numbers of a damaged file
        farthest = max(abs(cy), abs(height - cy) if height else 0.0)
        return float(abs(matrix[0, 1]) * farthest / fy)


def make_extrinsics(rotation: Any, translation: Any, source: str) -> tuple[Floats, Floats]:
    """Return `[3, 3]` rotation and `[3]` translation of cam_from_world.

    rotation: a matrix or a rotation vector.
    """
    given = numbers(rotation, "a rotation (3 x 3, or a vector of 3)", source)
    offset = numbers(translation, "a translation of 3 numbers", source).reshape(-1)
    plausible = np.isfinite(offset).all() and (np.abs(given) < _LARGEST_ROTATION).all()
    fits = (given.shape == (3, 3) or given.size == 3) and offset.shape == (3,)
    if not fits or not plausible:
        found = "numbers that cannot be"
        if plausible:
            found = f"shapes {given.shape} and {offset.shape}"
        expected = "a rotation (3 x 3, or a vector of 3) and a translation of 3"
        raise FormatError(source, expected, found, "correct the extrinsics")
    if given.size == 3:
        return matrix_from_vector(given.reshape(3)), offset
    return _check_rotation(given, source), offset


def describe_keys(fields: Any) -> str:
    """Return what came instead of a mapping with the right keys."""
    if isinstance(fields, dict):
        return ", ".join(map(str, list(fields)[:8]))
    return type(fields).__name__


def _check_size(value: Any, source: str) -> tuple[int, int]:
    """Return (width, height); (0, 0) where the file does not say."""
    if value is None:
        return (0, 0)
    size = numbers(value, "a size [width, height]", source).reshape(-1)
    fits = size.shape == (2,) and np.isfinite(size).all()
    if not fits or (size != size.round()).any() or (size < 0).any() or (size > _LARGEST_SIZE).any():
        raise FormatError(source, "a size [width, height] in pixels", value, "correct the size")
    return int(size[0]), int(size[1])


def _check_rotation(given: Floats, source: str) -> Floats:
    """Return the `[3, 3]` rotation that a matrix is, or was before its numbers were rounded."""
    excess = float(np.abs(given @ given.T - np.eye(3)).max())
    if excess > _NOT_A_ROTATION or np.linalg.det(given) < 0:
        expected = "a rotation (orthonormal, determinant 1)"
        remedy = "check the axes and the order of the rows"
        raise FormatError(source, expected, "another matrix", remedy)
    return nearest_rotation(given) if excess > _ROUNDED else given


def _check_matrix(value: Any, size: tuple[int, int], source: str) -> Floats:
    """Return the `[3, 3]` camera matrix; a skew that nobody sees is set to 0."""
    matrix = numbers(value, "a 3 x 3 camera matrix", source)
    if matrix.shape == (9,):
        matrix = matrix.reshape(3, 3)
    remedy = "correct the camera matrix"
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        found = f"shape {matrix.shape}"
        raise FormatError(source, "a finite 3 x 3 camera matrix", found, remedy)
    if (matrix[2, :2] != 0).any() or matrix[2, 2] != 1 or matrix[1, 0] != 0:
        expected = "a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        advice = "transpose it if it came from MATLAB"
        raise FormatError(source, expected, matrix.tolist(), advice)
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        found = matrix[[0, 1], [0, 1]].tolist()
        raise FormatError(source, "positive focal lengths", found, remedy)
    # OpenCV's pinhole model drops a skew silently, and COLMAP's fisheye model has none
    moved = skew_in_pixels(matrix, size[1])
    if moved > _UNSEEN or abs(matrix[0, 1]) > _SKEWED * matrix[0, 0]:
        found = f"skew {matrix[0, 1]:.6g}, which moves pixels by up to {moved:.2g}"
        advice = "calibrate without skew, or write 0 where that is near enough"
        raise FormatError(source, "a camera matrix without skew", found, advice)
    matrix[0, 1] = 0.0
    return matrix


def _check_distortion(value: Any, fisheye: bool, source: str) -> Floats:
    """Return as many coefficients as the model takes, `[4 | 5 | 8]`, or `[4]` of a fisheye.

    Missing ones are 0, and zeros too many are dropped.
    """
    given = numbers([] if value is None else value, "distortion coefficients", source).reshape(-1)
    if not fisheye and len(given) in _LONG_LENGTHS:
        if (given[8:] != 0).any():
            expected = "at most 8 distortion coefficients that are not 0"
            found = f"thin-prism or tilt terms {given[8:].tolist()}"
            raise FormatError(source, expected, found, "calibrate without thin prism and tilt")
        given = given[:8]
    lengths = _FISHEYE_LENGTHS if fisheye else _PINHOLE_LENGTHS
    used = int(np.flatnonzero(given).max(initial=-1)) + 1
    room = 4 if fisheye else 5
    # k1, k2 alone are clear; three may be k1 k2 k3 or k1 k2 p1
    clear = used <= 2 or (used <= room and (fisheye or len(given) > room))
    if not (len(given) in lengths or clear) or not np.isfinite(given).all():
        model = "the fisheye model" if fisheye else "OpenCV's model"
        expected = f"{' or '.join(map(str, lengths))} finite distortion coefficients of {model}"
        raise FormatError(source, expected, given.tolist(), "calibrate with one of them")
    if len(given) in lengths:
        return given
    padded = np.zeros(room)
    padded[:used] = given[:used]
    return padded
