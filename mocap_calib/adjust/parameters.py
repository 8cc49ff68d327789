"""Which parameters of the cameras are free in an adjustment, and what is known of them."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Parameters:
    """The free parameters of cameras: poses, and intrinsics with a prior.

    Each camera has C parameters: turn, shift, and its intrinsics.
    basis: `[C view, free]` 1 where a parameter of a camera is one of the free ones, else 0.
    precision: `[view, intrinsic]` inverse variance of a change of intrinsics; views that share them
        have a part of it each.
    """

    basis: Floats
    precision: Floats

    @property
    def intrinsics(self) -> Ints:
        """Index `[view, intrinsic]` of the free parameter that each of the intrinsics is."""
        return np.asarray(self.by_view[:, 6:].argmax(2), dtype=np.int64)

    @property
    def by_view(self) -> Floats:
        """The basis as `[view, C, free]`."""
        return self.basis.reshape(len(self.precision), -1, self.basis.shape[1])

    def prior(self, intrinsics: Floats) -> tuple[Floats, Floats]:
        """Return stiffness and gradient `[view, C]` of the prior at changes of intrinsics."""
        of_pose = np.zeros((len(intrinsics), 6))
        gradient = np.concatenate([of_pose, self.precision * intrinsics], axis=1)
        return np.concatenate([of_pose, self.precision], axis=1), gradient


def free_poses(views: int) -> Parameters:
    """Return free poses of cameras whose intrinsics are known.

    The first camera stays where it is: it is the frame of the world.
    """
    return Parameters(basis=np.eye(6 * views)[:, 6:], precision=np.zeros((views, 0)))


def free_intrinsics(group: Ints, sigma: Floats) -> Parameters:
    """Return free poses and intrinsics.

    group: `[view]` cameras of one number share the changes of their intrinsics.
    sigma: `[view, intrinsic]` standard deviation of a change, the same in all views of a group.
    """
    views, intrinsics = sigma.shape
    first_free = 6 * (views - 1)
    groups, of_view, sizes = np.unique(group, return_inverse=True, return_counts=True)
    basis = np.zeros((views, 6 + intrinsics, first_free + len(groups) * intrinsics))
    for view in range(views):
        if view > 0:
            basis[view, :6, 6 * (view - 1) : 6 * view] = np.eye(6)
        start = first_free + of_view[view] * intrinsics
        basis[view, 6:, start : start + intrinsics] = np.eye(intrinsics)
    precision = 1 / (sigma**2 * sizes[of_view][:, None])
    return Parameters(basis=basis.reshape(-1, basis.shape[2]), precision=precision)


def free_clocks(free: Bools, sigma: float) -> Parameters:
    """Return free poses, and free offsets of some clocks.

    free: `[view]` the cameras whose clocks may change; that of the first camera must stay.
    sigma: standard deviation of an offset, in frames.
    """
    every = np.eye(7 * len(free)).reshape(len(free), 7, -1)
    unknown = np.ones((len(free), 7), dtype=bool)
    unknown[0, :6] = False
    unknown[:, 6] = free
    basis = every.reshape(7 * len(free), -1)[:, unknown.ravel()]
    return Parameters(basis=basis, precision=np.full((len(free), 1), sigma**-2))
