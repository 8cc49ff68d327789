"""Our own poses3d.h5, which carries all; `io.results.poses_h5` has how its datasets are written.

The names of individuals and the rate (`fps`) may be missing.
"""

import io

import h5py
import numpy as np

from mocap_calib.io.hdf5 import names
from mocap_calib.io.poses.common import (
    PoseFile,
    WrittenPoses,
    attribute,
    is_hdf5_that,
    refuse_damage,
)
from mocap_calib.io.results.poses_h5 import parse_poses_h5, poses_to_h5

_FORMAT = "mocap-calib poses"


def sniff(content: bytes) -> bool:
    """Return whether the attribute `format` says that it is ours."""
    return is_hdf5_that(content, _is_ours)


def _is_ours(file: h5py.File) -> bool:
    return attribute(file.attrs, "format") == _FORMAT


def parse(content: bytes, source: str) -> PoseFile:
    """Read the poses, the names of the individuals, and the rate. Raises FormatError."""
    poses = parse_poses_h5(content, source)
    with refuse_damage(source, _FORMAT), h5py.File(io.BytesIO(content), "r") as file:
        individuals: tuple[str, ...] = ()
        if "individual_names" in file:
            individuals = names(file, "individual_names", source)
        return PoseFile(poses, float(file.attrs.get("fps", np.nan)), individuals)


def write(file: PoseFile, title: str) -> WrittenPoses:
    """Write the file, which carries all; a title becomes its provenance."""
    content = poses_to_h5(
        file.poses,
        {"title": title} if title else {},
        figures={"fps": file.rate},
        individuals=file.individuals,
    )
    return WrittenPoses(content)
