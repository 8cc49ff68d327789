"""The layout of the kernels of `poses`: tiles of frames, and groups of joints side by side."""

import numpy as np

from mocap_calib.types import Floats

AROUND = 2  # frames before and after all: as far as accelerations reach


def in_lanes(values: Floats, lanes: int) -> Floats:
    """Return values `[keypoint, frame, N]` as `[group, frame, N * lanes]`, see `in_tiles`."""
    joints, _, numbers = values.shape
    groups = -(-joints // lanes)
    padded = in_tiles(values.swapaxes(1, 2), lanes)
    found = np.zeros((groups * lanes, *padded.shape[1:]))
    found[:joints] = padded
    rows = found.reshape(groups, lanes, numbers, -1).transpose(0, 3, 2, 1)
    return np.ascontiguousarray(rows).reshape(groups, -1, numbers * lanes)


def from_lanes(rows: Floats, lanes: int, joints: int, frames: int) -> Floats:
    """Return values `[keypoint, frame, N]` of rows `[group, frame, N * lanes]`."""
    numbers = rows.shape[2] // lanes
    by_lane = rows[:, AROUND : AROUND + frames].reshape(len(rows), frames, numbers, lanes)
    own = by_lane.transpose(0, 3, 1, 2).reshape(-1, frames, numbers)
    return np.ascontiguousarray(own[:joints])


def in_tiles(values: Floats, lanes: int) -> Floats:
    """Return values `[..., frame]` with more frames, alike the first and the last.

    So many that they fill tiles, and two on each side.
    """
    frames = values.shape[-1]
    short = -frames % lanes
    found = np.empty((*values.shape[:-1], AROUND + frames + short + AROUND))
    found[..., :AROUND] = values[..., :1]
    found[..., AROUND : AROUND + frames] = values
    found[..., AROUND + frames :] = values[..., -1:]
    return found


def fill_tiles(values: Floats, found: Floats) -> None:
    """Set tiles `[tile, ..., lanes]` from values `[..., frame]`; what frames do not fill stays."""
    lanes = found.shape[-1]
    whole, rest = divmod(values.shape[-1], lanes)
    rows = values[..., : whole * lanes].reshape(*values.shape[:-1], whole, lanes)
    found[:whole] = np.moveaxis(rows, -2, 0)
    if rest:
        found[whole, ..., :rest] = values[..., whole * lanes :]
