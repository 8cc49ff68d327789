"""Name what a keypoint format may have no place for, and which views have it.

A writer says with these what it loses, or refuses it.
"""

from collections.abc import Sequence

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import NO_SCORE
from mocap_calib.io.format import Loss
from mocap_calib.types import Keypoints2D

Views = Sequence[Keypoints2D]


def _have_names(views: Views) -> bool:
    """Return whether there are views: keypoints always have names."""
    return bool(views)


def _follow_individuals(views: Views) -> bool:
    """Return whether a view follows several individuals from frame to frame."""
    return any(view.tracked and view.positions.shape[1] > 1 for view in views)


def _follow_in_some_cameras(views: Views) -> bool:
    """Return whether a view follows several individuals and another does not."""
    return _follow_individuals(views) and not all(view.tracked for view in views)


def _have_sizes(views: Views) -> bool:
    """Return whether the image size of a view is known."""
    return any(view.image_size != (0, 0) for view in views)


def _have_gaps(views: Views) -> bool:
    """Return whether a view lacks a frame between 0 and its last."""
    return any(len(view.frames) <= view.frames.max(initial=-1) for view in views)


def _lack_scores(views: Views) -> bool:
    """Return whether the file of a view had no scores."""
    return any(NO_SCORE in view.remarks for view in views)


NAMES = Loss("the names of keypoints", _have_names)
FOLLOWED = Loss("who is who from frame to frame", _follow_individuals)
# one column for all cameras says either individual or instance
MIXED = Loss(
    "who is who from frame to frame, as one of the cameras does not say it",
    _follow_in_some_cameras,
)
SIZES = Loss("image sizes", _have_sizes)
GAPS = Loss("which frames are absent: they become empty ones", _have_gaps)
SCORES = Loss("that there are no scores: each point gets 1", _lack_scores)


def require_followed(view: Keypoints2D, program: str) -> None:
    """Raise MismatchError where a view has several instances that are not followed.

    program: the format, whose individuals are followed by definition.
    """
    if not view.tracked and view.positions.shape[1] > 1:
        raise MismatchError(
            view.source,
            f"one individual or followed ones, as {program} has",
            "detections in any order",
            "choose csv or coco",
        )
