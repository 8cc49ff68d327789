"""The least squares of a camera's pose, held to its definition."""

import numpy as np
from oracles import adjust as oracle

from mocap_calib.adjust import resection
from mocap_calib.adjust.resection import CameraPoses, Sightings, _linearise, costs_of
from mocap_calib.geometry.rotation import matrix_from_vector


def test_detections_count_by_how_far_they_are_off_in_tolerances():
    """The weight is 1 / (1 + (gap / tolerance)^2)^2: of its scale, and of no other."""
    rng = np.random.default_rng(0)
    poses = CameraPoses(matrix_from_vector(np.array([[0.1, 0.4, 0.0]])), np.array([[0.2, 0, 5.0]]))
    points = rng.normal(0, 0.5, (1, 3, 7, 3))
    in_camera = points @ poses.rotation[0].T + poses.translation[0]
    unit = in_camera / np.linalg.norm(in_camera, axis=-1, keepdims=True)
    rays = unit + rng.normal(0, 0.03, unit.shape)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    counted = np.array([[True, True, False]])
    for tolerance in (0.02, 0.05):
        found = _linearise(poses, points, rays, counted=counted, tolerance=tolerance)
        square = ((unit - rays) ** 2).sum(-1)
        weight = counted[..., None] / (1 + square / tolerance**2) ** 2
        np.testing.assert_allclose(found.square, (weight * square).sum(-1), rtol=1e-9)
        length = np.linalg.norm(in_camera, axis=-1)
        np.testing.assert_allclose(found.depth, (weight * length).sum() / weight.sum(), rtol=1e-9)


def test_the_slope_is_the_change_of_the_gap():
    """A change of the pose by the unknowns of the problem, against differences."""
    rng = np.random.default_rng(1)
    rotation = matrix_from_vector(np.array([[0.3, -0.2, 0.1]]))
    poses = CameraPoses(rotation, np.array([[0.1, -0.3, 4.0]]))
    points, rays = rng.normal(0, 0.5, (1, 1, 9, 3)), rng.normal(0, 0.1, (1, 1, 9, 3)) + [0, 0, 1]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    one = np.ones((1, 1), bool)
    start = _linearise(poses, points, rays, counted=one, tolerance=1e6)
    step = 1e-6
    for k in range(6):
        change = step * np.eye(6)[k]
        turn = matrix_from_vector(change[None, :3])
        moved = np.einsum("pij,pj->pi", turn, poses.translation) + start.depth * change[3:]
        near = _linearise(
            CameraPoses(turn @ rotation, moved), points, rays, counted=one, tolerance=1e6
        )
        slope = (near.square - start.square) / (2 * step)
        np.testing.assert_allclose(slope, start.target[..., k], rtol=1e-4, atol=1e-5)


def test_the_kernel_compares_as_its_definition_does():
    """Joints missing on either side, bodies that are not there, and too few joints in common."""
    rng = np.random.default_rng(2)
    poses = CameraPoses(
        matrix_from_vector(rng.normal(0, 0.3, (6, 3))), rng.normal(0, 0.3, (6, 3)) + [0, 0, 4]
    )
    bodies = rng.normal(0, 0.6, (5, 4, 11, 3))
    bodies[rng.random((5, 4, 11)) < 0.3] = np.nan
    bodies[2, 1:] = np.nan
    bodies[3] = np.nan
    frame = np.sort(rng.integers(0, 5, 40))
    rays = rng.normal(0, 0.2, (40, 11, 3)) + [0, 0, 1]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays[rng.random((40, 11)) < 0.3] = np.nan
    seen = Sightings(frame, rays, bodies)
    tolerance = rng.uniform(0.02, 0.3, 40)
    found = resection._compare(poses, seen, tolerance, 4)
    assert np.isnan(found.cost).any()
    assert len(np.unique(found.body)) == 4
    cost, body = oracle.compare_poses(poses.rotation, poses.translation, seen, tolerance, 4)
    np.testing.assert_allclose(found.cost, cost, rtol=1e-11)
    np.testing.assert_array_equal(found.body, body)
    np.testing.assert_array_equal(costs_of(poses, seen, tolerance, 4), found.cost)
