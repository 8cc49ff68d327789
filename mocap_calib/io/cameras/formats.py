"""The table of camera formats: how each is recognised by content, read and written.

Lengths keep the unit that the file states or that the format is defined in; a format without
either leaves it open ("arbitrary") until someone says it.
"""

from collections.abc import Callable, Mapping
from typing import Any

from mocap_calib.io.cameras import (
    colmap,
    dannce,
    easymocap,
    json_files,
    kalibr,
    nerfstudio,
    openmvg,
    toml_files,
    yaml_files,
)
from mocap_calib.io.cameras.source import CameraFile, Source
from mocap_calib.io.registry import Format, Written
from mocap_calib.types import CameraRig

Provenance = Mapping[str, Any]
CameraFormat = Format[
    Callable[[Source], bool],
    Callable[[Source], CameraFile],
    Callable[[CameraRig, Provenance], Written],
]

# in the order in which they are tried: what is particular comes first
CAMERA_FORMATS = (
    CameraFormat(
        kind="cameras",
        name="mocap-calib",
        title="mocap-calib cameras.yaml",
        sniff=yaml_files.sniff_own,
        read=yaml_files.parse_own,
        write=yaml_files.write_own,
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
        sniff=yaml_files.sniff_jarvis,
        read=yaml_files.parse_jarvis,
        write=yaml_files.write_jarvis,
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
        sniff=yaml_files.sniff_ros,
        read=yaml_files.parse_ros,
    ),
    CameraFormat(
        kind="cameras",
        name="opencv",
        title="OpenCV YAML",
        sniff=yaml_files.sniff_opencv,
        read=yaml_files.parse_opencv,
        write=yaml_files.write_opencv,
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="colmap",
        title="COLMAP text model",
        sniff=colmap.sniff,
        read=colmap.parse,
        write=colmap.write,
        folder=True,
    ),
    CameraFormat(
        kind="cameras",
        name="panoptic",
        title="CMU Panoptic JSON",
        sniff=json_files.sniff_panoptic,
        read=json_files.parse_panoptic,
        write=json_files.write_panoptic,
        unit="cm",
    ),
    CameraFormat(
        kind="cameras",
        name="voxelpose",
        title="VoxelPose JSON",
        sniff=json_files.sniff_voxelpose,
        read=json_files.parse_voxelpose,
        write=json_files.write_voxelpose,
        unit="mm",
    ),
    CameraFormat(
        kind="cameras",
        name="4d-association",
        title="4D-Association JSON",
        sniff=json_files.sniff_4d_association,
        read=json_files.parse_4d_association,
        write=json_files.write_4d_association,
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
        sniff=json_files.sniff_multiview_calib,
        read=json_files.parse_multiview_calib,
        write=json_files.write_multiview_calib,
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
