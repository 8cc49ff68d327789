"""Find the rig of one subject from all views at once, without a model and without pairs.

Factorization of the image points (Tomasi and Kanade 1992), under scaled orthography (Poelman and
Kanade 1997). Two views of a subject that is small against its distance leave the rotation between
them open; three determine it, up to a reversal in depth (Ullman 1979). Both answers are given: the
adjustment that follows knows which one the perspective speaks for, if it speaks.
"""

import numpy as np

from mocap_calib.config import (
    FACTORIZATION_LEAST_PX,
    FACTORIZATION_OUTLIER,
    FACTORIZATION_POINTS,
    FACTORIZATION_SWEEPS,
    FACTORIZATION_VIEWS,
)
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import gather_tracks
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Sample

_REVERSE_DEPTH = np.diag([1.0, 1.0, -1.0])


def factorise(sample: Sample, matches: Matches) -> tuple[CameraRig, ...]:
    """Return two rigs, reversed in depth from each other, from the points that all views see.

    The cameras are scaled orthographic: what comes out is a start for the adjustment, in units of
    the subject's extent. Returns no rig where views or points are too few, or where they determine
    no rotations.
    """
    image = _image_points(sample, matches)
    if len(image) < FACTORIZATION_VIEWS or image.shape[1] < FACTORIZATION_POINTS:
        return ()
    focal = np.array([camera.focal for camera in sample.cameras])
    pixels = image * focal[:, None, None]
    kept = _points_that_fit(pixels)
    affine, _ = _factorise_affine(pixels[:, kept])
    rotation = _upgrade_to_rotations(affine)
    if rotation is None:
        return ()
    reversed_rotation = _REVERSE_DEPTH @ rotation @ _REVERSE_DEPTH
    return tuple(
        _place_cameras(sample.cameras, each, image[:, kept])
        for each in (rotation, reversed_rotation)
    )


def _image_points(sample: Sample, matches: Matches) -> Floats:
    """Return `[view, point, 2]` x / z, y / z of the points that all views see."""
    seen = gather_tracks(sample, matches, np.arange(len(sample.frames)))
    rays = np.swapaxes(seen.rays, 1, 2)
    in_front: Bools = (seen.weight > 0) & (rays[..., 2] > 0)
    everywhere = np.flatnonzero(in_front.all(0))
    return rays[:, everywhere, :2] / rays[:, everywhere, 2:]


def _points_that_fit(pixels: Floats) -> Ints:
    """Return the indices `[point]` of the points that three dimensions explain.

    Detectors are sometimes wrong by much: points with a large residual are left out, until all fit.
    """
    kept = np.arange(pixels.shape[1])
    while True:
        _, residual = _factorise_affine(pixels[:, kept])
        limit = max(FACTORIZATION_OUTLIER * np.median(residual), FACTORIZATION_LEAST_PX)
        fits = residual <= limit
        if fits.all() or fits.sum() < FACTORIZATION_POINTS:
            return kept
        kept = kept[fits]


def _factorise_affine(pixels: Floats) -> tuple[Floats, Floats]:
    """Return the affine cameras `[view, 2, 3]` about the centroid, and residuals `[point]` in px.

    The measurement matrix of centred images has rank 3 (Tomasi and Kanade 1992, section 3).
    pixels: `[view, point, 2]`.
    """
    centred = pixels - pixels.mean(1, keepdims=True)
    measurements = np.concatenate(np.swapaxes(centred, 1, 2))  # [2 x view, point]
    left, size, right = np.linalg.svd(measurements, full_matrices=False)
    motion = left[:, :3] * size[:3]
    residual = measurements - motion @ right[:3]
    length = np.sqrt((residual**2).sum(0))
    return motion.reshape(-1, 2, 3), length


def _upgrade_to_rotations(affine: Floats) -> Floats | None:
    """Return `[view, 3, 3]` rotations of affine cameras `[view, 2, 3]`, None where there are none.

    In the right coordinates both rows m and n of each camera are as long, and at right angles:
    m' Q m = n' Q n and m' Q n = 0 are linear in the symmetric Q (Poelman and Kanade 1997, scaled
    orthography).
    """
    m, n = affine[:, 0], affine[:, 1]
    size = (m**2).sum(1) + (n**2).sum(1)
    same_length = (_quadratic_terms(m, m) - _quadratic_terms(n, n)) / size[:, None]
    right_angle = 2 * _quadratic_terms(m, n) / size[:, None]
    constraints = np.concatenate([same_length, right_angle])
    _, _, right = np.linalg.svd(constraints)
    xx, xy, xz, yy, yz, zz = right[-1]
    q = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    values, vectors = np.linalg.eigh(q * np.sign(np.trace(q)))
    # one negative value is noise along the direction that is seen least
    if values[-1] <= 0 or values[1] <= 0:
        return None
    values = np.maximum(values, 1e-6 * values[-1])
    upgraded = affine @ (vectors * np.sqrt(values))
    rows = upgraded / np.linalg.norm(upgraded, axis=-1, keepdims=True)
    third = np.cross(rows[:, :1], rows[:, 1:])
    return nearest_rotation(np.concatenate([rows, third], axis=1))


def _quadratic_terms(m: Floats, n: Floats) -> Floats:
    """Return `[view, 6]` the factors of the six numbers of a symmetric Q in m' Q n.

    m, n: `[view, 3]`. The order is xx, xy, xz, yy, yz, zz.
    """
    x, y, z = m.T
    u, v, w = n.T
    xx = x * u
    xy = x * v + y * u
    xz = x * w + z * u
    yy = y * v
    yz = y * w + z * v
    zz = z * w
    return np.stack([xx, xy, xz, yy, yz, zz], axis=1)


def _place_cameras(cameras: tuple[Camera, ...], rotation: Floats, image: Floats) -> CameraRig:
    """Return the rig with cameras as far away as the size of the subject in their images says.

    rotation: `[view, 3, 3]`; image: `[view, point, 2]`. Lengths are in units of the subject's RMS
    extent, the origin is its centroid.
    """
    centroid = image.mean(1)
    centred = np.swapaxes(image - centroid[:, None], 1, 2)  # [view, 2, point]
    scale = _scales(rotation[:, :2], centred)
    depth = 1.0 / np.maximum(np.abs(scale), 1e-9)
    direction = np.concatenate([centroid, np.ones((len(centroid), 1))], axis=1)
    return CameraRig(cameras, rotation, direction * depth[:, None], "arbitrary")


def _scales(rows: Floats, centred: Floats) -> Floats:
    """Return `[view]` scales of the images: a length of 1 in space is so long in the image.

    The points and the scales are found in turns. rows: `[view, 2, 3]`, the first rows of the
    rotations; centred: `[view, 2, point]`.
    """
    scale = np.ones(len(rows))
    measurements = centred.reshape(-1, centred.shape[2])
    for _ in range(FACTORIZATION_SWEEPS):
        motion = (scale[:, None, None] * rows).reshape(-1, 3)
        points = np.linalg.lstsq(motion, measurements, rcond=None)[0]
        points /= np.sqrt((points**2).sum(0).mean())
        projected = rows @ points
        product = (centred * projected).sum((1, 2))
        scale = product / (projected**2).sum((1, 2))
    return scale
