"""What the checks of a rig measure: numbers of the residuals, independent of the covariance."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.medians import known_medians
from mocap_calib.config import Config
from mocap_calib.geometry import lens
from mocap_calib.geometry.epipolar import plane_errors
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import GroupResult
from mocap_calib.rig.graph import best_scores
from mocap_calib.rig.labels import matched_share
from mocap_calib.rig.tracks import labelled_frames
from mocap_calib.types import Floats
from mocap_calib.verdict.explained import Leftover

_PAIRS = 30  # of views, that are compared with planes
_MATCHES_OF_A_PAIR = 1000
_CERTAIN = 5.0  # standard deviations of the offset of a clock
_STRETCH_KEYPOINTS = 30  # of a camera, that a stretch of time has at least


@dataclass(frozen=True)
class Look:
    """A group of cameras, and the residuals of its points."""

    group: GroupResult
    left: Leftover
    config: Config


# Of the whole rig


def flatness(look: Look) -> float:
    """Return the errors of points, in those that they would have if all lay in one plane.

    Of pairs of views the median: a homography maps the images of a plane to each other, wherever
    a rig has the cameras. NaN where no two views have enough in common.
    """
    views = len(look.group.rig.cameras)
    pixels = look.left.pixels.reshape(views, 2, -1).swapaxes(1, 2)
    rays = lens.unproject_views(look.group.rig.cameras, pixels, by_component=True)
    focal = np.array([camera.focal for camera in look.group.rig.cameras])
    error = look.left.distance.reshape(views, -1) / focal[:, None]
    found = []
    for a, b in evenly_spaced(np.array(list(combinations(range(views), 2))), _PAIRS).tolist():
        both = np.flatnonzero(np.isfinite(error[[a, b]]).all(0))
        both = evenly_spaced(both, _MATCHES_OF_A_PAIR)
        in_plane = plane_errors(*(rays[view][:, both].T for view in (a, b)))
        if len(in_plane):
            usual = np.hypot(*np.median(error[[a, b]][:, both], axis=1))
            found.append(float(usual / max(np.median(in_plane), 1e-12)))
    return float(np.median(found)) if found else np.nan


def steadiest_bones(look: Look) -> float:
    """Return the share by which the steadiest quarter of all distances on a body vary over time.

    Of the triangulated points, by the median distance from the median.
    """
    positions = look.group.poses.raw
    frames = evenly_spaced(np.arange(len(positions)), 300)
    first, second = np.triu_indices(positions.shape[2], 1)
    bodies = mapped.take(positions, frames)
    length = np.linalg.norm(bodies[:, :, first] - bodies[:, :, second], axis=-1)
    length = length.reshape(len(frames), -1).T  # each distance of each individual: sizes differ
    known = np.isfinite(length).sum(1)
    length = length[known >= max(2, min(20, int(known.max(initial=0))))]
    if not length.size:
        return np.nan
    middle = known_medians(length)
    spread = 1.48 * known_medians(np.abs(length - middle[:, None]))
    apart = middle > 0
    return float(np.quantile(spread[apart] / middle[apart], 0.25)) if apart.any() else np.nan


def broken_loops(look: Look) -> float:
    """Return the share of the pairs of cameras that do not go with the rig."""
    weight = look.group.averaged.weight
    return float((weight < look.config.averaging.breaks).mean()) if len(weight) else np.nan


def weakest_bridge(look: Look) -> float:
    """Return how much worse the parts of a rig go together than their cameras do.

    Of the best pairs that connect all cameras: by how many times the score of the worst is below
    the median of the others. Cameras of two recordings agree among themselves, and hardly with each
    other. NaN where there are fewer than three cameras.
    """
    views = len(look.group.rig.cameras)
    cost = np.full((views, views), np.inf)
    for pair in look.group.pairs:
        cost[pair.a, pair.b] = 1 / max(pair.score, 1e-6)
    used = np.sort(np.minimum(cost, cost.T)[tuple(spanning_tree(cost).T)])
    return float(used[-1] / np.median(used[:-1])) if len(used) >= 2 else np.nan


# Of each camera


def lack_of_score(look: Look) -> Floats:
    """Return by how much `[view]` the lifted bodies of a camera's best pair agree too little."""
    score = best_scores(look.group.pairs, len(look.group.rig.cameras))
    return look.config.averaging.weak_score - score


def clocks(look: Look) -> Floats:
    """Return by how many frames `[view]` clocks are certainly off that were not put right."""
    offsets = look.group.time_offsets
    left = np.where(offsets.used, 0.0, np.abs(offsets.tau))
    certain = left > _CERTAIN * offsets.sigma
    return np.where(certain, left, np.where(np.isfinite(left), 0.0, np.nan))


def radial_slopes(look: Look) -> Floats:
    """Return how certain it is, `[view]`, that errors grow with the cube of the radius.

    In standard deviations, from how the sums of stretches of time and of joints scatter. Lenses
    that are wrong do that.
    """
    found = np.full(len(look.group.rig.cameras), np.nan)
    blocks = look.config.uncertainty.time_blocks
    for view, camera in enumerate(look.group.rig.cameras):
        centre = camera.matrix[:2, 2, None, None, None]
        arm = (look.left.pixels[view] - centre) / camera.focal
        usual = (
            np.nanmedian(look.left.distance[view])
            if np.isfinite(look.left.distance[view]).any()
            else 1
        )
        weight = 1 / (1 + (look.left.distance[view] / (2 * usual)) ** 2)
        pull = weight * (look.left.gap[view] * arm).sum(0) * (arm**2).sum(0)
        in_time = [np.nansum(part) for part in np.array_split(pull, blocks)]
        of_joint = np.nansum(pull, axis=(0, 1))
        scatter = float(np.square(in_time).sum() + np.square(of_joint).sum())
        if scatter > 0:
            found[view] = abs(float(np.nansum(pull))) / np.sqrt(scatter)
    return found


def over_time(look: Look) -> Floats:
    """Return the largest error of a stretch of time in median ones, `[view]`.

    That of a camera that was moved for a while.
    """
    stretches = np.array_split(look.left.distance, look.config.uncertainty.time_blocks, axis=1)
    counts = np.stack([np.isfinite(part).sum((1, 2, 3)) for part in stretches])
    # a stretch in which a camera hardly matches anybody tells nothing of where it stands
    least = np.maximum(_STRETCH_KEYPOINTS, np.median(counts, axis=0) / 2)
    medians = np.stack([_medians_by_view(part, least) for part in stretches])
    some = np.isfinite(medians).any(0)
    found = np.full(len(look.left.distance), np.nan)
    found[some] = np.nanmax(medians[:, some], axis=0) / np.nanmedian(medians[:, some], axis=0)
    return found


def _medians_by_view(distance: Floats, least: Floats) -> Floats:
    """Return the median `[view]` of distances `[view, ...]`, NaN where there are too few.

    least: `[view]` how many are enough.
    """
    flat = distance.reshape(len(distance), -1)
    enough = np.isfinite(flat).sum(1) >= least
    found = np.full(len(flat), np.nan)
    found[enough] = np.nanmedian(flat[enough], axis=1)
    return found


def errors_of_body(look: Look) -> Floats:
    """Return the median error of a keypoint `[view]` in sizes of the bodies in the image.

    Detectors err by a share of what they look at.
    """
    some = np.isfinite(look.left.distance).sum(-1, keepdims=True) >= 3
    pixels = np.where(
        some[:, None], look.left.pixels, np.nan
    )  # [view, 2, frame, individual, keypoint]
    found = np.full(len(look.group.rig.cameras), np.nan)
    for view, seen in enumerate(pixels):
        bodies = np.moveaxis(seen, 0, -1).reshape(-1, *seen.shape[3:], 2)
        bodies = bodies[np.isfinite(bodies[..., 0]).sum(1) >= 3]
        if len(bodies):
            off = bodies - np.nanmedian(bodies, axis=1, keepdims=True)
            size = np.median(np.sqrt(np.nanmean((off**2).sum(-1), axis=1)))
            found[view] = np.nanmedian(look.left.distance[view]) / size
    return found


def convergence(look: Look) -> float:
    """Return 1 where adjusting and matching did not converge, else 0."""
    return float(not look.group.adjusted.converged)


def few_frames(look: Look) -> float:
    """Return 10 over the number of frames in which bodies are matched."""
    return 10 / max(len(labelled_frames(look.group.matches)), 1)


def held_out(look: Look) -> float:
    """Return the ratio of held-out to in-sample errors of the worst fifth of the recording."""
    return look.group.uncertainty.held_out


def unmatched(look: Look) -> Floats:
    """Return the share `[view]` of the detections of a camera that stay unassigned."""
    return 1 - matched_share(look.group.recording, look.group.matches)


def times_others(look: Look) -> Floats:
    """Return the median error `[view]` in medians of the other cameras; of three and more."""
    group = look.group
    views = len(group.rig)
    if views < 3:
        return np.full(views, np.nan)
    flat = look.left.distance.reshape(views, -1)
    usual = known_medians(flat) / np.array([camera.focal for camera in group.rig.cameras])
    others = [np.nanmedian(np.delete(usual, view)) for view in range(views)]
    return np.asarray(usual / np.maximum(others, 1e-12))
