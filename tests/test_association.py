"""Groups of detections and their labels: laws on random affinities."""

import numpy as np

from mocap_calib.config import MatchingConfig
from mocap_calib.multi_view.clustering import cluster_detections
from mocap_calib.multi_view.labels import per_frame_labels, replace_labels
from mocap_calib.multi_view.tracking import link_through_time
from mocap_calib.types import Matches

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


def test_labels_within_frames_forget_the_names():
    """The same groups by any names; numbered from 0 by their first detection."""
    labels = np.random.default_rng(0).integers(-1, 5, (VIEWS, 7, INSTANCES))
    numbered = per_frame_labels(Matches(labels))
    renamed = replace_labels(labels, np.array([7, 0, 3, 9, 1]))
    np.testing.assert_array_equal(per_frame_labels(Matches(renamed)).labels, numbered.labels)
    np.testing.assert_array_equal(per_frame_labels(numbered).labels, numbered.labels)
    np.testing.assert_array_equal(numbered.labels < 0, labels < 0)


def test_groups_are_linked_by_where_they_stand():
    """Two bodies 3 body sizes apart walk 0.1 a frame; their groups are exchanged at random."""
    rng, frames = np.random.default_rng(0), 30
    walk = 0.1 * np.arange(frames)[:, None]
    places = np.zeros((frames, 2, 3))
    places[..., 0] = walk + [0.0, 3.0]
    group = np.stack([rng.permutation(2) for _ in range(frames)])  # of each body
    shuffled = np.take_along_axis(places, np.argsort(group, axis=1)[..., None], axis=1)
    labels = np.stack([group, group])
    linked = link_through_time(labels, shuffled, np.arange(frames), MatchingConfig())
    assert (linked == linked[:, :1]).all()
    assert set(linked[0, 0]) == {0, 1}
