"""List the detections of triangulated points, for other bundle adjusters."""

from functools import partial

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.results import Matches, ObservedPoints
from mocap_calib.rig.noise import view_noise
from mocap_calib.rig.triangulate import frame_blocks, triangulate_frames
from mocap_calib.types import CameraRig, Floats, Ints, Recording


def observe_points(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    config: TriangulateConfig = TriangulateConfig(),
) -> ObservedPoints:
    """Return the points that `triangulate` finds, and the detections that each was made of.

    The points are in the order frame, individual, keypoint.
    """
    noise = view_noise(recording, rig, matches, config)
    points = matches.individuals * len(recording.keypoints)
    work = partial(
        _observe_block, recording=recording, rig=rig, matches=matches, noise=noise, config=config
    )
    parts = list(map_in_threads(work, frame_blocks(len(recording.frames), points)))
    counts = [len(part.positions) for part in parts]
    starts = np.cumsum([0, *counts[:-1]])
    return ObservedPoints(
        positions=np.concatenate([part.positions for part in parts]),
        view=np.concatenate([part.view for part in parts]),
        point=np.concatenate(
            [part.point + start for part, start in zip(parts, starts, strict=True)]
        ),
        pixels=np.concatenate([part.pixels for part in parts]),
    )


def _observe_block(
    frames: Ints,
    *,
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    noise: Floats,
    config: TriangulateConfig,
) -> ObservedPoints:
    """Return the points in the frames with these indices, with their detections."""
    seen, points, used = triangulate_frames(
        frames, recording=recording, rig=rig, matches=matches, noise=noise, config=config
    )
    known = np.isfinite(points[0])
    view, point = np.nonzero(used[:, known])
    return ObservedPoints(
        positions=points[:, known].T,
        view=view,
        point=point,
        pixels=seen.pixels[:, :, known][view, :, point],
    )
