"""Run other people's bundle adjustments; called by adjustment.py in an environment of their own.

    python adjustment_peers.py METHOD problem.npz result.npz

problem.npz: pixels `[view, N, 2]` (NaN = missing), matrix `[view, 3, 3]`, distortion `[view, 5]`,
size `[view, 2]`, rotation `[view, 3]` (rotation vectors of cam_from_world) and translation `[view,
3]` to start from. result.npz: rotation, translation, seconds, processor.
"""

import sys
import time

import numpy as np


def anipose(problem):
    """Adjust with aniposelib's `bundle_adjust_iter`.

    Settings as in anipose's calibration from animals; intrinsics fixed.
    """
    from aniposelib.cameras import Camera, CameraGroup

    def group():
        rows = zip(
            problem["matrix"],
            problem["distortion"],
            problem["size"],
            problem["rotation"],
            problem["translation"],
            strict=True,
        )
        return CameraGroup(
            [Camera(m, d, tuple(s), r, t, name=str(k)) for k, (m, d, s, r, t) in enumerate(rows)]
        )

    settings = {
        "only_extrinsics": True,
        "n_iters": 10,
        "n_samp_iter": 300,
        "n_samp_full": 1000,
        "max_nfev": 500,
        "verbose": False,
    }
    # what it compiles on first use is not counted
    group().bundle_adjust_iter(
        problem["pixels"][:, :2000], **settings | {"n_iters": 2, "max_nfev": 5}
    )
    cameras = group()
    start = time.perf_counter(), time.process_time()
    np.random.seed(0)  # noqa: NPY002 - the generator that aniposelib draws from
    cameras.bundle_adjust_iter(problem["pixels"], **settings)
    spent = time.perf_counter() - start[0], time.process_time() - start[1]
    return cameras.get_rotations(), cameras.get_translations(), *spent


def scipy(problem):
    """Adjust with scipy's `least_squares` on cameras and 5,000 points.

    Sparse differences; soft_l1 tightened as ours is (50, 10, 3 px).
    """
    import cv2
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    start = time.perf_counter(), time.process_time()
    pixels = problem["pixels"]
    seen = np.isfinite(pixels[..., 0])
    chosen = np.flatnonzero(seen.sum(0) >= 2)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(5000, len(chosen))).astype(int)]
    pixels, seen = pixels[:, chosen], seen[:, chosen]
    views, count = seen.shape
    view, point = np.nonzero(seen)
    rotations = np.stack([cv2.Rodrigues(r)[0] for r in problem["rotation"]])
    rows = zip(problem["matrix"], problem["distortion"], pixels, strict=True)
    plane = np.stack(
        [cv2.undistortPoints(np.nan_to_num(p)[:, None], m, d)[:, 0] for m, d, p in rows]
    )
    projection = np.concatenate([rotations, problem["translation"][..., None]], axis=2)
    system = plane[..., None] * projection[:, None, 2:] - projection[:, None, :2]  # (view, N, 2, 4)
    system = np.moveaxis(system * seen[..., None, None], 0, 1).reshape(count, -1, 4)
    points = np.linalg.svd(system)[2][:, -1]
    points = points[:, :3] / points[:, 3:]

    def residuals(x):
        cameras, where = x[: 6 * views].reshape(views, 6), x[6 * views :].reshape(count, 3)
        out = np.zeros((views, count, 2))
        for v in range(views):
            out[v] = (
                cv2.projectPoints(
                    where,
                    cameras[v, :3],
                    cameras[v, 3:],
                    problem["matrix"][v],
                    problem["distortion"][v],
                )[0][:, 0]
                - pixels[v]
            )
        return out[view, point].ravel()

    pattern = lil_matrix((2 * len(view), 6 * views + 3 * count), dtype=int)
    row = np.arange(2 * len(view))
    for k in range(6):
        pattern[row, np.repeat(6 * view + k, 2)] = 1
    for k in range(3):
        pattern[row, np.repeat(6 * views + 3 * point + k, 2)] = 1
    x = np.concatenate(
        [
            np.concatenate([problem["rotation"], problem["translation"]], axis=1).ravel(),
            points.ravel(),
        ]
    )
    for scale in (50.0, 10.0, 3.0):
        x = least_squares(
            residuals,
            x,
            jac_sparsity=pattern,
            loss="soft_l1",
            f_scale=scale,
            x_scale="jac",
            method="trf",
            max_nfev=30,
        ).x
    cameras = x[: 6 * views].reshape(views, 6)
    return (
        cameras[:, :3],
        cameras[:, 3:],
        time.perf_counter() - start[0],
        time.process_time() - start[1],
    )


if __name__ == "__main__":
    with np.load(sys.argv[2]) as file:
        found = {"anipose": anipose, "scipy": scipy}[sys.argv[1]](dict(file))
    np.savez(
        sys.argv[3],
        **dict(zip(("rotation", "translation", "seconds", "processor"), found, strict=True)),
    )
