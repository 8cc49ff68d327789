"""What the cameras saw, in as many of the frames of a page as there is room for."""

from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import pack, quantise, small_ints
from mocap_calib.html_report.frames import fill_room
from mocap_calib.html_report.source import Seen
from mocap_calib.types import Ints

_CONFIG = ReportConfig()


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
    scale = max(_CONFIG.pixel_step, max(width, height) / 15000)
    points = quantise(pixels, scale)
    points[(points == -32768).any(-1)] = -32768
    return {
        "frame": pack(small_ints(frame), delta=0),
        "individual": pack(individual.astype(np.int16), delta=0),
        "scale": scale,
        "points": pack(points, delta=0),
    }
