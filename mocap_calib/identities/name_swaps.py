"""Stretches of a recording in which two individuals have each other's names.

Single pieces of tracks hold each other where they are. What is wrong for a stretch is found by
dynamic programming: names are either as they are or exchanged, and change over where both
individuals are uncertain at once.
"""

import numpy as np

from mocap_calib.types import Bools, Floats, Ints


def exchanged_pieces(
    first: Ints, last: Ints, of_second: Bools, preference: Floats, pairs: Floats
) -> Bools:
    """Return which pieces `[piece]` of two individuals should have the other's name.

    first, last: `[piece]` frames, in the order of the first ones. of_second: `[piece]` which of
    the two has it. preference: `[piece]` evidence for the other's name by what it looks like;
    pairs: `[piece, piece]` evidence that two pieces are one individual.
    """
    alike = of_second[:, None] == of_second
    bound = np.triu(np.where(alike, pairs, -pairs), 1)
    # what is lost by changing over before piece k: all that binds earlier ones to later ones
    gained = np.concatenate([[0.0], (bound.sum(1) - bound.sum(0)).cumsum()[:-1]])
    ended = np.concatenate([[-1], np.maximum.accumulate(last)[:-1]])
    loss = np.where(ended < first, gained, np.inf)
    loss[:1] = 0.0  # there may be no pieces

    total = np.array([0.0, 0.0])  # with names as they are, exchanged
    came_from = np.zeros((len(first), 2), dtype=np.int64)
    for piece, change in enumerate(loss):
        other = total[::-1] - change
        came_from[piece] = np.where(other > total, [1, 0], [0, 1])
        total = np.maximum(total, other) + np.array([0.0, preference[piece]])
    exchanged = np.zeros(len(first), dtype=bool)
    state = int(total[1] > total[0])
    for piece in range(len(first) - 1, -1, -1):
        exchanged[piece] = state
        state = came_from[piece, state]
    return exchanged
