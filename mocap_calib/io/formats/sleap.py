"""Read and write SLEAP's analysis .h5; read its project files .slp.

The analysis .h5 holds `tracks` with an axis of nodes and one of frames. Traps: the axes come as
MATLAB orders them, or as the user of sleap-io did, which its attribute `dims` says; without it only
the lengths tell; frames count from 0, so that a late start means many empty frames; tracks without
names follow nobody. sleap-io opens several tracks only where each has a name, so that detections in
any order are written under names that say so, and it saves a project only of a file that names a
video.

A project holds tables of frames, instances and points in HDF5, JSON in attributes, one video per
camera; it has been the same from format 1.0 on. It is read with h5py alone, since sleap-io brings
half a gigabyte. Traps: a prediction that a user has corrected lies beside the correction; before
format 1.1 the centre of a pixel was at 0.5; points made by hand have no score; frames without an
instance are absent; a package, which holds the images, has the paths of its videos elsewhere.
"""

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.io.detections import (
    GAPS,
    SCORES,
    SIZES,
    find_camera,
    make_view,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_ANALYSIS_INSTEAD = "export the analysis .h5 from SLEAP"
_REMEDY = f"{_ANALYSIS_INSTEAD} again"
Axes = tuple[int, int, int, int]
# where in `tracks` the axes frame, track, node and coordinate are
_MATLAB: Axes = (3, 0, 2, 1)
_STANDARD: Axes = (0, 1, 2, 3)
_DIMENSIONS = ("frame", "track", "node", "xy")  # as sleap-io calls them
# how many empty frames are written before and between the others
_EMPTY_PER_FRAME = 10
_EMPTY_AT_LEAST = 1000
# names of tracks that follow nobody: what an instance's place in its frame is called
_UNTRACKED = "untracked_"
_USER, _PREDICTED = 0, 1  # types of an instance of a project
_CENTRED_FORMAT = 1.1  # the first in which pixel centres are integers


# --- analysis


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with tracks and names of nodes."""
    return {"tracks", "node_names"} <= keys(document)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; tracks are individuals where they have names. Raises FormatError."""
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole SLEAP analysis .h5", _REMEDY):
        nodes = names(file, "node_names", source)
        individuals = names(file, "track_names", source) if "track_names" in file else ()
        values = _values(file, len(nodes), len(individuals), source)
    tracked = any(not name.startswith(_UNTRACKED) for name in individuals)
    return (make_view(document.origin, nodes, range(len(values)), values, tracked=tracked),)


def _values(file: Any, nodes: int, individuals: int, source: str) -> Floats:
    """Return `[frame, track, node, 3]` x, y, score. Raises FormatError."""
    tracks = array(file, "tracks", source)
    scores = array(file, "point_scores", source) if "point_scores" in file else np.zeros(0)
    shape = tracks.shape

    def fits(axes: Axes) -> bool:
        _, track, node, coordinate = (shape[axis] for axis in axes)
        fits_scores = scores.size == 0 or scores.shape == tuple(np.delete(shape, axes[3]))
        return (node, coordinate) == (nodes, 2) and individuals in (0, track) and fits_scores

    fitting = [axes for axes in _possible_axes(file["tracks"]) if len(shape) == 4 and fits(axes)]
    if len(fitting) != 1:
        expected = f"`tracks` of shape (tracks, 2, {nodes} nodes, frames), and `point_scores`"
        found = f"{shape} and {scores.shape}, which fits {len(fitting)} orders of axes"
        raise FormatError(source, expected, found, _REMEDY)
    axes = fitting[0]
    positions = tracks.transpose(axes).astype(np.float64)
    third = np.full((*positions.shape[:3], 1), np.nan)
    if scores.size:
        third[...] = np.expand_dims(scores, axes[3]).transpose(axes)
    return np.concatenate([positions, third], axis=-1)


def _possible_axes(tracks: Any) -> tuple[Axes, ...]:
    """Return the order of axes that sleap-io says of a dataset, else those of the presets."""
    if "dims" not in tracks.attrs:
        return _MATLAB, _STANDARD
    dims = json.loads(text(tracks.attrs["dims"]))
    frame, track, node, coordinate = (dims.index(name) for name in _DIMENSIONS)
    return ((frame, track, node, coordinate),)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a file per camera, frames from 0 to the last.

    Raises MismatchError where that would be far more frames than the view has.
    """
    return {f"{view.camera}.analysis.h5": _format_analysis(view) for view in views}


def _format_analysis(view: Keypoints2D) -> bytes:
    frames = int(view.frames.max(initial=-1)) + 1
    if frames > _EMPTY_PER_FRAME * len(view.frames) + _EMPTY_AT_LEAST:
        expected = "frame numbers near 0, which SLEAP counts from"
        found, remedy = f"{view.frames[0]}-{frames - 1}", "choose another format"
        raise MismatchError(view.source, expected, found, remedy)
    values = np.full((frames, *view.confidence.shape[1:], 3), np.nan)
    values[view.frames] = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
    values[~np.isfinite(values[..., 0])] = np.nan
    is_there = np.isfinite(values[..., 0]).any(-1)
    instances = values.shape[1]
    prefix = "track_" if view.tracked else _UNTRACKED
    is_followed = instances > 1 or view.tracked
    track_names = [f"{prefix}{number}" for number in range(instances)] if is_followed else []
    import h5py  # noqa: PLC0415 - as in document.py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["tracks"] = values[..., :2].transpose(1, 3, 2, 0)
        file["point_scores"] = values[..., 2].transpose(1, 2, 0)
        file["instance_scores"] = np.where(is_there, 1.0, np.nan).T
        file["tracking_scores"] = np.where(is_there, 0.0, np.nan).T
        file["track_occupancy"] = is_there.astype(np.uint8)
        file["node_names"] = np.array([name.encode() for name in view.keypoints])
        file["track_names"] = np.array(track_names, dtype="S")
        file["edge_inds"] = np.zeros((0, 2), dtype=np.int32)
        file["edge_names"] = np.zeros((0, 2), dtype="S1")
        file["labels_path"] = ""
        file["provenance"] = "{}"
        file["video_path"] = view.camera
        file["video_ind"] = 0
    return buffer.getvalue()


ANALYSIS = Format(
    name="sleap",
    title="SLEAP analysis .h5",
    sniff=sniff,
    read=read,
    passed_over=("instance_scores", "tracking_scores", "track_occupancy", "edge_inds", "video_ind"),
    write=write,
    endings=(".h5",),
    loses=(SIZES, GAPS, SCORES),
)


# --- projects


def sniff_project(document: Document) -> bool:
    """Return whether the file is HDF5 with SLEAP's tables."""
    return {"metadata", "frames", "instances", "points", "pred_points"} <= keys(document)


def read_project(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read a camera per video that has labelled frames.

    It is called by the video's name; by the file's where there is but one video.
    Raises FormatError.
    """
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole SLEAP project", _ANALYSIS_INSTEAD):
        frames, instances = array(file, "frames", source), array(file, "instances", source)
        points = {
            _USER: _points(file, "points", source),
            _PREDICTED: _points(file, "pred_points", source),
        }
        videos = np.unique(frames["video"]).tolist()
        if not videos:
            raise document.refuse("labelled frames", "none", "label or predict first")
        cameras = _cameras(file, videos, document, options.camera_pattern)
        nodes, views = _nodes(file, document), []
        for video in videos:
            of_video = frames[frames["video"] == video]
            found = [_instances_of_frame(frame, instances) for frame in of_video]
            tracked, detections = _detections(found, points, document)
            view = view_of_frames(
                replace(document, camera=cameras[video]),
                options,
                of_video["frame_idx"].astype(np.int64),
                detections,
                names=nodes,
                tracked=tracked,
            )
            views.append(view)
    return tuple(views)


def _nodes(file: Any, document: Document) -> tuple[str, ...]:
    """Return the names of the nodes of the one skeleton, in its order. Raises FormatError."""
    metadata = json.loads(text(file["metadata"].attrs["json"]))
    skeletons = metadata["skeletons"]
    if len(skeletons) != 1:
        raise document.refuse("one skeleton", len(skeletons), _ANALYSIS_INSTEAD)
    graph = skeletons[0].get("nx_graph", skeletons[0])
    return tuple(str(metadata["nodes"][node["id"]]["name"]) for node in graph["nodes"])


def _points(file: Any, name: str, source: str) -> Floats:
    """Return `[point, 3]` x, y, score of a table. Raises FormatError.

    NaN where a point is not visible, and for scores of points made by hand.
    """
    table = array(file, name, source)
    has_scores = "score" in (table.dtype.names or ())
    scores = table["score"] if has_scores else np.full(len(table), np.nan)
    values = np.column_stack([table["x"], table["y"], scores]).astype(np.float64).reshape(-1, 3)
    if float(file["metadata"].attrs.get("format_id", _CENTRED_FORMAT)) < _CENTRED_FORMAT:
        values[:, :2] -= 0.5
    values[~table["visible"].astype(bool), :2] = np.nan
    return values


def _instances_of_frame(frame: Any, instances: Any) -> Any:
    """Return the rows of a frame's instances, without predictions that were corrected by hand.

    A correction has the track of the prediction, or says which instance it was made from: by its
    id, or by its index in the table.
    """
    start, end = int(frame["instance_id_start"]), int(frame["instance_id_end"])
    rows = instances[start:end]
    is_by_hand = rows["instance_type"] == _USER
    tracks, originals = rows["track"][is_by_hand], rows["from_predicted"][is_by_hand]
    is_corrected = (
        np.isin(rows["track"], tracks[tracks >= 0])
        | np.isin(rows["instance_id"], originals)
        | np.isin(np.arange(start, start + len(rows)), originals[originals >= 0])
    )
    return rows[is_by_hand | ~is_corrected]


def _detections(
    instances: list[Any], points: dict[int, Floats], document: Document
) -> tuple[bool, list[list[Any]]]:
    """Return whether individuals are followed, and the detections of each frame.

    instances: rows of each frame. points: type of instance -> `[point, 3]`.

    Raises FormatError.
    """
    tracks = sorted({int(track) for rows in instances for track in rows["track"]})
    tracked = bool(tracks) and tracks[0] >= 0
    detections = []
    for rows in instances:
        found = [
            points[int(row["instance_type"])][int(row["point_id_start"]) : int(row["point_id_end"])]
            for row in rows
        ]
        if tracked:
            found_of = dict(zip(rows["track"].tolist(), found, strict=True))
            if len(found_of) < len(rows):
                expected, remedy = "each track once in a frame", "correct the tracks in SLEAP"
                raise document.refuse(expected, "one twice", remedy)
            found = [found_of.get(track, ()) for track in tracks]
        detections.append(found)
    return tracked, detections


def _cameras(file: Any, videos: list[int], document: Document, pattern: str) -> dict[int, str]:
    """Return video -> camera. Raises FormatError where names do not tell several videos apart."""
    one = {videos[0]: document.camera}
    if len(videos) == 1 and not pattern:
        return one
    entries = [json.loads(text(entry)) for entry in array(file, "videos_json", document.source)]
    paths = {video: _video_path(file, entries[video]) for video in videos}
    cameras = {
        video: find_camera(path, pattern or r"(?P<camera>[^/\\]*)\.[^./\\]*$")
        for video, path in paths.items()
    }
    if len(videos) == 1:
        return one if not cameras[videos[0]] else cameras
    if not any(paths.values()):
        cameras = _cameras_of_session(file, videos, document.source) or cameras
    if "" in cameras.values() or len(set(cameras.values())) < len(paths):
        known = ", ".join(path for path in paths.values() if path)
        remedy = "export an analysis .h5 of each video, which are named as the cameras"
        if known:
            remedy = f"say {argument('camera_regex')}"
        expected = "a camera's name in the path of each video"
        raise document.refuse(expected, known or "none", remedy)
    return cameras


def _video_path(file: Any, video: dict[str, Any]) -> str:
    """Return where a video was; "" where the project does not say it.

    A package has "." for the path, and the path beside the images that it holds.
    """
    backend = video.get("backend", video)
    path = str(backend.get("filename", ""))
    if path != ".":
        return path
    images = str(backend.get("dataset", "")).partition("/")[0]
    video_of_images = file.get(f"{images}/source_video")
    if video_of_images is None or "json" not in video_of_images.attrs:
        return ""
    entry = json.loads(text(video_of_images.attrs["json"]))
    return str(entry.get("backend", entry).get("filename", ""))


def _cameras_of_session(file: Any, videos: list[int], source: str) -> dict[int, str]:
    """Return video -> camera as the one session of the project says it; none without a session."""
    sessions = array(file, "sessions_json", source) if "sessions_json" in file else np.empty(0)
    if len(sessions) != 1:
        return {}
    session = json.loads(text(sessions[0]))
    camera_of = {
        int(video): str(session["calibration"].get(f"cam_{camera}", {}).get("name", ""))
        for camera, video in session["camcorder_to_video_idx_map"].items()
    }
    return {video: camera_of.get(video, "") for video in videos}


PROJECT = Format(
    name="sleap-slp",
    title="SLEAP .slp",
    sniff=sniff_project,
    read=read_project,
)
