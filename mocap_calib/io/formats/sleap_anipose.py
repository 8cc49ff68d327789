"""SLEAP-anipose's points3d.h5: one dataset `tracks`, (frame, track, node, 3).

* Its own files name no nodes and no tracks, and count frames from 0 without gaps.
* SLEAP's 2D analysis has `tracks` too, (track, 2, node, frame): of three frames it looks like 3D,
  but has `track_occupancy` beside.
* We write names, frame numbers, unit and rate beside the tracks, where its readers do not look.
"""

import io

import h5py
import numpy as np

from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, integers, names_if_there, opened_hdf5, text, write_names
from mocap_calib.io.poses import (
    QUALITY,
    PoseFile,
    bare_poses,
    fill_gaps,
    is_hdf5_that,
    mark_missing,
)
from mocap_calib.io.units import known_unit


def sniff(document: Document) -> bool:
    """Return whether there are tracks of 3D points."""
    return is_hdf5_that(document, _has_tracks)


def _has_tracks(file: h5py.File) -> bool:
    if "tracks" not in file or "track_occupancy" in file:
        return False
    shape = file["tracks"].shape
    return len(shape) == 4 and shape[-1] == 3


def read(document: Document) -> PoseFile:
    """Read the tracks as individuals; nodes without names are numbered. Raises FormatError."""
    source = document.source
    notes: tuple[str, ...] = ()
    with opened_hdf5(document, "points3d.h5 of SLEAP-anipose") as file:
        positions = mark_missing(array(file, "tracks", source).astype(np.float64))
        count, _, nodes, _ = positions.shape
        frames = integers(file, "frames", source) if "frames" in file else np.arange(count)
        keypoints = names_if_there(file, "node_names", source)
        if not keypoints:
            keypoints = tuple(f"node_{node}" for node in range(nodes))
            unnamed = f"the file does not name its {nodes} nodes"
            notes = (f"{unnamed}: they are called node_0, node_1, ...",)
        unit = known_unit(text(file.attrs.get("unit", "")), source)
        poses = bare_poses(keypoints, frames, positions, unit=unit)
        individuals = names_if_there(file, "track_names", source)
        return PoseFile(poses, float(file.attrs.get("fps", np.nan)), individuals, notes)


def write(file: PoseFile, title: str) -> bytes:
    """Write the tracks without gaps. Raises MismatchError."""
    frames, positions = fill_gaps(file.poses, "sleap-anipose")
    content = io.BytesIO()
    with h5py.File(content, "w") as out:
        tracks = out.create_dataset("tracks", data=positions, track_times=False)
        tracks.attrs["Description"] = "Shape: (n_frames, n_tracks, n_nodes, 3)."
        out.create_dataset("frames", data=frames, track_times=False)
        write_names(out, "node_names", file.poses.keypoints)
        write_names(out, "track_names", file.individuals)
        out.attrs["unit"] = file.poses.unit
        out.attrs["fps"] = file.rate
    return content.getvalue()


POSES = Format(
    name="sleap-anipose",
    title="SLEAP-anipose points3d.h5",
    sniff=sniff,
    read=read,
    write=write,
    result="points3d.h5",
    loses=(*QUALITY,),
)
