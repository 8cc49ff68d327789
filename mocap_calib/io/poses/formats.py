"""The table of formats of 3D poses: how each is recognised by content, read and written."""

from collections.abc import Callable

from mocap_calib.io.poses import (
    anipose_csv,
    bvh,
    c3d_file,
    movement,
    npz,
    nwb,
    poses3d_h5,
    sleap_anipose,
    trc,
)
from mocap_calib.io.poses.common import PoseFile, WrittenPoses, never, refuse_reading
from mocap_calib.io.registry import Format

# read: content and what complaints call it. write: the poses and a title
PoseFormat = Format[
    Callable[[bytes], bool],
    Callable[[bytes, str], PoseFile],
    Callable[[PoseFile, str], WrittenPoses],
]

# in the order in which they are tried
POSE_FORMATS = (
    PoseFormat(
        kind="poses",
        name="poses-h5",
        title="mocap-calib poses3d.h5",
        sniff=poses3d_h5.sniff,
        read=poses3d_h5.parse,
        write=poses3d_h5.write,
        endings=(".h5",),
    ),
    PoseFormat(
        kind="poses",
        name="anipose-csv",
        title="Anipose CSV",
        sniff=anipose_csv.sniff,
        read=anipose_csv.parse,
        write=anipose_csv.write,
        endings=(".csv",),
        single=True,
    ),
    PoseFormat(
        kind="poses",
        name="trc",
        title="OpenSim TRC",
        sniff=trc.sniff,
        read=trc.parse,
        write=trc.write,
        endings=(".trc",),
        single=True,
        timed=True,
        unit="mm",
        up="y",
    ),
    PoseFormat(
        kind="poses",
        name="c3d",
        title="C3D",
        sniff=c3d_file.sniff,
        read=c3d_file.parse,
        write=c3d_file.write,
        endings=(".c3d",),
        timed=True,
        unit="mm",
    ),
    PoseFormat(
        kind="poses",
        name="movement-3d",
        title="movement netCDF",
        sniff=movement.sniff,
        read=movement.parse,
        write=movement.write,
        endings=(".nc",),
    ),
    PoseFormat(
        kind="poses",
        name="sleap-anipose",
        title="SLEAP-anipose points3d.h5",
        sniff=sleap_anipose.sniff,
        read=sleap_anipose.parse,
        write=sleap_anipose.write,
        result="points3d.h5",
    ),
    PoseFormat(
        kind="poses",
        name="nwb-3d",
        title="NWB with ndx-pose",
        sniff=nwb.sniff,
        read=nwb.parse,
        write=nwb.write,
        endings=(".nwb",),
        timed=True,
        packages=("pynwb", "ndx_pose"),
        extra="nwb",
    ),
    PoseFormat(
        kind="poses",
        name="npz",
        title="numpy archive",
        sniff=npz.sniff,
        read=npz.parse,
        write=npz.write,
        endings=(".npz",),
    ),
    PoseFormat(
        kind="poses",
        name="bvh",
        title="BVH of animation programs",
        sniff=never,
        read=refuse_reading,
        write=bvh.write,
        only_written=True,
        endings=(".bvh",),
        single=True,
        timed=True,
        up="y",
    ),
)
