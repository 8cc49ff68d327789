"""Put right what is wrong with the files of one camera.

Each mend is a frozen record that turns a recording into another one; all stages then work as ever.
Those of detections are here, those of intrinsics in `mended_intrinsics`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from mocap_calib.config import EPOCH_MARK, SIDE_WORDS
from mocap_calib.errors import MismatchError
from mocap_calib.recording.joints import normalise_name
from mocap_calib.types import (
    Bools,
    Fault,
    FaultWord,
    Ints,
    Mend,
    Recording,
)


def apply_mends(recording: Recording, mends: tuple[Mend, ...]) -> Recording:
    """Return the recording with all mends applied, one after the other.

    Raises MismatchError where a mend is of a camera that the recording does not have, or does not
    know enough of.
    """
    for mend in mends:
        recording = mend.apply(recording)
    return recording


@dataclass(frozen=True)
class Mirrored:
    """The images of a camera are mirrored, left for right.

    sides: the detector took the left limbs for the right ones as well, as it does where it sees
        nothing but the mirrored image.
    """

    camera: str
    sides: bool = True
    word: ClassVar[FaultWord] = "mirrored"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        mirrored = f"--mirrored {self.camera}"
        return mirrored if self.sides else f"{mirrored} --sides {self.camera}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "mirror the video and detect again"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the detections as the camera would have seen them."""
        view = find_view(recording, self.camera)
        camera = recording.cameras[view]
        width = camera.size[0]
        last = width - 1 if width else 2 * camera.matrix[0, 2]
        positions = recording.positions.copy()
        positions[view, ..., 0] = last - positions[view, ..., 0]
        mirrored = replace(recording, positions=positions)
        return Sides(self.camera).apply(mirrored) if self.sides else mirrored


@dataclass(frozen=True)
class Sides:
    """The keypoints of a camera's left and right limbs are exchanged.

    detections: rows (frame number, instance) of the detections in which they are; None: all.
    """

    camera: str
    detections: tuple[tuple[int, int], ...] | None = None
    word: ClassVar[FaultWord] = "sides"

    @property
    def option(self) -> str:
        """How a user states it beforehand; there is no option for single detections."""
        return f"--sides {self.camera}" if self.detections is None else ""

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "exchange left and right in the names of its keypoints"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with left and right of these detections exchanged."""
        view = find_view(recording, self.camera)
        order = exchanged_sides(recording.keypoints)
        chosen = self._chosen(recording)
        positions, confidence = recording.positions.copy(), recording.confidence.copy()
        positions[view][chosen] = positions[view][chosen][:, order]
        confidence[view][chosen] = confidence[view][chosen][:, order]
        return replace(recording, positions=positions, confidence=confidence)

    def _chosen(self, recording: Recording) -> Bools:
        """Return the detections `[frame, instance]` of the view that are exchanged."""
        shape = recording.positions.shape[1:3]
        if self.detections is None:
            return np.ones(shape, dtype=bool)
        chosen = np.zeros(shape, dtype=bool)
        frames, instances = np.array(self.detections, dtype=np.int64).reshape(-1, 2).T
        known = np.isin(frames, recording.frames)
        chosen[np.searchsorted(recording.frames, frames[known]), instances[known]] = True
        return chosen


@dataclass(frozen=True)
class Moved:
    """A camera stands, or looks, elsewhere from a frame (number) on."""

    camera: str
    frame: int
    word: ClassVar[FaultWord] = "moved"

    @property
    def option(self) -> str:
        """How a user states it beforehand."""
        return f"--moved {self.camera}:{self.frame}"

    @property
    def advice(self) -> str:
        """What a user should do about the files."""
        return "use the rig of each part of the recording"

    @property
    def later_name(self) -> str:
        """Name of the camera from the frame on."""
        return f"{self.camera}{EPOCH_MARK}{self.frame}"

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with two cameras: up to the frame, and from it on."""
        view = self._last_before(recording)
        later = np.asarray(recording.frames >= self.frame)
        both = [*range(view + 1), *range(view, len(recording.cameras))]
        cameras = [recording.cameras[each] for each in both]
        cameras[view + 1] = replace(cameras[view + 1], name=self.later_name)
        split = replace(
            recording,
            cameras=tuple(cameras),
            positions=recording.positions[both],
            confidence=recording.confidence[both],
            tracked=recording.tracked[both],
        )
        for part, hidden in ((view, later), (view + 1, ~later)):
            split.positions[part, hidden] = np.nan
            split.confidence[part, hidden] = 0.0
        return split

    def _last_before(self, recording: Recording) -> int:
        """Return the view of the camera before the frame; it may have moved earlier.

        Raises MismatchError where the recording does not have the camera.
        """
        view = find_view(recording, self.camera)
        for name in recording.names[view + 1 :]:
            camera, _, start = name.rpartition(EPOCH_MARK)
            if camera != self.camera or int(start) >= self.frame:
                break
            view += 1
        return view


def describe_faults(faults: Sequence[Fault]) -> dict[str, Any]:
    """Return what is wrong with a camera by word; what it has several times, under `further`."""
    described: dict[str, Any] = {}
    for fault in faults:
        if fault.word in described:
            described[fault.word].setdefault("further", []).append(_describe_fault(fault))
        else:
            described[fault.word] = _describe_fault(fault)
    return described


def _describe_fault(fault: Fault) -> dict[str, Any]:
    """Return what is wrong with a camera, the numbers it rests on, and how it was mended."""
    mend = fault.mend
    return {
        "says": fault.says,
        "mended": mend is not None,
        "advice": mend.advice if mend else None,
        "option": mend.option if mend and mend.option else None,
        **fault.evidence,
    }


def find_view(recording: Recording, camera: str) -> int:
    """Return the index of a camera. Raises MismatchError where the recording does not have it."""
    if camera not in recording.names:
        raise MismatchError(
            f"expected one of the cameras {', '.join(recording.names)}, found {camera}; "
            "name a camera of this recording"
        )
    return recording.names.index(camera)


def exchanged_sides(keypoints: tuple[str, ...]) -> Ints:
    """Return the order `[keypoint]` in which left and right keypoints have changed places.

    By their names: what begins with one side once the name is spelt out, and has a partner.
    """
    index = {normalise_name(name): k for k, name in enumerate(keypoints)}
    order = np.arange(len(keypoints))
    left, right = SIDE_WORDS
    for name, k in index.items():
        partner = index.get(right + name.removeprefix(left)) if name.startswith(left) else None
        if partner is not None:
            order[[k, partner]] = partner, k
    return order
