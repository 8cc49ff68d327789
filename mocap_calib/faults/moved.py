"""Find a camera that was bumped or moved during the recording, and the frames.

A camera that was moved bends the rig of all, so it is judged by bodies that the others place:
first, cheaply, by the rig of all without its rays; then, where its errors change at some moment,
by its leave-one-out rig. Its errors over time tell the rest (`changes`).
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.camera_fit import CameraPoses
from mocap_calib.adjust.resection import Sightings, sightings_of
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.faults.changes import (
    Epochs,
    change_at_a_glance,
    find_epochs,
    last_moments,
)
from mocap_calib.faults.compare import Alternative
from mocap_calib.faults.leave_one_out import OtherCameras, leave_out, pose_beside
from mocap_calib.geometry.rotation import angle_between, rig_size
from mocap_calib.recording.corrections import Moved
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.recording.timeline import own_name
from mocap_calib.results import Fault, GroupResult, Matches
from mocap_calib.rig.observed import Look, Observed, PlacedCameras, choose_frames, place_bodies
from mocap_calib.rig.tracks import per_frame_labels
from mocap_calib.types import CameraRig, Ints, Recording

_GLANCED_DETECTIONS = 120  # of one camera, for a first look
_CANDIDATES = 3  # cameras that are held against their leave-one-out rig
_NEAR_DETECTIONS = 5  # on either side, among which the frame of a change is looked for


@dataclass(frozen=True)
class _Changed:
    """A view with the epochs of its pose.

    view: its index. frames: `[detection]` indices into the recording. others: its leave-one-out
    rig, which has the views `members` (indices). evidence: of its changes, in nats.
    """

    view: int
    epochs: Epochs
    frames: Ints
    others: OtherCameras
    members: Ints
    evidence: float


def find_moved_cameras(observed: Observed, group: GroupResult, config: Config) -> list[Alternative]:
    """Return alternatives, of one camera each: a fault for each time that it was moved.

    Of two cameras neither can be named, as both have the errors.
    """
    if len(group.rig) <= 2:
        return []
    observed, placed = PlacedCameras.of_group(observed, group, config)
    found = []
    for view in _screen(observed, placed, config):
        changed = _find_changes(observed, placed.rig, view, config)
        faults = _describe_changes(observed, group, changed, config) if changed else ()
        if changed and faults:
            found.append(Alternative(faults, changed.evidence))
    return found


def _screen(observed: Observed, placed: PlacedCameras, config: Config) -> list[int]:
    """Return the views whose errors change at some moment, the most suspicious first."""
    look = Look.at(
        observed.sample, placed, choose_frames(observed.sample, _GLANCED_DETECTIONS, config)
    )

    def glance(view: int) -> float:
        """Return how much a view stands out."""
        bodies = look.place(placed, config, without=view)
        rays = observed.sample.rays[view][look.frames]
        seen = sightings_of(rays, bodies, config.moved.least_joints)
        pose = CameraPoses(placed.rig.rotation[[view]], placed.rig.translation[[view]])
        return change_at_a_glance(pose, seen, config.moved)

    scores = np.array(list(map_in_threads(glance, range(len(placed.rig)))))
    order = np.argsort(-scores, kind="stable")[:_CANDIDATES]
    return [int(view) for view in order if scores[view] > 1]


def _find_changes(observed: Observed, rig: CameraRig, view: int, config: Config) -> _Changed | None:
    """Return a view with its epochs by its leave-one-out rig, None where there is only one.

    rig: of all views.
    """
    # a rig that bends moves its points, as a camera that was moved would see them
    others = leave_out(observed, view, config, most_deg=VERDICT_LIMITS_DEG[1])
    if others is None:
        return None
    sample, names = observed.sample, observed.recording.names
    frames = choose_frames(sample, config.moved.detections, config)
    bodies = place_bodies(others.sample, others.placed, frames, config)
    seen = sightings_of(sample.rays[view][frames], bodies, config.moved.least_joints)
    if len(seen.frame) < 2 * config.moved.least_detections:
        return None
    pose = pose_beside(others.rig, rig, names[view])
    epochs, evidence = find_epochs(
        CameraPoses(pose.rotation[None], pose.translation[None]),
        seen,
        config.moved,
        least_noise=config.triangulate.least_noise_px / sample.cameras[view].focal,
    )
    if not evidence:
        return None
    members = np.array([names.index(name) for name in others.rig.names])
    return _Changed(
        view, epochs, observed.sample_frames[frames[seen.frame]], others, members, evidence
    )


# --- the frame, and the fault


def _describe_changes(
    observed: Observed, group: GroupResult, changed: _Changed, config: Config
) -> tuple[Fault, ...]:
    """Return a fault for each change of a view that is large enough to matter."""
    recording, poses = observed.recording, changed.epochs.poses
    name = own_name(recording.names[changed.view], recording.names)
    centres = -np.einsum("pji,pj->pi", poses.rotation, poses.translation)
    angles = np.rad2deg(angle_between(poses.rotation[:-1], poses.rotation[1:])).tolist()
    shifts = np.linalg.norm(np.diff(centres, axis=0), axis=1) / rig_size(changed.others.rig)
    faults = []
    for change, (angle, shift) in enumerate(zip(angles, shifts.tolist(), strict=True)):
        if angle < config.moved.least_angle_deg and shift < config.moved.least_shift:
            continue
        index = _find_frame(recording, group.matches, changed, change, config)
        frame = int(recording.frames[index])
        evidence = {
            "frame": frame,
            "angle_deg": angle,
            "centre_shift": shift * rig_size(group.rig),
            "nats": changed.evidence,
        }
        says = f"moved at frame {frame}, turned by {angle:.1f} deg"
        faults.append(Fault(name, "moved", says, evidence, Moved(name, frame)))
    return tuple(faults)


def _find_frame(
    recording: Recording, matches: Matches, changed: _Changed, change: int, config: Config
) -> int:
    """Return the index of the first frame after a change that shows the view.

    The frames about it are looked at ever more closely, down to each single one.
    matches: labels of the whole recording.
    """
    start = int(changed.epochs.starts[change])
    first = int(changed.frames[max(0, start - _NEAR_DETECTIONS)])
    last = int(changed.frames[min(len(changed.frames) - 1, start + _NEAR_DETECTIONS)])
    found = int(changed.frames[start])
    pair = changed.epochs.poses[change : change + 2]
    while True:
        frames = evenly_spaced(np.arange(first, last + 1), config.moved.detections)
        seen = _sightings_in(recording, matches, changed, frames, config)
        if len(seen.frame) < 2:
            return found
        before, after = last_moments(pair, seen, changed.epochs.tolerance, config.moved)
        found = int(frames[after])
        margin = (last - first) // len(frames)
        closer = max(first, int(frames[before]) - margin), min(last, found + margin)
        if len(frames) == last - first + 1 or closer == (first, last):
            return found
        first, last = closer


def _sightings_in(
    recording: Recording, matches: Matches, changed: _Changed, frames: Ints, config: Config
) -> Sightings:
    """Return what a view saw in some frames (indices), by the bodies that the others place."""
    others, members = changed.others, changed.members
    part = recording.select(views=members, frames=frames)
    labels = per_frame_labels(matches.select(views=members, frames=frames))
    placed = PlacedCameras(others.rig, labels, others.placed.noise)
    bodies = place_bodies(part, placed, np.arange(len(frames)), config)
    own = take_sample(recording.select(views=[changed.view], frames=frames), slice(None))
    return sightings_of(own.rays[0], bodies, config.moved.least_joints)
