"""Laws of the minimisation over cameras and points."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from oracles.adjust import NormalEquations, eliminate_points, normal_equations
from scenes import scene, turn_cameras

from mocap_calib.adjust import covariance, residuals, solve
from mocap_calib.adjust.covariance import find_covariance, size_direction
from mocap_calib.adjust.problem import Problem, free_parameters, free_poses
from mocap_calib.adjust.residuals import Block, Linearised, Residuals, State, changed_cameras
from mocap_calib.adjust.solve import Parameters, minimise, optimise_points
from mocap_calib.config import Config
from mocap_calib.geometry import lens
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.rig import Tracks
from mocap_calib.types import Camera

SCALE = 3.0  # of the loss
FREE = free_poses(3)


def problem() -> tuple[State, Residuals]:
    """Return three cameras about a hundred points, with noise and gross errors."""
    rng = np.random.default_rng(0)
    true = scene(cameras=3).rig
    start = turn_cameras(true, 1.0)
    points = rng.uniform(-1, 1, (3, 100)) + np.array([[0], [0], [1.0]])
    in_camera = true.rotation @ points + true.translation[:, :, None]
    in_camera += rng.normal(0, 0.02, in_camera.shape) + (rng.random((3, 1, 100)) < 0.05) * 0.5
    rays = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
    basis = np.linalg.svd(np.moveaxis(rays, 1, 2)[..., None, :])[2][..., 1:, :]  # [view, N, 2, 3]
    weight = rng.uniform(0, 1, (3, 100)) * (rng.random((3, 100)) > 0.1)
    seen = Residuals(rays, metric=300 * np.moveaxis(basis, 1, 3), weight=weight)
    return State(start.rotation, start.translation, points, np.zeros((3, 0))), seen


def problem_with_intrinsics(
    distortion: str,
) -> tuple[State, Residuals, Parameters]:
    """Return three cameras about a hundred points that they see with noise and gross errors."""
    rng = np.random.default_rng(0)
    true = scene(cameras=3, distortion=distortion).rig
    points = rng.uniform(-1, 1, (3, 100)) + np.array([[0], [0], [1.0]])
    exact = State(true.rotation, true.translation, points, np.zeros((3, 2)))
    pixels = seen_pixels(true.cameras, exact)
    pixels += rng.normal(0, 3, pixels.shape) + (rng.random((3, 1, 100)) < 0.05) * 100
    seen = Residuals.of_pixels(
        cameras=true.cameras,
        pixels=pixels,
        sigma=np.array([2.0, 3.0, 4.0]),
        weight=(rng.random((3, 100)) > 0.1).astype(np.float64),
    )
    start = turn_cameras(true, 1.0)
    intrinsics = np.array([[0.05, -0.02], [0.1, 0.03], [-0.1, 0.0]])
    state = State(start.rotation, start.translation, points, intrinsics)
    return state, seen, free_parameters(np.arange(3), np.full((3, 2), 0.2))


def linear(state: State, seen: Residuals) -> Linearised:
    """Return the residuals of all points where they are."""
    return seen.linearise(state, SCALE, steps=0)


def whole_block(seen: Residuals) -> Block:
    """Return all points and views as one block."""
    return Block(np.arange(3), slice(0, 100), seen)


def linearise(state: State, seen: Residuals) -> NormalEquations:
    """Return the normal equations of all points."""
    return normal_equations(state.rotation, linear(state, seen))


def robust_cost(state: State, seen: Residuals) -> float:
    """Return the sum of w s^2 log(1 + r'r / s^2)."""
    return linear(state, seen).cost * SCALE**2


def seen_pixels(cameras: tuple[Camera, ...], state: State) -> np.ndarray:
    """Return where cameras see the points of a state, `[view, 2, N]`."""
    in_camera = state.rotation @ state.points + state.translation[:, :, None]
    changed = changed_cameras(cameras, state.intrinsics)
    return np.stack([lens.project(*each) for each in zip(changed, in_camera, strict=True)])


def total_cost(state: State, seen: Residuals, freedom: Parameters) -> float:
    """Return the robust cost and that of intrinsics that differ from what is known beforehand."""
    return robust_cost(state, seen) + float((freedom.precision * state.intrinsics**2).sum())


def residual_lengths(state: State, seen: Residuals) -> np.ndarray:
    """Return the lengths `[view, N]` of residuals in standard deviations, 0 where not seen."""
    linear = seen.linearise(state, 1e6, steps=0)
    return np.linalg.norm(linear.residual, axis=1)


def slope(seen: Residuals, ahead: State, behind: State, distance: float) -> float:
    """Return the slope of the cost between two states."""
    return (robust_cost(ahead, seen) - robust_cost(behind, seen)) / distance


def test_residuals_against_pixels_are_distances_in_standard_deviations():
    state, seen = problem_with_intrinsics("brown")[:2]
    expected = np.linalg.norm(seen_pixels(seen.cameras, state) - seen.seen, axis=1)
    expected = np.where(seen.weight > 0, expected / seen.sigma[:, None], 0.0)
    np.testing.assert_allclose(residual_lengths(state, seen), expected, rtol=1e-6, atol=1e-9)


def test_residuals_against_rays_are_those_of_pixels_to_first_order():
    """Of points 1 % off; measured 0.7 % of the largest."""
    state, seen = problem_with_intrinsics("brown")[:2]
    state = replace(state, intrinsics=np.zeros((3, 0)))
    off = replace(state, points=state.points * 1.01)
    pixels = seen_pixels(seen.cameras, state)
    rays = lens.unproject_views(seen.cameras, np.moveaxis(pixels, 1, 2), by_component=True)
    focal = np.array([camera.focal for camera in seen.cameras])
    by_rays = Residuals.of_rays(seen.cameras, rays, 2.0 / focal, seen.weight)
    expected = np.linalg.norm(seen_pixels(seen.cameras, off) - pixels, axis=1) / 2.0
    expected = np.where(seen.weight > 0, expected, 0.0)
    found = residual_lengths(off, by_rays)
    np.testing.assert_allclose(found, expected, atol=0.02 * expected.max())


@pytest.mark.parametrize("axis", range(3))
def test_the_gradient_is_the_slope_of_the_cost(axis):
    """By central differences, of one camera and of one point; measured 1e-7 of the largest."""
    state, seen = problem()
    equations = linearise(state, seen)
    nudge = 1e-6

    shift = np.zeros_like(state.translation)
    shift[1, axis] = nudge
    ahead = replace(state, translation=state.translation + shift)
    behind = replace(state, translation=state.translation - shift)
    expected = slope(seen, ahead, behind, 2 * nudge)
    assert 2 * equations.camera_gradient[1, 3 + axis] == pytest.approx(expected, rel=1e-5)

    shift = np.zeros_like(state.points)
    shift[axis, 7] = nudge
    ahead = replace(state, points=state.points + shift)
    behind = replace(state, points=state.points - shift)
    expected = slope(seen, ahead, behind, 2 * nudge)
    assert 2 * equations.point_gradient[axis, 7] == pytest.approx(expected, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("distortion", ["brown", "fisheye"])
@pytest.mark.parametrize("intrinsic", [0, 1])
def test_the_gradient_by_intrinsics_is_the_slope_of_the_cost(distortion, intrinsic):
    """Log focal length and k1 of one camera, with what is known beforehand: measured 1e-8."""
    state, seen, freedom = problem_with_intrinsics(distortion)
    equations = linearise(state, seen)
    nudge = np.zeros_like(state.intrinsics)
    nudge[1, intrinsic] = 1e-6
    costs = [
        total_cost(replace(state, intrinsics=state.intrinsics + step), seen, freedom)
        for step in (nudge, -nudge)
    ]
    slope = (costs[0] - costs[1]) / 2e-6
    gradient = equations.camera_gradient + freedom.prior(state.intrinsics)[1]
    assert 2 * gradient[1, 6 + intrinsic] == pytest.approx(slope, rel=1e-5)


def test_cameras_that_share_intrinsics_keep_them_alike_and_others_have_their_own():
    """Noise-free pixels of focal lengths 10 % longer for two cameras, 5 % shorter for the third."""
    state, seen, _ = problem_with_intrinsics("none")
    true = replace(state, intrinsics=np.log([[1.1], [1.1], [0.95]]))
    pixels = seen_pixels(seen.cameras, true)
    group, sigma = np.array([0, 0, 2]), np.full((3, 1), 1e3)
    found = minimise(
        replace(state, intrinsics=np.zeros((3, 1))),
        replace(seen, seen=pixels),
        free_parameters(group, sigma),
        loss_scale=SCALE,
        tolerance=1e-12,
    )
    np.testing.assert_allclose(found.intrinsics, true.intrinsics, atol=1e-5)
    assert found.intrinsics[0, 0] == found.intrinsics[1, 0]


def test_what_is_known_beforehand_counts_once_for_all_views_that_share_it():
    """Of views that saw nothing only that is left: the change goes back to zero."""
    state, seen, _ = problem_with_intrinsics("none")
    blind = replace(seen, weight=np.zeros_like(seen.weight))
    freedom = free_parameters(np.array([0, 0, 2]), np.full((3, 1), 0.1))
    state = replace(state, intrinsics=np.array([[0.3], [0.3], [0.2]]))
    assert total_cost(state, blind, freedom) == pytest.approx(3.0**2 + 2.0**2)
    np.testing.assert_array_equal(freedom.intrinsics, [[12], [12], [13]])


def whole_system(equations: NormalEquations) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrix and the gradient of all cameras and points, undamped."""
    views, count = len(equations.camera), equations.point_gradient.shape[1]
    rows = 6 * views
    matrix = np.zeros((rows + 3 * count, rows + 3 * count))
    for view, camera in enumerate(equations.camera):
        matrix[6 * view : 6 * view + 6, 6 * view : 6 * view + 6] = camera
    for n in range(count):
        point = slice(rows + 3 * n, rows + 3 * n + 3)
        matrix[point, point] = equations.point[..., n]
        matrix[:rows, point] = equations.mixed[..., n].reshape(rows, 3)
        matrix[point, :rows] = matrix[:rows, point].T
    points = equations.point_gradient.T.ravel()
    return matrix, np.concatenate([equations.camera_gradient.ravel(), points])


def test_the_reduced_system_gives_the_step_of_the_whole_system():
    """All unknowns but those of the first camera, solved at once: measured 3e-11 of the largest."""
    state, seen = problem()
    found = solve.eliminate_points(whole_block(seen), state, SCALE, steps=0)
    equations = normal_equations(state.rotation, found.linear)
    # nothing of the whole system holds the size of the rig
    matrix, gradient = whole_system(replace(equations, camera=equations.camera * 1.01))
    expected = -np.linalg.lstsq(matrix[6:, 6:], gradient[6:])[0][:12]  # one point is not seen
    held = scipy.linalg.block_diag(*(0.01 * equations.camera))
    step = -np.linalg.solve((found.matrix + held)[6:, 6:], found.gradient[6:])
    np.testing.assert_allclose(step, expected, atol=1e-9 * np.abs(expected).max())


def test_minimising_ends_where_the_gradient_vanishes():
    state, seen = problem()
    found = minimise(state, seen, FREE, loss_scale=SCALE, tolerance=1e-12)
    found = optimise_points(found, seen, loss_scale=SCALE)
    before = linearise(state, seen).camera_gradient[1:]
    after = linearise(found, seen).camera_gradient[1:]
    assert np.abs(after).max() < 1e-4 * np.abs(before).max()
    assert robust_cost(found, seen) < 0.5 * robust_cost(state, seen)
    np.testing.assert_array_equal(found.rotation[0], state.rotation[0])


def test_a_covariance_is_how_far_many_draws_of_noise_scatter_the_cameras():
    """Three views: residuals lie where the cameras pull, so its curvature counts most."""
    state, _ = problem()
    rng = np.random.default_rng(1)
    true = scene(cameras=3).rig
    loss_scale, found, stated = 1.5, [], []
    every = np.arange(100)
    none = np.zeros((3, 100))
    tracks = Tracks(none, none, none, frame=every // 5, individual=0 * every, keypoint=every % 17)
    for _ in range(20):
        in_camera = true.rotation @ state.points + true.translation[:, :, None]
        rays = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
        basis = np.linalg.svd(np.moveaxis(rays, 1, 2)[..., None, :])[2][..., 1:, :]
        noise = rng.normal(0, 1 / 300, (3, 100, 2))
        noisy = rays + np.moveaxis(np.einsum("vnk,vnki->vni", noise, basis), 1, 2)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        basis = np.linalg.svd(np.moveaxis(noisy, 1, 2)[..., None, :])[2][..., 1:, :]
        # residuals are in what is left of the noise when points have bent to it, as in a run
        metric = 300 * np.sqrt(2) * np.moveaxis(basis, 1, 3)
        drawn = Residuals(noisy, metric=metric, weight=np.ones((3, 100)))
        start = State(true.rotation, true.translation, state.points, np.zeros((3, 0)))
        fitted = minimise(start, drawn, FREE, loss_scale=loss_scale, tolerance=1e-9)
        turns = vector_from_matrix(fitted.rotation @ np.swapaxes(true.rotation, 1, 2))
        found.append((turns[1:] ** 2).sum())
        covariance = find_covariance(
            Problem(true, state.points, tracks, np.ones(3), loss_scale),
            fitted,
            drawn,
            FREE,
            Config(),
        )
        variance = covariance.once * np.diag(covariance.cautious)
        stated.append(variance.reshape(2, 6)[:, :3].sum())
    # 1.2 here; 1.6 without the curvature
    assert 0.8 < np.sqrt(np.mean(found) / np.mean(stated)) < 1.35


def test_what_a_covariance_is_made_of_is_the_sum_of_what_each_detection_adds():
    """Each alone, its point eliminated under all views that see it: measured 1e-14."""
    state, seen, freedom = problem_with_intrinsics("brown")
    several = (seen.weight > 0).sum(0) >= 2
    seen = replace(seen, weight=np.where(several, seen.weight, 0.0))
    _, found, _ = covariance.gather_information(state, seen, freedom, SCALE)
    whole = linearise(state, seen)
    inverse, _, _ = eliminate_points(whole)
    scores = np.zeros_like(found)
    for view in range(3):
        one = np.arange(3)[:, None] == view
        alone = linearise(state, replace(seen, weight=np.where(one, seen.weight, 0.0)))
        moved = np.einsum("ijn,jn->in", inverse, alone.point_gradient)
        for n in np.flatnonzero(seen.weight[view]):
            single = replace(seen, weight=np.where(one & (np.arange(100) == n), seen.weight, 0.0))
            own = linearise(state, single).camera_gradient
            added = freedom.basis.T @ (own - whole.mixed[..., n] @ moved[:, n]).ravel()
            scores[:, n] += added
    np.testing.assert_allclose(found, scores, atol=1e-10 * np.abs(scores).max())


@pytest.mark.parametrize("lens", ["known", "brown", "fisheye"])
def test_the_equations_are_those_of_their_jacobians(lens):
    """Of rays and of pixels, with a point that no view sees, and none that a single view sees."""
    state, seen = problem() if lens == "known" else problem_with_intrinsics(lens)[:2]
    several = ((seen.weight > 0).sum(0) >= 2) & (np.arange(100) != 7)
    seen = replace(seen, weight=np.where(several, seen.weight, 0.0))
    found = solve.eliminate_points(whole_block(seen), state, SCALE)
    expected = normal_equations(state.rotation, found.linear)
    _, matrix, gradient = eliminate_points(expected)
    pairs = [
        (found.matrix, matrix),
        (found.gradient, gradient),
        (found.stiffness, np.einsum("vii->vi", expected.camera).ravel()),
    ]
    for ours, defined in pairs:
        assert np.abs(ours - defined).max() < 1e-9 * np.abs(defined).max()


@pytest.mark.parametrize("lens", ["known", "brown"])
@pytest.mark.parametrize("blind", [[0], [1, 2], [0, 1, 2]])
def test_cameras_that_see_nothing_of_a_block_of_points_are_left_out_of_it(lens, blind, monkeypatch):
    """The same step and the same covariance as with all cameras in all blocks: measured 1e-15."""
    state, seen, freedom = (*problem(), FREE) if lens == "known" else problem_with_intrinsics(lens)
    monkeypatch.setattr(residuals, "_BLOCK", 16)
    hidden = np.isin(np.arange(3)[:, None], blind) & (np.arange(100) < 40)
    seen = replace(seen, weight=np.where(hidden, 0.0, seen.weight))

    def found() -> list[np.ndarray]:
        reduced = solve._reduce(state, seen, freedom, SCALE)
        information = covariance.gather_information(state, seen, freedom, SCALE)
        settled = optimise_points(state, seen, loss_scale=SCALE).points
        return [
            reduced.matrix,
            reduced.gradient,
            reduced.stiffness,
            settled,
            *information,
        ]

    of_some = found()
    monkeypatch.setattr(Residuals, "blocks", [whole_block(seen)])
    for ours, expected in zip(of_some, found(), strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("known", [True, False])
def test_points_settle_where_they_pull_no_more(known):
    """Each by itself, under cameras that stay: what a step more would gain, from a median of 4.

    Measured: 2e-6 of three in four; the slowest, of gross errors, end early.
    """
    state, seen = problem() if known else problem_with_intrinsics("brown")[:2]
    settled = seen.linearise(state, SCALE)
    there = replace(state, points=settled.points)
    equations = linearise(there, seen)
    inverse, _, _ = eliminate_points(equations)
    pull = equations.point_gradient
    gain = np.einsum("in,ijn,jn->n", pull, inverse, pull)
    assert np.quantile(gain, 0.75) < 1e-5
    assert settled.cost * SCALE**2 == pytest.approx(robust_cost(there, seen))
    assert settled.cost * SCALE**2 < robust_cost(state, seen)


def test_the_size_grows_as_poses_do_whichever_parameters_are_between_them():
    """The derivative is numerical."""
    state, _ = problem()
    free = free_parameters(np.array([-1, 1, 2]), np.ones((3, 1)))
    centres = -np.einsum("vji,vj->vi", state.rotation, state.translation)

    def translation(size):
        """Return `[view, 3]` of the rig at another size, its first camera in place."""
        grown = centres[0] + size * (centres - centres[0])
        return -np.einsum("vij,vj->vi", state.rotation, grown)

    expected = np.zeros((3, 7))
    expected[:, 3:6] = (translation(1 + 1e-5) - translation(1 - 1e-5)) / 2e-5
    np.testing.assert_allclose(
        (free.basis @ size_direction(state, free)).reshape(3, 7), expected, atol=1e-8
    )
