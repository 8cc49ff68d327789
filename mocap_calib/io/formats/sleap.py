"""Read and write SLEAP's analysis .h5: `tracks` with an axis of nodes and one of frames.

Traps: the axes come as MATLAB orders them, or as the user of sleap-io did, which its attribute
`dims` says; without it only the lengths tell; frames count from 0, so that a late start means many
empty frames; tracks without names follow nobody. sleap-io opens several tracks only where each has
a name, so that detections in any order are written under names that say so, and it saves a project
only of a file that names a video.

The analysis .csv has a row per detection, and the header
`track,frame_idx,instance.score,<node>.x,<node>.y,<node>.score,...`. Traps: frames without a
detection are absent; `track` is empty where no one was followed.
"""

import io
import itertools
import json
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.detections import (
    ABSENT_FRAMES,
    GAPS,
    SCORES,
    SIZES,
    blank,
    fill_missing_scores,
    make_view,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats.tables import Points, views_from_points
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.table import read_table
from mocap_calib.types import Floats, Keypoints2D

_REMEDY = "export the analysis .h5 from SLEAP again"
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
    values, remarks = fill_missing_scores(values)
    frames = range(len(values))
    tracked = any(not name.startswith(_UNTRACKED) for name in individuals)
    return (make_view(document.origin, nodes, frames, values, tracked=tracked, remarks=remarks),)


def _values(file: Any, nodes: int, individuals: int, source: str) -> Floats:
    """Return `[frame, track, node, 3]` x, y, score. Raises FormatError."""
    tracks = array(file, "tracks", source)
    scores = array(file, "point_scores", source) if "point_scores" in file else np.zeros(0)
    occupancy = array(file, "track_occupancy", source) if "track_occupancy" in file else np.zeros(0)
    length, shape = max(occupancy.shape, default=0), tracks.shape

    def fits(axes: Axes) -> bool:
        _, track, node, coordinate = (shape[axis] for axis in axes)
        return (node, coordinate) == (nodes, 2) and individuals in (0, track)

    fitting = [axes for axes in _possible_axes(file["tracks"]) if len(shape) == 4 and fits(axes)]
    if len(fitting) > 1:
        fitting = [axes for axes in fitting if shape[axes[0]] == length] or fitting
    without_coordinate = {axes: tuple(np.delete(shape, axes[3])) for axes in fitting}
    if len(fitting) > 1:
        fitting = [axes for axes in fitting if scores.shape == without_coordinate[axes]] or fitting
    if len(fitting) != 1:
        expected = f"`tracks` of shape (tracks, 2, {nodes} nodes, frames)"
        found = f"{shape}, which fits {len(fitting)} orders of axes"
        raise FormatError(source, expected, found, _REMEDY)
    axes = fitting[0]
    positions = tracks.transpose(axes).astype(np.float64)
    frames, instances, keypoints = positions.shape[:3]
    values = blank(frames, instances, keypoints, source)
    values[..., :2] = positions
    if scores.size and scores.shape != without_coordinate[axes]:
        expected = f"`point_scores` of shape {without_coordinate[axes]}"
        raise FormatError(source, expected, scores.shape, _REMEDY)
    if scores.size:
        values[..., 2] = np.expand_dims(scores, axes[3]).transpose(axes)[..., 0]
    return values


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
    values = _values_from_frame_0(view)
    instances = values.shape[1]
    seen = np.isfinite(values[..., 0])
    is_there = seen.any(-1)
    prefix = "track_" if view.tracked else _UNTRACKED
    is_followed = instances > 1 or view.tracked
    track_names = [f"{prefix}{number}" for number in range(instances)] if is_followed else []
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


def _values_from_frame_0(view: Keypoints2D) -> Floats:
    """Return `[frame, instance, keypoint, 3]` x, y, confidence of all frames from 0 to the last.

    NaN = missing. Raises MismatchError.
    """
    frames = int(view.frames.max(initial=-1)) + 1
    if frames > _EMPTY_PER_FRAME * len(view.frames) + _EMPTY_AT_LEAST:
        expected = "frame numbers near 0, which SLEAP counts from"
        found, remedy = f"{view.frames[0]}-{frames - 1}", "choose another format"
        raise MismatchError(view.source, expected, found, remedy)
    values = np.full((frames, *view.confidence.shape[1:], 3), np.nan)
    values[view.frames] = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
    values[~np.isfinite(values[..., 0])] = np.nan
    return values


ANALYSIS = Format(
    kind="keypoints",
    name="sleap",
    title="SLEAP analysis .h5",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".h5",),
    loses=(SIZES, GAPS, SCORES),
)


# --- csv


def sniff_csv(document: Document) -> bool:
    """Return whether the header has track and frame_idx."""
    return {"track", "frame_idx"} <= set(document.header)


def read_csv(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; tracks are individuals where all rows have one. Raises FormatError."""
    header = document.header
    nodes = [name.removesuffix(".x") for name in header if name.endswith(".x")]
    if not nodes or not all(f"{node}.y" in header for node in nodes):
        remedy = "export the analysis .csv from SLEAP again"
        raise document.refuse("columns <node>.x and <node>.y", ",".join(header), remedy)
    columns = [f"{node}.{part}" for node in nodes for part in ("x", "y", "score")]
    table = read_table(document, texts=("track", "frame_idx"), numbers=columns)
    frames, tracks = table.text("frame_idx"), table.text("track")
    tracked = all(tracks)
    if not tracked:  # a row's number among those of its frame
        count = defaultdict[str, Iterator[int]](itertools.count)
        tracks = tuple(str(next(count[frame])) for frame in frames)
    points = Points(
        camera=(document.camera,) * (len(nodes) * len(frames)),
        frame=frames * len(nodes),
        identity=tracks * len(nodes),
        keypoint=[node for node in nodes for _ in frames],
        values=table.numbers.reshape(len(frames), -1, 3).swapaxes(0, 1).reshape(-1, 3),
        lines=table.lines * len(nodes),
    )
    return views_from_points(points, document, tracked=tracked, remarks=(ABSENT_FRAMES,))


TABLE = Format(
    kind="keypoints",
    name="sleap-csv",
    title="SLEAP analysis .csv",
    sniff=sniff_csv,
    read=read_csv,
)
