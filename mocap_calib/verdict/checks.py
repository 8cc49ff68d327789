"""Look at a rig in ways that are independent of its covariance.

A covariance knows what chance does to a rig under a model that is right. Whether the model is
right (one clock, these lenses, cameras that stay where they are, rigid bodies, who is who) is to be
seen in what the model leaves over. docs/how-good.md has the values of sound recordings.
"""

from itertools import combinations

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.medians import known_medians
from mocap_calib.config import Config
from mocap_calib.geometry import lens
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.geometry.homography import plane_errors
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.labels import matched_share
from mocap_calib.rig.observations import labelled_frames
from mocap_calib.rig.view_graph import best_scores
from mocap_calib.types import Check, Floats, GroupResult
from mocap_calib.verdict.explained import Leftover

_PAIRS = 30  # of views, that tell whether all lies in a plane,
_MATCHES_OF_A_PAIR = 1000


def check_rig(group: GroupResult, config: Config) -> tuple[Check, ...]:
    """Return all checks of the rig of a group."""
    limits, left = config.verdict, Leftover.of(group)
    of_cameras = {
        "pair score": (_lack_of_score(group, config), 0.0),
        "clock": (_clocks(group, config), limits.clock_frames),
        "lens": (_radial_slopes(group, left, config), limits.lens),
        "over time": (_over_time(left, config), limits.over_time),
        "unmatched": (1 - matched_share(group.recording, group.matches), limits.unmatched),
        "errors": (_errors_of_body(group, left), limits.errors),
    }
    return (
        Check("convergence", 0.0 if group.adjusted.converged else 1.0, 0.0),
        Check("moments", limits.least_moments / max(len(labelled_frames(group.matches)), 1), 1.0),
        Check("held-out frames", group.uncertainty.held_out, limits.held_out),
        Check("flat", _flatness(group, left), limits.flat),
        Check("bones", _bones(group.poses.positions), limits.bones),
        Check("loops", _broken_loops(group, config), limits.broken_loops),
        Check("bridge", _weakest_bridge(group), limits.bridge),
        *(_of_worst(name, *found, group=group) for name, found in of_cameras.items()),
    )


def _of_worst(name: str, values: Floats, limit: float, *, group: GroupResult) -> Check:
    """Return the check of the camera with the largest of some values `[view]`."""
    if not np.isfinite(values).any():
        return Check(name, np.nan, limit)
    worst = int(np.nanargmax(values))
    return Check(name, float(values[worst]), limit, group.rig.names[worst])


# Of the whole rig


def _flatness(group: GroupResult, left: Leftover) -> float:
    """Return the errors of points, in those that they would have if all lay in one plane.

    Of pairs of views the median: a homography maps the images of a plane to each other, wherever
    a rig has the cameras. NaN where no two views have enough in common.
    """
    views = len(group.rig.cameras)
    pixels = left.pixels.reshape(views, 2, -1).swapaxes(1, 2)
    rays = lens.unproject_views(group.rig.cameras, pixels, by_component=True)
    focal = np.array([camera.focal for camera in group.rig.cameras])
    error = left.distance.reshape(views, -1) / focal[:, None]
    found = []
    for a, b in evenly_spaced(np.array(list(combinations(range(views), 2))), _PAIRS).tolist():
        both = np.flatnonzero(np.isfinite(error[[a, b]]).all(0))
        both = evenly_spaced(both, _MATCHES_OF_A_PAIR)
        in_plane = plane_errors(*(rays[view][:, both].T for view in (a, b)))
        if len(in_plane):
            usual = np.hypot(*np.median(error[[a, b]][:, both], axis=1))
            found.append(float(usual / max(np.median(in_plane), 1e-12)))
    return float(np.median(found)) if found else np.nan


def _bones(positions: Floats) -> float:
    """Return the share by which the steadiest quarter of all distances on a body vary over time.

    positions: `[frame, individual, keypoint, 3]`. By the median distance from the median.
    """
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


def _broken_loops(group: GroupResult, config: Config) -> float:
    """Return the share of the pairs of cameras that do not go with the rig."""
    weight = group.averaged.weight
    return float((weight < config.averaging.breaks).mean()) if len(weight) else np.nan


def _weakest_bridge(group: GroupResult) -> float:
    """Return how much worse the parts of a rig go together than their cameras do.

    Of the best pairs that connect all cameras: by how many times the score of the worst is below
    the median of the others. Cameras of two recordings agree among themselves, and hardly with each
    other. NaN where there are fewer than three cameras.
    """
    views = len(group.rig.cameras)
    cost = np.full((views, views), np.inf)
    for pair in group.pairs:
        cost[pair.a, pair.b] = 1 / max(pair.score, 1e-6)
    used = np.sort(np.minimum(cost, cost.T)[tuple(spanning_tree(cost).T)])
    return float(used[-1] / np.median(used[:-1])) if len(used) >= 2 else np.nan


# Of each camera


def _lack_of_score(group: GroupResult, config: Config) -> Floats:
    """Return by how much `[view]` the lifted bodies of a camera's best pair agree too little."""
    score = best_scores(group.pairs, len(group.rig.cameras))
    return config.averaging.weak_score - score


def _clocks(group: GroupResult, config: Config) -> Floats:
    """Return by how many frames `[view]` clocks are certainly off that were not put right."""
    offsets = group.time_offsets
    left = np.where(offsets.used, 0.0, np.abs(offsets.tau))
    certain = left > config.verdict.clock_significance * offsets.sigma
    return np.where(certain, left, np.where(np.isfinite(left), 0.0, np.nan))


def _radial_slopes(group: GroupResult, left: Leftover, config: Config) -> Floats:
    """Return how certain it is, `[view]`, that errors grow with the cube of the radius.

    In standard deviations, from how the sums of stretches of time and of joints scatter. Lenses
    that are wrong do that.
    """
    found = np.full(len(group.rig.cameras), np.nan)
    blocks = config.uncertainty.time_blocks
    for view, camera in enumerate(group.rig.cameras):
        centre = camera.matrix[:2, 2, None, None, None]
        arm = (left.pixels[view] - centre) / camera.focal
        usual = np.nanmedian(left.distance[view]) if np.isfinite(left.distance[view]).any() else 1
        weight = 1 / (1 + (left.distance[view] / (2 * usual)) ** 2)
        pull = weight * (left.gap[view] * arm).sum(0) * (arm**2).sum(0)
        in_time = [np.nansum(part) for part in np.array_split(pull, blocks)]
        of_joint = np.nansum(pull, axis=(0, 1))
        scatter = float(np.square(in_time).sum() + np.square(of_joint).sum())
        if scatter > 0:
            found[view] = abs(float(np.nansum(pull))) / np.sqrt(scatter)
    return found


def _over_time(left: Leftover, config: Config) -> Floats:
    """Return the largest error of a stretch of time in median ones, `[view]`.

    That of a camera that was moved for a while.
    """
    stretches = np.array_split(left.distance, config.uncertainty.time_blocks, axis=1)
    counts = np.stack([np.isfinite(part).sum((1, 2, 3)) for part in stretches])
    # a stretch in which a camera hardly matches anybody tells nothing of where it stands
    limits = config.verdict
    least = np.maximum(limits.stretch_keypoints, limits.stretch_share * np.median(counts, axis=0))
    medians = np.stack([_medians_by_view(part, least) for part in stretches])
    some = np.isfinite(medians).any(0)
    found = np.full(len(left.distance), np.nan)
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


def _errors_of_body(group: GroupResult, left: Leftover) -> Floats:
    """Return the median error of a keypoint `[view]` in sizes of the bodies in the image.

    Detectors err by a share of what they look at.
    """
    some = np.isfinite(left.distance).sum(-1, keepdims=True) >= 3
    pixels = np.where(some[:, None], left.pixels, np.nan)  # [view, 2, frame, individual, keypoint]
    found = np.full(len(group.rig.cameras), np.nan)
    for view, seen in enumerate(pixels):
        bodies = np.moveaxis(seen, 0, -1).reshape(-1, *seen.shape[3:], 2)
        bodies = bodies[np.isfinite(bodies[..., 0]).sum(1) >= 3]
        if len(bodies):
            off = bodies - np.nanmedian(bodies, axis=1, keepdims=True)
            size = np.median(np.sqrt(np.nanmean((off**2).sum(-1), axis=1)))
            found[view] = np.nanmedian(left.distance[view]) / size
    return found
