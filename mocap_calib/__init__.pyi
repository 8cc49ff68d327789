"""The names of the library and where each is, for `__init__.py` and for type checkers."""

from typing import TYPE_CHECKING

__version__: str

if TYPE_CHECKING:  # or mypy checks the whole package as one circle
    from mocap_calib.config import Config as Config
    from mocap_calib.errors import ClusterError as ClusterError
    from mocap_calib.errors import DegenerateError as DegenerateError
    from mocap_calib.errors import FormatError as FormatError
    from mocap_calib.errors import MismatchError as MismatchError
    from mocap_calib.errors import MocapCalibError as MocapCalibError
    from mocap_calib.errors import UnderconstrainedCameraError as UnderconstrainedCameraError
    from mocap_calib.front import read_recording as read_recording
    from mocap_calib.front import write as write
    from mocap_calib.io.camera_files import read_cameras as read_cameras
    from mocap_calib.io.camera_files import read_rig as read_rig
    from mocap_calib.io.keypoints import read_keypoints as read_keypoints
    from mocap_calib.io.pose_files import read_poses as read_poses
    from mocap_calib.io.read_options import ReadOptions as ReadOptions
    from mocap_calib.pipeline import calibrate as calibrate
    from mocap_calib.recording.corrections import Cropped as Cropped
    from mocap_calib.recording.corrections import Exchanged as Exchanged
    from mocap_calib.recording.corrections import Flipped as Flipped
    from mocap_calib.recording.corrections import Mirrored as Mirrored
    from mocap_calib.recording.corrections import Moved as Moved
    from mocap_calib.recording.corrections import Refocused as Refocused
    from mocap_calib.recording.corrections import Resized as Resized
    from mocap_calib.recording.corrections import Rotated as Rotated
    from mocap_calib.recording.corrections import Sides as Sides
    from mocap_calib.results import CalibrationResult as CalibrationResult
    from mocap_calib.results import Fault as Fault
    from mocap_calib.results import GroupResult as GroupResult
    from mocap_calib.results import Matches as Matches
    from mocap_calib.results import Poses3D as Poses3D
    from mocap_calib.results import Verification as Verification
    from mocap_calib.results import VerifiedCamera as VerifiedCamera
    from mocap_calib.rig.triangulate import triangulate as triangulate
    from mocap_calib.stages import average as average
    from mocap_calib.stages import bundle_adjust as bundle_adjust
    from mocap_calib.stages import filter as filter
    from mocap_calib.stages import match as match
    from mocap_calib.stages import pairwise as pairwise
    from mocap_calib.stages import smooth as smooth
    from mocap_calib.synthetic.config import SimulateConfig as SimulateConfig
    from mocap_calib.synthetic.scene import Scene as Scene
    from mocap_calib.synthetic.scene import simulate as simulate
    from mocap_calib.types import Camera as Camera
    from mocap_calib.types import CameraRig as CameraRig
    from mocap_calib.types import Keypoints2D as Keypoints2D
    from mocap_calib.types import PosedCamera as PosedCamera
    from mocap_calib.types import Recording as Recording
    from mocap_calib.verdict.evaluation import Evaluation as Evaluation
    from mocap_calib.verdict.evaluation import evaluate as evaluate
    from mocap_calib.verdict.verify import verify as verify
