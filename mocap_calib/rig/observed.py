"""What is known of cameras before a rig is built, and the bodies that cameras of a group place."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mocap_calib.config import Config
from mocap_calib.errors import UnderconstrainedCameraError
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import GroupResult, LiftedPoses, Matches, PairwiseCalibration
from mocap_calib.rig.averaging import pairs_among
from mocap_calib.rig.tracks import Tracks, gather_tracks, per_frame_labels, view_noise
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import CameraRig, Floats, Ints, Recording, Sample

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


@dataclass(frozen=True)
class PlacedCameras:
    """Cameras that place bodies.

    rig: of all views of a recording. matches: labels of its frames, frame by frame.
    noise: `[view]` of each, in radians.
    """

    rig: CameraRig
    matches: Matches
    noise: Floats

    @classmethod
    def of(
        cls, recording: Recording, rig: CameraRig, matches: Matches, config: Config
    ) -> "PlacedCameras":
        """Return cameras whose noise is measured on the matches."""
        matches = per_frame_labels(matches)
        return cls(rig, matches, view_noise(recording, rig, matches, config.triangulate))

    @classmethod
    def of_group(
        cls, observed: Observed, group: GroupResult, config: Config
    ) -> tuple[Observed, "PlacedCameras"]:
        """Return what was known of the cameras of a group alone, and these cameras.

        observed: of all cameras.
        """
        names = observed.recording.names
        own = observed.select(np.array([names.index(name) for name in group.rig.names]))
        instances = own.sample.positions.shape[2]
        matches = group.matches.select(frames=own.sample_frames, instances=instances)
        return own, cls.of(own.sample, group.rig, matches, config)


def choose_frames(sample: Sample, wanted: int, config: Config) -> Ints:
    """Return evenly spread frames (indices into the sample) with so many detections a view, about.

    So many of all views together as eight views have: large rigs say the same many times.
    """
    detections = sample.detected.sum(2)  # [view, frame]
    usual = max(1.0, float(detections.mean()))
    views = max(1.0, len(detections) / 8)
    count = max(2 * config.moved.stretches, round(wanted / usual / views))
    return evenly_spaced(np.arange(len(sample.frames)), count)


@dataclass(frozen=True)
class Look:
    """What all views saw of the bodies of some frames.

    frames: `[frame]` indices. keypoints: of a body. seen: the detections.
    """

    frames: Ints
    keypoints: int
    seen: Tracks

    @classmethod
    def at(cls, recording: Recording, placed: PlacedCameras, frames: Ints) -> "Look":
        """Return a look at some frames (indices)."""
        seen = gather_tracks(recording, placed.matches, frames)
        return cls(frames, len(recording.keypoints), seen)

    def place(self, placed: PlacedCameras, config: Config, without: int | None = None) -> Floats:
        """Return the bodies `[frame, body, joint, 3]`, NaN = missing.

        without: a view whose rays do not count.
        """
        weight = self.seen.weight.copy()
        if without is not None:
            weight[without] = 0.0
        points, _ = triangulate_rays(
            placed.rig, self.seen.rays, weight=weight, noise=placed.noise, config=config.triangulate
        )
        shape = len(self.frames), placed.matches.individuals, self.keypoints
        return points.T.reshape(*shape, 3)


def place_bodies(
    recording: Recording,
    placed: PlacedCameras,
    frames: Ints,
    config: Config,
    without: int | None = None,
) -> Floats:
    """Return the bodies `[frame, body, joint, 3]` of some frames (indices), NaN = missing.

    without: a view whose rays do not count.
    """
    return Look.at(recording, placed, frames).place(placed, config, without)
