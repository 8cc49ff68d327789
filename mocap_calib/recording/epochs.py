"""List the epochs of a recording between two moves of its cameras.

A camera that was moved is two views: `cam2` up to a frame, and `cam2@573` from frame 573 on. Files
list it once, under its own name, with one rig for each epoch of the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.config import EPOCH_MARK
from mocap_calib.types import Camera, CameraRig, Ints, Recording


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
    starts = {view: start_of(view, views) for view in views}
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


def start_of(view: str, views: Sequence[str]) -> int | float:
    """Return the first frame number of a view's epoch, -inf for the first view of a camera."""
    name, start = _split_name(view)
    return -np.inf if start is None or name not in views else start


def _split_name(view: str) -> tuple[str, int | None]:
    """Return the name of the camera of a view, and the first frame of its epoch, if any."""
    name, mark, start = view.rpartition(EPOCH_MARK)
    return (name, int(start)) if mark and start.isascii() and start.isdigit() else (view, None)
