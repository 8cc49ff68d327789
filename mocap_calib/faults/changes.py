"""The moments from which on one camera stands elsewhere, given bodies that other cameras place.

With one pose for each epoch the errors of a camera that was moved fall at once to those of a
camera that was not. Errors that drift with the subject, by the lens or a wrong focal length, fall
bit by bit with each further epoch: a change is believed where it explains far more than one more
change would (binary segmentation, Scott and Knott 1974).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_calib.adjust.camera_fit import CameraPoses
from mocap_calib.adjust.resection import (
    Sightings,
    costs_of,
    linearise,
    propose_poses,
    refine_poses,
    typical_error,
)
from mocap_calib.config import DECISIVE_NATS, MovedConfig
from mocap_calib.rig.tracks import MEDIAN_DISTANCE
from mocap_calib.types import POSE, Bools, Floats, Ints


@dataclass(frozen=True)
class Epochs:
    """Poses that a camera had one after the other.

    starts: `[change]` index of the first detection of each epoch but the first, ascending.
    poses: of the `change + 1` epochs.
    tolerance: radians, of an error.
    """

    starts: Ints
    poses: CameraPoses
    tolerance: float


def find_epochs(
    start: CameraPoses,
    seen: Sightings,
    config: MovedConfig,
    *,
    least_noise: float,
) -> tuple[Epochs, float]:
    """Return the epochs of a camera, and the evidence (nats) of their changes.

    There is one epoch, and no evidence, where the evidence of no change is decisive.

    start: the pose in the rig. least_noise: radians, below which no detector is.
    """
    loose = config.loose * float(np.median(seen.size))
    found = [_refine(np.zeros(0, np.int64), start, seen, config, (loose, least_noise))]
    proposed = start + propose_poses(start, seen, config)
    costs = costs_of(proposed, seen, config.loose * seen.size, config.least_joints)
    for _ in range(config.most_changes + 1):
        tried = []
        for split in _propose_splits(found[-1], proposed, costs, seen, config):
            widest = loose if split.is_large else 2 * found[-1].tolerance
            starts, poses = _with_split(found[-1], split)
            tried.append(_refine(starts, poses, seen, config, (widest, least_noise)))
        if not tried:
            break
        best = int(_total_costs(tried, seen, config)[0].argmin())
        (before, after), detections = _total_costs([found[-1], tried[best]], seen, config)
        found.append(tried[best])
        if detections * (before / max(after, 1e-12) - 1) < 1:
            break
    costs, detections = _total_costs(found, seen, config)
    return _choose_number(found, costs, detections, config)


def own_costs(epochs: Epochs, tolerance: float, seen: Sightings, config: MovedConfig) -> Floats:
    """Return the cost `[detection]` of each detection under the pose of its epoch."""
    cost = costs_of(epochs.poses, seen, tolerance, config.least_joints)
    return cost[_epoch_of(epochs.starts, len(seen.frame)), np.arange(len(seen.frame))]


def change_at_a_glance(start: CameraPoses, seen: Sightings, config: MovedConfig) -> float:
    """Return how far the errors of a camera change at one moment, above 1 = look closer.

    Of two signs the larger: the share of the squared errors that a small change of pose explains,
    and the step of the mean cost. start: its pose in the rig. Cheap: nothing is refined.
    """
    detections, least = len(seen.frame), _least(seen, config)
    if detections < 2 * least:
        return 0.0
    tolerance = config.loose * float(np.median(seen.size))
    problem = linearise(start.each()[0], seen, tolerance, config.least_joints)
    normal, target = problem.normal, problem.target
    gains, moments = split_gains(normal, target, 0, detections, least)
    left = problem.square.sum() - _explained(normal.sum(0), target.sum(0))
    cost = costs_of(start, seen, tolerance, config.least_joints)[0].cumsum()
    before, after = (
        cost[moments - 1] / moments,
        (cost[-1] - cost[moments - 1]) / (detections - moments),
    )
    balance = 2 * np.sqrt(moments * (detections - moments)) / detections
    step = np.abs(after - before) * balance
    share = float(gains.max()) / max(float(left), 1e-300)
    return max(share / config.suspicious_gain, float(step.max()) / config.suspicious_step)


def last_moments(
    pair: CameraPoses, seen: Sightings, tolerance: float, config: MovedConfig
) -> tuple[int, int]:
    """Return the last frame (index) that shows the pose before a change, and the first after it.

    pair: the poses before and after.
    """
    cost = np.nan_to_num(costs_of(pair, seen, tolerance, config.least_joints))
    total = np.concatenate([[0.0], (cost[0] - cost[1]).cumsum()])
    moment = int(np.clip(total.argmin(), 1, len(seen.frame) - 1))
    return int(seen.frame[moment - 1]), int(seen.frame[moment])


def split_gains(
    normal: Floats, target: Floats, first: int, last: int, least: int
) -> tuple[Floats, Ints]:
    """Return what a change of pose explains at each possible moment, and the moments.

    normal: `[detection, 6, 6]` and target: `[detection, 6]` of the least-squares problem of the
        pose; of the detections from `first` to `last` (excluded), at least `least` on either side.
    """
    moments = np.arange(first + least, last - least + 1)
    if not len(moments):
        return np.zeros(0), moments
    normals = np.concatenate([np.zeros((1, POSE, POSE)), normal[first:last].cumsum(0)])
    targets = np.concatenate([np.zeros((1, POSE)), target[first:last].cumsum(0)])
    here = moments - first
    whole = _explained(normals[-1:], targets[-1:])[0]
    before = _explained(normals[here], targets[here])
    after = _explained(normals[-1] - normals[here], targets[-1] - targets[here])
    return before + after - whole, moments


def _explained(normal: Floats, target: Floats) -> Floats:
    """Return b' A^-1 b, by how much the best step lowers the squared error, `[...]`."""
    ridge = 1e-9 * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-12
    step = np.linalg.solve(normal + ridge * np.eye(POSE), target[..., None])[..., 0]
    return np.asarray((step * target).sum(-1))


def _epoch_of(starts: Ints, detections: int) -> Ints:
    """Return the epoch `[detection]` of each detection."""
    return np.searchsorted(starts, np.arange(detections), side="right")


def _members(starts: Ints, detections: int) -> Bools:
    """Return which detections are of each epoch, `[epoch, detection]`."""
    return _epoch_of(starts, detections) == np.arange(len(starts) + 1)[:, None]


def _least(seen: Sightings, config: MovedConfig) -> int:
    """Return how many detections an epoch has at least."""
    return max(config.least_detections, int(np.ceil(config.least_share * len(seen.frame))))


def _total_costs(found: list[Epochs], seen: Sightings, config: MovedConfig) -> tuple[Floats, int]:
    """Return the cost for each of several numbers of epochs, and of how many detections.

    All at the tolerance of the finest, of the detections that one of them explains: the others are
    of strangers.
    """
    tolerance = min(epochs.tolerance for epochs in found)
    costs = np.array([own_costs(epochs, tolerance, seen, config) for epochs in found])
    explained = (costs < config.explained).any(0)
    return np.asarray(costs[:, explained].sum(1)), int(explained.sum())


@dataclass(frozen=True)
class _Split:
    """An epoch that may be two.

    gain: what that explains. epoch: its number. moment: index of the first detection after the
    change. poses: before and after. is_large: these are proposed poses.
    """

    gain: float
    epoch: int
    moment: int
    poses: CameraPoses
    is_large: bool


def _propose_splits(
    epochs: Epochs, proposed: CameraPoses, costs: Floats, seen: Sightings, config: MovedConfig
) -> list[_Split]:
    """Return the epochs that may best be two: by small steps of the pose, and by proposed poses.

    None where no epoch is long enough. costs: `[pose, detection]` of the proposed poses.
    """
    least = _least(seen, config)
    bounds = np.concatenate([[0], epochs.starts, [len(seen.frame)]])
    small, large = [], []
    for epoch, (first, last) in enumerate(pairwise(bounds.tolist())):
        if last - first >= 2 * least:
            span = (first, last)
            small.append(_small_split(epochs, epoch, span, least=least, seen=seen, config=config))
            large.append(_large_split(epoch, span, proposed, np.nan_to_num(costs), least=least))
    best = [max(splits, key=lambda split: split.gain) for splits in (small, large) if splits]
    worth = 0.03 * len(seen.frame)  # else small steps do as well
    return [split for split in best if not split.is_large or split.gain > worth]


def _small_split(
    epochs: Epochs,
    epoch: int,
    span: tuple[int, int],
    *,
    least: int,
    seen: Sightings,
    config: MovedConfig,
) -> _Split:
    """Return the best split of an epoch by small steps from its pose."""
    pose = epochs.poses[epoch : epoch + 1]
    problem = linearise(pose.each()[0], seen, epochs.tolerance, config.least_joints)
    gains, moments = split_gains(problem.normal, problem.target, *span, least)
    best = int(gains.argmax())
    return _Split(float(gains[best]), epoch, int(moments[best]), pose + pose, False)


def _large_split(
    epoch: int, span: tuple[int, int], proposed: CameraPoses, costs: Floats, *, least: int
) -> _Split:
    """Return the best split of an epoch by two of the proposed poses."""
    first, last = span
    total = np.zeros((len(costs), last - first + 1))
    total[:, 1:] = costs[:, first:last].cumsum(1)
    before, after = total, total[:, -1:] - total
    gains = total[:, -1].min() - before.min(0) - after.min(0)
    moment = least + int(gains[least : last - first - least + 1].argmax())
    pair = np.array([before[:, moment].argmin(), after[:, moment].argmin()])
    return _Split(float(gains[moment]), epoch, first + moment, proposed[pair], True)


def _with_split(epochs: Epochs, split: _Split) -> tuple[Ints, CameraPoses]:
    """Return starts and poses with an epoch in two."""
    before, after = epochs.poses[: split.epoch], epochs.poses[split.epoch + 1 :]
    return np.insert(epochs.starts, split.epoch, split.moment), before + split.poses + after


def _refine(
    starts: Ints,
    poses: CameraPoses,
    seen: Sightings,
    config: MovedConfig,
    angles: tuple[float, float],
) -> Epochs:
    """Return the poses of least cost, and the moments between them where it is least.

    angles: radians, the widest tolerance, and the noise below which no detector is.
    """
    detections = len(seen.frame)
    widest, least_noise = angles
    tolerances = np.geomspace(widest, widest / 10, config.steps)
    for _ in range(3):
        own = _members(starts, detections)
        poses = refine_poses(
            poses,
            seen,
            counted=own,
            tolerances=tuple(tolerances.tolist()),
            least_joints=config.least_joints,
        )
        tight = _tight_tolerance(poses, seen, own, config, least_noise)
        cost = np.nan_to_num(costs_of(poses, seen, tight, config.least_joints))
        starts = _move_starts(starts, cost, _least(seen, config))
        tolerances = np.geomspace(2 * tight, tight, config.steps // 2)
    return Epochs(starts, poses, tight)


def _tight_tolerance(
    poses: CameraPoses, seen: Sightings, own: Bools, config: MovedConfig, least_noise: float
) -> float:
    """Return the tolerance in radians that the errors of detections under their poses ask for.

    own: `[epoch, detection]`. least_noise: radians, below which no detector is.
    """
    noise = typical_error(poses, seen, own, config.least_joints) / MEDIAN_DISTANCE
    return config.tolerance_noises * max(noise, least_noise)


def _move_starts(starts: Ints, cost: Floats, least: int) -> Ints:
    """Return the moments at which it costs least to go on with the next pose.

    cost: `[epoch, detection]`.
    """
    moved = starts.copy()
    for k in range(len(starts)):
        first = moved[k - 1] if k else 0
        last = starts[k + 1] if k + 1 < len(starts) else cost.shape[1]
        total = np.concatenate([[0.0], (cost[k] - cost[k + 1])[first:last].cumsum()])
        possible = total[least : last - first - least + 1]
        if len(possible):
            moved[k] = first + least + int(possible.argmin())
    return moved


def _choose_number(
    found: list[Epochs], costs: Floats, detections: int, config: MovedConfig
) -> tuple[Epochs, float]:
    """Return the epochs that are accepted, of those with 0, 1, 2, ... changes, and their evidence.

    A change that lowers the cost of n detections by a share g has n g / 2 nats (a profile
    likelihood), divided by what one more change would seem to have: errors that drift with the
    subject are no independent errors, and they fall bit by bit. Each change pays for the choice of
    its moment: epochs have at least `least_share` of the detections, so 1 / `least_share` moments
    are possible, each as likely beforehand.

    costs: `[change]` of each, of so many detections.
    """
    gains = np.maximum(costs[:-1] / np.maximum(costs[1:], 1e-12) - 1, 0.0) * detections
    for changes in range(min(len(gains), config.most_changes), 0, -1):
        further = max(1.0, float(gains[changes:].max(initial=0.0)))
        gain = min(float(gains[:changes].min()), float(gains[changes - 1]) / further)
        evidence = gain / 2 + float(np.log(config.least_share))
        if evidence >= DECISIVE_NATS:
            return found[changes], evidence
    return found[0], 0.0
