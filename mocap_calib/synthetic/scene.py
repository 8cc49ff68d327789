"""A whole recording with its truth, from one seed."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import CAMERA_HEIGHT, ROOM_SIDE, SimulateConfig
from mocap_calib.synthetic.bodies import JOINTS, people
from mocap_calib.synthetic.detections import Detections, detect, keypoint_files
from mocap_calib.synthetic.rigs import ring_rig
from mocap_calib.types import CameraRig, Floats, Ints, Keypoints2D, Record


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Record):
    """Detections, and the truth behind them.

    rig: in metres, +z up.
    poses: `[frame, individual, joint, 3]` metres, of the joints `joints`, whatever the layout of
        the detections.
    """

    rig: CameraRig
    joints: tuple[str, ...]
    poses: Floats
    detections: Detections

    @property
    def files(self) -> tuple[Keypoints2D, ...]:
        """What the detector's files hold, one a view."""
        return keypoint_files(self.rig, self.detections)

    @property
    def identity(self) -> Ints:
        """`[view, frame, instance]` who each detection is, -1 = nobody."""
        return self.detections.identity


def simulate(config: SimulateConfig = SimulateConfig()) -> Scene:
    """Return a scene of people who walk about among a ring of cameras.

    The same configuration gives the same bytes. People, rig and detector draw from generators of
    their own: another noise leaves the people and the rig as they are.

    Raises MismatchError.
    """
    rng_people, rng_rig, rng_detector = np.random.default_rng(config.seed).spawn(3)
    side = ROOM_SIDE * config.radius
    poses = people(
        rng_people,
        individuals=config.people,
        frames=config.frames,
        fps=config.fps,
        room=(side, side),
    )
    rig = ring_rig(
        rng_rig,
        cameras=config.cameras,
        radius=config.radius,
        height=CAMERA_HEIGHT,
        size=config.size,
        distortion=config.distortion,
        arc_deg=config.arc_deg,
    )
    detections = detect(
        rng_detector,
        rig,
        poses,
        layout=config.layout,
        noise_px=config.noise_px,
        missing=config.missing,
        outliers=config.outliers,
        false_detections=config.false_detections,
        shuffle=config.shuffle,
    )
    return Scene(rig, JOINTS, poses, detections)
