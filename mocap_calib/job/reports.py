"""report.html of a folder of results, made again from its files and the keypoints of the run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.clocks.estimate import clocks_from, retime
from mocap_calib.config import EPOCH_MARK
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import rig_size
from mocap_calib.html_report.source import Reference, ReportSource, Seen
from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.conversion import load_pose_sources
from mocap_calib.io.hashing import hash_file
from mocap_calib.io.results.group import PAGE, REPORT, group_folder, write_run_json
from mocap_calib.io.results.matches_csv import read_matches_csv
from mocap_calib.io.results.run_json import read_run_json
from mocap_calib.job.load import KeypointSource, load_recording
from mocap_calib.job.results import name_results
from mocap_calib.recording.corrections import (
    Flipped,
    Mirrored,
    Moved,
    Sides,
    apply_mends,
)
from mocap_calib.recording.epochs import own_names, views_by_camera
from mocap_calib.report import SCHEMA
from mocap_calib.results import Matches, Mend
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Recording

_REMEDY = "give the folder that `run` wrote"


@dataclass(frozen=True)
class ResultsFolder:
    """A folder of results. run: what its run.json holds. number: of the group, counted from 0."""

    path: Path
    run: Mapping[str, Any]

    @property
    def number(self) -> int:
        """Which group of cameras it is of, counted from 0."""
        cameras = [camera["name"] for camera in self.run["cameras"]]
        listed = [group["cameras"] for group in self.run["groups"]]
        return listed.index(cameras) if cameras in listed else 0

    @property
    def root(self) -> Path:
        """The folder of the run, in which those of further groups lie."""
        return self.path.resolve().parent if self.number else self.path

    @property
    def group_paths(self) -> list[Path]:
        """Folders of all groups of the run."""
        return [self.root / group_folder(number) for number in range(len(self.run["groups"]))]


def open_results(path: Path) -> ResultsFolder:
    """Return the results in a folder. Raises FormatError where it has no run.json of this kind."""
    if not path.is_dir():
        raise FormatError(str(path), "a folder of results", "none", _REMEDY)
    if not (path / REPORT).is_file():
        raise FormatError(str(path), f"a folder with {REPORT} in it", "none", _REMEDY)
    run = read_run_json(path / REPORT, SCHEMA)
    if not (run["cameras"] and run["groups"] and run["epochs"]):
        raise FormatError(str(path / REPORT), "cameras in a group", "none", "run again")
    return ResultsFolder(path, run)


def read_source(
    folder: ResultsFolder,
    keypoints: KeypointSource | None,
    *,
    insist: bool = False,
    reference: Reference | None = None,
) -> ReportSource:
    """Return what the report of a folder of results is made of.

    keypoints: of the run, None where there are none. insist: raise where they cannot be read;
        else the report has no detections, and says why.

    Raises FormatError and MismatchError.
    """
    rig = _read_rig(folder)
    file = load_pose_sources([folder.path / "poses3d.h5"], None, None)
    notes: list[str] = []
    seen = None
    try:
        if keypoints is not None:
            seen = _read_seen(folder, rig, keypoints, file.poses.frames)
            late = [each["name"] for each in folder.run["cameras"] if each["clock"]["used"]]
            if late:
                notes.append(
                    f"detections of {', '.join(late)} are as in the files, a part of a frame late "
                    "or early"
                )
    except (FormatError, MismatchError, OSError) as error:
        if insist:
            raise
        notes.append(f"the keypoints of the run could not be read: {error}")
    return ReportSource(
        title=name_results(folder.root, folder.number),
        run=folder.run,
        rig=rig,
        covariance=_covariance(folder, rig),
        directed=False,
        poses=file.poses,
        edges=tuple(file.edges),
        fps=file.rate,
        seen=seen,
        reference=reference,
        notes=tuple(notes),
    )


def note_page(folder: ResultsFolder) -> None:
    """Put the hash of a page that was made again into run.json, which lists all files."""
    root = folder if folder.number == 0 else open_results(folder.root)
    if "outputs" not in root.run:
        return
    name = (Path(group_folder(folder.number)) / PAGE).as_posix()
    outputs = {**root.run["outputs"], name: hash_file(folder.path / PAGE)}
    write_run_json(root.path, {**root.run, "outputs": outputs})


def _read_rig(folder: ResultsFolder) -> CameraRig:
    """Return the rig with a view for each place of a camera that was moved."""
    epochs = folder.run["epochs"]
    rigs = [read_rig(folder.path / epoch["folder"] / "cameras.yaml") for epoch in epochs]
    posed = {}
    for name in rigs[0].names:
        posed[name] = rigs[0][name]
        for epoch, rig in zip(epochs[1:], rigs[1:], strict=True):
            if name in epoch["moved"]:
                posed[f"{name}{EPOCH_MARK}{epoch['first']}"] = rig[name]
    return replace(
        rigs[0],
        cameras=tuple(
            Camera(label, each.size, each.matrix, each.distortion, each.fisheye)
            for label, each in posed.items()
        ),
        rotation=np.stack([each.rotation for each in posed.values()]),
        translation=np.stack([each.translation for each in posed.values()]),
    )


def _covariance(folder: ResultsFolder, rig: CameraRig) -> Floats:
    """Return the covariance of the centres, alike in all directions: run.json has no more."""
    percent = {each["name"]: each["centre_sigma_percent"] for each in folder.run["cameras"]}
    covariance = np.full((len(rig), 3, 3), np.nan)
    for name, views in views_by_camera(rig.names).items():
        if percent.get(name) is not None:
            covariance[views] = np.eye(3) * (percent[name] / 100 * rig_size(rig)) ** 2 / 3
    return covariance


def _read_seen(
    folder: ResultsFolder, rig: CameraRig, keypoints: KeypointSource, frames: Ints
) -> Seen:
    """Return what the cameras saw in frames `[frame]` (numbers), and identities.

    Raises FormatError and MismatchError.
    """
    cameras = {
        camera.name: camera
        for path in (folder.path, *folder.group_paths)
        if (path / "cameras.yaml").is_file()
        for camera in read_rig(path / "cameras.yaml").cameras
    }
    loaded = load_recording(
        replace(keypoints, mends=(*keypoints.mends, *_mends_of(folder))),
        CameraFile(cameras=tuple(cameras.values()), extrinsics={}),
        only_known_cameras=True,
    ).recording
    clocks = clocks_from(loaded, rig.clocks)
    names = own_names(rig.names)
    recording = retime(loaded, clocks).select(views=names)
    matches = read_matches_csv(folder.path / "matches.csv", recording, clocks)
    recording, matches = _show_frames(recording, matches, frames)
    if list(recording.keypoints) != folder.run["keypoints"]:
        raise MismatchError(
            "keypoints",
            ", ".join(folder.run["keypoints"]),
            ", ".join(recording.keypoints),
            "give the keypoints of this run",
        )
    later = [view.rpartition(EPOCH_MARK) for view in rig.names if view not in names]
    moves = tuple(Moved(name, int(start)) for name, _, start in later)
    split = apply_mends(recording, moves)
    detected = split.detected
    labels = np.full(detected.shape, -1)
    for camera, views in enumerate(views_by_camera(rig.names).values()):
        labels[views] = np.where(detected[views], matches.labels[camera], -1)
    return Seen(replace(split, cameras=rig.cameras), Matches(labels))


def _show_frames(recording: Recording, matches: Matches, frames: Ints) -> tuple[Recording, Matches]:
    """Return a recording and its matches in frames `[frame]` (numbers), where it has them."""
    if np.array_equal(recording.frames, frames):
        return recording, matches
    place = np.searchsorted(recording.frames, frames).clip(max=len(recording.frames) - 1)
    there = recording.frames[place] == frames
    if not there.any():
        raise MismatchError(
            "keypoints", "frames of the results", "none of them", "give the keypoints of this run"
        )
    source = np.tile(np.where(there, place, -1), (len(recording.cameras), 1))
    labels = np.where(there[:, None], matches.labels[:, place], -1)
    return recording.show(source, frames), Matches(labels)


def _mends_of(folder: ResultsFolder) -> Sequence[Mend]:
    """Return how the run mended detections; intrinsics and places of cameras are in the rig."""
    mends: list[Mend] = []
    for camera in folder.run["cameras"]:
        found = camera["fault_evidence"]
        if found.get("mirrored", {}).get("mended"):
            alone = "--sides" in (found["mirrored"]["option"] or "")
            mends.append(Mirrored(camera["name"], sides=not alone))
        if found.get("flipped", {}).get("mended"):
            mends.append(Flipped(camera["name"]))
        if found.get("sides", {}).get("mended"):
            mends.append(Sides(camera["name"]))
    return mends
