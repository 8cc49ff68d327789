"""The table of camera formats: how each is recognised by content, read and written.

Lengths keep the unit that the file states or that the format is defined in; a format without
either leaves it open ("arbitrary") until someone says it.
"""

from collections.abc import Callable, Mapping
from typing import Any

from mocap_calib.io.cameras import (
    cameras_yaml,
    colmap,
    dannce,
    easymocap,
    four_d_association,
    jarvis,
    kalibr,
    multiview_calib,
    nerfstudio,
    opencv,
    openmvg,
    panoptic,
    toml_files,
    voxelpose,
)
from mocap_calib.io.cameras.source import CameraFile, Source
from mocap_calib.io.registry import Format, Written

Provenance = Mapping[str, Any]
CameraFormat = Format[
    Callable[[Source], bool],
    Callable[[Source], CameraFile],
    Callable[..., Written],  # of a rig, provenance and, where the format has `points`, points
]

# in the order in which they are tried: what is particular comes first
CAMERA_FORMATS = (
    CameraFormat(
        kind="cameras",
        name="mocap-calib",
        title="mocap-calib cameras.yaml",
        sniff=cameras_yaml.sniff,
        read=cameras_yaml.parse,
        write=cameras_yaml.write,
        endings=(".yaml", ".yml"),
    ),
    CameraFormat(
        kind="cameras",
        name="caliscope",
        title="caliscope camera_array.toml",
        sniff=toml_files.sniff_caliscope,
        read=toml_files.parse,
        write=toml_files.write_caliscope,
        unit="m",
    ),
    CameraFormat(
        kind="cameras",
        name="freemocap",
        title="FreeMoCap calibration.toml",
        sniff=toml_files.sniff_freemocap,
        read=toml_files.parse,
        write=toml_files.write_freemocap,
        unit="mm",
    ),
    CameraFormat(
        kind="cameras",
        name="pose2sim",
        title="Pose2Sim Calib.toml",
        sniff=toml_files.sniff_pose2sim,
        read=toml_files.parse,
        write=toml_files.write_pose2sim,
        unit="m",
    ),
    CameraFormat(
        kind="cameras",
        name="anipose",
        title="anipose calibration.toml",
        sniff=toml_files.sniff_anipose,
        read=toml_files.parse,
        write=toml_files.write_anipose,
        endings=(".toml",),
    ),
    CameraFormat(
        kind="cameras",
        name="jarvis",
        title="JARVIS YAML",
        sniff=jarvis.sniff,
        read=jarvis.parse,
        write=jarvis.write,
        unit="mm",
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="easymocap",
        title="EasyMocap intri.yml and extri.yml",
        sniff=easymocap.sniff,
        read=easymocap.parse,
        write=easymocap.write,
        unit="m",
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="kalibr",
        title="Kalibr camchain",
        sniff=kalibr.sniff,
        read=kalibr.parse,
        unit="m",
    ),
    CameraFormat(
        kind="cameras",
        name="ros",
        title="ROS camera_info",
        sniff=opencv.sniff_ros,
        read=opencv.parse_ros,
    ),
    CameraFormat(
        kind="cameras",
        name="opencv",
        title="OpenCV YAML",
        sniff=opencv.sniff,
        read=opencv.parse,
        write=opencv.write,
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="colmap-binary",
        title="COLMAP binary model",
        sniff=colmap.sniff_binary,
        read=colmap.parse_binary,
        write=colmap.write_binary,
        folder=True,
        points=True,
    ),
    CameraFormat(
        kind="cameras",
        name="colmap",
        title="COLMAP text model",
        sniff=colmap.sniff_text,
        read=colmap.parse_text,
        write=colmap.write_text,
        folder=True,
        points=True,
    ),
    CameraFormat(
        kind="cameras",
        name="panoptic",
        title="CMU Panoptic JSON",
        sniff=panoptic.sniff,
        read=panoptic.parse,
        write=panoptic.write,
        unit="cm",
    ),
    CameraFormat(
        kind="cameras",
        name="voxelpose",
        title="VoxelPose JSON",
        sniff=voxelpose.sniff,
        read=voxelpose.parse,
        write=voxelpose.write,
        unit="mm",
    ),
    CameraFormat(
        kind="cameras",
        name="4d-association",
        title="4D-Association JSON",
        sniff=four_d_association.sniff,
        read=four_d_association.parse,
        write=four_d_association.write,
        unit="m",
    ),
    CameraFormat(
        kind="cameras",
        name="nerfstudio",
        title="nerfstudio transforms.json",
        sniff=nerfstudio.sniff,
        read=nerfstudio.parse,
        write=nerfstudio.write,
    ),
    CameraFormat(
        kind="cameras",
        name="openmvg",
        title="OpenMVG sfm_data.json",
        sniff=openmvg.sniff,
        read=openmvg.parse,
        write=openmvg.write,
    ),
    CameraFormat(
        kind="cameras",
        name="multiview-calib",
        title="multiview_calib JSON",
        sniff=multiview_calib.sniff,
        read=multiview_calib.parse,
        write=multiview_calib.write,
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="dannce",
        title="Label3D or DANNCE .mat",
        sniff=dannce.sniff,
        read=dannce.parse,
        write=dannce.write,
        unit="mm",
        endings=(".mat",),
    ),
)

# endings of files that may be one of several in a folder, and all that are looked at in a folder
ONE_CAMERA_ENDINGS = (".yml", ".yaml", ".toml", ".json", ".mat")
FOLDER_ENDINGS = (*ONE_CAMERA_ENDINGS, ".txt", ".bin")  # the last two are COLMAP's
