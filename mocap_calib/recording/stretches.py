"""Choose stretches of consecutive frames, in which it shows whether clocks differ."""

import numpy as np

from mocap_calib.config import SyncConfig
from mocap_calib.types import Ints, Recording


def choose_stretches(recording: Recording, config: SyncConfig) -> Ints:
    """Return the frames `[stretch, frame]` (indices, -1 = not in the recording) of stretches.

    Within a stretch, frames follow each other by the usual distance of frame numbers. A short
    recording is one stretch; of a long one there are several, which begin with its first frame and
    are spread over it, each several windows long, and no more in all than the configuration says.
    """
    frames = recording.frames
    step = usual_step(frames)
    first = frames.min()  # frames may come in any order
    position = np.round((frames - first) / step).astype(np.int64)
    on_grid = first + position * step == frames
    length = int(position.max()) + 1
    budget = _frame_budget(recording, config)
    each = max(int(config.stretch_windows * config.window), 1)
    count = max(1, budget // each)
    if length <= max(budget, each):
        starts, each = np.zeros(1, dtype=np.int64), length
    else:
        starts = np.unique(np.linspace(0, max(length - each, 0), count).astype(np.int64))
    index = np.full(length, -1, dtype=np.int64)
    index[position[on_grid]] = np.flatnonzero(on_grid)
    return index[starts[:, None] + np.arange(min(each, length))]


def usual_step(frames: Ints) -> int:
    """Return by how much frame numbers `[frame]` go up mostly: these frames follow each other."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1


def _frame_budget(recording: Recording, config: SyncConfig) -> int:
    """Return how many frames have as many detections in all views as are looked at."""
    total = len(recording.frames)
    some = recording.select(frames=np.arange(0, total, max(1, total // 200)))
    detections = some.detected.sum() / max(len(some.frames), 1)
    return int(min(config.frames, config.detections / max(detections, 1.0)))
