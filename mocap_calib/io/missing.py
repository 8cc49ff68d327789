"""Points that are missing, as the customs of files say it."""

from collections.abc import Mapping

import numpy as np

from mocap_calib.types import Bools, Floats

MISSING_CUSTOMS = ("(0, 0)", "(-1, -1)", "empty or NaN", "confidence 0")


def mark_missing(positions: Floats, confidence: Floats) -> tuple[Floats, Floats, dict[str, int]]:
    """Mark every point that a custom of files calls missing.

    positions: `[..., keypoint, 2]`. confidence: `[..., keypoint]`.

    Returns the positions with NaN and the confidences with 0 where a point is missing, and how many
    points each custom marks; of several customs the first counts. The customs are (0, 0) (OpenPose,
    COCO), (-1, -1) (DeepLabCut 3), not a number (counted in detections that have any point), and a
    confidence of 0 or below.
    """
    x, y = positions[..., 0], positions[..., 1]  # `all` over an axis of two is slow
    marks = (
        (x == 0) & (y == 0),
        (x == -1) & (y == -1),
        ~(np.isfinite(x) & np.isfinite(y) & np.isfinite(confidence)),
        confidence <= 0,
    )
    customs = dict(zip(MISSING_CUSTOMS, marks, strict=True))
    missing = np.logical_or.reduce(marks)
    counts = _count_customs(customs, ~missing)
    positions = np.where(missing[..., None], np.nan, positions)
    return positions, np.where(missing, 0.0, confidence), counts


def _count_customs(customs: Mapping[str, Bools], present: Bools) -> dict[str, int]:
    """Return how many points each custom marks as missing, of those that mark any.

    customs: name -> `[..., keypoint]` points that it marks. present: `[..., keypoint]`.
    """
    counts = {}
    counted = np.zeros_like(present)
    for name, marked in customs.items():
        if not marked.any():
            continue
        added = marked & ~counted
        if name == "empty or NaN":
            added &= present.any(-1, keepdims=True)
        if number := int(added.sum()):
            counts[name] = number
        counted |= marked
    return counts
