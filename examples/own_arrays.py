"""Numpy arrays in, cameras out: for detections that are in no file.

python own_arrays.py
"""

import numpy as np

import mocap_calib as mc

# stands for arrays of your own: a detector has looked at the images of three cameras
scene = mc.simulate(mc.SimulateConfig(cameras=3, people=1, frames=30, false_detections=0))
names = scene.files[0].keypoints
positions = np.stack([view.positions for view in scene.files])  # view, frame, instance, keypoint, 2
confidence = np.stack([view.confidence for view in scene.files])  # the same without the last axis

# what is known of each camera: its name, the size of its images, and its matrix
cameras = [
    mc.Camera(known.name, size=known.size, matrix=known.matrix, distortion=known.distortion)
    for known in scene.rig.cameras
]
recording = mc.Recording.from_arrays(
    positions,  # pixels, NaN = not found
    confidence=confidence,
    keypoints=names,
    cameras=cameras,
)
result = mc.calibrate(recording)
print(result)

rig = result.groups[0].rig
for camera in rig:
    print(f"{camera.name}: centre {np.round(camera.centre, 2)}, rvec {np.round(camera.rvec, 3)}")
