"""One subject, all views at once, far away: the rig by factorisation (Tomasi and Kanade 1992), no model and no pairs needed.

Two views of a subject that is small against its distance leave the rotation between them open; three settle it, up to a reversal in
depth (Ullman 1979). Both answers are given: the adjustment that follows knows which one the perspective speaks for, if it speaks.
"""

from itertools import repeat

import numpy as np

from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.multi_view.triangulation import observations
from mocap_calib.types import CameraRig, Floats, Ints, Matches, Sample

_REVERSE = np.diag([1.0, 1.0, -1.0])
_LEAST_VIEWS = 3
_LEAST_POINTS = 24
_ROUNDS = 5  # of leaving out the points that fit worst
_FAR = 2.5  # median residuals
_SWEEPS = 50


def factorise(recording: Sample, matches: Matches) -> tuple[CameraRig, ...]:
    """Two rigs, reversed in depth from each other, from the points that all views see; none where these are too few.

    Scaled orthographic cameras: what comes out is a start for the adjustment, in units of the subject's extent.
    """
    seen = observations(recording, matches, np.arange(len(recording.frames)))
    views, rays, weight = len(seen.rays), np.swapaxes(seen.rays, 1, 2), seen.confidence
    whole = np.flatnonzero(((weight > 0) & (rays[..., 2] > 0)).all(0))
    if views < _LEAST_VIEWS or len(whole) < _LEAST_POINTS:
        return ()
    image = rays[:, whole, :2] / rays[:, whole, 2:]  # (view, point, 2)
    focal = np.array([camera.focal for camera in recording.cameras])
    kept = _fitting(image * focal[:, None, None])
    rotation = _metric(_low_rank((image * focal[:, None, None])[:, kept])[0])
    if rotation is None:
        return ()
    return tuple(
        _placed(recording, turned, image[:, kept])
        for turned in (rotation, _REVERSE @ rotation @ _REVERSE)
    )


def _low_rank(image: Floats) -> tuple[Floats, Floats]:
    """The affine cameras `[view, 2, 3]` about the centroid, and the residual `[point]` of each point, in the units of the image."""
    centred = np.concatenate(
        np.swapaxes(image - image.mean(1, keepdims=True), 1, 2)
    )  # (2 view, point)
    left, size, right = np.linalg.svd(centred, full_matrices=False)
    residual = centred - (left[:, :3] * size[:3]) @ right[:3]
    return (left[:, :3] * size[:3]).reshape(-1, 2, 3), np.sqrt((residual**2).sum(0))


def _fitting(image: Floats) -> Ints:
    """The points that three dimensions explain: detectors are sometimes wrong by much."""
    kept = np.arange(image.shape[1])
    for _ in repeat(None, _ROUNDS):
        residual = _low_rank(image[:, kept])[1]
        near = residual <= max(_FAR * np.median(residual), 1.0)
        if near.all() or near.sum() < _LEAST_POINTS:
            break
        kept = kept[near]
    return kept


def _metric(affine: Floats) -> Floats | None:
    """`[view, 3, 3]` rotations: the coordinates in which both rows of each camera are as long and at right angles; None where there are none.

    The rows M_v Q M_v' are linear in the symmetric Q (Poelman and Kanade 1997, scaled orthography).
    """
    m, n = affine[:, 0], affine[:, 1]
    size = ((m**2).sum(1) + (n**2).sum(1))[:, None]
    rows = np.concatenate([(_products(m, m) - _products(n, n)) / size, 2 * _products(m, n) / size])
    q = np.linalg.svd(rows)[2][-1]
    square = np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]])
    values, vectors = np.linalg.eigh(square * np.sign(np.trace(square)))
    if (
        values[-1] <= 0 or values[1] <= 0
    ):  # one negative value is noise along the direction seen least
        return None
    upgraded = affine @ (vectors * np.sqrt(np.maximum(values, 1e-6 * values[-1])))
    across = upgraded / np.linalg.norm(upgraded, axis=-1, keepdims=True)
    return nearest_rotation(
        np.concatenate([across, np.cross(across[:, :1], across[:, 1:])], axis=1)
    )


def _products(m: Floats, n: Floats) -> Floats:
    """`[view, 6]` what the six numbers of a symmetric Q are multiplied by in m' Q n."""
    x, y, z = m.T
    u, v, w = n.T
    return np.stack([x * u, x * v + y * u, x * w + z * u, y * v, y * w + z * v, z * w], axis=1)


def _placed(recording: Sample, rotation: Floats, image: Floats) -> CameraRig:
    """The cameras as far away as the size of the subject in their images says, in units of its RMS extent."""
    middle = image.mean(1)
    centred = np.swapaxes(image - middle[:, None], 1, 2)  # (view, 2, point)
    scale = np.ones(len(rotation))
    for _ in repeat(None, _SWEEPS):
        points = np.linalg.lstsq(
            (scale[:, None, None] * rotation[:, :2]).reshape(-1, 3),
            centred.reshape(-1, centred.shape[2]),
            rcond=None,
        )[0]
        points /= np.sqrt((points**2).sum(0).mean())
        seen = rotation[:, :2] @ points
        scale = (centred * seen).sum((1, 2)) / (seen**2).sum((1, 2))
    depth = 1.0 / np.maximum(np.abs(scale), 1e-9)
    return CameraRig(
        recording.cameras,
        rotation,
        np.concatenate([middle, np.ones((len(middle), 1))], axis=1) * depth[:, None],
        "arbitrary",
    )
