"""Labels of detections: number the groups of each frame, and put names in place of labels."""

import numpy as np

from mocap_calib import mapped
from mocap_calib.results import Matches
from mocap_calib.types import Floats, Ints, Recording


def per_frame_labels(matches: Matches) -> Matches:
    """Return the same groups, numbered from 0 in each frame by their first detection.

    The names that groups have in other frames are forgotten. Labels are
    `[view, frame, instance]`, -1 = nobody.
    """
    labels = matches.labels
    return Matches(
        mapped.in_blocks(lambda block: _number_groups(labels[:, block]), labels.shape[1], axis=1)
    )


def _number_groups(labels: Ints) -> Ints:
    """Return the groups `[view, frame, instance]` of some frames, numbered in each frame."""
    views, frames, instances = labels.shape
    flat = np.swapaxes(labels, 0, 1).reshape(frames, views * instances)
    alike = flat[:, :, None] == flat[:, None]
    first = alike.argmax(-1)  # the first detection of the frame with the same label
    begins = (first == np.arange(views * instances)) & (flat >= 0)
    number = np.take_along_axis(begins.cumsum(1) - 1, first, axis=1)
    numbered = np.where(flat >= 0, number, -1)
    return np.swapaxes(numbered.reshape(frames, views, instances), 0, 1)


def matched_share(recording: Recording, matches: Matches) -> Floats:
    """Return the share `[view]` of the detections that are matched with somebody."""
    detected = recording.detected
    matched = detected & (matches.labels >= 0)
    return np.asarray(matched.sum((1, 2)) / np.maximum(detected.sum((1, 2)), 1))


def replace_labels(labels: Ints, names: Ints) -> Ints:
    """Return `names[label]` for each of the labels, an array of any shape; -1 stays -1.

    names: `[label]`.
    """
    return np.append(names, -1)[labels]  # the last entry is the one that -1 finds


def name_groups(groups: Ints, names: Ints) -> Ints:
    """Return the labels `[view, frame, instance]` of groups whose names are `[frame, group]`."""
    frame = np.arange(len(names))[:, None]
    padded = np.concatenate([names, np.full((len(names), 1), -1)], axis=1)
    return np.asarray(padded[frame, groups])
