"""Find cameras that were bumped or moved during the recording, and the frames.

A camera that was moved bends the rig of all, so it is judged by bodies that the others place:
first, cheaply, by the rig of all without its rays; then, where it stands out, by the rig that the
others make without it. Its errors over time tell the rest (`changes`).
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.resection import CameraPoses, Sightings, sightings_of
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, MovedConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.faults.changes import (
    Epochs,
    find_epochs,
    last_moments,
    stands_out,
)
from mocap_calib.geometry.alignment import rig_size
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.recording.corrections import Moved
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.recording.timeline import own_name
from mocap_calib.results import Fault, GroupResult, Matches
from mocap_calib.rig.observed import Look, Observed, PlacedCameras, choose_frames, place_bodies
from mocap_calib.rig.tracks import per_frame_labels
from mocap_calib.types import CameraRig, EstimatedCamera, Floats, Ints, Recording, silent


@dataclass(frozen=True)
class _Judged:
    """A view in the rig of the others.

    view: its index. epochs: its poses. frames: `[detection]` indices into the recording.
    others: indices `[view]`, rig: of these, and noise: `[view]` in radians, of these.
    gain: by how much its changes lower its cost. error: RMS error of all views, in radians.
    """

    view: int
    epochs: Epochs
    frames: Ints
    others: Ints
    rig: CameraRig
    noise: Floats
    gain: float
    error: float


def find_moved_cameras(observed: Observed, group: GroupResult, config: Config) -> tuple[Fault, ...]:
    """Return a fault for each time that a camera of a group was moved; of one camera.

    A camera that was moved blurs the places of all. The one is named whose changes explain most,
    and without which the errors of all are smallest; when that is mended, another may be. Of two
    cameras none is named, as both have the errors.
    """
    if len(group.rig) <= 2:
        return ()
    observed, all_views = PlacedCameras.of_group(observed, group, config)
    found = _judge_by_all(observed, all_views, config)
    found.sort(key=lambda judged: -judged.gain)
    again = [
        judged
        for first in found[: config.moved.candidates]
        if (judged := _judge_by_others(observed, all_views, first, config)) is not None
    ]
    if not again:
        return ()
    moved = min(again, key=lambda judged: judged.error / (1 + judged.gain))
    return _describe_changes(observed, group, moved, config)


def _judge_by_all(observed: Observed, placed: PlacedCameras, config: Config) -> list[_Judged]:
    """Return the views that changes explain, by the bodies of the present rig.

    All that stand out at a glance are looked at.
    """

    def look_at(detections: int) -> Look:
        """Return a look at frames with about so many detections a view."""
        frames = choose_frames(observed.sample, detections, config)
        return Look.at(observed.sample, placed, frames)

    def see(view: int, look: Look) -> Sightings:
        """Return what a view saw of the bodies that the others place."""
        bodies = look.place(placed, config, without=view)
        rays = observed.sample.rays[view][look.frames]
        return sightings_of(rays, bodies, config.moved.least_joints)

    def pose_of(view: int) -> CameraPoses:
        """Return where the rig has a view."""
        return CameraPoses(placed.rig.rotation[[view]], placed.rig.translation[[view]])

    def glance_at(view: int) -> bool:
        """Return whether a view stands out."""
        return stands_out(pose_of(view), see(view, glance), config.moved)

    def judge(view: int) -> _Judged | None:
        """Return a view with what explains its changes, None where nothing speaks for any."""
        others = np.delete(np.arange(len(placed.rig)), view)
        return _judge(
            observed,
            view,
            others=(others, placed),
            start=pose_of(view),
            looked_at=(look.frames, see(view, look)),
            config=config,
        )

    glance, views = look_at(config.moved.glanced_detections), range(len(placed.rig))
    suspects = np.flatnonzero(list(map_in_threads(glance_at, views))).tolist()
    if not suspects:
        return []
    look = look_at(config.moved.detections)
    return [judged for judged in map_in_threads(judge, suspects) if judged is not None]


def _judge_by_others(
    observed: Observed, placed: PlacedCameras, first: _Judged, config: Config
) -> _Judged | None:
    """Return a view by the rig of the others, adjusted without it; None where none is moved."""
    part = observed.select(first.others)
    try:
        adjusted = adjust_until_stable(
            part.sample,
            first.rig,
            placed.matches.select(views=first.others),
            config,
            lifted=part.lifted,
            progress=silent,
        )
    except DegenerateError:
        return None
    clean = PlacedCameras.of(part.sample, adjusted.rig, adjusted.matches, config)
    frames = choose_frames(observed.sample, config.moved.detections, config)
    bodies = place_bodies(part.sample, clean, frames, config)
    rays = observed.sample.rays[first.view][frames]
    seen = sightings_of(rays, bodies, config.moved.least_joints)
    if len(seen.frame) < 2 * config.moved.least_detections:
        return None
    return _judge(
        observed,
        first.view,
        others=(first.others, clean),
        start=first.epochs.poses[:1],
        looked_at=(frames, seen),
        config=config,
    )


def _judge(
    observed: Observed,
    view: int,
    *,
    others: tuple[Ints, PlacedCameras],
    start: CameraPoses,
    looked_at: tuple[Ints, Sightings],
    config: Config,
) -> _Judged | None:
    """Return the epochs of a view, None where there is only one.

    others: `[view]` indices of the others, and the cameras that place the bodies.
    looked_at: `[frame]` indices into the sample, and what the view saw there.
    """
    (index, placed), (frames, seen) = others, looked_at
    least = config.triangulate.least_noise_px / observed.sample.cameras[view].focal
    epochs, gain = find_epochs(start, seen, config.moved, least_noise=least)
    own = epochs.tolerance / config.moved.tolerance_noises
    if gain == 0 or own > config.moved.most_noise * float(np.median(seen.angular_size)):
        return None
    whole = len(placed.rig) == len(observed.sample.cameras)
    noise = placed.noise[index] if whole else placed.noise
    return _Judged(
        view=view,
        epochs=epochs,
        frames=observed.sample_frames[frames[seen.frame]],
        others=index,
        rig=placed.rig.select(index) if whole else placed.rig,
        noise=noise,
        gain=gain,
        error=float(np.sqrt(np.mean(np.append(noise, own) ** 2))),
    )


# --- the frame, and what is said of it


def _describe_changes(
    observed: Observed, group: GroupResult, moved: _Judged, config: Config
) -> tuple[Fault, ...]:
    """Return a fault for each change of a view that is large enough to matter."""
    recording, poses = observed.recording, moved.epochs.poses
    name = own_name(recording.names[moved.view], recording.names)
    centres = -np.einsum("pji,pj->pi", poses.rotation, poses.translation)
    angles = np.rad2deg(angle_between(poses.rotation[:-1], poses.rotation[1:])).tolist()
    shifts = np.linalg.norm(np.diff(centres, axis=0), axis=1).tolist()
    least_angle, least_shift = _least_change(group.rig, moved.view, config.moved)
    faults = []
    for change, (angle, shift) in enumerate(zip(angles, shifts, strict=True)):
        if angle < least_angle and shift < least_shift:
            continue
        index = _find_frame(recording, group.matches, moved, change, config)
        frame = int(recording.frames[index])
        evidence = {
            "frame": frame,
            "angle_deg": angle,
            "centre_shift": shift,
            "gain": moved.gain,
        }
        says = f"moved at frame {frame}, turned by {angle:.1f} deg"
        faults.append(Fault(name, "moved", says, evidence, Moved(name, frame)))
    return tuple(faults)


def _least_change(rig: CameraRig, view: int, config: MovedConfig) -> tuple[float, float]:
    """Return the angle in degrees, and the shift, below which a change of a view is none."""
    if isinstance(rig.cameras[view], EstimatedCamera):
        return config.estimated_angle_deg, config.estimated_shift * rig_size(rig)
    return config.least_angle_deg, config.least_shift * rig_size(rig)


def _find_frame(
    recording: Recording, matches: Matches, moved: _Judged, change: int, config: Config
) -> int:
    """Return the index of the first frame after a change that shows the view.

    The frames about it are looked at ever more closely, down to each single one.
    matches: labels of the whole recording.
    """
    start = int(moved.epochs.starts[change])
    near = config.moved.near_detections
    first = int(moved.frames[max(0, start - near)])
    last = int(moved.frames[min(len(moved.frames) - 1, start + near)])
    found = int(moved.frames[start])
    pair = moved.epochs.poses[change : change + 2]
    while True:
        frames = evenly_spaced(np.arange(first, last + 1), config.moved.detections)
        seen = _sightings_in(recording, matches, moved, frames, config)
        if len(seen.frame) < 2:
            return found
        before, after = last_moments(pair, seen, moved.epochs.tolerance, config.moved)
        found = int(frames[after])
        margin = (last - first) // len(frames)
        closer = max(first, int(frames[before]) - margin), min(last, found + margin)
        if len(frames) == last - first + 1 or closer == (first, last):
            return found
        first, last = closer


def _sightings_in(
    recording: Recording, matches: Matches, moved: _Judged, frames: Ints, config: Config
) -> Sightings:
    """Return what a view saw in some frames (indices), by the bodies that the others place."""
    part = recording.select(views=moved.others, frames=frames)
    labels = per_frame_labels(matches.select(views=moved.others, frames=frames))
    placed = PlacedCameras(moved.rig, labels, moved.noise)
    bodies = place_bodies(part, placed, np.arange(len(frames)), config)
    own = take_sample(recording.select(views=[moved.view], frames=frames), slice(None))
    return sightings_of(own.rays[0], bodies, config.moved.least_joints)
