"""What a keypoint format may have no place for, and which views have it: a writer says what it loses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mocap_calib.io.file import NO_SCORE
from mocap_calib.types import Keypoints2D


@dataclass(frozen=True)
class Loss:
    """`what` is lost, in words that follow "does not hold"; `has`: whether views have it."""

    what: str
    has: Callable[[Sequence[Keypoints2D]], bool]


def _followed(views: Sequence[Keypoints2D]) -> bool:
    return any(view.tracked and view.positions.shape[1] > 1 for view in views)


NAMES = Loss("the names of keypoints", bool)
FOLLOWED = Loss("who is who from frame to frame", _followed)
# one column for all cameras says either individual or instance
MIXED = Loss(
    "who is who from frame to frame, as one of the cameras does not say it",
    lambda views: _followed(views) and not all(v.tracked for v in views),
)
SIZES = Loss("image sizes", lambda views: any(view.image_size != (0, 0) for view in views))
GAPS = Loss(
    "which frames are absent: they become empty ones",
    lambda views: any(len(v.frames) <= v.frames.max(initial=-1) for v in views),
)
SCORES = Loss(
    "that there are no scores: each point gets 1",
    lambda views: any(NO_SCORE in view.remarks for view in views),
)
