"""What is known of cameras before a rig is built, and work on those of them that it constrains."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mocap_calib.errors import UnderconstrainedCameraError
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.rig.graph import pairs_among
from mocap_calib.types import Floats, Ints, Recording, Sample

T = TypeVar("T")


@dataclass(frozen=True)
class Observed:
    """What is known of some cameras before a rig is built.

    sample_frames: `[frame]` indices into the recording of the frames of the sample.
    lifted: the detections of the sample, lifted. pairs: between these cameras.
    """

    recording: Recording
    sample_frames: Ints
    sample: Sample
    lifted: LiftedPoses
    pairs: tuple[PairwiseCalibration, ...]

    @property
    def rotations(self) -> dict[tuple[int, int], Floats]:
        """(a, b) -> `[3, 3]` b_from_a of each pair."""
        return {(pair.a, pair.b): pair.rotation for pair in self.pairs}

    def select(self, views: Ints) -> "Observed":
        """Return what is known of these views (`[view]` indices) alone."""
        return Observed(
            recording=self.recording.select(views=views),
            sample_frames=self.sample_frames,
            sample=self.sample.select(views=views),
            lifted=self.lifted.select(views),
            pairs=pairs_among(self.pairs, views),
        )

    def without(self, camera: str) -> "Observed":
        """Return what is known of all cameras but this one."""
        names = self.recording.names
        return self.select(np.array([v for v, name in enumerate(names) if name != camera]))


def leave_out_underconstrained(observed: Observed, work: Callable[[Observed], T]) -> T:
    """Return what is found of the cameras of one group that are constrained.

    A camera that sees too little that agrees with others must not cost the others their rig: it
    is left out, and the work on the rest starts again.
    """
    while True:
        try:
            return work(observed)
        except UnderconstrainedCameraError as error:
            if len(observed.recording.cameras) == 2:
                raise
            observed = observed.without(error.camera)
