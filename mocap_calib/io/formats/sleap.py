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
    fitting = _fitting_axes(
        tracks.shape,
        _possible_axes(file["tracks"]),
        nodes=nodes,
        individuals=individuals,
        frames=_count_frames(file, source),
        score_shape=scores.shape,
    )
    if len(fitting) != 1:
        raise FormatError(
            source,
            f"`tracks` of shape (tracks, 2, {nodes} nodes, frames)",
            f"{tracks.shape}, which fits {len(fitting)} orders of axes",
            _REMEDY,
        )
    positions = tracks.transpose(fitting[0]).astype(np.float64)
    frames, instances, keypoints = positions.shape[:3]
    values = blank(frames, instances, keypoints, source)
    values[..., :2] = positions
    if scores.size:
        values[..., 2] = _scores(scores, fitting[0], values.shape[:3], source)
    return values


def _count_frames(file: Any, source: str) -> int:
    """Return how many frames there are by the occupancy; 0 where the file does not say."""
    if "track_occupancy" not in file:
        return 0
    return max(array(file, "track_occupancy", source).shape, default=0)


def _possible_axes(tracks: Any) -> tuple[Axes, ...]:
    """Return the order of axes that sleap-io says of a dataset, else those of the presets."""
    if "dims" not in tracks.attrs:
        return _MATLAB, _STANDARD
    dims = json.loads(text(tracks.attrs["dims"]))
    frame, track, node, coordinate = (dims.index(name) for name in _DIMENSIONS)
    return ((frame, track, node, coordinate),)


def _fitting_axes(
    shape: tuple[int, ...],
    possible: tuple[Axes, ...],
    *,
    nodes: int,
    individuals: int,
    frames: int,
    score_shape: tuple[int, ...],
) -> list[Axes]:
    """Return the orders of axes that fit what is known of the lengths.

    shape: of `tracks`. possible: orders to choose from. individuals, frames: 0 where the file does
    not say. The number of frames and the shape of the scores are looked at only where more than one
    order fits.
    """
    fitting = [
        axes for axes in possible if _fits(axes, shape, nodes=nodes, individuals=individuals)
    ]
    if len(fitting) > 1 and frames:
        fitting = [axes for axes in fitting if shape[axes[0]] == frames] or fitting
    if len(fitting) > 1:  # scores have no axis of coordinates
        agreeing = [axes for axes in fitting if score_shape == tuple(np.delete(shape, axes[3]))]
        fitting = agreeing or fitting
    return fitting


def _fits(axes: Axes, shape: tuple[int, ...], *, nodes: int, individuals: int) -> bool:
    """Return whether `tracks` of this shape can have its axes in this order."""
    if len(shape) != 4:
        return False
    _, track, node, coordinate = axes
    if shape[node] != nodes or shape[coordinate] != 2:
        return False
    return not individuals or shape[track] == individuals


def _scores(scores: Any, axes: Axes, shape: tuple[int, ...], source: str) -> Floats:
    """Return the `[frame, track, node]` scores. Raises FormatError.

    axes: of the tracks; those of the scores are in the same order, without the coordinates.
    """
    if scores.ndim == 3:
        scores = scores.transpose([sorted(axes[:3]).index(axis) for axis in axes[:3]])
    if scores.shape != shape:
        raise FormatError(
            source, f"`point_scores` of shape {shape} (frame, track, node)", scores.shape, _REMEDY
        )
    return np.asarray(scores, dtype=np.float64)


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
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["tracks"] = values[..., :2].transpose(1, 3, 2, 0)
        file["point_scores"] = values[..., 2].transpose(1, 2, 0)
        file["instance_scores"] = np.where(is_there, 1.0, np.nan).T
        file["tracking_scores"] = np.where(is_there, 0.0, np.nan).T
        file["track_occupancy"] = is_there.astype(np.uint8)
        file["node_names"] = np.array([name.encode() for name in view.keypoints])
        file["track_names"] = np.array(_track_names(instances, tracked=view.tracked), dtype="S")
        file["edge_inds"] = np.zeros((0, 2), dtype=np.int32)
        file["edge_names"] = np.zeros((0, 2), dtype="S1")
        file["labels_path"] = ""
        file["provenance"] = "{}"
        file["video_path"] = view.camera
        file["video_ind"] = 0
    return buffer.getvalue()


def _track_names(instances: int, *, tracked: bool) -> list[str]:
    """Return the names of the tracks; none for a single instance that nobody follows."""
    if instances == 1 and not tracked:
        return []
    prefix = "track_" if tracked else _UNTRACKED
    return [f"{prefix}{number}" for number in range(instances)]


def _values_from_frame_0(view: Keypoints2D) -> Floats:
    """Return `[frame, instance, keypoint, 3]` x, y, confidence of all frames from 0 to the last.

    NaN = missing. Raises MismatchError.
    """
    frames = int(view.frames.max(initial=-1)) + 1
    if frames > _EMPTY_PER_FRAME * len(view.frames) + _EMPTY_AT_LEAST:
        raise MismatchError(
            view.source,
            "frame numbers near 0, which SLEAP counts from",
            f"{view.frames[0]}-{frames - 1}",
            "choose another format",
        )
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
        camera=(document.camera,) * (len(nodes) * len(table)),
        frame=frames * len(nodes),
        identity=tracks * len(nodes),
        keypoint=[node for node in nodes for _ in frames],
        values=table.numbers.reshape(len(table), -1, 3).swapaxes(0, 1).reshape(-1, 3),
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
