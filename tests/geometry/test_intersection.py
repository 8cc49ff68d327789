"""The intersection of rays of many points at once gives that of each alone."""

import numpy as np
import pytest
from oracles import rays as oracle
from scenes import scene

from mocap_calib.geometry import intersection


@pytest.mark.parametrize("views", [2, 5, 9])
def test_the_kernel_gives_the_points_of_its_definition(views):
    rig = scene(cameras=views).rig
    rng = np.random.default_rng(views)
    points = rng.normal(size=(3, 500))
    rays = points - rig.centres[:, :, None]
    rays += 0.02 * rng.normal(size=rays.shape)
    wrong = rng.random((views, 1, 500)) < 0.2  # some points are searched among pairs of rays
    rays += wrong * rng.normal(size=rays.shape)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    precision = np.where(rng.random((views, 500)) < 0.8, 1e5, 0.0)
    rays[np.broadcast_to(precision[:, None] == 0, rays.shape)] = 0.0
    found = intersection.intersect(rig, rays, precision)
    expected = oracle.intersect(rig, rays, precision)
    # two rays that are nearly parallel meet far away, where rounding counts
    assert np.allclose(found, expected, rtol=1e-7, atol=1e-9, equal_nan=True)
