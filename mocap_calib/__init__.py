"""mocap-calib: cameras and 3D poses from the 2D keypoints of moving people and animals."""

__version__ = "0.1.0"
