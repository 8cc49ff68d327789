"""Our own poses3d.h5, which carries all; `io.results.poses_h5` has how its datasets are written.

The names of individuals, the rate (`fps`), the edges of the skeleton and the joints may be missing.
"""

import h5py
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.hdf5 import integers, names
from mocap_calib.io.poses.common import (
    PoseFile,
    WrittenPoses,
    attribute,
    is_hdf5_that,
    opened_hdf5,
)
from mocap_calib.io.results.poses_h5 import poses_to_h5, read_poses_h5
from mocap_calib.results import Poses3D
from mocap_calib.types import check_shape

_FORMAT = "mocap-calib poses"


def sniff(document: Document) -> bool:
    """Return whether the attribute `format` says that it is ours."""
    return is_hdf5_that(document, _is_ours)


def _is_ours(file: h5py.File) -> bool:
    return attribute(file.attrs, "format") == _FORMAT


def read(document: Document) -> PoseFile:
    """Read the poses, the names of the individuals, the rate, the edges and the joints.

    Raises FormatError.
    """
    poses = read_poses_h5(document)
    with opened_hdf5(document, _FORMAT) as file:
        individuals: tuple[str, ...] = ()
        if "individual_names" in file:
            individuals = names(file, "individual_names", document.source)
        rate = float(file.attrs.get("fps", np.nan))
        return PoseFile(
            poses,
            rate,
            individuals,
            edges=_read_edges(file, poses, document.source),
            joints=_read_joints(file, poses, document.source),
        )


def _read_edges(file: h5py.File, poses: Poses3D, source: str) -> tuple[tuple[int, int], ...]:
    """Return pairs of keypoints (indices), none where the file has none. Raises FormatError."""
    if "edges" not in file:
        return ()
    edges = integers(file, "edges", source)
    check_shape("edges", edges, None, 2)
    if edges.size and not 0 <= edges.min() <= edges.max() < len(poses.keypoints):
        found = f"{edges.min()} to {edges.max()}"
        expected = f"edges between the {len(poses.keypoints)} keypoints, counted from 0"
        raise FormatError(source, expected, found, "write the file again")
    return tuple((int(a), int(b)) for a, b in edges)


def _read_joints(file: h5py.File, poses: Poses3D, source: str) -> tuple[str, ...]:
    """Return the joint of each keypoint, none where the file has none. Raises FormatError."""
    if "keypoint_joints" not in file:
        return ()
    joints = names(file, "keypoint_joints", source)
    if len(joints) != len(poses.keypoints):
        expected = f"a joint for each of the {len(poses.keypoints)} keypoints"
        raise FormatError(source, expected, f"{len(joints)}", "write the file again")
    return joints


def write(file: PoseFile, title: str) -> WrittenPoses:
    """Write the file, which carries all; a title becomes its provenance."""
    content = poses_to_h5(
        file.poses,
        {"title": title} if title else {},
        edges=file.edges,
        fps=file.rate,
        individuals=file.individuals,
        joints=file.joints,
    )
    return WrittenPoses(content)
