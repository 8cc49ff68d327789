"""What the cameras saw: detections, whom they show in which frames, and how the rig fits them."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import REPORT_FRAMES
from mocap_calib.html_report.encode import (
    MISSING,
    fill_room,
    pack,
    pack_floats,
    quantiles,
    quantise,
    small_ints,
    split_evenly,
)
from mocap_calib.html_report.source import MOST_KEYPOINTS, Seen
from mocap_calib.recording.sampling import evenly_spaced, usual_step
from mocap_calib.results import Poses3D
from mocap_calib.types import Camera, CameraRig, Floats, Ints
from mocap_calib.verdict.checks import find_residuals

_PIXEL_STEP = 0.25  # that detections are rounded to
_RESIDUAL_STEP = 0.01  # the same of mean errors, in pixels
_MOST_RUNS, _MOST_SWAPS = 20_000, 1000  # that are listed
_CELLS, _FEW_CELLS = (24, 14), (12, 7)  # columns and rows of an image
_MANY_VIEWS = 64  # more have few cells
_LEAST_BINS, _MOST_BINS, _VIEW_BINS = 10, 100, 1500  # of errors over time; in all views


def describe_detections(seen: Seen, shown: Ints, room: int) -> dict[str, Any] | None:
    """Return the detections for a page in at most `room` bytes; None where there is no room.

    shown: `[frame]` indices of the frames whose poses the page has.
    """
    recording = seen.recording
    of_all = max(1, int(recording.select(frames=shown).detected.sum()))
    each = of_all * (4 * len(recording.keypoints) + 6) / max(1, len(shown))

    def pack_frames(places: Ints) -> dict[str, Any]:
        cameras = map_in_threads(
            lambda view: _pack_camera(seen, view, shown[places]), range(len(recording.cameras))
        )
        return {"frames": pack(small_ints(places), delta=0), "cameras": list(cameras)}

    packed, index = fill_room(pack_frames, len(shown), int(2 * room / each), room)
    return packed if len(index) else None


def _pack_camera(seen: Seen, view: int, index: Ints) -> dict[str, Any]:
    """Return the detections of one view in frames `[frame]` (indices), by individual."""
    recording = seen.recording
    positions = mapped.take(recording.positions[view], index)
    frame, instance = np.nonzero(np.isfinite(positions[..., 0]).any(-1))
    individual = seen.matches.labels[view, index][frame, instance]
    order = np.lexsort((instance, frame, individual))
    frame, individual = frame[order], individual[order]
    pixels = positions[frame, instance[order]].astype(np.float64)
    width, height = recording.cameras[view].size
    scale = max(_PIXEL_STEP, max(width, height) / 15000)
    points = quantise(pixels, scale)
    points[(points == MISSING).any(-1)] = MISSING
    return {
        "frame": pack(small_ints(frame), delta=0),
        "individual": pack(individual.astype(np.int16), delta=0),
        "scale": scale,
        "points": pack(points, delta=0),
    }


def describe_identities(seen: Seen) -> dict[str, Any]:
    """Return the runs of frames of each individual in each view, and the swaps, for a page.

    Where there are very many runs, the shortest gaps between them are closed.
    """
    runs, closed = _close_gaps(_find_runs(seen))
    swaps = _find_swaps(seen)
    return {
        "runs": pack(small_ints(runs), delta=0),
        "closed": closed,
        "swaps": pack(small_ints(swaps[:_MOST_SWAPS]), delta=0),
        "swaps_total": len(swaps),
    }


def _find_runs(seen: Seen) -> Ints:
    """Return rows (view, individual, first, last frame number), in this order."""
    frames, labels = seen.recording.frames, seen.matches.labels
    step = usual_step(frames)
    found = []
    for view, of_view in enumerate(labels):
        there = np.zeros((seen.matches.individuals, len(frames)), dtype=bool)
        frame, instance = np.nonzero(of_view >= 0)
        there[of_view[frame, instance], frame] = True
        who, when = np.nonzero(there)
        begins = np.ones(len(who), dtype=bool)
        begins[1:] = (np.diff(who) != 0) | (np.diff(frames[when]) > step)
        first, last = frames[when[begins]], frames[when[np.roll(begins, -1)]]
        found.append(np.column_stack([np.full(len(first), view), who[begins], first, last]))
    return np.concatenate(found)


def _close_gaps(runs: Ints) -> tuple[Ints, int]:
    """Return the runs without their shortest gaps, and the longest gap that was closed.

    Of runs that cannot be that few by this, the longest are kept.
    """
    if len(runs) <= _MOST_RUNS:
        return runs, 0
    same = (np.diff(runs[:, :2], axis=0) == 0).all(1)
    gap = np.where(same, runs[1:, 2] - runs[:-1, 3], np.iinfo(np.int64).max)
    ordered = np.sort(gap[same])
    closed = int(ordered[min(len(runs) - _MOST_RUNS, len(ordered)) - 1]) if len(ordered) else 0
    begins = np.append(True, gap > closed)
    merged = runs[begins].copy()
    merged[:, 3] = runs[np.roll(begins, -1), 3]
    longest = np.argsort(merged[:, 2] - merged[:, 3], kind="stable")[:_MOST_RUNS]
    merged = merged[np.sort(longest)]
    return merged, closed


def _find_swaps(seen: Seen) -> Ints:
    """Return rows (view, frame number, individual before, individual from then on), by frame.

    Of files that name individuals: where one name goes over to another individual.
    """
    rows = []
    for view in np.flatnonzero(seen.recording.tracked):
        labels = seen.matches.labels[view].T  # [instance, frame]
        instance, frame = np.nonzero(labels >= 0)
        who = labels[instance, frame]
        swap = np.flatnonzero((np.diff(instance) == 0) & (np.diff(who) != 0))
        number = seen.recording.frames[frame[swap + 1]]
        rows.append(np.column_stack([np.full(len(swap), view), number, who[swap], who[swap + 1]]))
    swaps = np.concatenate(rows) if rows else np.zeros((0, 4), dtype=np.int64)
    return swaps[np.argsort(swaps[:, 1], kind="stable")]


def describe_fits(seen: Seen, rig: CameraRig, poses: Poses3D) -> dict[str, Any]:
    """Return what a page shows of the errors of each view.

    Of the frames that run.json tells of, or fewer where there are very many keypoints.
    """
    recording, matches = seen.recording, seen.matches
    each = max(1, len(rig) * matches.individuals * len(recording.keypoints))
    count = min(REPORT_FRAMES, max(1, MOST_KEYPOINTS // each))
    frames = evenly_spaced(np.arange(len(recording.frames)), count)
    residuals = find_residuals(recording, matches, rig, poses.raw, frames)
    columns, rows = _CELLS if len(rig) <= _MANY_VIEWS else _FEW_CELLS
    views = range(len(rig))

    def grid(view: int) -> tuple[Ints, Floats, Ints]:
        camera = recording.cameras[view]
        unassigned = matches.labels[view, frames] < 0
        pixels = mapped.take(recording.positions[view], frames)[unassigned].reshape(-1, 2).T
        unmatched = _sum_in_cells(camera, pixels, (columns, rows))[0]
        gap = residuals.gap[view].reshape(2, -1)
        pixels = np.where(np.isfinite(gap).all(0), residuals.pixels[view].reshape(2, -1), np.nan)
        counts, *sums = _sum_in_cells(camera, pixels, (columns, rows), *gap)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.stack(sums, axis=-1) / counts[..., None]
        return counts, mean, unmatched

    counts, mean, unmatched = map(np.stack, zip(*map_in_threads(grid, views), strict=True))
    distance = residuals.distance
    joints = np.moveaxis(distance, -1, 1).reshape(len(rig), len(recording.keypoints), -1)
    most = max(_LEAST_BINS, min(_MOST_BINS, _VIEW_BINS // len(rig)))
    edges = split_evenly(len(frames), most)
    bins = [distance[:, first:last].reshape(len(rig), -1) for first, last in pairwise(edges)]
    median, p95 = np.stack([quantiles(each, (0.5, 0.95)) for each in bins], axis=-1)
    return {
        "columns": columns,
        "rows": rows,
        "counts": pack(small_ints(counts)),
        "unmatched": pack(small_ints(unmatched)),
        "residual_scale": _RESIDUAL_STEP,
        "residuals": pack(quantise(mean, _RESIDUAL_STEP)),
        "by_joint": pack_floats(quantiles(joints, (0.5,))[0]),
        "bins": recording.frames[frames[edges[:-1]]].tolist(),
        "median": pack_floats(median),
        "p95": pack_floats(p95),
        "looked_at": len(frames),
    }


def _sum_in_cells(
    camera: Camera, pixels: Floats, grid: tuple[int, int], *weights: Floats
) -> list[NDArray[Any]]:
    """Return `[row, column]` the number of pixels in each cell of an image, and sums of weights.

    pixels: `[2, N]`, NaN = missing; those outside the image count at the edge. grid: columns and
        rows. weights: `[N]` each.
    """
    width, height = camera.size
    size = (width or 2 * camera.matrix[0, 2] or 1, height or 2 * camera.matrix[1, 2] or 1)
    known = np.isfinite(pixels).all(0)
    column, row = (
        np.floor(along / length * number).clip(0, number - 1).astype(np.int64)
        for along, length, number in zip(pixels[:, known], size, grid, strict=True)
    )
    columns, rows = grid
    cell = row * columns + column
    of_each = (None, *(weight[known] for weight in weights))
    return [np.bincount(cell, of, columns * rows).reshape(rows, columns) for of in of_each]
