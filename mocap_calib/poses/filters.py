"""The classic filters of poses over time: Butterworth, median, Savitzky-Golay.

Each joint's track is cut where it is missing, or where frames are: nothing passes a gap.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy import ndimage, signal

from mocap_calib.config import FilterConfig
from mocap_calib.errors import MismatchError, argument
from mocap_calib.results import Poses3D
from mocap_calib.types import Bools, Floats, Ints


def filter_poses(poses: Poses3D, config: FilterConfig, *, fps: float | None = None) -> Poses3D:
    """Return the poses filtered over time; what is missing stays missing.

    fps: frames per second, for the cutoff of the Butterworth filter. The uncertainty of a filtered
    position is not known: the covariance is left out. A piece between gaps that is shorter than the
    filter stays as it is.

    Raises MismatchError for a cutoff without a rate, or one that is not below half of it, and a
    window that is longer than the recording.
    """
    longest = max(len(poses.frames), FilterConfig.window)
    if config.method != "butterworth" and config.window > longest:
        raise MismatchError(
            "", f"a window of at most {longest} frames", config.window, "give a shorter one"
        )
    run, least = _choose_filter(config, fps)
    positions = poses.positions.copy()
    for individual in range(positions.shape[1]):
        for keypoint in range(positions.shape[2]):
            track = positions[:, individual, keypoint]
            for piece in _pieces(track, poses.frames):
                if piece.stop - piece.start >= least:
                    track[piece] = run(track[piece])
    return replace(poses, positions=positions, covariance=np.zeros(0, np.float32))


def _choose_filter(
    config: FilterConfig, fps: float | None
) -> tuple[Callable[[Floats], Floats], int]:
    """Return what filters a piece `[frame, 3]`, and how many frames it needs."""
    if config.method == "median":
        return lambda track: ndimage.median_filter(track, (config.window, 1), mode="nearest"), 2
    if config.method == "savgol":
        window, order = config.window, config.polynomial
        if order >= window:
            raise MismatchError(
                "",
                f"a polynomial of an order below the window of {window} frames",
                order,
                "give a longer window",
            )
        return lambda track: signal.savgol_filter(track, window, order, axis=0), window
    sections = _design_butterworth(config, fps)
    least = 3 * (2 * len(sections) + 1)  # what scipy puts before and after
    return lambda track: signal.sosfiltfilt(sections, track, axis=0, padlen=least), least + 1


def _design_butterworth(config: FilterConfig, fps: float | None) -> Floats:
    """Return second-order sections of a low pass that runs forwards and backwards.

    Both runs together have the order and the cutoff that were asked for (Winter 2009, Biomechanics
    and Motor Control of Human Movement, 2.2.4.4).
    """
    if fps is None:
        raise MismatchError(
            "", "frames per second for the cutoff in Hz", "none", f"give {argument('fps')}"
        )
    if not 0 < config.cutoff < fps / 2:
        raise MismatchError(
            "",
            f"a cutoff below {fps / 2:g} Hz, half of the frames per second",
            f"{config.cutoff:g}",
            "choose a lower one",
        )
    order = config.order // 2
    wider = (np.sqrt(2) - 1) ** (1 / (2 * order))
    edge = np.arctan(np.tan(np.pi * config.cutoff / fps) / wider) * 2 / np.pi
    return np.asarray(signal.butter(order, edge, output="sos"))


def _pieces(track: Floats, frames: Ints) -> Iterator[slice]:
    """Yield the parts of a track `[frame, 3]` without gaps. frames: `[frame]` numbers."""
    known: Bools = np.asarray(np.isfinite(track).all(axis=1))
    usual = np.median(np.diff(frames)) if len(frames) > 1 else 1
    joined = known[1:] & known[:-1] & (np.diff(frames) == usual)
    starts = np.flatnonzero(known & ~np.concatenate([[False], joined]))
    ends = np.flatnonzero(known & ~np.concatenate([joined, [False]]))
    for start, end in zip(starts, ends, strict=True):
        yield slice(int(start), int(end) + 1)
