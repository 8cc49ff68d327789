"""A rig, poses and keypoints that tests convert."""

import numpy as np

from mocap_calib.io.poses.common import PoseFile
from mocap_calib.results import Poses3D
from mocap_calib.types import Camera, CameraRig

DLC = (
    "scorer,net,net,net\nbodyparts,nose,nose,nose\n"
    "coords,x,y,likelihood\n0,10,20,0.5\n1,11,21,0.5\n"
)


def rig():
    matrix = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
    cameras = tuple(
        Camera(name, (1280, 720), matrix, np.array([0.1, -0.01, 0, 0, 0]), False)
        for name in ("a", "b")
    )
    return CameraRig(cameras, np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 2], [1, 0, 2]]), "m")


def poses(individuals=2):
    positions = np.random.default_rng(0).normal(size=(4, individuals, 3, 3))
    quality = np.ones(positions.shape[:3])
    return PoseFile(
        Poses3D(
            ("x", "y", "z"),
            np.arange(4),
            positions,
            quality,
            quality.astype(np.int64),
            quality,
            "m",
        ),
        25.0,
    )
