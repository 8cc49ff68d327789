"""Laws of the minimisation over cameras and points, its covariance, and what it is given."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.views import eliminate_points, normal_equations
from rigs import unit
from scenes import scene, turn_cameras

from mocap_calib.adjust import covariance, solve
from mocap_calib.adjust.covariance import find_covariance, hotelling_factor, size_direction
from mocap_calib.adjust.intrinsics import shared_intrinsics
from mocap_calib.adjust.problem import (
    Problem,
    choose_loss_scale,
    drop_low_confidence,
    free_parameters,
    free_poses,
)
from mocap_calib.adjust.residuals import Block, Residuals, State, changed_cameras
from mocap_calib.adjust.solve import Parameters, minimise, optimise_points
from mocap_calib.config import AdjustConfig, Config, IntrinsicsConfig
from mocap_calib.geometry import lens
from mocap_calib.geometry.rotation import matrix_from_vector, vector_from_matrix
from mocap_calib.rig import MEDIAN_DISTANCE, Tracks
from mocap_calib.types import Camera

SCALE = 3.0  # of the loss
CONFIG = AdjustConfig()
LENSES = ["known", "brown", "fisheye"]
close = np.testing.assert_allclose


def problem(lenses: str, count: int = 100) -> tuple[State, Residuals, Parameters]:
    """Return three cameras about points that they see with noise and gross errors.

    Where lenses are known, residuals are against rays, else against pixels.
    """
    rng = np.random.default_rng(0)
    true = scene(cameras=3, distortion="none" if lenses == "known" else lenses).rig
    points = rng.uniform(-1, 1, (3, count)) + np.array([[0], [0], [1.0]])
    exact = State(true.rotation, true.translation, points, np.zeros((3, 2)))
    pixels = pixels_of(true.cameras, exact)
    pixels += rng.normal(0, 3, pixels.shape) + (rng.random((3, 1, count)) < 0.05) * 100
    weight = rng.uniform(0.2, 1, (3, count)) * (rng.random((3, count)) > 0.1)
    start = turn_cameras(true, 1.0)
    if lenses == "known":
        rays = lens.unproject_views(true.cameras, np.moveaxis(pixels, 1, 2), by_component=True)
        seen = Residuals.of_rays(true.cameras, rays, 3.0 / focal(true.cameras), weight)
        state = State(start.rotation, start.translation, points, np.zeros((3, 0)))
        return state, seen, free_poses(3)
    sigma = np.array([2.0, 3.0, 4.0])
    seen = Residuals.of_pixels(cameras=true.cameras, pixels=pixels, sigma=sigma, weight=weight)
    intrinsics = np.array([[0.05, -0.02], [0.1, 0.03], [-0.1, 0.0]])
    state = State(start.rotation, start.translation, points, intrinsics)
    return state, seen, free_parameters(np.arange(3), np.full((3, 2), 0.2))


def focal(cameras: tuple[Camera, ...]) -> np.ndarray:
    return np.array([camera.focal for camera in cameras])


def pixels_of(cameras: tuple[Camera, ...], state: State) -> np.ndarray:
    """Return where cameras see the points of a state, `[view, 2, N]`."""
    in_camera = state.rotation @ state.points + state.translation[:, :, None]
    changed = changed_cameras(cameras, state.intrinsics)
    return np.stack([lens.project(*each) for each in zip(changed, in_camera, strict=True)])


def seen_twice(seen: Residuals) -> Residuals:
    """Return residuals where no point is seen by a single view, and one by none."""
    several = ((seen.weight > 0).sum(0) >= 2) & (np.arange(seen.weight.shape[1]) != 7)
    return replace(seen, weight=np.where(several, seen.weight, 0.0))


def equations_of(state: State, seen: Residuals):
    """Return the normal equations of all points where they are."""
    return normal_equations(state.rotation, seen.linearise(state, SCALE, steps=0))


def cost_of(state: State, seen: Residuals) -> float:
    """Return the sum of w s^2 log(1 + r'r / s^2), of lengths measured without a loss."""
    flat = seen.linearise(state, 1e6, steps=0)
    square = (flat.residual**2).sum(1) / np.where(seen.weight > 0, seen.weight, 1)
    return float((seen.weight * np.log1p(square / SCALE**2)).sum() * SCALE**2)


# residuals


def test_residuals_are_distances_in_standard_deviations():
    """Of pixels; and to first order of rays: of points 1 % off 0.7 % of the largest is measured."""
    state, seen, _ = problem("brown")
    lengths = np.linalg.norm(seen.linearise(state, 1e6, steps=0).residual, axis=1)
    expected = np.linalg.norm(pixels_of(seen.cameras, state) - seen.seen, axis=1)
    close(lengths, expected * np.sqrt(seen.weight) / seen.sigma[:, None], rtol=1e-6, atol=1e-9)
    state = replace(state, intrinsics=np.zeros((3, 0)))
    off, pixels = replace(state, points=state.points * 1.01), pixels_of(seen.cameras, state)
    rays = lens.unproject_views(seen.cameras, np.moveaxis(pixels, 1, 2), by_component=True)
    used = (seen.weight > 0).astype(float)
    by_rays = Residuals.of_rays(seen.cameras, rays, 2.0 / focal(seen.cameras), used)
    lengths = np.linalg.norm(by_rays.linearise(off, 1e6, steps=0).residual, axis=1)
    expected = np.linalg.norm(pixels_of(seen.cameras, off) - pixels, axis=1) / 2.0 * used
    close(lengths, expected, atol=0.02 * expected.max())


@pytest.mark.parametrize("lenses", LENSES)
def test_gradients_are_the_slopes_of_the_cost(lenses):
    """By central differences, of all that one camera has and of one point: measured 1e-7."""
    state, seen, _ = problem(lenses)
    equations = equations_of(state, seen)
    assert seen.linearise(state, SCALE, steps=0).cost * SCALE**2 == pytest.approx(
        cost_of(state, seen)
    )

    def moved(camera: np.ndarray, point: np.ndarray) -> float:
        turn = np.stack([np.eye(3), matrix_from_vector(camera[:3]), np.eye(3)])
        translation = state.translation.copy()
        translation[1] = turn[1] @ translation[1] + camera[3:6]
        intrinsics, points = state.intrinsics.copy(), state.points.copy()
        intrinsics[1] += camera[6:]
        points[:, 7] += point
        return cost_of(State(turn @ state.rotation, translation, points, intrinsics), seen)

    count = equations.camera_gradient.shape[1]
    expected = np.concatenate([equations.camera_gradient[1], equations.point_gradient[:, 7]])
    for slope, step in zip(2 * expected, 1e-6 * np.eye(count + 3), strict=True):
        there, back = (moved(sign * step[:count], sign * step[count:]) for sign in (1, -1))
        assert (there - back) / 2e-6 == pytest.approx(slope, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("lenses", LENSES)
def test_the_reduced_equations_are_those_of_their_jacobians(lenses):
    """Of rays and of pixels, with a point that no view sees, and none that a single view sees."""
    state, seen, _ = problem(lenses)
    seen = seen_twice(seen)
    found = solve.eliminate_points(Block(np.arange(3), slice(0, 100), seen), state, SCALE)
    expected = normal_equations(state.rotation, found.linear)
    _, matrix, gradient = eliminate_points(expected)
    stiffness = np.einsum("vii->vi", expected.camera).ravel()
    close(found.matrix, matrix, atol=1e-9 * np.abs(matrix).max())
    close(found.gradient, gradient, atol=1e-9 * np.abs(gradient).max())
    close(found.stiffness, stiffness, rtol=1e-9)


@pytest.mark.parametrize("lenses", ["known", "brown"])
def test_points_settle_where_they_pull_no_more(lenses):
    """Each by itself, under cameras that stay: what a step more would gain, from a median of 4.

    Measured: 2e-6 of three in four; the slowest, of gross errors, end early.
    """
    state, seen, _ = problem(lenses)
    settled = seen.linearise(state, SCALE)
    there = replace(state, points=settled.points)
    equations = equations_of(there, seen)
    inverse, _, _ = eliminate_points(equations)
    pull = equations.point_gradient
    gain = np.einsum("in,ijn,jn->n", pull, inverse, pull)
    assert np.quantile(gain, 0.75) < 1e-5
    assert settled.cost * SCALE**2 == pytest.approx(cost_of(there, seen))
    assert settled.cost * SCALE**2 < cost_of(state, seen)


# the minimum


@pytest.mark.parametrize("lenses", ["known", "brown"])
def test_minimising_ends_where_the_gradient_vanishes(lenses):
    """With what is known of the intrinsics beforehand. The first camera stays."""
    state, seen, free = problem(lenses)

    def pull(at: State) -> np.ndarray:
        gradient = equations_of(at, seen).camera_gradient + free.prior(at.intrinsics)[1]
        return free.basis.T @ gradient.ravel()

    found = minimise(state, seen, free, loss_scale=SCALE, tolerance=1e-12)
    found = optimise_points(found, seen, loss_scale=SCALE)
    assert np.abs(pull(found)).max() < 1e-4 * np.abs(pull(state)).max()
    assert cost_of(found, seen) < 0.5 * cost_of(state, seen)
    np.testing.assert_array_equal(found.rotation[0], state.rotation[0])


@pytest.mark.parametrize("lenses", ["known", "brown"])
def test_the_order_of_points_and_the_views_of_their_blocks_do_not_matter(lenses):
    """Blocks leave out the views that see nothing of them; here the first of the points by one.

    Or none by any. Measured 1e-9 of the rig, and 1e-11 of the information.
    """
    state, seen, free = problem(lenses, count=3000)
    weight = seen.weight.copy()
    weight[0, :1200] = 0.0
    weight[:, 2100:] = 0.0
    order = np.random.default_rng(0).permutation(3000)
    mixed = replace(
        seen,
        seen=seen.seen[..., order],
        weight=weight[:, order],
        metric=seen.metric[..., order] if seen.metric.size else seen.metric,
    )
    seen = replace(seen, weight=weight)
    assert {len(block.views) for block in seen.blocks} == {2, 3}
    assert {len(block.views) for block in mixed.blocks} == {3}
    shuffled = replace(state, points=state.points[:, order])
    both = [
        minimise(*each, free, loss_scale=SCALE, tolerance=1e-10)
        for each in ((state, seen), (shuffled, mixed))
    ]
    close(both[0].rotation, both[1].rotation, atol=1e-8)
    close(both[0].translation, both[1].translation, atol=1e-7)
    settled = [
        optimise_points(*each, loss_scale=SCALE).points
        for each in ((state, seen), (shuffled, mixed))
    ]
    close(settled[0][:, order], settled[1], atol=1e-9)
    first = covariance.gather_information(state, seen, free, SCALE)
    second = covariance.gather_information(shuffled, mixed, free, SCALE)
    close(second[0], first[0], atol=1e-10 * np.abs(first[0]).max())
    close(second[1], first[1][:, order], atol=1e-9 * np.abs(first[1]).max())
    assert second[2] == pytest.approx(first[2])


def test_cameras_that_share_intrinsics_keep_them_alike_and_others_have_their_own():
    """Noise-free pixels of focal lengths 10 % longer for two cameras, 5 % shorter for the third."""
    state, seen, _ = problem("none")
    true = replace(state, intrinsics=np.log([[1.1], [1.1], [0.95]]))
    found = minimise(
        replace(state, intrinsics=np.zeros((3, 1))),
        replace(seen, seen=pixels_of(seen.cameras, true)),
        free_parameters(np.array([0, 0, 2]), np.full((3, 1), 1e3)),
        loss_scale=SCALE,
        tolerance=1e-12,
    )
    close(found.intrinsics, true.intrinsics, atol=1e-5)
    assert found.intrinsics[0, 0] == found.intrinsics[1, 0]


def test_what_is_known_beforehand_counts_once_for_all_views_that_share_it():
    free = free_parameters(np.array([0, 0, 2]), np.full((3, 1), 0.1))
    intrinsics = np.array([[0.3], [0.3], [0.2]])
    assert (free.precision * intrinsics**2).sum() == pytest.approx(3.0**2 + 2.0**2)
    np.testing.assert_array_equal(free.intrinsics, [[12], [12], [13]])


# covariances


def test_a_covariance_is_how_far_many_draws_of_noise_scatter_the_cameras():
    """Three views: residuals lie where the cameras pull, so its curvature counts most."""
    rng, every, scale = np.random.default_rng(1), np.arange(100), 1.5
    true = scene(cameras=3).rig
    points = problem("known")[0].points
    start = State(true.rotation, true.translation, points, np.zeros((3, 0)))
    none, free = np.zeros((3, 100)), free_poses(3)
    tracks = Tracks(none, none, none, frame=every // 5, individual=0 * every, keypoint=every % 17)
    found, stated = [], []
    for _ in range(20):
        rays = unit(true.rotation @ points + true.translation[:, :, None], 1)
        noisy = unit(rays + np.cross(rng.normal(0, 1 / 300, rays.shape), rays, axis=1), 1)
        basis = np.linalg.svd(np.moveaxis(noisy, 1, 2)[..., None, :])[2][..., 1:, :]
        # residuals are in what is left of the noise when points have bent to it, as in a run
        metric = 300 * np.sqrt(2) * np.moveaxis(basis, 1, 3)
        drawn = Residuals(noisy, metric=metric, weight=np.ones((3, 100)))
        fitted = minimise(start, drawn, free, loss_scale=scale, tolerance=1e-9)
        turns = vector_from_matrix(fitted.rotation @ np.swapaxes(true.rotation, 1, 2))
        found.append((turns[1:] ** 2).sum())
        whole = Problem(true, points, tracks, np.ones(3), scale)
        of_draw = find_covariance(whole, fitted, drawn, free, Config())
        variance = of_draw.once * np.diag(of_draw.cautious)
        stated.append(variance.reshape(2, 6)[:, :3].sum())
    # 1.2 here; 1.6 without the curvature
    assert 0.8 < np.sqrt(np.mean(found) / np.mean(stated)) < 1.35


def test_what_a_covariance_is_made_of_is_the_sum_of_what_each_detection_adds():
    """Each alone, its point eliminated under all views that see it: measured 1e-14."""
    state, seen, free = problem("brown")
    seen = seen_twice(seen)
    _, found, _ = covariance.gather_information(state, seen, free, SCALE)
    whole = equations_of(state, seen)
    inverse, _, _ = eliminate_points(whole)
    scores, every = np.zeros_like(found), np.arange(100)
    for view, n in np.argwhere(seen.weight > 0):
        one = (np.arange(3)[:, None] == view) & (every == n)
        single = equations_of(state, replace(seen, weight=np.where(one, seen.weight, 0.0)))
        moved = inverse[..., n] @ single.point_gradient[:, n]
        added = single.camera_gradient - whole.mixed[..., n] @ moved
        scores[:, n] += free.basis.T @ added.ravel()
    close(found, scores, atol=1e-10 * np.abs(scores).max())


def test_the_size_grows_as_poses_do_whichever_parameters_are_between_them():
    """The derivative is numerical."""
    state, _, _ = problem("known")
    free = free_parameters(np.array([-1, 1, 2]), np.ones((3, 1)))
    rig = scene(cameras=3).rig.stand(
        state.rotation, -np.einsum("vji,vj->vi", state.rotation, state.translation)
    )

    def translation(size):
        """Return `[view, 3]` of the rig at another size, its first camera in place."""
        return rig.stand(
            rig.rotation, rig.centres[0] + size * (rig.centres - rig.centres[0])
        ).translation

    expected = np.zeros((3, 7))
    expected[:, 3:6] = (translation(1 + 1e-5) - translation(1 - 1e-5)) / 2e-5
    close((free.basis @ size_direction(state, free)).reshape(3, 7), expected, atol=1e-8)


def test_regions_hold_as_many_draws_as_they_say():
    """Draws of three normal numbers, with covariances estimated from nine of them."""
    rng, degrees = np.random.default_rng(0), 8
    drawn = rng.normal(size=(20_000, degrees + 2, 3))
    spread = np.swapaxes(drawn[:, 1:], 1, 2) @ drawn[:, 1:] / (degrees + 1)
    square = np.einsum("ni,nij,nj->n", drawn[:, 0], np.linalg.inv(spread), drawn[:, 0])
    region = 7.815 * hotelling_factor(degrees + 1)  # 95 % of three squared normal numbers
    assert np.mean(square < region) == pytest.approx(0.95, abs=0.01)
    assert hotelling_factor(1e8) == pytest.approx(1.0, abs=0.006)


# what is adjusted


def test_the_least_confident_share_is_left_out_where_a_view_has_many_detections():
    """Not of few, nor of equal ones; what is missing stays missing."""
    many = np.random.default_rng(0).permutation(np.linspace(0.1, 1.0, 2000))
    few = np.linspace(0.1, 1.0, CONFIG.enough_detections)
    equal = np.where(np.arange(3000) % 3 == 0, 0.0, 1.0)
    for given, kept in ((many, many >= np.quantile(many, 0.3)), (few, few > 0), (equal, equal > 0)):
        (found,) = drop_low_confidence(given[None], CONFIG)
        np.testing.assert_array_equal(found, np.where(kept, given, 0.0))
    more = np.linspace(0.1, 1.0, CONFIG.enough_detections + 50)
    assert (drop_low_confidence(more[None], CONFIG) > 0).sum() >= CONFIG.enough_detections


@pytest.mark.parametrize(("degrees", "scale"), [(np.inf, 3.0), (2.0, 1.5), (1.0, 1.5)])
def test_the_loss_is_as_wide_as_the_errors_ask(degrees, scale):
    """Normal errors ask for a wide loss, Student's errors of few degrees of freedom for a narrow.

    The variance of the other is larger by 13 % or more.
    """
    rng = np.random.default_rng(0)
    errors = rng.normal(size=(20_000, 2))
    if np.isfinite(degrees):
        errors /= np.sqrt(rng.chisquare(degrees, size=20_000) / degrees)[:, None]
    lengths = np.linalg.norm(errors, axis=1)
    assert choose_loss_scale(lengths * MEDIAN_DISTANCE / np.median(lengths), (3.0, 1.5)) == scale


@pytest.mark.parametrize(
    ("sizes", "alone", "expected"),
    [
        (((1000, 1000), (1000, 1002), (640, 480)), False, [0, 0, 2]),
        (((1920, 1080), (1080, 1920), (1280, 720)), False, [0, 0, 2]),
        (((1920, 1080), (1920, 1080), (1920, 1080)), True, [0, 1, 2]),
    ],
)
def test_cameras_of_equal_image_size_share_their_intrinsics(sizes, alone, expected):
    cameras = tuple(Camera("c", size, np.eye(3)) for size in sizes)
    group = shared_intrinsics(cameras, IntrinsicsConfig(focal_per_camera=alone))
    assert group.tolist() == expected
