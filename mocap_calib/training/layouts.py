"""Which joints of a skeleton detectors have, or hide, together."""

import torch
from torch import Tensor

from mocap_calib.types import Skeleton


def symmetry_classes(skeleton: Skeleton) -> list[tuple[int, ...]]:
    """Return the joints that a layout has together: pairs of left and right, and single joints."""
    paired = {joint for pair in skeleton.symmetries for joint in pair}
    single = [(joint,) for joint in range(len(skeleton.keypoints)) if joint not in paired]
    return [*skeleton.symmetries, *single]


def class_of_joint(classes: list[tuple[int, ...]]) -> Tensor:
    """Return the index `[J]` of each joint's class of `symmetry_classes`."""
    index = torch.empty(sum(map(len, classes)), dtype=torch.long)
    for k, joints in enumerate(classes):
        index[list(joints)] = k
    return index


def limbs(skeleton: Skeleton) -> Tensor:
    """Return the joints `[edge, J]` (bool) at and beyond the child of each edge."""
    beyond = torch.zeros(len(skeleton.edges), len(skeleton.keypoints), dtype=torch.bool)
    for row, (_, root) in enumerate(skeleton.edges):
        beyond[row, root] = True
        for parent, child in skeleton.edges:
            beyond[row, child] |= beyond[row, parent]
    return beyond
