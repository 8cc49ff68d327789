"""A rig and a table of keypoints that tests convert."""

import numpy as np

import mocap_calib as mc

DLC = (
    "scorer,net,net,net\nbodyparts,nose,nose,nose\n"
    "coords,x,y,likelihood\n0,10,20,0.5\n1,11,21,0.5\n"
)


def rig() -> mc.CameraRig:
    """Return two cameras side by side."""
    matrix = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
    lens = np.array([0.1, -0.01, 0, 0, 0])
    cameras = tuple(mc.Camera(name, (1280, 720), matrix, lens) for name in ("a", "b"))
    return mc.CameraRig(cameras, np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 2], [1, 0, 2]]), "m")
