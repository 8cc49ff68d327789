"""Changes of a rig, apart from what a similarity of the world changes: its place, turn and size.

These three mean nothing. How far cameras are from where they should be is what is left after the
best similarity between two rigs.
"""

import numpy as np

from mocap_calib.geometry.rotation import matrix_from_vector, skew, vector_from_matrix
from mocap_calib.types import CameraRig, Floats


def rig_change(before: CameraRig, after: CameraRig) -> Floats:
    """Return how cameras turn and shift from one rig to another, after the best similarity.

    `[view, 6]`: turns about the axes of the world of the first rig (3, radians), and shifts of the
    centres (3, in sizes of the rig). Both rigs have the same cameras; their first cameras are
    about the same, so that the worlds are.
    """
    turn = vector_from_matrix(np.swapaxes(before.rotation, 1, 2) @ after.rotation)
    scale = rig_size(before) / rig_size(after)
    offsets = [rig.centres - rig.centres.mean(0) for rig in (before, after)]
    shift = (scale * offsets[1] - offsets[0]) / rig_size(before)
    return project_out_similarity(np.concatenate([turn, shift], axis=1), before)


def with_size_of(reference: CameraRig, rig: CameraRig) -> CameraRig:
    """Return the rig at the size of a reference, the first camera where the reference has it."""
    first = reference.centres[0]
    size = np.sqrt(((rig.centres - first) ** 2).sum())
    reference_size = np.sqrt(((reference.centres - first) ** 2).sum())
    centres = first + (rig.centres - first) * (reference_size / size)
    return rig.stand(rig.rotation, centres)


def changed_rig(rig: CameraRig, change: Floats) -> CameraRig:
    """Return a rig whose cameras were turned and shifted by changes `[view, 6]` of `rig_change`."""
    rotation = rig.rotation @ matrix_from_vector(change[:, :3])
    centres = rig.centres + rig_size(rig) * change[:, 3:]
    return rig.stand(rotation, centres)


def project_out_similarity(change: Floats, rig: CameraRig) -> Floats:
    """Return what is left of changes of cameras when the best similarity is taken out.

    change: `[view, 6, ...]` turns about the axes of the world (radians) and shifts of the centres,
        in sizes of the rig.
    """
    flat = change.reshape(6 * len(rig.cameras), -1)
    basis, _ = np.linalg.qr(gauge_of(rig).reshape(len(flat), 7))
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(change.shape))


def gauge_of(rig: CameraRig) -> Floats:
    """Return the changes `[view, 6, 7]` that similarities of the world make of all cameras.

    Turns about the axes of the world, shifts in sizes of the rig, as of `RigCovariance`.
    """
    offset = (rig.centres - rig.centres.mean(0)) / rig_size(rig)
    gauge = np.zeros((len(rig.cameras), 6, 7))
    gauge[:, :3, :3] = -np.eye(3)  # the world turns by phi: all cameras turn by -phi ...
    gauge[:, 3:, :3] = -skew(offset)  # ... and their centres go about its middle
    gauge[:, 3:, 3:6] = np.eye(3)
    gauge[:, 3:, 6] = offset
    return gauge


def rig_size(rig: CameraRig) -> float:
    """Return the RMS distance of the centres of a rig from their middle, in its unit."""
    offset = rig.centres - rig.centres.mean(0)
    return float(np.sqrt((offset**2).sum(1).mean()))
