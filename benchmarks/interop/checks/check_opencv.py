"""OpenCV's FileStorage: our OpenCV, EasyMocap and JARVIS files, projected with cv2."""

import cv2
import numpy as np
from expected import FILES, POINTS, near, pixels


def storage(path):
    """Open a file with FileStorage; return what gets its nodes by name."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert file.isOpened(), path
    return file.getNode


for folder, key, project in (
    ("opencv", "pixels", cv2.projectPoints),
    ("opencv-fisheye", "pixels_fisheye", cv2.fisheye.projectPoints),
):
    found, expected = [], pixels(key)
    for name in expected:
        node = storage(FILES / folder / f"{name}.yml")
        assert node("camera_name").string() == name
        assert node("image_width").real() == 1280
        vector = cv2.Rodrigues(node("R").mat())[0]
        image = project(
            POINTS[:, None],
            vector,
            node("T").mat(),
            node("camera_matrix").mat(),
            node("distortion_coefficients").mat(),
        )[0]
        found.append(image[:, 0])
    near(f"OpenCV {cv2.__version__} {folder} (px)", found, list(expected.values()), 1e-6)

intri, extri = (storage(FILES / "easymocap" / name) for name in ("intri.yml", "extri.yml"))
names = [intri("names").at(k).string() for k in range(intri("names").size())]
found = [
    cv2.projectPoints(
        POINTS,
        extri(f"R_{n}").mat(),
        extri(f"T_{n}").mat(),
        intri(f"K_{n}").mat(),
        intri(f"dist_{n}").mat(),
    )[0][:, 0]
    for n in names
]
assert [int(intri(f"W_{n}").real()) for n in names] == [1280] * len(names)
near("EasyMocap pair (px)", found, list(pixels().values()), 1e-6)

found = []
for name in pixels():  # as JARVIS-HybridNet does: [X 1] [R; T] K, then k1 and k2
    node = storage(FILES / "jarvis" / f"{name}.yaml")
    matrix, lens = node("intrinsicMatrix").mat(), node("distortionCoefficients").mat()
    camera = np.vstack([node("R").mat(), node("T").mat().reshape(1, 3)])
    rays = np.column_stack([POINTS * 1000, np.ones(len(POINTS))]) @ camera
    found.append(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix.T.copy(), lens)[0][:, 0])
near("JARVIS files (px)", found, list(pixels().values()), 1e-6)
