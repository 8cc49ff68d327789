"""What of the results of a run is drawn on videos, and which of it belongs to a frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.clocks.estimate import own_frames
from mocap_calib.errors import MismatchError
from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.document import as_document
from mocap_calib.io.formats import own_cameras
from mocap_calib.io.formats.own_cameras import SUBFRAME
from mocap_calib.io.pose_files import load_poses
from mocap_calib.io.poses import PoseFile
from mocap_calib.io.results.group import REPORT
from mocap_calib.io.results.matches_csv import parse_matches
from mocap_calib.io.results.run_json import read_run_json
from mocap_calib.recording.sampling import usual_step
from mocap_calib.report import SCHEMA
from mocap_calib.results import NO_FRAME
from mocap_calib.types import CameraClock, CameraRig, Floats, Ints, Keypoints2D

_FILES = ("cameras.yaml", "poses3d.h5", "matches.csv", REPORT)


@dataclass(frozen=True)
class Results:
    """What a folder of results says, as far as it is drawn.

    epochs: first and last frame (numbers of the common clock) of each rig.
    poses: of all frames. individuals: by camera and (frame number of its file, instance).
    late: by camera, the part of a frame by which its images are later than those of the first.
    mirrored: cameras whose images were found to be mirrored, left for right.
    reading: the options with which the run read its keypoints.
    """

    epochs: tuple[tuple[int, int, CameraRig], ...]
    poses: PoseFile
    individuals: Mapping[str, Mapping[tuple[int, int], int]]
    late: Mapping[str, float]
    mirrored: frozenset[str]
    reading: Mapping[str, Any]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return self.epochs[0][2].names


def read_results(folder: Path) -> Results:
    """Read the folder that `run` wrote, or that of a further group in it.

    Raises MismatchError where it is none, and FormatError for bad content.
    """
    for name in _FILES:
        if not (folder / name).is_file():
            raise MismatchError(
                folder, "the results of a run", f"no {name}", "give the folder that `run -o` wrote"
            )
    report = read_run_json(folder / REPORT, SCHEMA)
    faults = {each["name"]: each["fault_evidence"] for each in report["cameras"]}
    offsets = own_cameras.stored_provenance(folder / "cameras.yaml").get(SUBFRAME, {})
    cameras, rows = parse_matches(as_document(folder / "matches.csv"))
    individuals: dict[str, dict[tuple[int, int], int]] = {}
    for camera, (frame, instance, individual) in zip(cameras, rows.tolist(), strict=True):
        individuals.setdefault(camera, {})[frame, instance] = individual
    return Results(
        epochs=tuple(
            (each["first"], each["last"], read_rig(folder / each["folder"] / "cameras.yaml"))
            for each in report["epochs"]
        ),
        poses=load_poses(folder / "poses3d.h5"),
        individuals=individuals,
        late={camera: -offset for camera, offset in offsets.items()},
        mirrored=frozenset(name for name, found in faults.items() if "mirrored" in found),
        reading=report.get("reading", {}),
    )


@dataclass(frozen=True)
class CameraResults:
    """What is drawn on the frames of one camera, whose numbers are those of its own file.

    detections: None where nobody gave them.
    """

    name: str
    results: Results
    detections: Keypoints2D | None

    def own_numbers(self, frames: Sequence[int]) -> Ints:
        """Return the numbers that a camera gave to frames of the common clock, -1 = none."""
        clocks = self.results.epochs[0][2].clocks
        in_step = CameraClock(self.name, "in step")
        clock = next((each for each in clocks if each.camera == self.name), in_step)
        return own_frames(clock, np.asarray(frames, dtype=np.int64))

    def moments(self, numbers: Ints) -> Floats:
        """Return the times `[frame]` on the common clock of a camera's frames, NaN = outside."""
        frames = self.results.poses.poses.frames
        own = self.own_numbers(frames.tolist())
        shown = own != NO_FRAME
        if not shown.any():
            return np.full(len(numbers), np.nan)
        times = np.interp(numbers, own[shown], frames[shown], left=np.nan, right=np.nan)
        return np.asarray(times + self.results.late.get(self.name, 0.0))

    def rig_at(self, moment: float) -> CameraRig:
        """Return the rig of a time; the first one before all, where the time is not known too."""
        epochs = self.results.epochs
        begun = [rig for first, _, rig in epochs if np.isfinite(moment) and first <= moment]
        return begun[-1] if begun else epochs[0][2]

    def bodies_at(self, moment: float) -> Floats:
        """Return the bodies `[individual, keypoint, 3]` at a time, NaN = not there.

        Between two frames that follow each other they are on straight ways.
        """
        poses = self.results.poses.poses
        place = int(np.searchsorted(poses.frames, moment, side="right")) - 1
        if np.isfinite(moment) and place >= 0:
            part = moment - poses.frames[place]
            if part < 1e-6:
                return poses.positions[place]
            step = np.diff(poses.frames[place : place + 2])  # of the last frame none
            if len(step) and step[0] <= usual_step(poses.frames):
                before, after = poses.positions[place : place + 2]
                return np.asarray(before + part / step[0] * (after - before))
        return np.full(poses.positions.shape[1:], np.nan)

    def detected_at(self, number: int) -> tuple[Floats, list[int]]:
        """Return the detections `[instance, keypoint, 2]` in a frame, and who each is."""
        seen = self.detections
        place = -1 if seen is None else int(np.searchsorted(seen.frames, number))
        if seen is None or place == len(seen.frames) or seen.frames[place] != number:
            return np.zeros((0, 0, 2)), []
        who = self.results.individuals.get(self.name, {})
        positions = np.asarray(seen.positions[place], dtype=np.float64)
        return positions, [who.get((number, k), -1) for k in range(len(positions))]
