"""Each stage alone: laws first, then scenes with truth."""

import pickle
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scenes import lifted, precision, recording, rotation_errors_deg, scene, truth

from mocap_calib.config import (
    AveragingConfig,
    Config,
    FivePointConfig,
    PairwiseConfig,
    TriangulateConfig,
)
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.epipolar import essential_matrix, sampson_angle
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.io.results.pairs_json import pairs_to_json
from mocap_calib.multi_view.association import associate
from mocap_calib.multi_view.averaging import average
from mocap_calib.multi_view.bundle_adjustment import adjust
from mocap_calib.multi_view.triangulation import (
    project,
    reprojection_error,
    triangulate,
    triangulate_rays,
)
from mocap_calib.multi_view.view_graph import pairs_among, usable_cameras
from mocap_calib.two_view.affinity import (
    centre_error,
    epipolar_affinity,
    epipolar_error,
    epipolar_fit,
    steering_error,
)
from mocap_calib.two_view.assignment import mutual_best, sinkhorn
from mocap_calib.two_view.five_point_pairs import FivePointPairs
from mocap_calib.two_view.refine import refine_two_view
from mocap_calib.two_view.solve import calibrate_pair, calibrate_pairs, pair_problem
from mocap_calib.two_view.view_pair import MatchedRays, distances, reach, view_pair
from mocap_calib.types import CameraRig, Matches, PairwiseCalibration, Recording, silent


def ten_frames_of_two_views():
    return view_pair(recording(), lifted(), 0, 1, np.arange(10))


def turned(rig: CameraRig, degrees: float, seed: int = 0) -> CameraRig:
    """Every camera but the first turned about its centre by so much."""
    axis = np.random.default_rng(seed).normal(size=(len(rig.cameras), 3))
    axis *= np.radians(degrees) / np.linalg.norm(axis, axis=1, keepdims=True)
    axis[0] = 0
    rotation = matrix_from_vector(axis) @ rig.rotation
    return replace(
        rig, rotation=rotation, translation=-np.einsum("vij,vj->vi", rotation, rig.centres)
    )


# assignment


def test_sinkhorn_rows_and_columns_hold_at_most_one():
    weight = sinkhorn(np.random.default_rng(0).uniform(size=(20, 3, 5)), dummy=0.2)
    assert (weight.sum(-2) <= 1 + 1e-9).all()
    assert (weight.sum(-1) <= 1 + 1e-2).all()  # twelve sweeps


def test_sinkhorn_is_equivariant_to_order():
    affinity = np.random.default_rng(1).uniform(size=(4, 5))
    rows, columns = [2, 0, 3, 1], [4, 1, 0, 3, 2]
    np.testing.assert_allclose(
        sinkhorn(affinity[rows][:, columns], dummy=0.2),
        sinkhorn(affinity, dummy=0.2)[rows][:, columns],
        atol=1e-12,
    )


def test_the_unlike_stay_alone():
    affinity = np.array([[0.9, 0.0], [0.0, 0.01]])
    assert mutual_best(sinkhorn(affinity, dummy=0.2), least=0.2).tolist() == [
        [True, False],
        [False, False],
    ]


# affinity


def test_steering_error_is_the_weighted_distance_of_turned_bodies():
    pair, bodies = ten_frames_of_two_views(), lifted()
    rotation = matrix_from_vector(np.array([[0.3, -1.0, 0.2]]))
    fast = steering_error(pair, rotation)[0]
    weight = np.nan_to_num([1 / (bodies.spread[v, :10] ** 2 + 0.05**2) for v in (0, 1)])
    w = weight[0][:, :, None] * weight[1][:, None]
    gap = (np.nan_to_num(bodies.body[0, :10]) @ rotation[0].T)[:, :, None] - np.nan_to_num(
        bodies.body[1, :10]
    )[:, None]
    slow = (w * (gap**2).sum(-1)).sum(-1) / np.maximum(w.sum(-1), 1e-12)
    np.testing.assert_allclose(fast, slow, atol=1e-10)


def test_centre_error_is_the_distance_over_the_distances():
    pair = ten_frames_of_two_views()
    rotation, translation = matrix_from_vector(np.array([0.1, 0.5, 0.0])), np.array([1.0, 2.0, 3.0])
    gap = (pair.a.centre @ rotation.T + translation)[:, :, None] - pair.b.centre[:, None]
    slow = (gap**2).sum(-1) / (pair.a.distance[:, :, None] ** 2 + pair.b.distance[:, None] ** 2)
    np.testing.assert_allclose(
        centre_error(pair, rotation[None], translation[None])[0], slow, atol=1e-10
    )


def test_epipolar_error_is_sampsons_at_the_body():
    pair = ten_frames_of_two_views()
    rotation, translation = matrix_from_vector(np.array([0.1, 0.5, 0.0])), np.array([0.6, 0.0, 0.8])
    error, weight = epipolar_error(pair, rotation[None], translation[None])
    matrix = essential_matrix(rotation, translation)
    angle = sampson_angle(matrix, pair.a.rays[3, 1], pair.b.rays[3, 2])
    slow = np.abs(angle) * reach(pair)[3, 1, 2]
    known = weight[3, 1, 2] > 0
    assert known.any()
    np.testing.assert_allclose(error[0, 3, 1, 2][known], slow[known], atol=1e-12)


def test_the_affinity_by_a_rig_is_the_epipolar_fit_of_its_pairs():
    """Both say the same of a pair of views, given the same distances of the bodies."""
    sample, rig, config = recording(), scene().rig, PairwiseConfig()
    every = np.arange(len(sample.frames))
    pair = view_pair(sample, lifted(), 0, 2, every)
    error, weight = epipolar_error(pair, *(part[None] for part in rig.relative(0, 2)))
    distance = distances(lifted().centre, sample.rays)
    affinity, comparable = epipolar_affinity(sample, rig, distance, config)
    instances = sample.positions.shape[2]
    rows, columns = slice(0, instances), slice(2 * instances, 3 * instances)
    fit = epipolar_fit(error, weight, config)[0]
    np.testing.assert_allclose(affinity[:, rows, columns], fit, atol=1e-9)
    assert ((comparable[:, rows, columns] > 0) | (fit == 0)).all()
    np.testing.assert_array_equal(affinity, np.swapaxes(affinity, 1, 2))


# pairwise


def test_refinement_finds_the_pose_among_gross_outliers():
    """From 6 degrees off, with 20 % outliers and 1 mrad of noise: measured 0.02 degrees."""
    rng = np.random.default_rng(0)
    rotation, translation = (
        matrix_from_vector(np.array([0.2, 1.0, -0.1])),
        np.array([-3.0, 0.2, 2.0]),
    )
    in_a = rng.uniform(-1.5, 1.5, (2000, 3)) + [0, 0, 5.0]
    a, b = in_a, in_a @ rotation.T + translation
    a, b = (
        x / np.linalg.norm(x, axis=1, keepdims=True) + rng.normal(0, 1e-3, x.shape) for x in (a, b)
    )
    b[:400] = rng.permutation(b[:400])
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
    start = matrix_from_vector(np.radians([[3.0, -4.0, 3.0]])) @ rotation
    rays = MatchedRays(a[None], b[None], np.ones((1, 2000)), np.full((1, 2000), 5.0))
    config = PairwiseConfig(inlier=0.05)
    found, direction = refine_two_view(start, translation[None] + 0.3, rays, config)
    assert np.degrees(angle_between(found[0], rotation)) < 0.1
    assert np.degrees(direction_angle(direction[0], translation)) < 0.2
    assert np.linalg.norm(direction) == pytest.approx(np.linalg.norm(translation + 0.3))


def test_pairs_of_a_ring_of_strangers():
    """Three people, order shuffled: measured 0.1 to 0.4 degrees, no wrong match."""
    made = scene()
    pairs = calibrate_pairs(
        recording(), lifted(), PairwiseConfig(), rng=np.random.default_rng(0), progress=silent
    )
    assert [(p.a, p.b) for p in pairs] == list(combinations(range(4), 2))
    for pair in pairs:
        rotation, translation = made.rig.relative(pair.a, pair.b)
        assert np.degrees(angle_between(pair.rotation, rotation)) < 1.5
        assert np.degrees(direction_angle(pair.translation, translation)) < 2.0
        frame, i, j = pair.matches.T
        who_a, who_b = made.identity[pair.a, frame, i], made.identity[pair.b, frame, j]
        known = (who_a >= 0) & (who_b >= 0)
        assert (who_a == who_b)[known].mean() > 0.99


def test_baselines_come_in_one_unit():
    """Baselines in body sizes over baselines in metres, known without any length.

    Within 6 % of each other (measured 3 %).
    """
    made = scene()
    pairs = calibrate_pairs(
        recording(), lifted(), PairwiseConfig(), rng=np.random.default_rng(0), progress=silent
    )
    ratio = np.array(
        [
            np.linalg.norm(p.translation) / np.linalg.norm(made.rig.relative(p.a, p.b)[1])
            for p in pairs
        ]
    )
    assert np.ptp(ratio) / ratio.mean() < 0.12


def pair_of(
    found: Recording, a: int, b: int, config: PairwiseConfig | None = None
) -> PairwiseCalibration | None:
    config = config or PairwiseConfig()
    rng = np.random.default_rng(0)
    return calibrate_pair(pair_problem(found, lifted(), a, b, config=config, rng=rng), config)


def test_pairs_may_be_calibrated_elsewhere_and_in_any_order():
    """A mapper that pickles and turns the order round: the same bytes as `map`."""

    def away(function, items):
        return reversed(
            [
                pickle.loads(pickle.dumps(function))(pickle.loads(pickle.dumps(item)))
                for item in items
            ]
        )

    here, there = (
        calibrate_pairs(
            recording(),
            lifted(),
            PairwiseConfig(),
            rng=np.random.default_rng(0),
            progress=silent,
            mapper=m,
        )
        for m in (map, away)
    )
    assert pairs_to_json(here, recording().cameras) == pairs_to_json(there, recording().cameras)


def test_a_pair_is_its_own_inverse():
    """b_from_a of (a, b) and of (b, a): the search is not symmetric, its answer is.

    Measured 0.15 degrees.
    """
    forth = pair_of(recording(), 0, 2)
    back = pair_of(recording(), 2, 0)
    assert np.degrees(angle_between(forth.rotation, back.rotation.T)) < 0.6
    assert np.degrees(direction_angle(forth.translation, -forth.rotation @ back.translation)) < 0.6


def test_refinement_is_guarded():
    """A round that lowers its own score is not kept: more rounds end with no less.

    But for other draws of rays (4e-8).
    """
    scores = [pair_of(recording(), 1, 3, PairwiseConfig(rounds=r)).score for r in (0, 1, 3)]
    assert np.diff(scores).min() > -1e-5


def test_views_that_share_no_frame_make_no_pair():
    found = recording()
    positions, rays = found.positions.copy(), found.rays.copy()
    for array in (positions, rays):
        array[0, ::2] = np.nan
        array[1, 1::2] = np.nan
    apart = replace(
        found,
        positions=positions,
        rays=rays,
        confidence=np.where(np.isnan(positions[..., 0]), 0.0, found.confidence),
    )
    assert pair_of(apart, 0, 1) is None


def test_the_five_point_baseline_is_judged_as_any_other_pair():
    """Ten frames, no lifted bodies in the search: measured 0.7 degrees, and the same score."""
    sample, rig = recording(), scene().rig
    focal = np.array([camera.focal for camera in sample.cameras])
    config = PairwiseConfig(frames=10)
    solve = FivePointPairs(focal, config, FivePointConfig(candidates=20))
    rng = np.random.default_rng(0)
    found = solve(pair_problem(sample, lifted(), 1, 3, config=config, rng=rng))
    searched = pair_of(sample, 1, 3)
    rotation, translation = rig.relative(1, 3)
    assert found.source == "five-point"
    assert np.degrees(angle_between(found.rotation, rotation)) < 2.0
    assert np.degrees(direction_angle(found.translation, translation)) < 2.0
    assert found.score == pytest.approx(searched.score, abs=0.05)
    baselines = [np.linalg.norm(pair.translation) for pair in (found, searched)]
    assert baselines[0] == pytest.approx(baselines[1], rel=0.05)


# averaging


def exact_pairs(rig: CameraRig, *, wrong: tuple[int, ...] = ()) -> tuple[PairwiseCalibration, ...]:
    """Return pairs that agree with a rig, but for some that are 40 degrees off and score less."""
    pairs = []
    for k, (a, b) in enumerate(combinations(range(len(rig.cameras)), 2)):
        rotation, translation = rig.relative(a, b)
        if k in wrong:
            rotation = matrix_from_vector(np.radians([0.0, 40.0, 0.0])) @ rotation
            translation = np.roll(translation, 1)
        pair = PairwiseCalibration(
            a=a,
            b=b,
            rotation=rotation,
            translation=translation,
            matches=np.zeros((0, 3), int),
            frames=10,
            score=0.5 if k in wrong else 0.8,
            residual=0.0,
            in_front=1.0,
            source="lifted",
        )
        pairs.append(pair)
    return tuple(pairs)


def test_consistent_pairs_give_their_rig():
    """Up to the gauge: the first camera is the world, lengths are those of the baselines."""
    rig = scene(cameras=6).rig
    found = average(rig.cameras, exact_pairs(rig), AveragingConfig()).rig
    np.testing.assert_allclose(found.rotation[0], np.eye(3), atol=1e-12)
    for a, b in combinations(range(6), 2):
        for value, expected in zip(found.relative(a, b), rig.relative(a, b), strict=True):
            np.testing.assert_allclose(value, expected, atol=1e-8)


def test_a_pair_that_breaks_the_loops_is_named_and_loses_its_weight():
    rig = scene(cameras=5).rig
    found = average(rig.cameras, exact_pairs(rig, wrong=(4,)), AveragingConfig())
    assert rotation_errors_deg(found.rig, rig).max() < 0.1
    assert found.weight[4] < 0.05
    assert np.delete(found.weight, 4).min() > 0.9
    assert np.degrees(found.loop_error[4]) == pytest.approx(40, abs=0.5)


def test_unconnected_cameras_are_not_glued():
    rig = scene(cameras=4).rig
    pairs = [p for p in exact_pairs(rig) if (p.a < 2) == (p.b < 2)]
    with pytest.raises(DegenerateError, match=r"cam1, cam2 \| cam3, cam4"):
        usable_cameras(rig.cameras, tuple(pairs), AveragingConfig())


def test_a_camera_that_no_pair_holds_is_left_out():
    rig = scene(cameras=4).rig
    pairs = tuple(replace(p, score=0.02) if 1 in (p.a, p.b) else p for p in exact_pairs(rig))
    kept = usable_cameras(rig.cameras, pairs, AveragingConfig())
    assert kept.tolist() == [0, 2, 3]
    assert [(p.a, p.b) for p in pairs_among(pairs, kept)] == [(0, 1), (0, 2), (1, 2)]


# matching


def test_matching_with_the_true_rig_finds_everybody():
    made = scene()
    found = associate(recording(), lifted(), made.rig, Config(), progress=silent)
    assert precision(found.labels, made.identity) > 0.995
    people = made.identity >= 0
    assert (found.labels[people] >= 0).mean() > 0.97
    assert found.individuals >= 3


def test_a_label_is_given_once_a_view_and_frame():
    labels = associate(recording(), lifted(), scene().rig, Config(), progress=silent).labels
    for k in range(labels.max() + 1):
        assert ((labels == k).sum(-1) <= 1).all()
        assert ((labels == k).sum((0, 2)) != 1).all()  # never in a single view


def test_individuals_keep_their_label_through_time():
    made = scene()
    labels = associate(recording(), lifted(), made.rig, Config(), progress=silent).labels
    for person in range(3):
        own = labels[made.identity == person]
        own = own[own >= 0]
        assert (own == np.bincount(own).argmax()).mean() > 0.98


def test_matching_does_not_depend_on_the_unit_of_the_rig():
    rig = scene().rig
    in_mm = replace(rig, translation=1000 * rig.translation, unit="mm")
    first, second = (
        associate(recording(), lifted(), r, Config(), progress=silent) for r in (rig, in_mm)
    )
    np.testing.assert_array_equal(first.labels, second.labels)


# adjustment


def test_adjustment_comes_home_from_three_degrees():
    """With true matches: from 3 degrees off to below a tenth (measured 0.03)."""
    made = scene()
    found = adjust(recording(), turned(made.rig, 3.0), truth(), Config())
    assert rotation_errors_deg(found, made.rig).max() < 0.1


def test_adjustment_does_not_depend_on_the_gauge():
    """Another world, the same relative poses."""
    made = scene()
    start = turned(made.rig, 1.0)
    turn, shift = matrix_from_vector(np.array([0.4, -0.2, 0.9])), np.array([5.0, -3.0, 1.0])
    rotation = start.rotation @ turn.T
    elsewhere = replace(
        start,
        rotation=rotation,
        translation=2.0 * start.translation - np.einsum("vij,j->vi", rotation, shift),
    )
    first, second = (adjust(recording(), rig, truth(), Config()) for rig in (start, elsewhere))
    assert rotation_errors_deg(first, second).max() < 0.01


@pytest.mark.parametrize("distortion", ["brown", "fisheye"])
def test_adjustment_and_opencv_mean_the_same_camera(distortion):
    """Noise-free detections of distorted cameras: the rig is exact (measured 1e-5 degrees).

    Half a pixel or another lens model would bend it: half a pixel by 0.03 degrees.
    """
    clean = {
        "distortion": distortion,
        "noise_px": 0.0,
        "outliers": 0.0,
        "missing": 0.0,
        "false_detections": 0.0,
    }
    made = scene(**clean)
    found = adjust(recording(**clean), turned(made.rig, 1.0), truth(**clean), Config())
    assert rotation_errors_deg(found, made.rig).max() < 1e-3


def test_a_camera_without_matches_is_named():
    labels = truth().labels.copy()
    labels[2] = -1
    with pytest.raises(DegenerateError, match="camera cam3"):
        adjust(recording(), scene().rig, Matches(labels), Config())


# triangulation


def ring(views: int) -> CameraRig:
    """Return cameras on a ring, without distortion."""
    rig = scene(cameras=views).rig
    cameras = tuple(replace(camera, distortion=np.zeros(5)) for camera in rig.cameras)
    return replace(rig, cameras=cameras)


def rays_to(rig: CameraRig, points: np.ndarray) -> np.ndarray:
    """Return the rays `[view, 3, N]` to points `[N, 3]`."""
    in_camera = rig.rotation @ points.T + rig.translation[:, :, None]
    return in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)


def meet(
    rig: CameraRig, rays: np.ndarray, *, weight=None, noise: float = 1e-3, **changes: float
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate rays `[view, 3, N]` that all weigh the same."""
    views, _, count = rays.shape
    return triangulate_rays(
        rig,
        rays,
        weight=np.ones((views, count)) if weight is None else weight,
        noise=np.full(views, noise),
        config=TriangulateConfig(**changes),
    )


@pytest.mark.parametrize("views", [2, 4, 9])
def test_exact_rays_meet_in_their_point(views):
    rig, points = ring(views), np.random.default_rng(0).uniform(-1, 1, (300, 3)) + [0, 0, 1]
    found, used = meet(rig, rays_to(rig, points))
    np.testing.assert_allclose(found.T, points, atol=1e-6)
    assert used.all()


@pytest.mark.parametrize("views", [8, 10, 13])
def test_any_two_or_three_views_of_a_large_rig_will_do(views):
    """Not only those that are neighbours; two views may face each other, so 0.1 mm."""
    rig, point = ring(views), np.array([[0.1, -0.2, 1.1]])
    subsets = [*combinations(range(views), 2), *combinations(range(views), 3)]
    weight = np.zeros((views, len(subsets)))
    for n, subset in enumerate(subsets):
        weight[list(subset), n] = 1.0
    rays = np.repeat(rays_to(rig, point), len(subsets), axis=2)
    found, _ = meet(rig, rays, weight=weight)
    np.testing.assert_allclose(found.T, np.broadcast_to(point, (len(subsets), 3)), atol=1e-4)


def test_one_outlying_view_is_found_and_left_out():
    rig, points = ring(4), np.random.default_rng(1).uniform(-1, 1, (300, 3)) + [0, 0, 1]
    rays = rays_to(rig, points)
    bad, each = np.random.default_rng(2).integers(4, size=300), np.arange(300)
    rays[bad, :, each] = rays[bad, :, each] @ matrix_from_vector(np.array([0.1, 0.05, 0.0])).T
    found, used = meet(rig, rays, noise=2e-3)
    assert np.median(np.linalg.norm(found.T - points, axis=1)) < 2e-3
    assert not used[bad, each].any()
    assert (used.sum(0) == 3).mean() > 0.99


def test_two_views_that_disagree_or_look_alike_give_nothing():
    rig, points = ring(2), np.array([[0.0, 0.0, 1.0]])
    rays = rays_to(rig, points)
    off = rays.copy()
    normal = np.cross(rig.rotation[0] @ (rig.centres[1] - rig.centres[0]), rays[0, :, 0])
    off[0, :, 0] += 0.1 * normal / np.linalg.norm(normal)
    off[0] /= np.linalg.norm(off[0])
    assert np.isnan(meet(rig, off)[0]).all()
    assert np.isnan(meet(rig, rays, least_angle_deg=179.0)[0]).all()
    assert np.isfinite(meet(rig, rays)[0]).all()


def test_reprojection_error_is_the_rms_over_the_used_views():
    """Detections 3, 4 and 300 pixels off, the last not used: sqrt((9 + 16) / 2)."""
    rig, points = ring(3), np.array([[0.1, 0.2, 1.0]]).T
    pixels = project(rig, points)
    pixels[:, 0, 0] += [3.0, 4.0, 300.0]
    used = np.array([[True], [True], [False]])
    error = reprojection_error(rig, points, pixels=pixels, used=used)
    assert error == pytest.approx([np.sqrt(12.5)])


def test_poses_of_true_rig_and_labels_are_the_truth():
    """In metres: median 5 mm measured with 2 px noise; and the error says 2 px a coordinate."""
    made, found = scene(), recording()
    poses = triangulate(found, made.rig, truth(), TriangulateConfig(), progress=silent)
    joints = [made.joints.index(name) for name in found.keypoints]
    gap = np.linalg.norm(poses.positions[:, :3] - made.poses[:, :3, joints], axis=-1)
    assert np.nanmedian(gap) < 0.01
    assert np.isfinite(gap).mean() > 0.97
    assert 1.0 < np.nanmedian(poses.error) < 3.5
    assert poses.unit == "m"
    assert set(np.unique(poses.views)) <= {0, 2, 3, 4}
