"""Run aniposelib and OpenCV; called by `peer_calls.py` in an environment of their own.

    python peers.py METHOD problem.npz result.npz

problem.npz: matrix `[view, 3, 3]`, distortion `[view, 5]`, size `[view, 2]`, rotation `[view, 3]`
(rotation vectors of cam_from_world), translation `[view, 3]`, and pixels `[view, N, 2]` (NaN =
missing); for `smooth` pixels `[individual, view, frame, keypoint, 2]`, scores without the last
axis, edges `[edge, 2]` and fisheye. result.npz: seconds, processor, and what a method returns. What
aniposelib compiles on first use is not timed.
"""

import sys
import time

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup, FisheyeCamera

SETTINGS = {  # as in anipose's calibration from animals
    **{"only_extrinsics": True, "n_iters": 10, "n_samp_iter": 300, "n_samp_full": 1000},
    **{"max_nfev": 500, "verbose": False},
}
FEW = {"n_iters": 2, "max_nfev": 5}


def make_group(problem, rotation=None, translation=None):
    """Return aniposelib's cameras."""
    kind, terms = (FisheyeCamera, 4) if problem.get("fisheye") else (Camera, 5)
    rotation = problem["rotation"] if rotation is None else rotation
    translation = problem["translation"] if translation is None else translation
    given = zip(problem["matrix"], problem["distortion"], problem["size"], strict=True)
    poses = zip(rotation, translation, strict=True)
    return CameraGroup(
        [
            kind(matrix, lens[:terms], tuple(size), turn, shift, name=str(k))
            for k, ((matrix, lens, size), (turn, shift)) in enumerate(
                zip(given, poses, strict=True)
            )
        ]
    )


def adjust(problem, group=None):
    """Adjust with `bundle_adjust_iter`, intrinsics fixed."""
    make_group(problem).bundle_adjust_iter(problem["pixels"][:, :2000], **SETTINGS | FEW)

    def timed():
        np.random.seed(0)  # noqa: NPY002 - the generator that aniposelib draws from
        cameras = make_group(problem) if group is None else group()
        cameras.bundle_adjust_iter(problem["pixels"], **SETTINGS)
        return {"rotation": cameras.get_rotations(), "translation": cameras.get_translations()}

    return timed


def lab(problem):
    """Calibrate as labs do with identities given: five points, then `bundle_adjust_iter`.

    Each camera against the first, lengths by the points that all pairs share.
    """

    def group():
        rotations, translations, depths = [np.zeros(3)], [np.zeros(3)], None
        for view in range(1, len(problem["pixels"])):
            rotation, translation, depth = five_point(problem, view)
            depths = depth if depths is None else depths
            translations.append(translation * np.nanmedian(depths / depth))
            rotations.append(cv2.Rodrigues(rotation)[0].ravel())
        return make_group(problem, np.array(rotations), np.array(translations))

    return adjust(problem, group)


def triangulate(problem):
    """Triangulate with aniposelib, linear."""
    cameras = make_group(problem)
    cameras.triangulate(problem["pixels"][:, :100], undistort=True)
    return lambda: cameras.triangulate(problem["pixels"], undistort=True)


def opencv(problem):
    """Triangulate with OpenCV: two views, it has no more."""

    def timed():
        both = np.isfinite(problem["pixels"][:2, :, 0]).all(0)
        a, b = (undistort(problem, view, both) for view in (0, 1))
        poses = zip(problem["rotation"][:2], problem["translation"][:2], strict=True)
        first, second = (np.column_stack([cv2.Rodrigues(r)[0], t]) for r, t in poses)
        cv2.triangulatePoints(first, second, a.T, b.T)

    return timed


def smooth(problem):
    """Smooth tracks with `triangulate_optim`, the bones as constraints."""
    cameras, edges = make_group(problem), problem["edges"].tolist()
    tracks = list(zip(problem["pixels"], problem["scores"], strict=True))

    def smooth_one(pixels, scores):
        seen = np.flatnonzero((np.isfinite(pixels[..., 0]).sum(0) >= 2).any(1))
        found = np.full((*pixels.shape[1:3], 3), np.nan)
        if len(seen) >= 3:
            span = slice(seen[0], seen[-1] + 1)
            found[span] = cameras.triangulate_optim(
                pixels[:, span], constraints=edges, scores=scores[:, span]
            )
        return found

    smooth_one(*(each[:, :30] for each in tracks[0]))
    return lambda: {"positions": np.stack([smooth_one(*each) for each in tracks])}


def five_point(problem, view):
    """Return R, t of length 1, and the depths `[N]` of points in the first camera."""
    both = np.isfinite(problem["pixels"][[0, view], :, 0]).all(0)
    a, b = (undistort(problem, each, both) for each in (0, view))
    threshold = 3.0 / problem["matrix"][view, 0, 0]
    matrix, kept = cv2.findEssentialMat(
        a, b, np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=threshold
    )
    _, rotation, translation, _ = cv2.recoverPose(matrix, a, b, np.eye(3), mask=kept)
    points = cv2.triangulatePoints(np.eye(3, 4), np.hstack([rotation, translation]), a.T, b.T)
    depth = np.full(len(both), np.nan)
    depth[both] = points[2] / points[3]
    return rotation, translation[:, 0], depth


def undistort(problem, view, chosen):
    """Return points of a view on the plane at depth 1."""
    pixels = np.ascontiguousarray(problem["pixels"][view, chosen])[:, None]
    return cv2.undistortPoints(pixels, problem["matrix"][view], problem["distortion"][view])[:, 0]


METHODS = {each.__name__: each for each in (adjust, lab, triangulate, opencv, smooth)}


def main():
    """Read the problem, warm up, run, write the result."""
    with np.load(sys.argv[2]) as file:
        timed = METHODS[sys.argv[1]](dict(file))
    start = time.perf_counter(), time.process_time()
    found = timed()
    spent = {"seconds": time.perf_counter() - start[0], "processor": time.process_time() - start[1]}
    np.savez(sys.argv[3], **(found if isinstance(found, dict) else {}), **spent)


if __name__ == "__main__":
    main()
