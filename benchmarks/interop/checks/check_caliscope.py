"""caliscope's CameraArray: our camera_array.toml, pinhole and fisheye."""

from importlib.metadata import version
from pathlib import Path

import cv2
from caliscope.cameras.camera_array import CameraArray
from expected import FILES, POINTS, near, pixels

for file, key in (("caliscope", "pixels"), ("caliscope-fisheye", "pixels_fisheye")):
    array = CameraArray.from_toml(Path(FILES) / f"{file}.toml")
    found = []
    for camera in array.posed_cameras.values():
        project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
        found.append(
            project(
                POINTS[:, None],
                cv2.Rodrigues(camera.rotation)[0],
                camera.translation,
                camera.matrix,
                camera.distortions,
            )[0][:, 0]
        )
    near(f"caliscope {version('caliscope')} {file} (px)", found, list(pixels(key).values()), 1e-6)
