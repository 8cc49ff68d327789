"""Find a camera that was bumped or moved during the recording, and the frames.

A camera that was moved bends the rig of all, so it is judged by bodies that the others place:
first by the rig of all without its rays; then, where its errors change at some moment, by its
leave-one-out rig.

Its detections are divided into stretches of time, each of which asks for a pose. With one pose for
each epoch, of one stretch or more, the errors of a camera that was moved fall at once to those of a
camera that was not. Errors that drift with the subject, by the lens or a wrong focal length, fall
bit by bit with each further epoch: a change is believed where it explains far more than one more
change would (optimal segmentation, Bai and Perron 2003).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mocap_calib.adjust.resection import (
    FITS,
    Sightings,
    compare_projections,
    propose_poses,
    refine_poses,
    sightings_of,
)
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import DECISIVE_NATS, VERDICT_LIMITS_DEG, Config, MovedConfig
from mocap_calib.faults.compare import Alternative
from mocap_calib.faults.leave_one_out import Held, leave_out, pose_beside
from mocap_calib.geometry.rotation import angle_between, rig_size
from mocap_calib.recording.corrections import Moved
from mocap_calib.recording.epochs import own_name
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.results import Fault, GroupResult
from mocap_calib.rig import MEDIAN_DISTANCE, Observed, per_frame_labels
from mocap_calib.rig.triangulate import choose_frames, place_bodies
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class Epochs:
    """Poses that a camera had one after the other.

    bounds: `[epoch + 1]` index of the first detection of each, and how many there are.
    poses: `[epoch, 3, 4]` cam_from_world. tolerance: focal lengths, of an error.
    """

    bounds: Ints
    poses: Floats
    tolerance: float

    def moves(self, size: float) -> list[tuple[float, float]]:
        """Return by how many degrees and how many sizes (of a rig) the camera moves each time."""
        centres = -np.einsum("pji,pj->pi", self.poses[..., :3], self.poses[..., 3])
        angles = angle_between(self.poses[:-1, :, :3], self.poses[1:, :, :3])
        shifts = np.linalg.norm(np.diff(centres, axis=0), axis=1) / size
        return list(zip(np.rad2deg(angles).tolist(), shifts.tolist(), strict=True))

    def costs(self, seen: Sightings) -> Floats:
        """Return the cost `[detection]` of each detection under the pose of its epoch."""
        cost = compare_projections(self.poses, seen, self.tolerance).cost
        epoch = np.repeat(np.arange(len(self.poses)), np.diff(self.bounds))
        return cost[epoch, np.arange(len(epoch))]


def find_moved_cameras(
    observed: Observed, group: GroupResult, held: list[Held], config: Config
) -> list[Alternative]:
    """Return alternatives, of one camera each: a fault for each time that it was moved.

    held: the views of the group.
    """
    observed = observed.select(np.array([*map(observed.recording.names.index, group.rig.names)]))
    found = [_find_changes(observed, group, view, config) for view in _screen(held, config)]
    return [each for each in found if each is not None]


def _screen(held: list[Held], config: Config) -> list[int]:
    """Return the views whose errors change at some moment, the most suspicious first."""

    def evidence(one: Held) -> float:
        """Return that of a change of a view; a bent rig asks for further ones."""
        found = segment(one.pose, one.seen, config.moved, one.noise)
        costs, detections = total_costs(found, one.seen)
        gains = detections * (costs[0] / np.maximum(costs[1:], 1e-12) - 1)
        nats = gains / (2 * np.arange(1, len(costs)))  # of each of so many changes
        return float(nats.max(initial=0.0)) - float(np.log(config.moved.stretches))

    scores = np.array([*map_in_threads(evidence, held)])
    order = np.argsort(-scores, kind="stable")[: config.diagnosis.candidates]
    return [int(view) for view in order if scores[view] > 0]


def _find_changes(
    observed: Observed, group: GroupResult, view: int, config: Config
) -> Alternative | None:
    """Return a fault for each time that a view was moved, None where its rig shows no change.

    By its leave-one-out rig: one that bends moves its points, as a camera that was moved would see
    them.
    """
    others = leave_out(observed, view, config, most_deg=VERDICT_LIMITS_DEG[1])
    if others is None:
        return None
    sample, recording, settings = observed.sample, observed.recording, config.moved
    names, placed = recording.names, others.placed
    members = np.array([names.index(name) for name in others.rig.names])
    frames = choose_frames(sample, settings.detections, config)
    bodies = place_bodies(others.sample, placed, frames, config)
    seen = sightings_of(sample.rays[view][frames], bodies)
    pose = pose_beside(others.rig, group.rig, names[view])
    noise = config.triangulate.least_noise_px / sample.cameras[view].focal
    epochs, nats = find_epochs(pose, seen, settings, noise)

    def look(frames: Ints) -> Sightings:
        """Return what the view saw in some frames (indices), by the bodies that others place."""
        part = recording.select(views=members, frames=frames)
        labels = per_frame_labels(group.matches.select(views=members, frames=frames))
        every = np.arange(len(frames))
        bodies = place_bodies(part, replace(placed, matches=labels), every, config)
        own = take_sample(recording.select(views=[view], frames=frames), slice(None))
        return sightings_of(own.rays[0], bodies)

    moments, faults = observed.sample_frames[frames[seen.frame]], []
    for change, (angle, shift) in enumerate(epochs.moves(rig_size(others.rig))):
        if angle > settings.least_angle_deg or shift > settings.least_shift:
            frame = int(recording.frames[_find_frame(look, moments, epochs, change, settings)])
            says = f"moved at frame {frame}, turned by {angle:.1f} deg"
            evidence: dict[str, float | int | str] = {"frame": frame, "angle_deg": angle}
            evidence |= {"centre_shift": shift * rig_size(group.rig), "nats": nats}
            name = own_name(names[view], names)
            faults.append(Fault(name, "moved", says, evidence, Moved(name, frame)))
    return Alternative(tuple(faults), nats) if faults else None


# --- the epochs of a camera


def find_epochs(
    start: Floats, seen: Sightings, config: MovedConfig, noise: float
) -> tuple[Epochs, float]:
    """Return the epochs of a camera, and the evidence (nats) of their changes.

    There is one epoch, and no evidence, where the evidence of no change is decisive.

    start: the pose `[3, 4]` in the rig. noise: focal lengths, below which no detector is.
    """
    found = segment(start, seen, config, noise)
    found = [_refine(each, seen, config) for each in found]
    changes, evidence = choose_number(*total_costs(found, seen), config)
    return found[changes], evidence


def segment(start: Floats, seen: Sightings, config: MovedConfig, noise: float) -> list[Epochs]:
    """Return the best epochs with 0, 1, 2, ... changes, as stretches of time ask for their poses.

    With none where there are too few detections. Arguments: see `find_epochs`.
    """
    detections = len(seen.frame)
    stretches = min(config.stretches, detections // config.least_detections)
    if stretches < 2:
        return [Epochs(np.array([0, detections]), start[None], noise)]
    bounds = np.linspace(0, detections, stretches + 1).astype(np.int64)
    loose = config.loose * float(np.median(seen.size))
    proposed = propose_poses(start, seen, config)
    best, _ = _cheapest(proposed, seen, config.loose * seen.size, bounds)
    own = np.repeat(np.eye(stretches, dtype=bool), np.diff(bounds), axis=1)
    poses, error = refine_poses(
        proposed[best[np.arange(stretches), np.arange(1, stretches + 1)]],
        seen,
        counted=own,
        tolerances=np.geomspace(loose, loose / 10, config.steps),
    )
    tolerance = config.tolerance_noises * max(error / MEDIAN_DISTANCE, noise)
    poses = np.concatenate([start[None], poses])
    best, cost = _cheapest(poses, seen, tolerance, bounds)
    found = []
    for changes in range(min(config.most_changes + 2, stretches)):
        ends = np.array([*combinations(range(1, stretches), changes)], dtype=np.int64)
        ends = np.pad(ends, ((0, 0), (1, 1)), constant_values=(0, stretches))
        ends = ends[cost[ends[:, :-1], ends[:, 1:]].sum(1).argmin()]
        found.append(Epochs(bounds[ends], poses[best[ends[:-1], ends[1:]]], tolerance))
    return found


def _cheapest(
    poses: Floats, seen: Sightings, tolerance: Floats | float, bounds: Ints
) -> tuple[Ints, Floats]:
    """Return the pose (index) of least cost between two bounds, and the cost.

    Both `[first, last]`. bounds: indices of detections.
    """
    cost = np.nan_to_num(compare_projections(poses, seen, tolerance).cost)
    total = np.pad(cost.cumsum(1), ((0, 0), (1, 0)))[:, bounds]
    between = total[:, None] - total[:, :, None]
    return between.argmin(0), between.min(0)


def _refine(epochs: Epochs, seen: Sightings, config: MovedConfig) -> Epochs:
    """Return the poses of least cost, and the moments between them where it is least."""
    bounds, poses, tolerance = epochs.bounds.copy(), epochs.poses, epochs.tolerance
    every, least = np.arange(len(seen.frame)), bounds[-1] // config.stretches
    for _ in range(2):
        own = (bounds[:-1, None] <= every) & (every < bounds[1:, None])
        widths = np.geomspace(3 * tolerance, tolerance, config.steps)
        poses, _ = refine_poses(poses, seen, counted=own, tolerances=widths)
        cost = np.nan_to_num(compare_projections(poses, seen, tolerance).cost)
        for k in range(1, len(poses)):
            first, last = bounds[k - 1] + least, bounds[k + 1] - least
            total = (cost[k - 1] - cost[k]).cumsum()
            bounds[k] = first + total[first - 1 : last].argmin()
    return Epochs(bounds, poses, tolerance)


def total_costs(found: list[Epochs], seen: Sightings) -> tuple[Floats, int]:
    """Return the cost of each of several numbers of epochs, and of how many detections.

    Detections count that one of them explains: the others are of strangers.
    """
    costs = np.array([epochs.costs(seen) for epochs in found])
    explained = costs[:, (costs < FITS).any(0)]
    return explained.sum(1), explained.shape[1]


def choose_number(costs: Floats, detections: int, config: MovedConfig) -> tuple[int, float]:
    """Return how many changes are accepted, and their evidence (nats).

    A change that lowers the cost of n detections by a share g has n g / 2 nats (a profile
    likelihood), divided by what one more change would seem to have: errors that drift with the
    subject are no independent errors, and they fall bit by bit. Each change pays for the choice of
    its moment among the stretches, each as likely beforehand.

    costs: `[change]` of 0, 1, 2, ... changes, of so many detections.
    """
    gains = np.maximum(costs[:-1] / np.maximum(costs[1:], 1e-12) - 1, 0.0) * detections
    for changes in range(min(len(gains), config.most_changes), 0, -1):
        further = max(1.0, float(gains[changes:].max(initial=0.0)))
        gain = min(float(gains[:changes].min()), float(gains[changes - 1]) / further)
        evidence = gain / 2 - float(np.log(config.stretches))
        if evidence > DECISIVE_NATS:
            return changes, evidence
    return 0, 0.0


# --- the frame


def _find_frame(
    look: Callable[[Ints], Sightings],
    frames: Ints,
    epochs: Epochs,
    change: int,
    config: MovedConfig,
) -> int:
    """Return the index of the first frame after a change that shows the view.

    The frames about it are looked at ever more closely, down to each single one.
    look: at frames of the recording (indices). frames: `[detection]` those of the epochs.
    """
    start, near = int(epochs.bounds[change + 1]), config.least_detections
    first = int(frames[max(0, start - near)])
    last = int(frames[min(len(frames) - 1, start + near)])
    found = int(frames[start])
    pair = epochs.poses[change : change + 2]
    while True:
        tried = evenly_spaced(np.arange(first, last + 1), config.detections)
        seen = look(tried)
        if len(seen.frame) < 2:
            return found
        before, after = last_moments(pair, seen, epochs.tolerance)
        found = int(tried[after])
        margin = (last - first) // len(tried)
        closer = max(first, int(tried[before]) - margin), min(last, found + margin)
        if len(tried) == last - first + 1 or closer == (first, last):
            return found
        first, last = closer


def last_moments(pair: Floats, seen: Sightings, tolerance: float) -> tuple[int, int]:
    """Return the last frame (index) that shows the pose before a change, and the first after it.

    pair: `[2, 3, 4]` the poses before and after.
    """
    cost = np.nan_to_num(compare_projections(pair, seen, tolerance).cost)
    total = np.concatenate([[0.0], (cost[0] - cost[1]).cumsum()])
    moment = int(np.clip(total.argmin(), 1, len(seen.frame) - 1))
    return int(seen.frame[moment - 1]), int(seen.frame[moment])
