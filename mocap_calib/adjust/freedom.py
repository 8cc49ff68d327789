"""What of the cameras an adjustment may change."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Freedom:
    """What of the cameras may change, and how far their intrinsics are likely to.

    basis: `[C view, free]` 1 where an unknown of a camera is one of the free ones, else 0.
    precision: `[view, intrinsic]` inverse variance of a change of intrinsics, as much of it as
        one view of those that share them has.
    """

    basis: Floats
    precision: Floats

    @property
    def intrinsics(self) -> Ints:
        """Index `[view, intrinsic]` of the free unknown that each of the intrinsics is."""
        views, intrinsics = self.precision.shape
        by_view = self.basis.reshape(views, 6 + intrinsics, -1)
        return np.asarray(by_view[:, 6:].argmax(2), dtype=np.int64)


def free_poses(views: int) -> Freedom:
    """Return the freedom of cameras whose intrinsics are known.

    The first camera stays where it is: it is the frame of the world.
    """
    return Freedom(basis=np.eye(6 * views)[:, 6:], precision=np.zeros((views, 0)))


def free_intrinsics(group: Ints, sigma: Floats) -> Freedom:
    """Return the freedom of cameras some of whose intrinsics are adjusted with their poses.

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
    return Freedom(basis=basis.reshape(-1, basis.shape[2]), precision=precision)


def free_clocks(free: Bools, sigma: float) -> Freedom:
    """Return the freedom of cameras the offsets of whose clocks are adjusted with their poses.

    free: `[view]` the cameras whose clocks may change; that of the first camera must stay.
    sigma: standard deviation of an offset, in frames.
    """
    every = np.eye(7 * len(free)).reshape(len(free), 7, -1)
    unknown = np.ones((len(free), 7), dtype=bool)
    unknown[0, :6] = False
    unknown[:, 6] = free
    basis = every.reshape(7 * len(free), -1)[:, unknown.ravel()]
    return Freedom(basis=basis, precision=np.full((len(free), 1), sigma**-2))
