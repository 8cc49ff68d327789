"""How triangulated points move from frame to frame."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.types import Floats, Ints

_USUAL_SHARE = 0.98  # of the motions, the smaller ones


@dataclass(frozen=True)
class Motion:
    """The parabolas on which N points move, about where each is in its own frame.

    velocity: `[3, N]` in lengths by frame. acceleration: `[3, N]` in lengths by frame squared.
    """

    velocity: Floats
    acceleration: Floats

    def select(self, points: slice) -> "Motion":
        """Return the motion of some of the points."""
        return Motion(self.velocity[:, points], self.acceleration[:, points])

    def displacement(self, offset: Floats) -> Floats:
        """Return how far the points move in the frames of an offset `[view]`, `[view, 3, N]`."""
        time = np.asarray(offset)[:, None, None]
        return time * self.velocity + time**2 / 2 * self.acceleration

    def velocity_after(self, offset: Floats) -> Floats:
        """Return the velocity `[view, 3, N]` of the points after an offset `[view]` in frames."""
        return self.velocity + np.asarray(offset)[:, None, None] * self.acceleration


def motion_between(before: Floats, points: Floats, after: Floats, step: int) -> Motion:
    """Return the motion of points that are known `step` frames before and after, too.

    Each is `[3, N]`; the motion goes through all three.
    """
    return Motion(
        velocity=(after - before) / (2 * step),
        acceleration=(after - 2 * points + before) / step**2,
    )


def usual_step(frames: Ints) -> int:
    """Return by how much frame numbers `[frame]` go up mostly: these frames follow each other."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1


def smoothness(motion: Motion, step: int) -> float:
    """Return how smoothly points move over `step` frames: 1 without jerks, 0 as by chance.

    Points of independent errors of variance s^2, or of frames that do not follow each other, have
    velocities of variance s^2 / 2 and accelerations of 6 s^2. The largest motions, which are
    mistaken identities, do not count.
    """
    velocity = (motion.velocity**2).sum(0)
    acceleration = (motion.acceleration**2).sum(0) * step**2
    size = velocity + acceleration
    usual = size <= np.quantile(size, _USUAL_SHARE)
    total = velocity[usual].sum()
    return float(1 - acceleration[usual].sum() / (12 * total)) if total > 0 else 0.0
