"""Lifted bodies that may as well be the other way round in depth.

A body far away and its mirror image in depth have the same picture. They are of different shape
by twice the body's thickness, and the lifting network has learnt which shapes there are. Of a
nearly flat body both are of one shape: nobody can tell from one view which it was (Necker's
reversal). Then the lifted body is one of two readings, and two views compare both.
"""

from collections.abc import Iterable

import numpy as np

from mocap_calib.config import LEAST_LIFT_SPREAD
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints, LiftedPoses, Sample

_FRAMES = 20  # looked at to tell whether bodies are flat


def reversal_in_spreads(
    sample: Sample, lifted: LiftedPoses, views: Iterable[int], frames: Ints
) -> float:
    """Return how far a reversal moves the seen joints of bodies, in spreads of the network.

    Below 1 the bodies that the views show are too flat to tell front from back. frames: `[frame]`
    indices into the sample. Infinite where a view has nothing lifted.
    """
    few = evenly_spaced(frames, _FRAMES)
    moved, variance = np.mean([_flatness(sample, lifted, view, few) for view in views], axis=0)
    return float(np.sqrt(moved / variance)) if variance > 0 else np.inf


def _flatness(sample: Sample, lifted: LiftedPoses, view: int, frames: Ints) -> tuple[float, float]:
    """Return the medians of how far a reversal moves the seen joints, and of their variance.

    Both are squared, in body sizes. A reversal turns the sign of the least principal axis, after
    the best rotation; infinite and 0 where nothing was lifted.
    """
    known = sample.vocabulary >= 0
    joints = sample.vocabulary[known]
    body = lifted.body[view, frames][..., joints, :]
    spread = lifted.spread[view, frames][..., joints]
    seen = (sample.confidence[view, frames][..., known] > 0) & np.isfinite(body).all(-1)
    enough = seen.any(-1)
    if not enough.any():
        return np.inf, 0.0
    variance = np.where(seen, spread, 0.0)[enough] ** 2
    weight = seen[enough] / (variance + LEAST_LIFT_SPREAD**2)
    weight /= weight.sum(-1, keepdims=True)
    body = np.where(seen[..., None], body, 0.0)[enough]
    body -= np.einsum("nk,nkx->nx", weight, body)[:, None]
    scatter = np.swapaxes(body, 1, 2) @ (body * weight[..., None])
    least = np.maximum(np.linalg.eigvalsh(scatter)[:, 0], 0.0)
    return float(np.median(4 * least)), float(np.median((weight * variance).sum(-1)))


def readings(cross: Floats, centre_a: Floats, centre_b: Floats) -> Floats:
    """Return cross-covariances where neither body, that of a, that of b, or both are reversed.

    cross: `[frame, I, J, 3, 3]` sum w X_a X_b'; centre_a: `[frame, I, 3]`; centre_b:
    `[frame, J, 3]`. Returns `[4, frame, I, J, 3, 3]`.
    """
    mirror_a = _mirror(centre_a)[:, :, None]
    mirror_b = _mirror(centre_b)[:, None]
    of_a = mirror_a @ cross
    return np.stack([cross, of_a, cross @ mirror_b, of_a @ mirror_b])


def _mirror(centre: Floats) -> Floats:
    """Return the reflections `[..., 3, 3]` along the lines of sight to centres `[..., 3]`."""
    length = np.linalg.norm(centre, axis=-1, keepdims=True)
    sight = centre / np.maximum(length, 1e-12)
    return np.asarray(np.eye(3) - 2 * sight[..., :, None] * sight[..., None, :])
