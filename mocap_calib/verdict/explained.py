"""How much of what was seen a result explains: the yardstick for whether a mend is right."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import REPORT_FRAMES
from mocap_calib.geometry.lens import project_views
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import CalibrationResult, GroupResult, Matches
from mocap_calib.rig.tracks import matched_pixels
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Recording


@dataclass(frozen=True)
class Leftover:
    """What the points of a group leave over of what was seen, in pixels.

    Of an even sample of the frames, so that a long recording need not cost its length in memory.

    pixels, gap: `[view, 2, frame, individual, keypoint]` the detections, and how far from them the
        points are seen, NaN = missing.
    distance: `[view, frame, individual, keypoint]` length of the gap.
    """

    pixels: Floats
    gap: Floats
    distance: Floats

    @classmethod
    def of(cls, group: GroupResult) -> "Leftover":
        """Return that of the matched keypoints and the triangulated points of a group."""
        recording = group.recording
        frames = report_frames(recording)
        return cls.of_points(recording, group.matches, group.rig, group.poses.raw, frames)

    @classmethod
    def of_points(
        cls, recording: Recording, matches: Matches, rig: CameraRig, points: Floats, frames: Ints
    ) -> "Leftover":
        """Return that of points `[frame, individual, keypoint, 3]`, in frames `[frame]` (indices).

        rig: of the cameras of the recording.
        """
        seen, _ = matched_pixels(recording, matches, frames)
        pixels = np.moveaxis(seen, -1, 1)
        bodies = seen.shape[1:4]
        seen_at = project_views(rig, mapped.take(points, frames).reshape(-1, 3).T)
        gap = seen_at.reshape(len(seen), 2, *bodies) - pixels
        return cls(pixels=pixels, gap=gap, distance=np.linalg.norm(gap, axis=1))


def report_frames(recording: Recording) -> Ints:
    """Return the frames (indices) that are looked at: evenly spread, and not too many."""
    return evenly_spaced(np.arange(len(recording.frames)), REPORT_FRAMES)


def focal_lengths(group: GroupResult) -> Floats:
    """Return the focal lengths in pixels, `[view, 1, 1, 1]`."""
    return np.array([camera.focal for camera in group.rig.cameras])[:, None, None, None]


@dataclass(frozen=True)
class Yardstick:
    """Which distance from a point still counts for much.

    angle: in radians. focal: focal lengths by the names of cameras, which make pixels of it; with
        and without a mend of intrinsics the same pixels must count alike.
    """

    angle: float
    focal: Mapping[str, float]

    def width(self, camera: Camera) -> float:
        """Return the distance in pixels for a camera."""
        return self.angle * self.focal.get(camera.name, camera.focal)


def usual_distance(result: CalibrationResult, recording: Recording) -> Yardstick:
    """Return the median distance of keypoints from the points of the largest group.

    recording: of all cameras.
    """
    group = result.groups[0]
    angle = distances_from_points(group) / focal_lengths(group)
    return Yardstick(
        angle=float(np.median(angle[np.isfinite(angle)])),
        focal={camera.name: camera.focal for camera in recording.cameras},
    )


def explained_share(result: CalibrationResult, recording: Recording, yardstick: Yardstick) -> float:
    """Return the share (0..1) of all detected keypoints that the largest group explains.

    A keypoint counts 1 / (1 + (e / width)^2), e being its distance in pixels from the triangulated
    point, and nothing where it was matched with nobody or its camera was left out.

    recording: with all that was detected, in the frames of the groups.
    """
    group = result.groups[0]
    detected = int(recording.select(frames=report_frames(recording)).seen.sum())
    width = np.array([yardstick.width(camera) for camera in group.rig.cameras])
    fit = 1 / (1 + (distances_from_points(group) / width[:, None, None, None]) ** 2)
    return float(np.nansum(fit)) / max(detected, 1)


def distances_from_points(group: GroupResult) -> Floats:
    """Return the distances of matched keypoints from the triangulated points; see `Leftover`."""
    return Leftover.of(group).distance
