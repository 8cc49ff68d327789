"""Put all cameras of a recording on one clock, once it is known how their clocks differ."""

from dataclasses import replace

import numpy as np

from mocap_calib.recording.stretches import usual_step
from mocap_calib.types import CameraClock, Clocks, Ints, Recording


def retime(recording: Recording, clocks: Clocks) -> Recording:
    """Return the recording with the detections of each camera at the frames that it saw them.

    A recording that is in step is returned as it is.
    """
    if not clocks.changed:
        return recording
    view = np.arange(len(recording.cameras))[:, None]
    missing = clocks.source < 0
    positions = recording.positions[view, clocks.source]
    confidence = recording.confidence[view, clocks.source]
    positions[missing] = np.nan
    confidence[missing] = 0.0
    return replace(recording, frames=clocks.frames, positions=positions, confidence=confidence)


def clocks_from(recording: Recording, cameras: tuple[CameraClock, ...]) -> Clocks:
    """Return which frames cameras show, given how the clock of each differs.

    The common clock has the frames in which two cameras show something.

    cameras: `[view]`.
    """
    if not any(camera.table or camera.offset for camera in cameras):
        return Clocks.of_one(recording, cameras)
    frames = _common_frames(recording.frames, cameras)
    source = np.stack([_source_of(camera, frames, recording.frames) for camera in cameras])
    shown = (source >= 0).sum(0) >= 2
    return Clocks(
        frames=frames[shown],
        given=recording.frames,
        source=source[:, shown],
        cameras=cameras,
        subframe=np.zeros(len(cameras)),
    )


def own_frames(camera: CameraClock, frames: Ints) -> Ints:
    """Return the numbers `[frame]` that a camera gave to frames `[frame]` of the common clock.

    The largest negative number where it has none.
    """
    none = np.iinfo(np.int64).min
    table = np.array(camera.table or ((0, camera.offset),), dtype=np.int64)
    row = np.searchsorted(table[:, 0], frames, side="right") - 1
    start, offset = table[np.maximum(row, 0)].T
    scaled = (frames - camera_start(camera)) * camera.rate
    own = camera_start(camera) + np.round(scaled).astype(np.int64) + offset
    return np.where(np.isclose(scaled % 1, 0), own, none)


def camera_start(camera: CameraClock) -> int:
    """Return the frame of the common clock from which on a camera's own rate is counted."""
    return camera.table[0][0] if camera.table else 0


def _common_frames(frames: Ints, cameras: tuple[CameraClock, ...]) -> Ints:
    """Return the frame numbers from the first to the last that any camera may show."""
    offsets = [offset for camera in cameras for _, offset in camera.table] or [0]
    offsets += [camera.offset for camera in cameras]
    step = usual_step(frames)
    before = -(-max(*offsets, 0) // step)
    after = -(min(*offsets, 0) // step)
    early = frames[0] - step * np.arange(before, 0, -1)
    late = frames[-1] + step * np.arange(1, after + 1)
    return np.concatenate([early, frames, late])


def _source_of(camera: CameraClock, frames: Ints, given: Ints) -> Ints:
    """Return the indices `[frame]` into the frames that were given, -1 = the camera has none."""
    own = own_frames(camera, frames)
    # no frame is shown twice: where some were lost, the camera shows nothing for as long
    latest = np.maximum.accumulate(own)
    repeated = np.r_[False, own[1:] <= latest[:-1]]
    place = np.minimum(np.searchsorted(given, own), len(given) - 1)
    return np.where((given[place] == own) & ~repeated, place, -1)
