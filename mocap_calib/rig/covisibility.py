"""Which views see the same bodies, before any pair of them was calibrated.

A posture looks alike from everywhere: distances within a lifted body do not depend on where the
camera stands. Views of the same bodies show alike postures in the same frames, and less alike ones
in other frames.
"""

import numpy as np

from mocap_calib.config import ViewGraphConfig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Floats, LiftedPoses


def measure_covisibility(lifted: LiftedPoses, config: ViewGraphConfig) -> Floats:
    """Return by how much more alike the bodies of two views are in step than out of step.

    `[view, view]`, symmetric, -1..1, about 0 where two views see nothing in common, or too little
    was lifted to say.
    """
    views, count = lifted.centre.shape[:2]
    frames = evenly_spaced(np.arange(count), config.frames)
    seen: Bools = np.asarray(np.isfinite(lifted.body[:, frames]).all((-2, -1)))
    if not seen.any():
        return np.zeros((views, views))
    shapes = _describe_shapes(lifted.body[:, frames], seen, config)
    shifts = evenly_spaced(np.arange(len(frames)), config.shifts + 1)[1:]
    in_step = _likeness(shapes, seen, shift=0)
    out_of_step = [_likeness(shapes, seen, shift=int(shift)) for shift in shifts if shift > 0]
    more = in_step - sum(out_of_step) / max(len(out_of_step), 1)
    return np.asarray((more + more.T) / 2)


def _describe_shapes(body: Floats, seen: Bools, config: ViewGraphConfig) -> Floats:
    """Return what of bodies no rotation changes, `[view, frame, instance, axis]`; 0 = not lifted.

    The principal axes of their Gram matrices, in units of their usual distance times the square
    root of `config.alike`. body: `[view, frame, instance, joint, 3]`.
    """
    bodies = body[seen]
    first, second = np.triu_indices(bodies.shape[1])
    gram = (bodies @ np.swapaxes(bodies, 1, 2))[:, first, second]
    gram *= np.where(first == second, 1.0, np.sqrt(2.0))  # distances are those of whole matrices
    gram -= gram.mean(0)
    axes = np.linalg.eigh(gram.T @ gram)[1][:, -config.axes :]
    along = gram @ axes
    usual = np.sqrt(2 * (along**2).sum(1).mean() * config.alike)
    shapes = np.zeros((*seen.shape, along.shape[1]))
    shapes[seen] = along / max(float(usual), 1e-12)
    return shapes


def _likeness(shapes: Floats, seen: Bools, *, shift: int) -> Floats:
    """Return how alike the bodies of two views are, `[view, view]` in 0..1.

    Each body counts with the most alike of the other view. The frames of the second view are
    later by `shift`, going round.
    """
    views, frames, instances = seen.shape
    total, count = np.zeros((views, views)), np.zeros((views, views))
    for frame in range(frames):
        other = (frame + shift) % frames
        both = seen[:, frame].reshape(-1, 1) & seen[:, other].reshape(1, -1)
        first, second = (shapes[:, k].reshape(views * instances, -1) for k in (frame, other))
        apart = (first**2).sum(1)[:, None] + (second**2).sum(1) - 2 * first @ second.T
        alike = np.where(both, np.exp(-np.maximum(apart, 0.0)), 0.0)
        by_view = alike.reshape(views, instances, views, instances)
        total += by_view.max(3).sum(1) + by_view.max(1).sum(2)
        bodies_first, bodies_second = seen[:, frame].sum(1), seen[:, other].sum(1)
        together = (bodies_first[:, None] > 0) & (bodies_second > 0)
        count += np.where(together, bodies_first[:, None] + bodies_second, 0)
    return total / np.maximum(count, 1)
