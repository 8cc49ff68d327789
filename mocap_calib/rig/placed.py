"""Bodies that cameras of a group place, by which one camera is judged that may be wrong."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import Config
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import GroupResult, Matches
from mocap_calib.rig.labels import per_frame_labels
from mocap_calib.rig.noise import view_noise
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.tracks import Tracks, gather_tracks
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import CameraRig, Floats, Ints, Recording, Sample


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
    count = max(config.moved.least_frames, round(wanted / usual / views))
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
