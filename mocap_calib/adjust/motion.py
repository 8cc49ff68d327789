"""How triangulated points move from frame to frame."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.types import Floats, Ints

_USUAL_SHARE = 0.98  # of the motions, the smaller ones


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """The parabolas on which N points move, about where each is in its own frame.

    velocity: `[3, N]` in lengths by frame. acceleration: `[3, N]` in lengths by frame squared.
    """

    velocity: Floats
    acceleration: Floats

    def displacement(self, frames: Floats) -> Floats:
        """Return how far the points move in times `[view]` in frames, `[view, 3, N]`."""
        time = frames[:, None, None]
        return time * self.velocity + time**2 / 2 * self.acceleration

    def velocity_after(self, frames: Floats) -> Floats:
        """Return the velocity of the points after times `[view]` in frames, `[view, 3, N]`."""
        return self.velocity + frames[:, None, None] * self.acceleration

    def select(self, points: slice | Ints) -> "Motion":
        """Return the motion of some of the points."""
        return Motion(self.velocity[:, points], self.acceleration[:, points])


def motion_between(from_last: Floats, to_next: Floats, step: int) -> Motion:
    """Return the motion of points that are known `step` frames before and after, too.

    from_last, to_next: `[3, N]` how far they come and go.
    """
    return Motion(
        velocity=(to_next + from_last) / (2 * step),
        acceleration=(to_next - from_last) / step**2,
    )


def smoothness(before: Floats, points: Floats, after: Floats) -> float:
    """Return how smoothly points move: 1 without jerks, 0 as by chance.

    Each is `[3, N]`, the same points in frames that follow each other. Where errors are independent
    and of variance s^2, or frames do not follow each other, half of the way from before to after
    varies by s^2 / 2, and the way of a point off the middle of the two by 3 s^2 / 2. The largest
    motions, which are mistaken identities, do not count.
    """
    along = (((after - before) / 2) ** 2).sum(0)
    aside = ((points - (after + before) / 2) ** 2).sum(0)
    if not len(along):
        return 0.0
    usual = along + aside <= np.quantile(along + aside, _USUAL_SHARE)
    total = along[usual].sum()
    return float(1 - aside[usual].sum() / (3 * total)) if total > 0 else 0.0
