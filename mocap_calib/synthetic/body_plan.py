"""Read the section `body` of a skeleton's file: bones, body plans and postures.

mocap_calib/skeletons/quadruped.yaml shows one. Each bone is named by the joint at its far end and
has a vector from its parent in the rest pose (x forward, y left, z up). Its angles turn it and all
beyond: pitch raises the nose and swings a hanging leg forward, yaw turns to the left, roll swings a
hanging left leg outward. The right side mirrors the left. A posture gives ranges of angles, and
cycles of the stride, in which the legs' phases and the spine go together.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.types import Floats, Ints, Skeleton

AXES = ("roll", "pitch", "yaw")
ROOT = "root"  # the name of the whole body among the bones

Angles = Mapping[tuple[str, str], tuple[float, ...]]


@dataclass(frozen=True)
class PostureRange:
    """One way to hold the body, by its name.

    opposed: degrees (least, most) between the strides of left and right.
    angles: (bone without its side unless only one is meant, axis) -> (least, most) or (middle,
        amplitude, phase), in degrees.
    """

    name: str
    weight: float
    opposed: tuple[float, float]
    angles: Angles


@dataclass(frozen=True)
class BodyPlan:
    """A parsed section `body`.

    joints: all of the skeleton, in its order.
    parent: `[joint]` index, -1 at the root.
    order: `[joint]` indices, parents first.
    rest: `[joint, 3]` from the parent in the rest pose, zero at the root.
    twin: `[joint]` the left one of a pair stands for both.
    right: `[joint]` 1 where it mirrors its twin, else 0.
    plans: `[plan, joint]` factors on the lengths.
    spread: log-normal, of a length.
    direction: degrees by which a bone's direction varies.
    """

    joints: tuple[str, ...]
    parent: Ints
    order: Ints
    rest: Floats
    twin: Ints
    right: Floats
    plans: Floats
    spread: float
    direction: float
    postures: tuple[PostureRange, ...]


def parse_body(fields: Mapping[str, Any], skeleton: Skeleton) -> BodyPlan:
    """Return the parsed section `body` of a skeleton's file.

    Raises FormatError where bones are missing, names are unknown, or values are no numbers.
    """
    try:
        return _parse_plan(fields, skeleton)
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        raise FormatError(
            f"skeleton {skeleton.name}",
            "a section `body` as docs/skeletons.md has it",
            f"an error ({one_line(error)})",
            "mend that place",
        ) from None


def _parse_plan(fields: Mapping[str, Any], skeleton: Skeleton) -> BodyPlan:
    """Return the parsed section. Raises FormatError, and what Python raises of other types."""
    parent, order = _tree(skeleton)
    twin = _left_twins(skeleton)
    rest = _rest_pose(fields.get("bones") or {}, skeleton, order=order, twin=twin)
    plans = fields.get("plans") or {"only": {}}
    always = _parse_angles(fields.get("always") or {}, skeleton)
    postures = fields.get("postures") or {"only": {}}
    return BodyPlan(
        joints=skeleton.keypoints,
        parent=parent,
        order=order,
        rest=rest,
        twin=twin,
        right=(twin != np.arange(len(twin))).astype(np.float64),
        plans=np.stack([_parse_factors(plan or {}, skeleton) for plan in plans.values()]),
        spread=float(fields.get("spread", 0.1)),
        direction=float(fields.get("direction", 0.0)),
        postures=tuple(
            _parse_posture(str(name), posture or {}, always, skeleton)
            for name, posture in postures.items()
        ),
    )


def without_side(name: str) -> str:
    """Return `elbow` for `left_elbow`."""
    return name.removeprefix("left_").removeprefix("right_")


def _tree(skeleton: Skeleton) -> tuple[Ints, Ints]:
    """Return the parent of each joint `[joint]` and an order `[joint]` with parents first.

    Raises FormatError where the edges are no tree over all joints.
    """
    parent = np.full(len(skeleton.keypoints), -1, dtype=np.int64)
    for above, below in skeleton.edges:
        parent[below] = above
    roots = np.flatnonzero(parent < 0)
    order = [int(roots[0])]
    for k in order:  # grows while it is walked
        order += np.flatnonzero(parent == k).tolist()
    if len(roots) != 1 or len(order) != len(parent):
        names = ", ".join(skeleton.keypoints[k] for k in roots)
        raise FormatError(
            f"skeleton {skeleton.name}: body",
            "edges that are one tree over all joints",
            f"{len(roots)} roots: {names}",
            "add or remove edges",
        )
    return parent, np.array(order)


def _left_twins(skeleton: Skeleton) -> Ints:
    """Return for each joint `[joint]` the left one of its pair, or itself."""
    twin = np.arange(len(skeleton.keypoints))
    for left, right in skeleton.symmetries:
        twin[right] = left
    return twin


def _rest_pose(bones: Mapping[str, Any], skeleton: Skeleton, *, order: Ints, twin: Ints) -> Floats:
    """Return the vector `[joint, 3]` from each joint's parent, zero at the root.

    Raises FormatError where bones are missing or names are unknown.
    """
    rest = np.zeros((len(skeleton.keypoints), 3))
    lacking = []
    for k in order[1:]:
        name = skeleton.keypoints[int(twin[k])]
        mirror = [1, -1, 1] if twin[k] != k else 1
        if name in bones:
            rest[k] = np.array(bones[name], dtype=np.float64) * mirror
        else:
            lacking.append(name)
    unknown = sorted(set(bones) - set(skeleton.keypoints))
    if lacking or unknown:
        raise FormatError(
            f"skeleton {skeleton.name}: body",
            "a bone to each joint",
            f"none to {lacking or 'none'}, and unknown {unknown or 'none'}",
            "add or rename bones",
        )
    return rest


def _parse_factors(plan: Mapping[str, Any], skeleton: Skeleton) -> Floats:
    """Return the factors `[joint]` on the lengths of a body plan. Raises FormatError."""
    _check_names(plan, skeleton)
    factors = [plan.get(name, plan.get(without_side(name), 1.0)) for name in skeleton.keypoints]
    return np.array([float(factor) for factor in factors])


def _parse_posture(
    name: str, fields: Mapping[str, Any], always: Angles, skeleton: Skeleton
) -> PostureRange:
    """Return a posture, with the angles that always hold. Raises FormatError."""
    least, most = fields.get("opposed") or (0.0, 0.0)
    angles = _parse_angles(fields.get("angles") or {}, skeleton)
    return PostureRange(
        name=name,
        weight=float(fields.get("weight", 1.0)),
        opposed=(float(least), float(most)),
        angles={**always, **angles},
    )


def _parse_angles(fields: Mapping[str, Any], skeleton: Skeleton) -> Angles:
    """Return ranges and cycles of angles by bone and axis. Raises FormatError."""
    found = {}
    for key, numbers in fields.items():
        bone, _, axis = str(key).partition(".")
        if axis not in AXES or not isinstance(numbers, list) or len(numbers) not in (2, 3):
            raise FormatError(
                f"skeleton {skeleton.name}: body",
                "bone.(roll|pitch|yaw): [least, most] or [middle, amplitude, phase]",
                f"{key}: {numbers}",
                "correct that line",
            )
        found[bone, axis] = tuple(float(number) for number in numbers)
    _check_names([bone for bone, _ in found], skeleton)
    return found


def _check_names(names: Iterable[str], skeleton: Skeleton) -> None:
    """Raise FormatError where a name is of no joint of the skeleton."""
    known = {ROOT, *skeleton.keypoints, *map(without_side, skeleton.keypoints)}
    if unknown := sorted(set(names) - known):
        raise FormatError(
            f"skeleton {skeleton.name}: body",
            "names of its joints",
            ", ".join(unknown),
            "rename them",
        )
