"""The camera formats: one table, by which files are recognised, read and written.

A format is recognised by content, never by the name of the file. Lengths keep the unit that the file states or that the
format is defined in; a format without either leaves it open ("arbitrary") until someone says it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import check_alone, folder, write_bytes
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
from mocap_calib.io.cameras.source import CameraFile, Source, Written
from mocap_calib.io.units import unit_factor
from mocap_calib.types import CameraRig

ONE_CAMERA = (
    ".yml",
    ".yaml",
    ".toml",
    ".json",
    ".mat",
)  # of a file that may be one of several in a folder
FOLDER_SUFFIXES = (*ONE_CAMERA, ".txt", ".bin")  # COLMAP's

Write = Callable[[CameraRig, Mapping[str, Any]], Written]


@dataclass(frozen=True)
class CameraFormat:
    """One format.

    unit: what its lengths are in, "" where it leaves that open. write: None where it is only read. folder: it is
    several files, by names of its own. endings: of a file's name, for which it is written without being named.
    """

    name: str
    title: str
    sniff: Callable[[Source], bool]
    parse: Callable[[Source], CameraFile]
    write: Write | None = None
    unit: str = ""
    folder: bool = False
    endings: tuple[str, ...] = ()


# in the order in which they are tried: what is particular comes first
CAMERA_FORMATS = (
    CameraFormat(
        "mocap-calib",
        "mocap-calib cameras.yaml",
        yaml_files.sniff_own,
        yaml_files.parse_own,
        yaml_files.write_own,
        endings=(".yaml", ".yml"),
    ),
    CameraFormat(
        "caliscope",
        "caliscope camera_array.toml",
        toml_files.sniff_caliscope,
        toml_files.parse,
        toml_files.write_caliscope,
        "m",
    ),
    CameraFormat(
        "freemocap",
        "FreeMoCap calibration.toml",
        toml_files.sniff_freemocap,
        toml_files.parse,
        toml_files.write_freemocap,
        "mm",
    ),
    CameraFormat(
        "pose2sim",
        "Pose2Sim Calib.toml",
        toml_files.sniff_pose2sim,
        toml_files.parse,
        toml_files.write_pose2sim,
        "m",
    ),
    CameraFormat(
        "anipose",
        "anipose calibration.toml",
        toml_files.sniff_anipose,
        toml_files.parse,
        toml_files.write_anipose,
        endings=(".toml",),
    ),
    CameraFormat(
        "jarvis",
        "JARVIS YAML",
        yaml_files.sniff_jarvis,
        yaml_files.parse_jarvis,
        yaml_files.write_jarvis,
        "mm",
        folder=True,
    ),
    CameraFormat(
        "easymocap",
        "EasyMocap intri.yml and extri.yml",
        easymocap.sniff,
        easymocap.parse,
        easymocap.write,
        "m",
        folder=True,
    ),
    CameraFormat("kalibr", "Kalibr camchain", kalibr.sniff, kalibr.parse, unit="m"),
    CameraFormat("ros", "ROS camera_info", yaml_files.sniff_ros, yaml_files.parse_ros),
    CameraFormat(
        "opencv",
        "OpenCV YAML",
        yaml_files.sniff_opencv,
        yaml_files.parse_opencv,
        yaml_files.write_opencv,
        folder=True,
    ),
    CameraFormat(
        "colmap", "COLMAP text model", colmap.sniff, colmap.parse, colmap.write, folder=True
    ),
    CameraFormat(
        "panoptic",
        "CMU Panoptic JSON",
        json_files.sniff_panoptic,
        json_files.parse_panoptic,
        json_files.write_panoptic,
        "cm",
    ),
    CameraFormat(
        "voxelpose",
        "VoxelPose JSON",
        json_files.sniff_voxelpose,
        json_files.parse_voxelpose,
        json_files.write_voxelpose,
        "mm",
    ),
    CameraFormat(
        "4d-association",
        "4D-Association JSON",
        json_files.sniff_4d_association,
        json_files.parse_4d_association,
        json_files.write_4d_association,
        "m",
    ),
    CameraFormat(
        "nerfstudio",
        "nerfstudio transforms.json",
        nerfstudio.sniff,
        nerfstudio.parse,
        nerfstudio.write,
    ),
    CameraFormat("openmvg", "OpenMVG sfm_data.json", openmvg.sniff, openmvg.parse, openmvg.write),
    CameraFormat(
        "multiview-calib",
        "multiview_calib JSON",
        json_files.sniff_multiview_calib,
        json_files.parse_multiview_calib,
        json_files.write_multiview_calib,
        folder=True,
    ),
    CameraFormat(
        "dannce",
        "Label3D or DANNCE .mat",
        dannce.sniff,
        dannce.parse,
        dannce.write,
        "mm",
        endings=(".mat",),
    ),
)
CAMERA_FORMAT_NAMES = tuple(each.name for each in CAMERA_FORMATS)


def camera_format(name: str) -> CameraFormat:
    """The format of that name. Raises MismatchError."""
    for each in CAMERA_FORMATS:
        if each.name == name:
            return each
    raise MismatchError(
        f"expected one of the camera formats {', '.join(CAMERA_FORMAT_NAMES)}, found {name!r}; use one of them"
    )


def format_rig(rig: CameraRig, name: str, provenance: Mapping[str, Any]) -> Written:
    """The files of a rig in the format, their names as the format has them, lengths in its unit.

    Raises MismatchError where the format cannot carry the rig, and where a unit is needed that is not known.
    """
    target = camera_format(name)
    if target.write is None:
        raise MismatchError(
            f"{name}: expected a format that is written, found one that is only read; choose another"
        )
    if target.unit:
        factor = unit_factor(rig.unit, target.unit, name)
        rig = replace(rig, translation=rig.translation * factor, unit=target.unit)
    return target.write(rig, provenance)


def write_cameras(
    path: Path, rig: CameraRig, name: str, provenance: Mapping[str, Any] | None = None
) -> tuple[str, ...]:
    """Writes the rig in the format, atomically: to the file `path`, or to the folder where the format is several files.

    Returns what of the rig the format does not carry. Raises MismatchError where it carries too little.
    """
    written = format_rig(rig, name, provenance or {})
    if camera_format(name).folder:
        check_alone(path, written.files, FOLDER_SUFFIXES)
        with folder(path) as work:
            for file, content in written.files.items():
                (work / file).write_bytes(content)
    else:
        write_bytes(path, next(iter(written.files.values())))
    return written.lost
