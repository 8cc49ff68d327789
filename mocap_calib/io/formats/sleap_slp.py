"""Read SLEAP's project files .slp: tables in HDF5, JSON in attributes, one video per camera.

The tables hold frames, instances and points, and have been the same from format 1.0 on. They are
read with h5py alone, since sleap-io brings half a gigabyte. Traps: a prediction that a user has
corrected lies beside the correction; before format 1.1 the centre of a pixel was at 0.5; points
made by hand have no score; frames without an instance are absent; a package, which holds the
images, has the paths of its videos elsewhere.
"""

import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_calib.errors import argument
from mocap_calib.io.detections import blank, fill_missing_scores, find_camera, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, damage_refused, keys, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_REMEDY = "export the analysis .h5 from SLEAP"
_USER, _PREDICTED = 0, 1  # types of an instance
_CENTRED_FORMAT = 1.1  # the first in which pixel centres are integers


@dataclass(frozen=True)
class _Tables:
    """The tables of a project.

    nodes: names of the nodes, in the order of the points of an instance.
    frames: `[frame]` structured rows of all videos.
    instances: `[instance]` structured rows.
    points: type of instance -> `[point, 3]` x, y, score, NaN where not visible.
    """

    nodes: tuple[str, ...]
    frames: Any
    instances: Any
    points: dict[int, Floats]


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with SLEAP's tables."""
    return {"metadata", "frames", "instances", "points", "pred_points"} <= keys(document)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read a camera per video that has labelled frames.

    It is called by the video's name; by the file's where there is but one video.
    Raises FormatError.
    """
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole SLEAP project", _REMEDY):
        tables = _Tables(
            nodes=_nodes(file, document),
            frames=array(file, "frames", source),
            instances=array(file, "instances", source),
            points={
                _USER: _points(file, "points", source),
                _PREDICTED: _points(file, "pred_points", source),
            },
        )
        videos = np.unique(tables.frames["video"]).tolist()
        if not videos:
            raise document.refuse("labelled frames", "none", "label or predict first")
        cameras = _cameras(file, videos, document, options.camera_pattern)
        return tuple(_view(tables, *each, document) for each in cameras.items())


def _nodes(file: Any, document: Document) -> tuple[str, ...]:
    """Return the names of the nodes of the one skeleton, in its order. Raises FormatError."""
    try:
        metadata = json.loads(text(file["metadata"].attrs["json"]))
    except RecursionError:
        found = "JSON nested too deeply"
        raise document.refuse("a skeleton as SLEAP writes it", found, _REMEDY) from None
    skeletons = metadata["skeletons"]
    if len(skeletons) != 1:
        raise document.refuse("one skeleton", len(skeletons), _REMEDY)
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


# --- cameras


def _cameras(file: Any, videos: list[int], document: Document, pattern: str) -> dict[int, str]:
    """Return video -> camera. Raises FormatError where names do not tell several videos apart."""
    if len(videos) == 1 and not pattern:
        return {videos[0]: document.camera}
    entries = [json.loads(text(entry)) for entry in array(file, "videos_json", document.source)]
    paths = {video: _video_path(file, entries[video]) for video in videos}
    cameras = {
        video: find_camera(path, pattern) if pattern else _stem(path)
        for video, path in paths.items()
    }
    if len(videos) == 1 and not cameras[videos[0]]:
        return {videos[0]: document.camera}
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


def _stem(path: str) -> str:
    return re.split(r"[/\\]", path)[-1].rpartition(".")[0]


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


# --- detections


def _view(tables: _Tables, video: int, camera: str, document: Document) -> Keypoints2D:
    """Return the camera of a video. Raises FormatError."""
    source = document.source
    frames = tables.frames[tables.frames["video"] == video]
    instances = [_instances_of_frame(frame, tables, document) for frame in frames]
    tracks = sorted({int(track) for rows in instances for track in rows["track"]})
    tracked = bool(tracks) and tracks[0] >= 0
    most = len(tracks) if tracked else max(map(len, instances), default=0)
    values = blank(len(frames), most, len(tables.nodes), source)
    for values_of_frame, rows in zip(values, instances, strict=True):
        places = [tracks.index(int(row["track"])) for row in rows] if tracked else range(len(rows))
        if len(set(places)) < len(rows):
            expected, remedy = "each track once in a frame", "correct the tracks in SLEAP"
            raise document.refuse(expected, "one twice", remedy)
        for place, row in zip(places, rows, strict=True):
            points = tables.points[int(row["instance_type"])]
            points_of_row = points[int(row["point_id_start"]) : int(row["point_id_end"])]
            values_of_frame[place] = points_of_row
    values, remarks = fill_missing_scores(values)
    numbers = frames["frame_idx"].astype(np.int64)
    origin = Origin(camera, source)
    return make_view(origin, tables.nodes, numbers, values, tracked=tracked, remarks=remarks)


def _instances_of_frame(frame: Any, tables: _Tables, document: Document) -> Any:
    """Return the rows of a frame's instances, without predictions that were corrected by hand.

    A correction has the track of the prediction, or says which instance it was made from: by its
    id, or by its index in the table. Raises FormatError.
    """
    start, end = int(frame["instance_id_start"]), int(frame["instance_id_end"])
    rows, nodes = tables.instances[start:end], len(tables.nodes)
    if (rows["point_id_end"] - rows["point_id_start"] != nodes).any():
        raise document.refuse(f"{nodes} points in each instance", "another number", _REMEDY)
    is_by_hand = rows["instance_type"] == _USER
    tracks, originals = rows["track"][is_by_hand], rows["from_predicted"][is_by_hand]
    index = np.arange(start, start + len(rows))
    is_corrected = (
        np.isin(rows["track"], tracks[tracks >= 0])
        | np.isin(rows["instance_id"], originals)
        | np.isin(index, originals[originals >= 0])
    )
    return rows[is_by_hand | ~is_corrected]


PROJECT = Format(
    kind="keypoints",
    name="sleap-slp",
    title="SLEAP .slp",
    sniff=sniff,
    read=read,
)
