"""Read the keypoint files and the cameras of a recording, and summarise what of them is used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import LEAST_JOINTS
from mocap_calib.faults.hypotheses import describe_corrected
from mocap_calib.io.cameras import CameraFile
from mocap_calib.io.detections import collect_remarks
from mocap_calib.io.filled_table import describe_filled
from mocap_calib.io.keypoints import find_superseded_files, read_keypoints
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.recording.far_points import count_far_points, largest_size
from mocap_calib.recording.image_sizes import join_sized
from mocap_calib.recording.joints import fit_vocabulary, load_aliases
from mocap_calib.recording.names import (
    ASSUMED_NOTE,
    assume_cameras,
    describe_names,
    keypoint_meanings,
    match_cameras,
    unshared_keypoints,
    views_named,
    views_with_detections,
)
from mocap_calib.results import Clocks, Mend
from mocap_calib.types import Keypoints2D, Recording, Skeleton


@dataclass(frozen=True)
class CameraSummary:
    """The keypoints of one camera: where they come from, and how many there are."""

    camera: str
    source: str
    frames: int
    detections: int


@dataclass(frozen=True)
class RecordingSummary:
    """What the files of a recording gave, and what of it is not used.

    cameras: those with keypoints, in the order of the intrinsics.
    without_keypoints: names of cameras that no keypoint file belongs to.
    left_out: names of cameras in which nothing was detected.
    lone_detections: number of detections in frames that no second camera has.
    frames: number of frames of the recording.
    keypoints: names of its joints. unknown: those that the model does not know.
    single_camera_joints: name of joint -> the one camera that names it; not used.
    skeleton: name of the skeleton of the model.
    camera_notes: what the file of the cameras lacks, a line each.
    ignored_files: keypoint files beside which another file of the same name was read.
    filled_in: a line for each camera with keypoints that were completed, not measured.
    unknown_cameras: names of keypoint files that no camera of the rig belongs to.
    corrected: a line for each camera whose intrinsics are for images of another size.
    naming: a line that says that cameras were found in longer names, "" where they were not.
    far_points: camera -> number of its points that lie far outside of its images, and are missing.
    remarks: of the readers of keypoints, a line each.
    """

    cameras: tuple[CameraSummary, ...]
    without_keypoints: tuple[str, ...]
    left_out: tuple[str, ...]
    lone_detections: int
    frames: int
    keypoints: tuple[str, ...]
    unknown: tuple[str, ...]
    single_camera_joints: Mapping[str, str]
    skeleton: str
    camera_notes: tuple[str, ...]
    ignored_files: tuple[str, ...]
    filled_in: tuple[str, ...]
    unknown_cameras: tuple[str, ...]
    corrected: tuple[str, ...]
    naming: str
    far_points: Mapping[str, int]
    remarks: tuple[str, ...]

    @property
    def known(self) -> int:
        """Number of joints of the recording that the model knows."""
        return len(self.keypoints) - len(self.unknown)

    @property
    def too_few_known_joints(self) -> bool:
        """Whether the model knows too few joints to help."""
        return self.known < LEAST_JOINTS


def _count_detections(view: Keypoints2D) -> int:
    """Return the number of instances, in all frames, that have any keypoint."""
    blocks = mapped.frame_slices(len(view.frames))
    return sum(int(np.isfinite(view.positions[block, ..., 0]).any(-1).sum()) for block in blocks)


def _count_lone_detections(views: Sequence[Keypoints2D], recording: Recording) -> int:
    """Return how many detections are in frames that no second camera has."""
    count = 0
    for view in views:
        lone = view.positions[~np.isin(view.frames, recording.frames), ..., 0]
        count += int(np.isfinite(lone).any(-1).sum())
    return count


@dataclass(frozen=True)
class KeypointSource:
    """Which keypoints are read, and how.

    paths: files, folders and name=path pairs, as `read_keypoints` takes them.
    format: name of their format; None: their content shows it.
    options: what the files do not say themselves.
    aliases: a YAML file with other names of joints, see `load_aliases`.
    model: name of a shipped model, a weights file, or "none" for geometry alone; None: the
        shipped model that knows most of the joints.
    mends: what is known to be wrong with the files, put right in this order.
    """

    paths: tuple[str, ...]
    format: str | None = None
    options: ReadOptions = field(default_factory=ReadOptions)
    aliases: Path | None = None
    model: str | None = None
    mends: tuple[Mend, ...] = ()


@dataclass(frozen=True)
class LoadedRecording:
    """A recording, and what a person should know of it.

    clocks: by which it was put on one clock since it was read, None where it was not.
    """

    recording: Recording
    summary: RecordingSummary
    clocks: Clocks | None = None


def load_recording(
    source: KeypointSource, camera_file: CameraFile | None, *, only_known_cameras: bool = False
) -> LoadedRecording:
    """Read keypoints and join them with their cameras.

    camera_file: None where nothing is known of the cameras but the sizes of their images.
    only_known_cameras: leave out keypoints of cameras that the file does not have, as a rig does
        not have those that were left out of it; unless that leaves none.

    Raises FormatError, and MismatchError where keypoints and cameras do not go together.
    """
    options = replace(source.options, single_precision=True)
    views = read_keypoints(source.paths, source.format, options)
    cameras = camera_file.cameras if camera_file else assume_cameras(views)
    known = views_named(views, cameras) if only_known_cameras else ()
    unknown = tuple(view.camera for view in views if known and view not in known)
    views = known or views
    skeleton, aliases = _choose_vocabulary(source, views)
    cropped = source.options.cropped(views)
    recording = join_sized(views, cameras, skeleton, aliases, mends=source.mends, cropped=cropped)
    recording = replace(recording, model=source.model or skeleton.name)
    used = views_with_detections(views)
    named = dict(zip(match_cameras(views, cameras), views, strict=True))
    far = {
        each.name: count_far_points(view, largest_size(view, each))
        for each in cameras
        if (view := named.get(each.name)) is not None
    }
    found = {
        name: CameraSummary(name, view.source, len(view.frames), _count_detections(view))
        for name, view in named.items()
    }
    names = [camera.name for camera in cameras]
    joints = zip(recording.keypoints, recording.vocabulary, strict=True)
    summary = RecordingSummary(
        cameras=tuple(found[name] for name in names if name in found),
        without_keypoints=tuple(name for name in names if name not in found),
        left_out=tuple(name for name in names if name not in recording.names),
        lone_detections=_count_lone_detections(views, recording),
        frames=len(recording.frames),
        keypoints=recording.keypoints,
        unknown=tuple(name for name, joint in joints if joint < 0),
        single_camera_joints=unshared_keypoints(used, keypoint_meanings(used, skeleton, aliases)),
        skeleton=skeleton.name,
        camera_notes=camera_file.notes if camera_file else (ASSUMED_NOTE,),
        ignored_files=find_ignored_files(source.paths),
        filled_in=describe_filled(views),
        unknown_cameras=unknown,
        corrected=describe_corrected(recording),
        naming=describe_names(views, match_cameras(views, cameras)),
        far_points={name: points for name, points in far.items() if points},
        remarks=collect_remarks(views),
    )
    return LoadedRecording(recording, summary)


def find_ignored_files(arguments: Sequence[str]) -> tuple[str, ...]:
    """Return the files that are not read because an .h5 file or a filtered one lies beside them."""
    paths = [path for path in map(Path, arguments) if path.exists()]
    return tuple(map(str, find_superseded_files(paths)))


def _choose_vocabulary(
    source: KeypointSource, views: Sequence[Keypoints2D]
) -> tuple[Skeleton, dict[str, str]]:
    """Return the joints of the model, and the aliases of its joints. Raises FormatError."""
    if source.model is None:
        names = (name for view in views for name in view.keypoints)
        return fit_vocabulary(names, source.aliases)
    skeleton = load_vocabulary(source.model)
    return skeleton, load_aliases(source.aliases, skeleton) if source.aliases else {}
