"""A track as the kernels of `poses` take it, see `poses.lanes`."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels.pose_bands import factor_bands
from mocap_calib.kernels.pose_energy import LANES
from mocap_calib.kernels.pose_motion import share_accelerations
from mocap_calib.poses.energy import SHARED_LEAST, SHARED_ROUNDS, Strengths, shared_part
from mocap_calib.poses.lanes import fill_tiles, in_lanes, in_tiles
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class Packed:
    """Arrays of `energy_kernels.sum_terms` and of `bands_kernels.factor_bands`.

    Points, what accelerations share, along and factor are overwritten.
    """

    joints: int
    config: PosesConfig
    rays: Floats
    centres: Floats
    points: Floats
    steps: Floats
    expected: Floats
    stiffness: Floats
    edges: Ints
    bones: Floats
    along: Floats
    factor: Floats

    def share_accelerations(self) -> None:
        """Set what joints share of their accelerations at the points."""
        if self.expected[:, 0].any():
            share_accelerations(
                self.points,
                self.steps,
                self.joints,
                SHARED_ROUNDS,
                SHARED_LEAST,
                shared_part(self.joints, self.config),
                self.expected,
            )

    def factor_bands(self, gradient: Floats) -> None:
        """Add accelerations to the blocks and the gradient, and factor the bands."""
        factor_bands(
            self.points,
            self.steps,
            self.expected,
            self.stiffness,
            self.config.prior_loss,
            self.factor,
            gradient,
        )


def pack(
    points: Floats,
    seen: Detections,
    body: Body,
    strengths: Strengths,
    config: PosesConfig,
) -> Packed:
    """Return a track packed, from the points `[keypoint, frame, 3]`."""
    joints, frames = points.shape[:2]
    lanes = LANES
    found = in_lanes(points, lanes)
    usual = 1 / (strengths.acceleration * body.size) ** 2 * (body.steps[0] != 0)
    stiffness = np.zeros((len(found), lanes))
    stiffness.reshape(-1)[:joints] = body.agility**-2
    expected = np.zeros((5, frames))
    expected[0], expected[1] = usual, config.ridge / body.size**2
    edges, bones = _pack_bones(body, strengths, lanes)
    return Packed(
        joints=joints,
        config=config,
        rays=_pack_rays(seen, lanes),
        centres=np.ascontiguousarray(seen.centres),
        points=found,
        steps=np.ascontiguousarray(in_tiles(body.steps, lanes).T),
        expected=np.ascontiguousarray(in_tiles(expected, lanes).T),
        stiffness=stiffness,
        edges=edges,
        bones=bones,
        along=np.empty((len(bones), len(edges), 4 * lanes)),
        factor=np.zeros((len(found), found.shape[1], 16 * lanes)),
    )


def _pack_rays(seen: Detections, lanes: int) -> Floats:
    """Return rays and precisions `[tile, view, keypoint, 4 * lanes]`, 0 beyond the frames."""
    views, joints, frames = seen.precision.shape
    found = np.zeros((-(-frames // lanes), views, joints, 4, lanes))
    for k in range(3):
        fill_tiles(seen.rays[k], found[..., k, :])
    fill_tiles(seen.precision, found[..., 3, :])
    return found.reshape(len(found), views, joints, 4 * lanes)


def _pack_bones(body: Body, strengths: Strengths, lanes: int) -> tuple[Ints, Floats]:
    """Return the edges that tell `[edge, 2]`, and of these `[tile, edge, 3 * lanes]`.

    The lengths, their inverse standard deviations, and the shortest length to divide by.
    """
    edges = body.edges if np.isfinite(strengths.bones) else body.edges[:0]
    lengths, varies = body.lengths[: len(edges)], body.varies[: len(edges)]
    known = np.isfinite(lengths)
    sigma = np.hypot(strengths.bones * body.size, np.where(known, varies, 0.0))
    found = np.zeros((-(-lengths.shape[1] // lanes), len(edges), 3, lanes))
    fill_tiles(np.where(known, lengths, 0.0), found[..., 0, :])
    fill_tiles(known / sigma, found[..., 1, :])
    found[..., 2, :] = 1e-9 * body.size.min()
    return np.ascontiguousarray(edges), found.reshape(len(found), len(edges), 3 * lanes)
