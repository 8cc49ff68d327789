"""SLEAP's analysis .h5: `tracks` with a node and a frame axis, as MATLAB orders them or as sleap-io's `standard` preset does."""

import io
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import blank, fill_missing_scores, make_view, malformed
from mocap_calib.io.hdf5 import array, damage_refused, keys, names
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_REMEDY = "export the analysis .h5 from SLEAP again"


def sniff(document: Document) -> bool:
    """HDF5 with tracks and names of nodes."""
    return {"tracks", "node_names"} <= keys(document)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """One camera; frames count from 0. Tracks are individuals where they have names. Raises FormatError."""
    source, file = item.origin.source, item.document.hdf5
    with damage_refused(source, "a whole SLEAP analysis .h5", _REMEDY):
        nodes = names(file, "node_names", source)
        who = names(file, "track_names", source) if "track_names" in file else ()
        tracks = array(file, "tracks", source)
        scores = array(file, "point_scores", source) if "point_scores" in file else np.zeros(0)
        order = _axes(
            tracks.shape, scores.shape, len(nodes), len(who), _frames(file, source), source
        )
        positions = tracks.transpose(order).astype(np.float64)
        values = blank(positions.shape[0], positions.shape[1], positions.shape[2], source)
        values[..., :2] = positions
        if scores.size:
            values[..., 2] = _scores(scores, order, positions.shape[:3], source)
    values, remarks = fill_missing_scores(values)
    return (
        make_view(
            item.origin, nodes, range(len(values)), values, tracked=bool(who), remarks=remarks
        ),
    )


def _frames(file: Any, source: str) -> int:
    """How many frames there are by the occupancy; 0 where the file does not say."""
    return (
        max(array(file, "track_occupancy", source).shape, default=0)
        if "track_occupancy" in file
        else 0
    )


def _axes(
    tracks: tuple[int, ...], scores: tuple[int, ...], nodes: int, who: int, frames: int, source: str
) -> tuple[int, int, int, int]:
    """Which axes are frame, track, node and coordinate: the order that fits what is known of the lengths."""
    orders = ((3, 0, 2, 1), (0, 1, 2, 3))  # MATLAB, standard
    fitting = [
        o
        for o in orders
        if len(tracks) == 4
        and tracks[o[2]] == nodes
        and tracks[o[3]] == 2
        and (not who or tracks[o[1]] == who)
    ]
    if len(fitting) > 1 and frames:
        fitting = [order for order in fitting if tracks[order[0]] == frames] or fitting
    if len(fitting) > 1 and scores:  # which have no axis of coordinates
        fitting = [
            order for order in fitting if scores == tuple(np.delete(tracks, order[3]))
        ] or fitting
    if len(fitting) != 1:
        expected = f"`tracks` of shape (tracks, 2, {nodes} nodes, frames)"
        raise malformed(
            source, expected, f"{tracks}, which fits {len(fitting)} orders of axes", _REMEDY
        )
    return fitting[0]


def _scores(scores: Any, order: tuple[int, ...], shape: tuple[int, ...], source: str) -> Floats:
    """`[frame, track, node]` from the tracks' order of axes, without that of coordinates."""
    turned = scores.transpose((2, 0, 1)) if scores.ndim == 3 and order[0] == 3 else scores
    if turned.shape != shape:
        raise malformed(
            source, f"`point_scores` of shape {shape} (frame, track, node)", turned.shape, _REMEDY
        )
    return np.asarray(turned, dtype=np.float64)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """A file per camera, frames from 0 to the last. Raises MismatchError where that would be more than the detections ask for."""
    return {f"{view.camera}.analysis.h5": _content(view) for view in views}


def _content(view: Keypoints2D) -> bytes:
    frames, (_, instances, nodes) = int(view.frames.max(initial=-1)) + 1, view.positions.shape[:3]
    if frames > 10 * len(view.frames) + 1000:
        raise MismatchError(
            f"{view.source}: expected frame numbers near 0, which SLEAP counts from, found {view.frames[0]}-{frames - 1}; choose another format"
        )
    values = np.full((frames, instances, nodes, 3), np.nan)
    values[view.frames] = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
    seen = np.isfinite(values[..., 0])
    values[~seen] = np.nan
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["tracks"] = values[..., :2].transpose(1, 3, 2, 0)
        file["point_scores"] = values[..., 2].transpose(1, 2, 0)
        file["instance_scores"] = np.where(seen.any(-1), 1.0, np.nan).T
        file["tracking_scores"] = np.where(seen.any(-1), 0.0, np.nan).T
        file["track_occupancy"] = seen.any(-1).astype(np.uint8)
        file["node_names"] = np.array([name.encode() for name in view.keypoints])
        file["track_names"] = (
            np.array([f"track_{k}".encode() for k in range(instances)])
            if view.tracked
            else np.zeros(0)
        )
        file["edge_inds"], file["edge_names"] = (
            np.zeros((0, 2), dtype=np.int32),
            np.zeros((0, 2), dtype="S1"),
        )
        file["labels_path"], file["provenance"], file["video_path"], file["video_ind"] = (
            "",
            "{}",
            "",
            0,
        )
    return buffer.getvalue()
