"""Cameras and 3D poses from the 2D keypoints of moving people and animals.

The names of `__all__` are the library, as far as most programs need it; docs/python.md shows them
at work. Each is imported when it is first used: `import mocap_calib` itself is quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap_calib.config import Config
    from mocap_calib.errors import (
        ClusterError,
        DegenerateError,
        FormatError,
        MismatchError,
        MocapCalibError,
        UnderconstrainedCameraError,
    )
    from mocap_calib.front import read_recording, write
    from mocap_calib.io.cameras.read import read_cameras, read_rig
    from mocap_calib.io.keypoints.document import ReadOptions
    from mocap_calib.io.keypoints.read import read_keypoints
    from mocap_calib.io.poses.read import read_poses
    from mocap_calib.pipeline import calibrate, match
    from mocap_calib.recording.corrections import (
        Cropped,
        Exchanged,
        Mirrored,
        Moved,
        Refocused,
        Resized,
        Rotated,
        Sides,
    )
    from mocap_calib.results import (
        CalibrationResult,
        Fault,
        GroupResult,
        Matches,
        Poses3D,
        Verification,
        VerifiedCamera,
    )
    from mocap_calib.rig.triangulate import triangulate
    from mocap_calib.synthetic import Scene, simulate
    from mocap_calib.synthetic.config import SimulateConfig
    from mocap_calib.types import Camera, CameraRig, Keypoints2D, PosedCamera, Recording
    from mocap_calib.verdict.evaluation import Evaluation, evaluate
    from mocap_calib.verdict.verify import verify

__version__ = "0.1.0"

_NAMES = {
    "config": ("Config",),
    "errors": (
        "ClusterError",
        "DegenerateError",
        "FormatError",
        "MismatchError",
        "MocapCalibError",
        "UnderconstrainedCameraError",
    ),
    "front": ("read_recording", "write"),
    "io.cameras.read": ("read_cameras", "read_rig"),
    "io.keypoints.document": ("ReadOptions",),
    "io.keypoints.read": ("read_keypoints",),
    "io.poses.read": ("read_poses",),
    "verdict.evaluation": ("Evaluation", "evaluate"),
    "rig.triangulate": ("triangulate",),
    "verdict.verify": ("verify",),
    "pipeline": ("calibrate", "match"),
    "recording.corrections": (
        "Cropped",
        "Exchanged",
        "Mirrored",
        "Moved",
        "Refocused",
        "Resized",
        "Rotated",
        "Sides",
    ),
    "synthetic": ("Scene", "simulate"),
    "synthetic.config": ("SimulateConfig",),
    "results": (
        "CalibrationResult",
        "Fault",
        "GroupResult",
        "Matches",
        "Poses3D",
        "Verification",
        "VerifiedCamera",
    ),
    "types": ("Camera", "CameraRig", "Keypoints2D", "PosedCamera", "Recording"),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "CalibrationResult",
    "Camera",
    "CameraRig",
    "ClusterError",
    "Config",
    "Cropped",
    "DegenerateError",
    "Evaluation",
    "Exchanged",
    "Fault",
    "FormatError",
    "GroupResult",
    "Keypoints2D",
    "Matches",
    "Mirrored",
    "MismatchError",
    "MocapCalibError",
    "Moved",
    "PosedCamera",
    "Poses3D",
    "ReadOptions",
    "Recording",
    "Refocused",
    "Resized",
    "Rotated",
    "Scene",
    "Sides",
    "SimulateConfig",
    "UnderconstrainedCameraError",
    "Verification",
    "VerifiedCamera",
    "calibrate",
    "evaluate",
    "match",
    "read_cameras",
    "read_keypoints",
    "read_poses",
    "read_recording",
    "read_rig",
    "simulate",
    "triangulate",
    "verify",
    "write",
]


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first used (PEP 562), and `methods` before it."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import_module(f"{__name__}.methods")  # binds rig.project, result.plot, ...
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that this module has or can import."""
    return sorted({*globals(), *__all__})
