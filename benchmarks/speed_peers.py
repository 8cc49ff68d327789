"""Run other people's triangulation and calibration; called by speed.py where they are installed.

    python speed_peers.py METHOD problem.npz result.npz

problem.npz as adjustment_peers.py says. result.npz: seconds, processor, and of `lab` the rig.
"""

import sys
import time

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup


def group(problem, rotation, translation):
    """Return aniposelib's cameras."""
    given = problem["matrix"], problem["distortion"], problem["size"], rotation, translation
    rows = enumerate(zip(*given, strict=True))
    return CameraGroup([Camera(m, d, tuple(s), r, t, name=str(k)) for k, (m, d, s, r, t) in rows])


def anipose(problem):
    """Triangulate with aniposelib, linear; what it compiles is not counted."""
    cameras = group(problem, problem["rotation"], problem["translation"])
    cameras.triangulate(problem["pixels"][:, :100], undistort=True)
    start = time.perf_counter(), time.process_time()
    cameras.triangulate(problem["pixels"], undistort=True)
    return {"seconds": time.perf_counter() - start[0], "processor": time.process_time() - start[1]}


def opencv(problem):
    """Triangulate with OpenCV: two views, it knows no more."""
    start = time.perf_counter(), time.process_time()
    both = np.isfinite(problem["pixels"][:2, :, 0]).all(0)
    a, b = (undistorted(problem, view, both) for view in (0, 1))
    poses = [
        np.column_stack([cv2.Rodrigues(r)[0], t])
        for r, t in zip(problem["rotation"][:2], problem["translation"][:2], strict=True)
    ]
    cv2.triangulatePoints(*poses, a.T, b.T)
    return {"seconds": time.perf_counter() - start[0], "processor": time.process_time() - start[1]}


def lab(problem):
    """Calibrate as labs do with identities given: five points, then aniposelib's adjustment.

    Each camera against the first, lengths by the points that all pairs share.
    """
    settings = {"only_extrinsics": True, "n_iters": 10, "n_samp_iter": 300, "n_samp_full": 1000}
    settings |= {"max_nfev": 500, "verbose": False}
    warm = group(problem, problem["rotation"], problem["translation"])
    warm.bundle_adjust_iter(problem["pixels"][:, :2000], **settings | {"n_iters": 2, "max_nfev": 5})
    start = time.perf_counter(), time.process_time()
    np.random.seed(0)  # noqa: NPY002 - the generator that aniposelib draws from
    rotations, translations, depths = [np.zeros(3)], [np.zeros(3)], None
    for view in range(1, len(problem["pixels"])):
        rotation, translation, depth = five_point(problem, view)
        if depths is not None:
            translation = translation * np.nanmedian(depths / depth)
        else:
            depths = depth
        rotations.append(cv2.Rodrigues(rotation)[0].ravel())
        translations.append(translation)
    cameras = group(problem, np.array(rotations), np.array(translations))
    cameras.bundle_adjust_iter(problem["pixels"], **settings)
    return {
        "seconds": time.perf_counter() - start[0],
        "processor": time.process_time() - start[1],
        "rotation": cameras.get_rotations(),
        "translation": cameras.get_translations(),
    }


def five_point(problem, view):
    """Return R, t of length 1, and the depths `[N]` of points in the first camera."""
    both = np.isfinite(problem["pixels"][[0, view], :, 0]).all(0)
    a, b = (undistorted(problem, each, both) for each in (0, view))
    threshold = 3.0 / problem["matrix"][view, 0, 0]
    matrix, kept = cv2.findEssentialMat(
        a, b, np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=threshold
    )
    _, rotation, translation, _ = cv2.recoverPose(matrix, a, b, np.eye(3), mask=kept)
    points = cv2.triangulatePoints(np.eye(3, 4), np.hstack([rotation, translation]), a.T, b.T)
    depth = np.full(len(both), np.nan)
    depth[both] = points[2] / points[3]
    return rotation, translation[:, 0], depth


def undistorted(problem, view, chosen):
    """Return points of a view on the plane at depth 1."""
    pixels = np.ascontiguousarray(problem["pixels"][view, chosen])[:, None]
    return cv2.undistortPoints(pixels, problem["matrix"][view], problem["distortion"][view])[:, 0]


if __name__ == "__main__":
    with np.load(sys.argv[2]) as file:
        found = {"anipose": anipose, "opencv": opencv, "lab": lab}[sys.argv[1]](dict(file))
    np.savez(sys.argv[3], **found)
