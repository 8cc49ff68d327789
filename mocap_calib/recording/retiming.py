"""Put all cameras of a recording on one clock, once it is known how their clocks differ."""

from collections.abc import Mapping

import numpy as np

from mocap_calib.recording.corrections import find_view
from mocap_calib.recording.sampling import usual_step
from mocap_calib.results import NO_FRAME, Clocks
from mocap_calib.types import CameraClock, CameraRig, Ints, Recording


def retime(recording: Recording, clocks: Clocks) -> Recording:
    """Return the recording with the detections of each camera at the frames that it saw them.

    A recording that is in step is returned as it is.
    """
    if not clocks.changed:
        return recording
    return recording.show(clocks.source, clocks.frames)


def clocks_from(recording: Recording, cameras: tuple[CameraClock, ...]) -> Clocks:
    """Return which frames cameras show, given how the clock of each differs.

    The common clock has the frames in which two cameras show something.

    cameras: `[view]`.
    """
    if not any(camera.differs for camera in cameras):
        return Clocks.of_one(recording, cameras)
    frames = _common_frames(recording.frames, cameras)
    source = np.stack([_source_of(camera, frames, recording.frames) for camera in cameras])
    shown = (source >= 0).sum(0) >= 2
    return Clocks(
        frames=frames[shown],
        given=recording.frames,
        source=source[:, shown],
        cameras=cameras,
    )


def own_frames(camera: CameraClock, frames: Ints) -> Ints:
    """Return the numbers `[frame]` that a camera gave to frames `[frame]` of the common clock.

    `NO_FRAME` where it has none: of several frames of the common clock, the nearest shows one of a
    slower camera.
    """
    table = np.array(camera.table or ((0, camera.offset),), dtype=np.int64)
    row = np.searchsorted(table[:, 0], frames, side="right") - 1
    offset = table[np.maximum(row, 0), 1]
    counted = frames - table[0, 0]  # a rate is counted from the first frame of the table
    scaled = np.round(counted * camera.rate).astype(np.int64)
    nearest = np.round(scaled / camera.rate).astype(np.int64) == counted
    return np.where(nearest | (camera.rate >= 1.0), table[0, 0] + scaled + offset, NO_FRAME)


def clocks_of_rates(recording: Recording, rates: Mapping[str, float]) -> Clocks:
    """Return the clocks of cameras that have other frame rates, as somebody said.

    rates: name of a camera -> its frames for one of the common clock. All begin together, at the
        first frame of the recording.

    Raises MismatchError where the recording does not have the camera.
    """
    cameras = [CameraClock(name) for name in recording.names]
    for name, rate in rates.items():
        first = int(recording.frames[0])
        table = ((first, 0),)
        view = find_view(recording, name)
        cameras[view] = CameraClock(recording.names[view], "rate", rate=rate, table=table)
    return clocks_from(recording, tuple(cameras))


def clocks_of_rig(recording: Recording, rig: CameraRig) -> Clocks:
    """Return the clocks of a recording as a rig says them; cameras it does not name are in step.

    rig: of the cameras of the recording.
    """
    said = {clock.camera: clock for clock in rig.clocks}
    cameras = tuple(said.get(name, CameraClock(name, "in step")) for name in recording.names)
    return clocks_from(recording, cameras)


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
    repeated = np.append(False, own[1:] <= latest[:-1])
    place = np.minimum(np.searchsorted(given, own), len(given) - 1)
    return np.where((given[place] == own) & ~repeated, place, -1)
