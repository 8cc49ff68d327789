"""Graphs of a few nodes or of many: what is joined, and by which edges at the least cost.

scipy has the same for sparse matrices; importing it takes longer than most runs need for graphs.
"""

import numpy as np

from mocap_calib.types import Floats, Ints


def spanning_tree(cost: Floats, root: int = 0) -> Ints:
    """Return the edges `[edge, 2]` (parent, child) of the minimum spanning tree, root first.

    Prim's algorithm (1957). Where not all nodes can be reached, a tree of each part.

    cost: `[node, node]` of the edges, in either direction; infinite where there is none.
    """
    cost = np.minimum(cost, cost.T)
    parent = np.full(len(cost), root)
    nearest = cost[root].copy()  # of each node: the cost of its edge to the tree
    waiting = np.arange(len(cost)) != root
    edges = []
    while waiting.any():
        node = int(np.argmin(np.where(waiting, nearest, np.inf)))
        if np.isfinite(nearest[node]) and waiting[node]:
            edges.append((parent[node], node))
        else:
            node = int(np.argmax(waiting))  # the root of the next part
        waiting[node] = False
        closer = waiting & (cost[node] < nearest)
        nearest[closer] = cost[node, closer]
        parent[closer] = node
    return np.array(edges, dtype=np.int64).reshape(-1, 2)


def connected_parts(first: Ints, second: Ints, nodes: int) -> Ints:
    """Return the number of the part of a graph that each node `[node]` is in.

    Parts are numbered in the order of their first nodes. Every node points at the lowest that it
    is known to be joined to, and again at what that points at, until nothing changes: as many
    rounds as the logarithm of the largest part (Shiloach and Vishkin 1982).

    first, second: `[edge]` the nodes that edges join.
    """
    lowest = np.arange(nodes)
    while True:
        a, b = lowest[first], lowest[second]
        if np.array_equal(a, b):
            break
        np.minimum.at(lowest, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(jumped := lowest[lowest], lowest):
            lowest = jumped
    del a, b  # of long recordings they are large
    return (np.cumsum(lowest == np.arange(nodes)) - 1)[lowest]


def fiedler_vector(weight: Floats) -> Floats:
    """Return a number `[node]` for each node, near to those of the nodes that it is joined to.

    The eigenvector of the second smallest eigenvalue of the graph's Laplacian (Fiedler 1973): its
    signs cut the graph where it is weakest. Its own sign is arbitrary.

    weight: `[node, node]` of the edges, symmetric; the diagonal does not count.
    """
    laplacian = np.diag(weight.sum(1)) - weight
    return np.asarray(np.linalg.eigh(laplacian)[1][:, 1], dtype=np.float64)
