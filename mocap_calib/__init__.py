"""Cameras and 3D poses from the 2D keypoints of moving people and animals.

The names of `__all__` are the library, as far as most programs need it. Each is imported when it
is first used: `import mocap_calib` itself is quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap_calib.config import Config, SimulateConfig
    from mocap_calib.errors import (
        ClusterError,
        DegenerateError,
        FormatError,
        MismatchError,
        MocapCalibError,
        UnderconstrainedCameraError,
    )
    from mocap_calib.io.cameras.read import read_cameras, read_rig
    from mocap_calib.io.cameras.write import write_cameras
    from mocap_calib.io.keypoints.read import read_keypoints
    from mocap_calib.io.keypoints.write import write_keypoints
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.io.poses.write import write_poses
    from mocap_calib.job import (
        CalibrationRequest,
        KeypointSource,
        calibrate_job,
        read_job,
        write_results,
    )
    from mocap_calib.multi_view.evaluation import Evaluation, evaluate_rig
    from mocap_calib.multi_view.triangulation import triangulate
    from mocap_calib.pipeline import calibrate
    from mocap_calib.recording.joints import fit_vocabulary, load_skeleton
    from mocap_calib.recording.synchronise import make_recording
    from mocap_calib.steerpose.checkpoint import load_model
    from mocap_calib.synthetic import simulate
    from mocap_calib.types import (
        CalibrationResult,
        Camera,
        CameraRig,
        GroupResult,
        Keypoints2D,
        Matches,
        Poses3D,
        Recording,
        Skeleton,
        silent,
    )

__version__ = "0.1.0"

_NAMES = {
    "config": ("Config", "SimulateConfig"),
    "errors": (
        "ClusterError",
        "DegenerateError",
        "FormatError",
        "MismatchError",
        "MocapCalibError",
        "UnderconstrainedCameraError",
    ),
    "io.cameras.read": ("read_cameras", "read_rig"),
    "io.cameras.write": ("write_cameras",),
    "io.keypoints.read": ("read_keypoints",),
    "io.keypoints.write": ("write_keypoints",),
    "io.poses.read": ("read_poses",),
    "io.poses.write": ("write_poses",),
    "job": (
        "CalibrationRequest",
        "KeypointSource",
        "calibrate_job",
        "read_job",
        "write_results",
    ),
    "multi_view.evaluation": ("Evaluation", "evaluate_rig"),
    "multi_view.triangulation": ("triangulate",),
    "pipeline": ("calibrate",),
    "recording.joints": ("fit_vocabulary", "load_skeleton"),
    "recording.synchronise": ("make_recording",),
    "steerpose.checkpoint": ("load_model",),
    "synthetic": ("simulate",),
    "types": (
        "CalibrationResult",
        "Camera",
        "CameraRig",
        "GroupResult",
        "Keypoints2D",
        "Matches",
        "Poses3D",
        "Recording",
        "Skeleton",
        "silent",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "CalibrationRequest",
    "CalibrationResult",
    "Camera",
    "CameraRig",
    "ClusterError",
    "Config",
    "DegenerateError",
    "Evaluation",
    "FormatError",
    "GroupResult",
    "KeypointSource",
    "Keypoints2D",
    "Matches",
    "MismatchError",
    "MocapCalibError",
    "Poses3D",
    "Recording",
    "SimulateConfig",
    "Skeleton",
    "UnderconstrainedCameraError",
    "calibrate",
    "calibrate_job",
    "evaluate_rig",
    "fit_vocabulary",
    "load_model",
    "load_skeleton",
    "make_recording",
    "read_cameras",
    "read_job",
    "read_keypoints",
    "read_poses",
    "read_rig",
    "silent",
    "simulate",
    "triangulate",
    "write_cameras",
    "write_keypoints",
    "write_poses",
    "write_results",
]


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first used (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that this module has or can import."""
    return sorted({*globals(), *__all__})
