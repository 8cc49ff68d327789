"""Trees and parts of graphs, against scipy's."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from mocap_calib.geometry.graphs import connected_parts, spanning_tree


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_trees_of_least_cost(share):
    """Also of graphs in several parts; parents come before their children."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        nodes = int(rng.integers(1, 15))
        cost = np.where(rng.random((nodes, nodes)) < share, rng.random((nodes, nodes)), np.inf)
        cost[np.tril_indices(nodes)] = np.inf
        edges = spanning_tree(cost, root=nodes // 2)
        true = minimum_spanning_tree(np.where(np.isinf(cost), 0, cost)).tocoo()
        found = {tuple(sorted(edge)) for edge in edges.tolist()}
        assert found == set(zip(true.row.tolist(), true.col.tolist(), strict=True))
        reached = [child for _, child in edges.tolist()]
        assert len(set(reached)) == len(reached)
        for k, (parent, _) in enumerate(edges.tolist()):
            assert parent not in reached[k:]


def test_parts_are_numbered_by_their_first_nodes():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        nodes = int(rng.integers(1, 40))
        first, second = rng.integers(0, nodes, (2, int(rng.integers(0, nodes + 1))))
        graph = coo_array((np.ones(len(first)), (first, second)), shape=(nodes, nodes))
        true = connected_components(graph, directed=False)[1]
        np.testing.assert_array_equal(connected_parts(first, second, nodes), true)


def test_long_chains_are_one_part():
    """In any order of the nodes; 0.1 s, as rounds grow with the logarithm of the length."""
    order = np.random.default_rng(0).permutation(100_000)
    for nodes in (np.arange(100_000), order):
        assert not connected_parts(nodes[:-1], nodes[1:], 100_000).any()
