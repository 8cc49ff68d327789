"""Rules of the stages of many cameras that are small enough for a table of cases."""

from types import SimpleNamespace

import numpy as np
import pytest
from scenes import scene
from scipy.linalg import null_space

from mocap_calib.adjust import refine
from mocap_calib.adjust.covariance import _inverse_at_size
from mocap_calib.adjust.problem import free_parameters
from mocap_calib.clocks.maps import agreement_along
from mocap_calib.clocks.subframe import _are_significant, _choose_stretches
from mocap_calib.config import Config
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.results import Matches
from mocap_calib.rig import matched_share
from mocap_calib.rig.averaging import best_scores
from mocap_calib.types import Camera, EstimatedCamera
from mocap_calib.verdict.verdict import _left_open


@pytest.mark.parametrize(("estimated", "given", "unchecked"), [(2, 0, 1), (1, 1, 0), (3, 0, 0)])
def test_no_third_camera_checks_the_intrinsics_of_two(estimated, given, unchecked):
    known = Camera("a", (640, 480), np.diag([500.0, 500.0, 1.0]), np.zeros(5), False)
    found = EstimatedCamera.of(known, focal_sigma=1.0, k1_sigma=0.0)
    cameras = (found,) * estimated + (known,) * given
    group = SimpleNamespace(
        rig=SimpleNamespace(cameras=cameras, names=("a",) * len(cameras)),
        adjusted=SimpleNamespace(depth_reversed_rig=None),
        uncertainty=SimpleNamespace(outlier_cameras=np.zeros(len(cameras), dtype=bool)),
    )
    assert len(list(_left_open(group, (), None))) == unchecked


def test_the_share_of_the_matched_counts_whoever_is_named():
    detected = np.ones((2, 3, 2), bool)
    detected[1, 0, 1] = False
    labels = np.array([[[0, 1], [0, -1], [-1, -1]], [[0, -1], [0, 1], [1, 0]]])
    share = matched_share(SimpleNamespace(detected=detected), SimpleNamespace(labels=labels))
    np.testing.assert_allclose(share, [3 / 6, 5 / 5])


def test_agreement_along_maps_is_that_of_the_frames_that_they_show():
    """Of two partners; one shows nothing in the third frame, the camera nothing in the last."""
    values = np.arange(16.0, dtype=np.float32).reshape(1, 4, 4)
    agreements = SimpleNamespace(values={(0, 1): values, (0, 2): 100 * values})
    maps = np.array([[0, 2, 3, -1], [0, 1, -1, 2], [1, 2, 3, 3]])[:, None]
    found = agreement_along(agreements, maps, 0, [1, 2])
    assert found.tolist() == [[0 + 100, 9 + 1000, 1500, 0]]


def test_the_inverse_at_a_size_is_that_of_all_that_leaves_it():
    """D (D' M D)^-1 D', where D spans what the size does not change; scales from 1e-2 to 1e2."""
    rng = np.random.default_rng(0)
    rotation, translation = nearest_rotation(rng.normal(size=(3, 3, 3))), rng.normal(size=(3, 3))
    scale = np.exp(rng.uniform(-4, 4, 15))  # two poses, and three that are shared
    matrix = rng.normal(size=(15, 40)) * scale[:, None]
    matrix = matrix @ matrix.T
    state = SimpleNamespace(rotation=rotation, translation=translation)
    shared = free_parameters(np.zeros(3, int), np.ones((3, 3)))
    found = _inverse_at_size(matrix, state, shared)
    centres = -np.einsum("vji,vj->vi", rotation, translation)
    size = np.zeros(15)
    for view in (1, 2):  # a translation changes by -R (C - C0)
        size[6 * view - 3 : 6 * view] = rotation[view] @ (centres[0] - centres[view])
    free = null_space(size[None])
    expected = free @ np.linalg.inv(free.T @ matrix @ free) @ free.T
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(found * unit, expected * unit, atol=1e-6)


def test_stretches_are_whole_and_spread_over_the_recording():
    labels = np.zeros((2, 100, 1), dtype=np.int64)
    labels[:, 40:60] = -1
    found = _choose_stretches(Matches(labels), 10, budget=400).reshape(-1, 10)
    starts = found[:, 0]
    assert (found == starts[:, None] + np.arange(10)).all()
    assert len(starts) == 4
    assert (starts[0], starts[-1]) == (0, 90)
    assert not ((starts >= 40) & (starts < 60)).any()


@pytest.mark.parametrize(
    ("misfits", "taken"),
    [
        ((1.0005, 1.0), 0),  # the first of those that tie
        ((1.01, 1.0), 1),
        ((np.nan, 1.0), 1),  # nothing is matched under the first
        ((np.nan, np.nan), 0),
    ],
)
def test_the_first_of_the_rigs_that_fit_best_is_taken(monkeypatch, misfits, taken):
    rigs = [SimpleNamespace(rig=scene().rig, matches=misfit) for misfit in misfits]
    monkeypatch.setattr(
        refine, "measure_fit", lambda _, __, misfit, ___: SimpleNamespace(misfit=misfit)
    )
    assert refine._best_fit(None, rigs, Config()) is rigs[taken]


def test_offsets_of_clocks_are_used_that_are_certain_large_and_all_in_reach():
    """The first camera's is 0; the third's is small, and the last one's not certain."""
    tau, sigma = np.array([0.0, 0.5, 0.08, -0.3]), np.array([0.0, 0.02, 0.001, 0.2])
    assert _are_significant(tau, sigma).tolist() == [False, True, False, False]
    assert not _are_significant(np.append(tau, -1.3), np.append(sigma, 0.02)).any()


def test_the_score_of_a_camera_is_that_of_its_best_pair():
    pairs = [SimpleNamespace(a=a, b=b, score=s) for a, b, s in ((0, 1, 0.5), (2, 1, 0.8))]
    np.testing.assert_array_equal(best_scores(tuple(pairs), 4), [0.5, 0.8, 0.8, np.nan])
