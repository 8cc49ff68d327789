"""How sure the places of the cameras are: the covariance of a rig that was adjusted.

Errors of detections go together, by the moment and by the joint (`covariance`). Where a rig stands
in the world, how it is turned and how large it is means nothing: what counts is how far its
cameras are from where they should be after the best similarity between the two. So no camera is
the fixed one, and all have a share of what is not known.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import Config
from mocap_calib.geometry.rotation import skew
from mocap_calib.multi_view.bundle_adjustment import (
    choose_points,
    minimise_in_steps,
    observe_rays,
)
from mocap_calib.multi_view.covariance import find_covariance
from mocap_calib.multi_view.residuals import State
from mocap_calib.multi_view.schur import free_poses
from mocap_calib.records import Record
from mocap_calib.types import CameraRig, Floats, Matches, Sample


@dataclass(frozen=True, eq=False, repr=False)
class RigCovariance(Record):
    """The covariance of where the cameras of a rig stand, after the best similarity.

    matrix: `[view, 6, view, 6]` of small turns of the cameras (3, radians, about the axes of the
        world) and of shifts of their centres (3, in sizes of the rig).
    independent: the same if all detections erred independently: too small, but of the right shape.
    size: of the rig: RMS distance of the centres from their middle, in the unit of the rig.
    """

    matrix: Floats
    independent: Floats
    size: float

    @property
    def rotation_sigma(self) -> Floats:
        """`[view]` RMS angle in radians by which a camera is turned from its true rotation."""
        return np.sqrt(np.einsum("vivi->v", self.matrix[:, :3, :, :3]))

    @property
    def centre_sigma(self) -> Floats:
        """`[view]` RMS distance of a centre from the true one, in sizes of the rig."""
        return np.sqrt(np.einsum("vivi->v", self.matrix[:, 3:, :, 3:]))

    def pair_sigma(self, a: int, b: int) -> float:
        """Return the RMS angle in radians between the relative rotation of two views and its truth.

        a, b: indices of the views.
        """
        parts = self.matrix[[a, b], :3][:, :, [a, b], :3]
        signs = np.array([-1.0, 1.0])
        return float(np.sqrt(np.einsum("a,b,aibi->", signs, signs, parts)))


def rig_covariance(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> RigCovariance:
    """Return the covariance of a rig that has been adjusted to what was matched.

    Raises as `bundle_adjustment.adjust` does.
    """
    views = len(rig.cameras)
    points = choose_points(sample, rig, matches, config)
    seen = observe_rays(rig, points)
    start = State(rig.rotation, rig.translation, points.points, np.zeros((views, 0)))
    freedom = free_poses(views)
    state = minimise_in_steps(start, seen, freedom, config.adjust, already_close=True)
    found = find_covariance(
        state,
        seen,
        freedom,
        clusters=(points.time_blocks(config.uncertainty.time_blocks), points.keypoint),
        loss_scale=config.adjust.loss_scales[-1],
    )
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    real, independent = (
        _in_the_world(
            (freedom.basis @ free @ freedom.basis.T).reshape(views, 6, views, 6), adjusted
        )
        for free in (found.sandwich, found.bread)
    )
    return RigCovariance(matrix=real, independent=independent, size=rig_size(adjusted))


def project_out_similarity(change: Floats, rig: CameraRig) -> Floats:
    """Return what is left of changes of cameras when the best similarity is taken out.

    change: `[view, 6, ...]` turns about the axes of the world (radians) and shifts of the centres,
        in sizes of the rig.
    """
    flat = change.reshape(6 * len(rig.cameras), -1)
    basis, _ = np.linalg.qr(gauge_of(rig).reshape(len(flat), 7))
    return (flat - basis @ (basis.T @ flat)).reshape(change.shape)


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


def _in_the_world(matrix: Floats, rig: CameraRig) -> Floats:
    """Return a covariance of poses as that `[view, 6, view, 6]` of turns and shifts in the world.

    matrix: `[view, 6, view, 6]` of turns w and translations d in the frames of the cameras, the
        first of which stays: R <- exp(w) R and t <- exp(w) t + d move the centre by -R' d.
    """
    views, size = len(rig.cameras), rig_size(rig)
    to_world = np.zeros((views, 6, 6))
    to_world[:, :3, :3] = np.swapaxes(rig.rotation, 1, 2)
    to_world[:, 3:, 3:] = -np.swapaxes(rig.rotation, 1, 2) / size
    turned = np.einsum("vij,vjwk,wlk->viwl", to_world, matrix, to_world)
    half = project_out_similarity(turned.reshape(views, 6, -1), rig)
    whole = project_out_similarity(half.reshape(6 * views, 6 * views).T.reshape(views, 6, -1), rig)
    return whole.reshape(views, 6, views, 6)
