"""How the cameras fit what they saw: over the image, by joint, over time."""

from itertools import pairwise
from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import REPORT_FRAMES
from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import pack, pack_floats, quantise, small_ints
from mocap_calib.html_report.frames import quantiles, split_evenly
from mocap_calib.html_report.source import Seen
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Poses3D
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Recording
from mocap_calib.verdict.checks import Residuals, find_residuals

_CONFIG = ReportConfig()
_SHARES = (0.5, 0.95)


def describe_fits(seen: Seen, rig: CameraRig, poses: Poses3D) -> dict[str, Any]:
    """Return what a page shows of the errors of each view.

    Of the frames that run.json tells of, or fewer where there are very many keypoints.
    """
    recording, matches = seen.recording, seen.matches
    each = max(1, len(rig) * matches.individuals * len(recording.keypoints))
    count = min(REPORT_FRAMES, max(1, _CONFIG.most_keypoints // each))
    frames = evenly_spaced(np.arange(len(recording.frames)), count)
    residuals = find_residuals(recording, matches, rig, poses.raw, frames)
    columns, rows = _CONFIG.cells if len(rig) <= _CONFIG.many_views else _CONFIG.few_cells
    views = range(len(rig))

    def grid(view: int) -> tuple[Ints, Floats, Ints]:
        counts, mean = _grid_errors(recording.cameras[view], view, residuals, (columns, rows))
        return counts, mean, _grid_unmatched(seen, view, frames, (columns, rows))

    counts, mean, unmatched = map(np.stack, zip(*map_in_threads(grid, views), strict=True))
    scale = _CONFIG.residual_step
    return {
        "columns": columns,
        "rows": rows,
        "counts": pack(small_ints(counts)),
        "unmatched": pack(small_ints(unmatched)),
        "residual_scale": scale,
        "residuals": pack(quantise(mean, scale)),
        "by_joint": pack_floats(_errors_by_joint(residuals)),
        **_errors_over_time(recording, residuals, frames),
        "looked_at": len(frames),
    }


def _grid_errors(
    camera: Camera, view: int, residuals: Residuals, grid: tuple[int, int]
) -> tuple[Ints, Floats]:
    """Return counts `[row, column]` and mean gaps `[row, column, 2]` in pixels of a view."""
    pixels, gap = residuals.pixels[view].reshape(2, -1), residuals.gap[view].reshape(2, -1)
    known = np.isfinite(gap).all(0)
    cell = _cells_of(camera, pixels[:, known], grid)
    columns, rows = grid
    counts = np.bincount(cell, minlength=columns * rows)
    sums = np.stack(
        [np.bincount(cell, weights=of, minlength=columns * rows) for of in gap[:, known]], axis=-1
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / counts[:, None]
    return counts.reshape(rows, columns), mean.reshape(rows, columns, 2)


def _grid_unmatched(seen: Seen, view: int, frames: Ints, grid: tuple[int, int]) -> Ints:
    """Return how many keypoints `[row, column]` of a view are nobody's."""
    positions = mapped.take(seen.recording.positions[view], frames)
    nobody = seen.matches.labels[view, frames] < 0
    pixels = positions[nobody].reshape(-1, 2).T
    known = np.isfinite(pixels).all(0)
    cell = _cells_of(seen.recording.cameras[view], pixels[:, known], grid)
    columns, rows = grid
    return np.bincount(cell, minlength=columns * rows).reshape(rows, columns)


def _cells_of(camera: Camera, pixels: Floats, grid: tuple[int, int]) -> Ints:
    """Return the cell `[N]` of pixels `[2, N]`; those outside count at the edge."""
    width, height = camera.size
    size = (width or 2 * camera.matrix[0, 2] or 1, height or 2 * camera.matrix[1, 2] or 1)
    column, row = (
        np.floor(along / length * number).clip(0, number - 1).astype(np.int64)
        for along, length, number in zip(pixels, size, grid, strict=True)
    )
    return row * grid[0] + column


def _errors_by_joint(residuals: Residuals) -> Floats:
    """Return median errors `[view, keypoint]` in pixels."""
    distance = residuals.distance
    views, _, _, keypoints = distance.shape
    by_joint = np.moveaxis(distance, -1, 1).reshape(views, keypoints, -1)
    return quantiles(by_joint, _SHARES)[0]


def _errors_over_time(recording: Recording, residuals: Residuals, frames: Ints) -> dict[str, Any]:
    """Return the medians and 95th percentiles of the errors of views in bins of frames."""
    views = len(residuals.distance)
    most = max(_CONFIG.least_bins, min(_CONFIG.most_bins, _CONFIG.view_bins // max(1, views)))
    edges = split_evenly(len(frames), most)
    by_frame = residuals.distance.reshape(views, len(frames), -1)
    found = np.stack(
        [
            quantiles(by_frame[:, first:last].reshape(views, -1), _SHARES)
            for first, last in pairwise(edges)
        ],
        axis=-1,
    )
    return {
        "bins": recording.frames[frames[edges[:-1]]].tolist(),
        "median": pack_floats(found[0]),
        "p95": pack_floats(found[1]),
    }
