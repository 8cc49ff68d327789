"""Groups of detections and their labels: laws on random affinities, and scenes with truth."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from scenes import lifted, precision, recording, scene

from mocap_calib.config import Config, MatchingConfig, PairwiseConfig
from mocap_calib.pairs.affinity import body_agreement
from mocap_calib.pairs.view_pair import distances, gather_view_pair
from mocap_calib.rig import association, linking
from mocap_calib.rig.association import associate
from mocap_calib.rig.body_affinity import ever_compared, temper_by_bodies
from mocap_calib.rig.clustering import cluster_detections
from mocap_calib.rig.labels import per_frame_labels, replace_labels
from mocap_calib.rig.linking import link_through_time
from mocap_calib.types import Matches, silent

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


def test_bodies_of_all_views_temper_as_those_of_each_pair_of_views():
    """Also where one view lifted nothing at all, and another nothing in some frames."""
    sample, rig, config = recording(), scene().rig, PairwiseConfig()
    blind = lifted().body.copy()
    blind[2], blind[3, :4] = np.nan, np.nan
    bodies, frames, scale = replace(lifted(), body=blind), np.arange(10), 1.7
    views, instances = len(rig.cameras), sample.positions.shape[2]
    distance = distances(bodies.centre[:, frames], sample.rays[:, frames])
    rng = np.random.default_rng(0)
    affinity = rng.uniform(size=(len(frames), views * instances, views * instances))
    found = temper_by_bodies(
        affinity,
        bodies,
        rig,
        frames,
        distance=distance,
        scale=scale,
        compared=ever_compared(bodies),
        config=config,
    )
    by_view = [each.reshape(-1, views, instances, views, instances) for each in (affinity, found)]
    for a, b in combinations(range(views), 2):
        rotation, translation = rig.relative(a, b)
        pair = gather_view_pair(sample, bodies, (a, b), frames)
        agreement = body_agreement(pair, rotation[None], scale * translation[None], config)[0]
        unlifted = config.unlifted_affinity if pair.overlap.lifted.any() else 1.0
        expected = np.where(pair.overlap.lifted > 0, np.sqrt(agreement), unlifted)
        expected *= by_view[0][:, a, :, b]
        np.testing.assert_allclose(by_view[1][:, a, :, b], expected, rtol=1e-9, atol=1e-12)


def test_frames_are_grouped_independently():
    affinity, comparable = random_affinities(10)
    together = cluster(affinity, comparable)
    for frame in range(10):
        alone = cluster(affinity[[frame]], comparable[[frame]])
        np.testing.assert_array_equal(alone[0], together[frame])


def test_blocks_of_frames_make_the_labels_of_all_at_once(monkeypatch):
    sample, rig, config = recording(), scene().rig, Config()
    found = []
    for pairs in (10**9, 1000, 1):  # all frames at once, some of them, each alone
        monkeypatch.setattr(association, "_LIFTED_PAIRS", pairs)
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


def test_groups_are_linked_in_a_slice_of_a_recording():
    """Of whose frame numbers every second one is looked at, in place."""
    numbers = recording().select(frames=slice(0, None, 2)).frames
    labels = np.zeros((VIEWS, len(numbers), 1), dtype=np.int64)
    places = np.zeros((len(numbers), 1, 3))
    linked = link_through_time(labels, places, numbers, MatchingConfig())
    np.testing.assert_array_equal(linked, labels)


def test_easy_frames_are_linked_as_any_other(monkeypatch):
    """Bodies that come, go, meet and jump, more of them than there is room for at first."""
    rng, frames, groups = np.random.default_rng(0), 400, 5
    places = rng.normal(size=(frames, groups, 3)).cumsum(0) * 0.2
    places[rng.uniform(size=(frames, groups)) < 0.2] = np.nan
    places[::7] += 40.0 * np.arange(len(places[::7]))[:, None, None]
    labels = np.where(np.isfinite(places[None, ..., 0]), np.arange(groups), -1)
    numbers = np.cumsum(rng.integers(1, 4, frames))
    quick = link_through_time(labels, places, numbers, MatchingConfig())
    monkeypatch.setattr(linking._Linking, "link_easy_frames", lambda _, start, __: start)
    slow = link_through_time(labels, places, numbers, MatchingConfig())
    np.testing.assert_array_equal(quick, slow)
    assert slow.max() > 70


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
