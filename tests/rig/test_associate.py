"""Groups of detections and their labels: laws on random affinities, and scenes with truth."""

from dataclasses import replace
from functools import partial

import numpy as np
from scenes import lifted, precision, recording, scene

from mocap_calib.config import Config
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.rig import associate as association
from mocap_calib.rig import per_frame_labels, replace_labels
from mocap_calib.rig.associate import associate, cluster_detections, measure_log_ratio
from mocap_calib.types import silent

VIEWS, INSTANCES = 4, 3
DETECTIONS = VIEWS * INSTANCES
LEAST = 0.4


def random_affinities(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return symmetric affinities `[frame, N, N]` and which of them mean something."""
    rng = np.random.default_rng(0)
    affinity = rng.uniform(size=(frames, DETECTIONS, DETECTIONS))
    comparable = (rng.uniform(size=affinity.shape) < 0.8).astype(float)
    return tuple(
        np.triu(each, 1) + np.triu(each, 1).swapaxes(1, 2) for each in (affinity, comparable)
    )


def cluster(affinity: np.ndarray, comparable: np.ndarray) -> np.ndarray:
    return cluster_detections(affinity, comparable, views=VIEWS, least_affinity=LEAST)


def slow_groups(affinity: np.ndarray, comparable: np.ndarray) -> set[frozenset[int]]:
    """Return the groups of one frame by average linkage, one merge after the other."""
    clusters = [{detection} for detection in range(DETECTIONS)]
    while True:
        best, pair = LEAST, None
        for i, first in enumerate(clusters):
            for second in clusters[i + 1 :]:
                block = np.ix_(sorted(first), sorted(second))
                mean = (affinity * comparable)[block].sum() / max(comparable[block].sum(), 1.0)
                views = [detection // INSTANCES for detection in (*first, *second)]
                if mean >= best and len(set(views)) == len(views):
                    best, pair = mean, (first, second)
        if pair is None:
            return {frozenset(members) for members in clusters if len(members) > 1}
        clusters = [members for members in clusters if members not in pair] + [pair[0] | pair[1]]


def test_clusters_are_those_of_average_linkage_step_by_step():
    affinity, comparable = random_affinities(20)
    for frame, groups in enumerate(cluster(affinity, comparable)):
        found = {frozenset(np.flatnonzero(groups == k).tolist()) for k in set(groups) - {-1}}
        assert found == slow_groups(affinity[frame], comparable[frame])


def test_what_is_not_alike_at_all_stays_alone_whatever_is_asked_for():
    affinity, comparable = random_affinities(2)
    affinity[1] = 0.0
    groups = cluster_detections(affinity, comparable, views=VIEWS, least_affinity=0.0)
    assert (groups[0] >= 0).sum() > INSTANCES
    assert (groups[1] == -1).all()


def test_a_group_never_holds_two_detections_of_a_view():
    affinity, comparable = random_affinities(50)
    groups = cluster(affinity, comparable).reshape(-1, VIEWS, INSTANCES)
    for k in range(DETECTIONS):
        assert ((groups == k).sum(-1) <= 1).all()
        assert ((groups == k).sum((1, 2)) != 1).all()


def test_frames_are_grouped_independently():
    affinity, comparable = random_affinities(10)
    together = cluster(affinity, comparable)
    for frame in range(10):
        alone = cluster(affinity[[frame]], comparable[[frame]])
        np.testing.assert_array_equal(alone[0], together[frame])


def test_blocks_of_frames_make_the_labels_of_all_at_once(monkeypatch):
    sample, rig, config = recording(), scene().rig, Config()
    found = []
    frames = len(sample.frames)
    for blocks in (1, 3, frames):  # all frames at once, some of them, each alone
        cut = partial(np.array_split, np.arange(frames), blocks)
        monkeypatch.setattr(association, "_cut_into_blocks", lambda *_, cut=cut: cut())
        found.append(associate(sample, lifted(), rig, config, progress=silent).labels)
    assert (found[0] >= 0).any()
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


def test_labels_within_frames_forget_the_names():
    """The same groups by any names; numbered from 0 by their first detection."""
    labels = np.random.default_rng(0).integers(-1, 5, (VIEWS, 7, INSTANCES))
    numbered = per_frame_labels(Matches(labels))
    renamed = replace_labels(labels, np.array([7, 0, 3, 9, 1]))
    np.testing.assert_array_equal(per_frame_labels(Matches(renamed)).labels, numbered.labels)
    np.testing.assert_array_equal(per_frame_labels(numbered).labels, numbered.labels)
    np.testing.assert_array_equal(numbered.labels < 0, labels < 0)


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


def test_matching_does_not_depend_on_the_unit_of_the_rig():
    rig = scene().rig
    in_mm = replace(rig, translation=1000 * rig.translation, unit="mm")
    first, second = (
        associate(recording(), lifted(), r, Config(), progress=silent) for r in (rig, in_mm)
    )
    np.testing.assert_array_equal(first.labels, second.labels)


def turned_at_random(bodies: LiftedPoses) -> LiftedPoses:
    """Return lifted bodies, each turned by another rotation: they say nothing of individuals."""
    rng = np.random.default_rng(0)
    turns = matrix_from_vector(rng.normal(size=(*bodies.body.shape[:3], 3)))
    return replace(bodies, body=bodies.body @ turns)


def test_lifted_bodies_weigh_what_they_prove():
    """Bodies turned at random prove less; they do not keep detections of one individual apart."""
    made, config = scene(), Config()
    right = association._measure_pose_ratio(recording(), lifted(), made.rig, config.pairwise)
    wrong = turned_at_random(lifted())
    found = association._measure_pose_ratio(recording(), wrong, made.rig, config.pairwise)
    assert right.slope[0] < -1.0
    assert found is None or found.slope[0] > right.slope[0] / 2
    labels = associate(recording(), wrong, made.rig, config, progress=silent).labels
    assert precision(labels, made.identity) > 0.99
    assert (labels[made.identity >= 0] >= 0).mean() > 0.95


def test_a_ratio_is_that_of_the_densities():
    """Normal classes one apart: the slope of the log-likelihood ratio is 1, and 0 in the middle."""
    rng = np.random.default_rng(0)
    label = rng.random(20_000) < 0.3
    features = rng.normal(size=(20_000, 1)) + label[:, None]
    ratio = measure_log_ratio(features, label.astype(float), 1.0 - label)
    np.testing.assert_allclose(ratio(np.array([[0.5], [1.5]])), [0.0, 1.0], atol=0.1)
    assert ratio(np.array([[np.nan]])) == 0.0


def test_without_examples_of_both_there_is_no_ratio():
    assert measure_log_ratio(np.ones((5, 1)), np.ones(5), np.zeros(5)) is None
