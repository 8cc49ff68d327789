"""Read the tables of SLEAP and sleap-io.

A row is a detection (SLEAP's analysis .csv, sleap-io's `instances`), with the columns
`track,frame_idx,instance.score,<node>.x,<node>.y,<node>.score,...`; a point (sleap-io's `points`:
`node,x,y`); or a frame (`frames`: `inst0.track,inst0.<node>.x,...`, or tracks in place of inst0).
Traps: frames without a detection are absent; `track` is empty where no one was followed; a project
of several videos has a column of their paths.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from mocap_calib.errors import argument
from mocap_calib.io.detections import ABSENT_FRAMES, find_camera
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats.tables import views_of_points
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.table import Table, read_table
from mocap_calib.types import Keypoints2D

_REMEDY = "export it from SLEAP again"
_VIDEOS = ("video_path", "video_idx", "video")  # the heading of the column of videos, if any
_STEM = r"(?P<camera>[^/\\]+?)(\.[^./\\]*)?$"  # of a path


def sniff(document: Document) -> bool:
    """Return whether the header has frame_idx, and tracks or nodes."""
    header = document.header
    has_points = not {"track", "node"}.isdisjoint(header) or bool(_prefixes(header))
    return "frame_idx" in header and has_points


def _prefixes(header: Sequence[str]) -> list[str]:
    """Return what stands before the nodes of each instance of a row (`inst0.` of inst0.nose.x)."""
    nodes = [name.split(".") for name in header if name.endswith(".x") and name.count(".") > 1]
    return [f"{instance}." for instance in dict.fromkeys(parts[0] for parts in nodes)]


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read a camera a video; tracks are individuals where all instances have one.

    A row is a point (sleap-io's `points`), an instance, or a frame (`frames`). Raises FormatError.
    """
    header = document.header
    prefixes, parts = [""], ["x", "y", "score"]
    if "node" not in header:
        prefixes = [""] if "track" in header else _prefixes(header)
        start = prefixes[0] if prefixes else ""
        of_first = [name.removeprefix(start) for name in header if name.startswith(start)]
        nodes = [name.removesuffix(".x") for name in of_first if name.endswith(".x")]
        parts = [f"{node}.{part}" for node in nodes for part in parts]
    columns = [prefix + part for prefix in prefixes for part in parts]
    needed = [column for column in columns if not column.endswith("score")] or ["<node>.x"]
    if missing := [column for column in needed if column not in header]:
        raise document.refuse(f"a column {missing[0]}", ",".join(header), _REMEDY)
    track_columns = [f"{prefix}track" for prefix in prefixes]
    texts = ("frame_idx", "node", *_VIDEOS, *track_columns)
    table = read_table(document, texts=texts, numbers=columns)
    points = table.numbers.reshape(len(table.lines), len(prefixes), -1, 3)
    names = [table.text(column, column.rpartition(".")[0]) for column in track_columns]
    tracks = np.array(names, dtype=object).T  # `[row, instance]`
    is_there = (tracks != "") | np.isfinite(points[..., :2]).any((2, 3)) | (len(prefixes) == 1)
    tracked = bool((tracks[is_there] != "").all())
    is_empty = ~is_there.any(1)  # frames without an instance, which have one without points
    is_there[is_empty, 0], tracks[is_empty, 0] = True, tracks[is_there][0] if tracked else ""
    row, instance = (np.repeat(index, points.shape[2]) for index in np.nonzero(is_there))
    frames, cameras = (
        np.array(texts, dtype=object)[row].tolist()
        for texts in (table.text("frame_idx"), _cameras_of_rows(table, document, options))
    )
    keypoints = table.text("node") if "node" in header else nodes * int(is_there.sum())
    identities = tracks[row, instance].tolist()
    if not tracked:  # a point's number among those of its node and frame
        count = defaultdict[tuple[str, ...], Iterator[int]](itertools.count)
        at = zip(cameras, frames, keypoints, strict=True)
        identities = [str(next(count[each])) for each in at]
    return views_of_points(
        document,
        camera=cameras,
        frame=frames,
        identity=identities,
        keypoint=keypoints,
        values=points[is_there].reshape(-1, 3),
        lines=np.array(table.lines)[row].tolist(),
        tracked=tracked,
        remarks=(ABSENT_FRAMES,),
    )


def _cameras_of_rows(table: Table, document: Document, options: ReadOptions) -> list[str]:
    """Return the `[row]` cameras: the videos, or the file's where there is one video.

    Raises FormatError where two videos have one name.
    """
    column = next((name for name in _VIDEOS if name in table.texts), "")
    videos = table.text(column)
    pattern = options.camera_pattern or _STEM
    camera_of = {video: find_camera(video, pattern) for video in dict.fromkeys(videos)}
    if len(camera_of) == 1:
        return [document.camera or camera_of[videos[0]]] * len(videos)
    if "" in camera_of.values() or len(set(camera_of.values())) < len(camera_of):
        remedy = f"change {argument('camera_regex')}"
        expected = f"a camera's name in each {column}"
        raise document.refuse(expected, ", ".join(camera_of), remedy)
    return [camera_of[video] for video in videos]


FORMAT = Format(
    name="sleap-csv",
    title="SLEAP and sleap-io .csv",
    sniff=sniff,
    read=read,
    passed_over=("score", "track_score", "tracking_score", "instance_score"),
)
