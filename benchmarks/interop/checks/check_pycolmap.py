"""pycolmap: our text and binary models, projected by it; its pixels are half a pixel more."""

import numpy as np
import pycolmap
from expected import FILES, POINTS, near, pixels

for folder, key in (
    ("colmap", "pixels"),
    ("colmap-fisheye", "pixels_fisheye"),
    ("colmap-binary", "pixels"),
    ("colmap-binary-fisheye", "pixels_fisheye"),
):
    model = pycolmap.Reconstruction(str(FILES / folder))
    images = {image.name.removesuffix(".png"): image for image in model.images.values()}
    found = []
    for name in pixels(key):
        image = images[name]
        moved = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        rays = POINTS @ moved.rotation.matrix().T + moved.translation
        found.append(
            np.array([np.ravel(model.cameras[image.camera_id].img_from_cam(ray)) for ray in rays])
            - 0.5
        )
    near(f"pycolmap {pycolmap.__version__} {folder} (px)", found, list(pixels(key).values()), 1e-6)
