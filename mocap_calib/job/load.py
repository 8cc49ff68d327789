"""From keypoint files and a file of cameras to a recording, and what of them is not used."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.keypoints.filled_table import describe_filled
from mocap_calib.io.keypoints.items import find_superseded_files
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.job.request import KeypointSource
from mocap_calib.job.summary import RecordingSummary, summarise_recording
from mocap_calib.lift.weights import load_vocabulary
from mocap_calib.recording.corrections import apply_mends
from mocap_calib.recording.joints import fit_vocabulary, load_aliases
from mocap_calib.recording.names import views_named
from mocap_calib.recording.synchronise import join_views, recording_of_views
from mocap_calib.recording.views import ASSUMED_NOTE, assume_cameras
from mocap_calib.results import Clocks
from mocap_calib.types import Keypoints2D, Recording, Skeleton


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
    joined = join_views(views, cameras, skeleton, aliases)
    recording = apply_mends(recording_of_views(joined), source.mends)
    summary = summarise_recording(recording, joined, cameras)
    notes = camera_file.notes if camera_file else (ASSUMED_NOTE,)
    summary = replace(
        summary,
        camera_notes=notes,
        unknown_cameras=unknown,
        ignored_files=find_ignored_files(source.paths),
        filled_in=describe_filled(joined.files),
    )
    return LoadedRecording(replace(recording, model=source.model or skeleton.name), summary)


def find_ignored_files(arguments: Sequence[str]) -> tuple[str, ...]:
    """Return the files of the folders that are not read because an .h5 file lies beside them."""
    folders = [path for path in map(Path, arguments) if path.is_dir()]
    return tuple(str(file) for folder in folders for file in find_superseded_files(folder))


def _choose_vocabulary(
    source: KeypointSource, views: Sequence[Keypoints2D]
) -> tuple[Skeleton, dict[str, str]]:
    """Return the joints of the model, and the aliases of its joints. Raises FormatError."""
    if source.model is None:
        names = (name for view in views for name in view.keypoints)
        return fit_vocabulary(names, source.aliases)
    skeleton = load_vocabulary(source.model)
    return skeleton, load_aliases(source.aliases, skeleton) if source.aliases else {}
