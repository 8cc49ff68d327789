"""Find the rig of one subject from all views at once, without a model and without pairs.

Factorization of the image points (Tomasi and Kanade 1992), under scaled orthography (Poelman and
Kanade 1997). Two views of a subject that is small against its distance leave the rotation between
them open; three determine it, up to a reversal in depth (Ullman 1979). Both answers are given: the
adjustment that follows knows which one the perspective speaks for, if it speaks.
"""

import numpy as np

from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import gather_tracks
from mocap_calib.types import Bools, CameraRig, Floats, Sample

# of three rotations up to a reversal; points: several times the unknowns of a view
_LEAST_VIEWS = 3
_LEAST_POINTS = 24
_REVERSE_DEPTH = np.diag([1.0, 1.0, -1.0])


def factorise(sample: Sample, matches: Matches) -> tuple[CameraRig, ...]:
    """Return two rigs, reversed in depth from each other, from the points that all views see.

    The cameras are scaled orthographic: what comes out is a start for the adjustment, in units of
    the subject's RMS extent, its centroid at the origin. Returns no rig where views or points are
    too few, or where they determine no rotations.
    """
    image = _image_points(sample, matches)
    if len(image) < _LEAST_VIEWS or image.shape[1] < _LEAST_POINTS:
        return ()
    middle = image.mean(1)
    centred = np.concatenate(np.swapaxes(image - middle[:, None], 1, 2))  # [2 x view, point]
    left, size, _ = np.linalg.svd(centred, full_matrices=False)
    # the measurement matrix of centred images has rank 3 (Tomasi and Kanade 1992, section 3)
    affine = (left[:, :3] * size[:3]).reshape(-1, 2, 3)
    upgrade = _metric_upgrade(affine)
    if upgrade is None:
        return ()
    cameras = affine @ upgrade
    length = np.linalg.norm(cameras, axis=-1, keepdims=True)
    rows = cameras / length
    third = np.cross(rows[:, :1], rows[:, 1:])
    rotation = nearest_rotation(np.concatenate([rows, third], axis=1))
    extent = np.linalg.norm(np.linalg.inv(upgrade)) / np.sqrt(image.shape[1])
    scale = length.mean((1, 2)) * extent  # of an image: a length of 1 in space is so long in it
    translation = np.column_stack([middle, np.ones(len(middle))]) / scale[:, None]
    return tuple(
        CameraRig(sample.cameras, each, translation, "arbitrary")
        for each in (rotation, _REVERSE_DEPTH @ rotation @ _REVERSE_DEPTH)
    )


def label_single_subject(sample: Sample) -> Matches | None:
    """Label the only detection of each view as the single subject.

    Returns labels `[view, frame, instance]`, 0 or -1; None where half of the frames or more show
    several detections in some view.
    """
    at_most_one: Bools = np.asarray((sample.detected.sum(-1) <= 1).all(0))
    if 2 * at_most_one.sum() <= len(at_most_one):
        return None
    return Matches(np.where(sample.detected & at_most_one[:, None], 0, -1))


def _image_points(sample: Sample, matches: Matches) -> Floats:
    """Return `[view, point, 2]` x / z, y / z of the points that all views see."""
    seen = gather_tracks(sample, matches, np.arange(len(sample.frames)))
    rays = np.swapaxes(seen.rays, 1, 2)
    in_front: Bools = (seen.weight > 0) & (rays[..., 2] > 0)
    everywhere = np.flatnonzero(in_front.all(0))
    return rays[:, everywhere, :2] / rays[:, everywhere, 2:]


def _metric_upgrade(affine: Floats) -> Floats | None:
    """Return the change of coordinates `[3, 3]` that makes cameras of affine ones, or None.

    In the right coordinates both rows m and n of each camera are as long, and at right angles:
    m' Q m = n' Q n and m' Q n = 0 are linear in the symmetric Q (Poelman and Kanade 1997, scaled
    orthography). affine: `[view, 2, 3]`.
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
    return np.asarray(vectors * np.sqrt(np.maximum(values, 1e-6 * values[-1])))


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
