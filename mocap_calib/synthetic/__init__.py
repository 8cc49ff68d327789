"""Scenes with truth, for tests, examples and training: people, rigs, and what detectors see."""

from mocap_calib.synthetic.bodies import JOINTS, people
from mocap_calib.synthetic.detections import LAYOUTS, Detections, detect, keypoint_files
from mocap_calib.synthetic.rigs import ring_rig
from mocap_calib.synthetic.scene import Scene, simulate

__all__ = [
    "JOINTS",
    "LAYOUTS",
    "Detections",
    "Scene",
    "detect",
    "keypoint_files",
    "people",
    "ring_rig",
    "simulate",
]
