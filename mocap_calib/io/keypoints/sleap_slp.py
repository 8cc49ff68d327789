"""SLEAP's project files .slp: tables of frames, instances and points in HDF5, JSON in attributes; one video per camera.

Read with h5py alone: the tables have been the same from format 1.0 on, and sleap-io brings half a gigabyte.
"""

import json
import re
from typing import Any

import numpy as np

from mocap_calib.io.file import (
    Origin,
    blank,
    fill_missing_scores,
    find_camera,
    make_view,
    malformed,
)
from mocap_calib.io.hdf5 import array, damage_refused, keys, text
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Keypoints2D

_REMEDY = "export the analysis .h5 from SLEAP"
_USER, _PREDICTED = 0, 1


def sniff(document: Document) -> bool:
    """HDF5 with SLEAP's tables."""
    return {"metadata", "frames", "instances", "points", "pred_points"} <= keys(document)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """A camera per video that has labelled frames, called by the video's name; by the file's where there is but one video.

    Frames without an instance are absent. A prediction that a user has corrected does not count. Raises FormatError.
    """
    source, file = item.origin.source, item.document.hdf5
    with damage_refused(source, "a whole SLEAP project", _REMEDY):
        nodes = _nodes(file, source)
        frames, instances = array(file, "frames", source), array(file, "instances", source)
        points = {
            kind: _points(file, name, source)
            for kind, name in ((_USER, "points"), (_PREDICTED, "pred_points"))
        }
        cameras = _cameras(file, np.unique(frames["video"]).tolist(), item, options)
        rows = {
            video: [
                _instances(frame, instances, len(nodes), source)
                for frame in frames[frames["video"] == video]
            ]
            for video in cameras
        }
        return tuple(
            _view(
                Origin(cameras[video], source),
                nodes,
                frames[frames["video"] == video],
                rows[video],
                points,
            )
            for video in cameras
        )


def _nodes(file: Any, source: str) -> tuple[str, ...]:
    """Names of the nodes of the one skeleton, in its order."""
    try:
        metadata = json.loads(text(file["metadata"].attrs["json"]))
        skeletons = metadata["skeletons"]
        if len(skeletons) != 1:
            raise malformed(source, "one skeleton", len(skeletons), _REMEDY)
        graph = skeletons[0].get("nx_graph", skeletons[0])
        return tuple(str(metadata["nodes"][node["id"]]["name"]) for node in graph["nodes"])
    except RecursionError:
        raise malformed(
            source, "a skeleton as SLEAP writes it", "JSON nested too deeply", _REMEDY
        ) from None


def _points(file: Any, name: str, source: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """`[point, 3]` x, y, score, NaN where not visible; hand-made points have no score. Before format 1.1 the centre of a pixel was at 0.5."""
    table = array(file, name, source)
    score = table["score"] if "score" in (table.dtype.names or ()) else np.full(len(table), np.nan)
    values = np.column_stack([table["x"], table["y"], score]).astype(np.float64).reshape(-1, 3)
    values[:, :2] -= 0.5 if float(file["metadata"].attrs.get("format_id", 1.1)) < 1.1 else 0.0
    values[~table["visible"].astype(bool), :2] = np.nan
    return values


def _cameras(file: Any, videos: list[int], item: Item, options: ReadOptions) -> dict[int, str]:
    """Video -> camera."""
    source = item.origin.source
    if not videos:
        raise malformed(source, "labelled frames", "none", "label or predict first")
    if len(videos) == 1 and not options.camera_pattern:
        return {videos[0]: item.camera}
    listed = [json.loads(text(entry)) for entry in array(file, "videos_json", source)]
    paths = {video: _path(file, listed[video]) for video in videos}
    stems = {
        video: re.split(r"[/\\]", path)[-1].rpartition(".")[0] for video, path in paths.items()
    }
    names = {
        video: find_camera(path, options.camera_pattern) if options.camera_pattern else stems[video]
        for video, path in paths.items()
    }
    if len(videos) == 1 and not names[videos[0]]:
        return {videos[0]: item.camera}
    if not any(paths.values()):
        names = _session(file, videos, source) or names
    if len(set(names.values())) < len(videos) or not all(names.values()):
        remedy = (
            "say --camera-regex"
            if any(paths.values())
            else "export an analysis .h5 of each video, which are named as the cameras"
        )
        raise malformed(
            source,
            "a camera's name in the path of each video",
            ", ".join(filter(None, paths.values())) or "none",
            remedy,
        )
    return names


def _session(file: Any, videos: list[int], source: str) -> dict[int, str]:
    """Video -> camera as the one session of the project has them, if it has all."""
    sessions = array(file, "sessions_json", source) if "sessions_json" in file else np.empty(0)
    if len(sessions) != 1:
        return {}
    session = json.loads(text(sessions[0]))
    called = {
        key.removeprefix("cam_"): str(fields.get("name", ""))
        for key, fields in session["calibration"].items()
    }
    names = {
        int(video): called.get(camera, "")
        for camera, video in session["camcorder_to_video_idx_map"].items()
    }
    return {video: names.get(video, "") for video in videos}


def _path(file: Any, video: dict[str, Any]) -> str:
    """Where the video was; a package, which holds the images, says it beside them; nothing where it does not."""
    backend = video.get("backend", video)
    path = str(backend.get("filename", ""))
    if path != ".":
        return path
    kept = file.get(f"{str(backend.get('dataset', '')).partition('/')[0]}/source_video")
    if kept is None or "json" not in kept.attrs:
        return ""
    origin = json.loads(text(kept.attrs["json"]))
    return str(origin.get("backend", origin).get("filename", ""))


def _instances(frame: Any, instances: Any, nodes: int, source: str) -> Any:
    """The rows of a frame's instances, without predictions that were corrected by hand."""
    rows = instances[int(frame["instance_id_start"]) : int(frame["instance_id_end"])]
    if (rows["point_id_end"] - rows["point_id_start"] != nodes).any():
        raise malformed(source, f"{nodes} points in each instance", "another number", _REMEDY)
    by_hand = rows[rows["instance_type"] == _USER]
    mended = np.isin(rows["track"], by_hand["track"][by_hand["track"] >= 0])
    index = np.arange(int(frame["instance_id_start"]), int(frame["instance_id_start"]) + len(rows))
    mended |= np.isin(rows["instance_id"], by_hand["from_predicted"]) | np.isin(
        index, by_hand["from_predicted"][by_hand["from_predicted"] >= 0]
    )
    return rows[(rows["instance_type"] == _USER) | ~mended]


def _view(
    origin: Origin, nodes: tuple[str, ...], frames: Any, rows: list[Any], points: dict[int, Any]
) -> Keypoints2D:
    source = origin.source
    tracks = sorted({int(track) for found in rows for track in found["track"]})
    tracked = bool(tracks) and tracks[0] >= 0
    values = blank(
        len(rows), len(tracks) if tracked else max(map(len, rows), default=0), len(nodes), source
    )
    for target, found in zip(values, rows, strict=True):
        places = (
            [tracks.index(int(row["track"])) for row in found] if tracked else range(len(found))
        )
        if len(set(places)) < len(found):
            raise malformed(
                source, "each track once in a frame", "one twice", "mend the tracks in SLEAP"
            )
        for place, row in zip(places, found, strict=True):
            target[place] = points[int(row["instance_type"])][
                int(row["point_id_start"]) : int(row["point_id_end"])
            ]
    values, remarks = fill_missing_scores(values)
    return make_view(
        origin,
        nodes,
        frames["frame_idx"].astype(np.int64),
        values,
        tracked=tracked,
        remarks=remarks,
    )
