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


def assign(cost: Floats) -> tuple[Ints, Ints]:
    """Return the rows and the columns of the assignment of least total cost, as scipy's does.

    Shortest augmenting paths: Crouse (2016), "On implementing 2D rectangular assignment
    algorithms". For a few rows at a time: each costs a search over all columns.

    cost: `[row, column]`. As many pairs as there are of the fewer of the two, by their rows. Raises
    ValueError where a cost is not finite: no path would end.
    """
    if not np.isfinite(cost).all():
        raise ValueError("assign: expected costs that are finite, got NaN or infinite ones")
    if cost.shape[0] > cost.shape[1]:
        columns, rows = assign(cost.T)
        order = np.argsort(rows)
        return rows[order], columns[order]
    price = np.zeros(cost.shape[1])  # of each column
    paid = np.zeros(cost.shape[0])  # by each row
    owner = np.full(cost.shape[1], -1)
    for row in range(len(cost)):
        _find_room(row, cost, price, paid, owner)
    columns = np.flatnonzero(owner >= 0)
    order = np.argsort(owner[columns])
    return owner[columns][order], columns[order]


def _find_room(row: int, cost: Floats, price: Floats, paid: Floats, owner: Ints) -> None:
    """Give a column to one more row, along the shortest path of exchanges; changes the others."""
    shortest = np.full(len(price), np.inf)  # to each column
    before = np.full(len(price), -1)  # the row from which it is reached
    settled = np.zeros(len(price), dtype=bool)
    length, here = 0.0, row
    while True:
        through = length + cost[here] - paid[here] - price
        closer = ~settled & (through < shortest)
        shortest[closer], before[closer] = through[closer], here
        column = int(np.argmin(np.where(settled, np.inf, shortest)))
        length = float(shortest[column])
        settled[column] = True
        if owner[column] < 0:
            break
        here = int(owner[column])
    paid[row] += length
    others = settled & (owner >= 0)
    paid[owner[others]] += length - shortest[others]
    price[settled] -= length - shortest[settled]
    while (here := int(before[column])) != row:
        given_up = int(np.flatnonzero(owner == here)[0])
        owner[column], column = here, given_up
    owner[column] = row
