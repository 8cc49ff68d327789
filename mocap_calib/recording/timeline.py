"""The time line of a recording: cameras on one clock, and epochs between two moves of a camera.

A camera that was moved is two views: `cam2` up to a frame, and `cam2@573` from frame 573 on. Files
list it once, under its own name, with one rig for each epoch of the recording.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from mocap_calib.config import EPOCH_MARK
from mocap_calib.recording.corrections import find_view
from mocap_calib.recording.sampling import usual_step
from mocap_calib.results import NO_FRAME, Clocks, FaultWord
from mocap_calib.types import Camera, CameraClock, CameraRig, Ints, Recording

# --- clocks


def retime(recording: Recording, clocks: Clocks) -> Recording:
    """Return the recording with the detections of each camera at the frames that it saw them.

    A recording that is in step is returned as it is.
    """
    if not clocks.changed:
        return recording
    return recording.show(clocks.source, clocks.frames)


def clocks_from(recording: Recording, clocks: Iterable[CameraClock]) -> Clocks:
    """Return which frames cameras show, given how the clocks of some of them differ.

    The common clock has the frames in which two cameras show something. Cameras without a clock in
    `clocks` are on it.
    """
    given = {clock.camera: clock for clock in clocks}
    cameras = tuple(given.get(name, CameraClock(name, "in step")) for name in recording.names)
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
    for name in rates:
        find_view(recording, name)
    table = ((int(recording.frames[0]), 0),)
    return clocks_from(
        recording,
        [CameraClock(name, "rate", rate=rate, table=table) for name, rate in rates.items()],
    )


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


@dataclass(frozen=True)
class Retimed:
    """The clock of a camera differs from that of the others."""

    clock: CameraClock

    @property
    def camera(self) -> str:
        """Name of the camera."""
        return self.clock.camera

    @property
    def word(self) -> FaultWord:
        """The fault that it mends."""
        return cast(FaultWord, self.clock.kind)

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the camera on the clock of the others.

        Raises MismatchError where the recording does not have it.
        """
        find_view(recording, self.camera)
        return retime(recording, clocks_from(recording, [self.clock]))


# --- epochs


@dataclass(frozen=True)
class Epoch:
    """A part of a recording in which no camera is moved.

    first, last: frame numbers. views: `[camera]` indices of the views that are valid in it.
    names: of the cameras. moved: names of the cameras that were moved at the first frame.
    """

    first: int
    last: int
    views: Ints
    names: tuple[str, ...]
    moved: tuple[str, ...]


def epoch_folder(number: int) -> str:
    """Return the folder of an epoch, counted from 0, relative to that of its group."""
    return "." if number == 0 else f"epoch_{number + 1}"


def own_name(view: str, views: Sequence[str]) -> str:
    """Return the name of the camera of a view, without the frame of its epoch.

    views: names of all. The camera up to its first move must be among them.
    """
    name, start = _split_name(view)
    return view if start is None or name not in views else name


def own_names(views: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the cameras of views, each once."""
    return tuple(dict.fromkeys(own_name(view, views) for view in views))


def views_by_camera(views: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of the views of each camera, by its name.

    views: names.
    """
    found: dict[str, list[int]] = {name: [] for name in own_names(views)}
    for index, view in enumerate(views):
        found[own_name(view, views)].append(index)
    return found


def list_epochs(views: Sequence[str], frames: Ints) -> tuple[Epoch, ...]:
    """Return the epochs of a recording, one where no camera was moved.

    views: names. frames: `[frame]` numbers, ascending.
    """
    starts = {view: _start_of(view, views) for view in views}
    possible = {start for start in starts.values() if frames[0] < start <= frames[-1]}
    firsts = [int(frames[0]), *sorted(possible)]
    epochs = []
    for number, first in enumerate(firsts):
        last = frames[frames < firsts[number + 1]].max() if first != firsts[-1] else frames[-1]
        holding = {
            own_name(view, views): k
            for k, view in sorted(enumerate(views), key=lambda item: starts[item[1]])
            if starts[view] <= first
        }
        names = sorted(holding, key=lambda name: holding[name])
        index = np.array([holding[name] for name in names], dtype=np.int64)
        moved = tuple(own_name(view, views) for view in views if number and starts[view] == first)
        epochs.append(Epoch(int(first), int(last), index, tuple(names), moved))
    return tuple(epochs)


def describe_epochs(views: Sequence[str], frames: Ints) -> list[dict[str, Any]]:
    """Return the epochs of a recording as `run.json` has them. views, frames: see `list_epochs`."""
    return [
        {
            "folder": epoch_folder(number),
            "first": epoch.first,
            "last": epoch.last,
            "moved": list(epoch.moved),
        }
        for number, epoch in enumerate(list_epochs(views, frames))
    ]


def recording_of_epoch(recording: Recording, epoch: Epoch) -> Recording:
    """Return the recording of an epoch, with the cameras under their own names."""
    if epoch.names == recording.names:
        return recording
    frames = (recording.frames >= epoch.first) & (recording.frames <= epoch.last)
    part = recording.select(views=epoch.views, frames=frames)
    return replace(part, cameras=_name_cameras(part.cameras, epoch))


def rig_of_epoch(rig: CameraRig, epoch: Epoch) -> CameraRig:
    """Return the rig of an epoch, with the cameras under their own names."""
    if epoch.names == rig.names:
        return rig
    part = rig.select(epoch.views)
    own = dict(zip(part.names, epoch.names, strict=True))
    clocks = tuple(replace(clock, camera=own[clock.camera]) for clock in part.clocks)
    return replace(part, cameras=_name_cameras(part.cameras, epoch), clocks=clocks)


def _name_cameras(cameras: tuple[Camera, ...], epoch: Epoch) -> tuple[Camera, ...]:
    """Return the cameras of an epoch under their own names."""
    named = zip(cameras, epoch.names, strict=True)
    return tuple(replace(camera, name=name) for camera, name in named)


def _start_of(view: str, views: Sequence[str]) -> int | float:
    """Return the first frame number of a view's epoch, -inf for the first view of a camera."""
    name, start = _split_name(view)
    return -np.inf if start is None or name not in views else start


def _split_name(view: str) -> tuple[str, int | None]:
    """Return the name of the camera of a view, and the first frame of its epoch, if any."""
    name, mark, start = view.rpartition(EPOCH_MARK)
    return (name, int(start)) if mark and start.isascii() and start.isdigit() else (view, None)
