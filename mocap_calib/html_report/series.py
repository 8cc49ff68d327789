"""What bodies do over time: lengths of bones, height, speed, in bins of frames."""

from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import pack_floats
from mocap_calib.html_report.frames import quantiles, split_evenly
from mocap_calib.html_report.source import ReportSource
from mocap_calib.kinematics import define, frame_velocity
from mocap_calib.recording.joints import choose_skeleton
from mocap_calib.recording.sampling import usual_step
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_CONFIG = ReportConfig()


def describe_series(source: ReportSource) -> dict[str, Any]:
    """Return the series for a page: medians over some consecutive frames of each bin."""
    poses = source.poses
    total, individuals, joints = poses.positions.shape[:3]
    numbers = max(1, individuals * (len(source.edges) + 2))
    bins = max(_CONFIG.least_bins, min(_CONFIG.series_bins, _CONFIG.series_numbers // numbers))
    edges = split_evenly(total, bins)
    begin, end = edges[:-1], edges[1:]
    each = max(3, _CONFIG.most_keypoints // max(1, len(begin) * individuals * joints))
    looked = min(int((end - begin).max(initial=0)), each)
    # and a frame before and after these: a frame by itself has no speed
    index = begin[:, None] + np.arange(-1, looked + 1)
    frames, points = _take_frames(poses, index)
    speeds = _speeds(source, points, frames)[:, 1:-1]
    points = points[:, 1:-1]
    outside = index[:, 1:-1] >= end[:, None]
    points[outside] = speeds[outside] = np.nan
    pairs = np.array(source.edges, dtype=np.int64).reshape(-1, 2)
    bones = np.linalg.norm(points[..., pairs[:, 0], :] - points[..., pairs[:, 1], :], axis=-1)
    return {
        "bins": poses.frames[begin].tolist(),
        "bones": pack_floats(np.moveaxis(_medians(bones), 0, -1)),
        "height": _heights(source, points),
        "speed": pack_floats(_medians(speeds).T),
    }


def _take_frames(poses: Poses3D, index: Ints) -> tuple[Ints, Floats]:
    """Return the numbers `[bin, frame]` of frames (indices), and their positions.

    What is before the first frame and after the last has numbers that go on, and no positions.
    """
    last = len(poses.frames) - 1
    inside = index.clip(0, last)
    points = mapped.take(poses.positions, inside.ravel())
    points = points.reshape(*inside.shape, *points.shape[1:])
    points[inside != index] = np.nan
    return poses.frames[inside] + (index - inside) * usual_step(poses.frames), points


def _medians(values: Floats) -> Floats:
    """Return medians `[bin, ...]` of values `[bin, frame, ...]`."""
    return quantiles(np.moveaxis(values, 1, -1), (0.5,))[0]


def _heights(source: ReportSource, points: Floats) -> dict[str, Any] | None:
    """Return the height of the highest joint above the floor; None where that is not known."""
    world = source.poses.world
    if not (np.isfinite(world.up).all() and np.isfinite(world.floor).all()):
        return None
    height = (points - world.floor) @ world.up
    highest = np.where(np.isfinite(height), height, -np.inf).max(-1, initial=-np.inf)
    return pack_floats(_medians(np.where(np.isfinite(highest), highest, np.nan)).T)


def _speeds(source: ReportSource, points: Floats, frames: Ints) -> Floats:
    """Return the speeds of trunks `[bin, frame, individual]`, per second where fps is known.

    points: `[bin, frame, individual, keypoint, 3]`. frames: `[bin, frame]` numbers.
    """
    names = source.poses.keypoints
    trunk = list(define(names, choose_skeleton(names)).trunk) or list(range(len(names)))
    own = points[..., trunk, :]
    velocity = (
        np.stack(
            [frame_velocity(number, of_bin) for number, of_bin in zip(frames, own, strict=True)]
        )
        if len(own)
        else own
    )
    rate = source.fps if np.isfinite(source.fps) else 1.0
    return rate * np.linalg.norm(mean_of_known(velocity, 3), axis=-1)
