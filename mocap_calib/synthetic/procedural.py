"""Bodies made from a description alone: bones, body plans and postures in a skeleton's file, no data.

A skeleton's YAML file may carry a section `body` (mocap_calib/skeletons/quadruped.yaml shows one). Each bone is named by the joint at
its far end and has a vector from its parent in the rest pose (x forward, y left, z up). Its angles turn it and all beyond: pitch
raises the nose and swings a hanging leg forward, yaw turns to the left, roll swings a hanging left leg outward. The right side
mirrors the left. A posture gives ranges of angles, and cycles of the stride, in which the legs' phases and the spine go together.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.types import Floats, Ints, Skeleton

AXES = ("roll", "pitch", "yaw")
_PHASE_JITTER_DEG = 15.0  # of a joint within the stride
_ROOT = "root"

Angles = Mapping[tuple[str, str], tuple[float, ...]]


@dataclass(frozen=True)
class Posture:
    """One way to hold the body.

    opposed: degrees (least, most) between the strides of left and right; angles: (bone without its side unless only one
    is meant, axis) -> (least, most) or (middle, amplitude, phase), in degrees.
    """

    weight: float
    opposed: tuple[float, float]
    angles: Angles


@dataclass(frozen=True)
class Body:
    """A parsed section `body`.

    joints: all of the skeleton, in its order; parent: `[joint]` index, -1 at the root; order: `[joint]` parents first; rest:
    `[joint, 3]` from the parent, zero at the root; twin: `[joint]` the left one of a pair stands for both; right: `[joint]` whether
    it mirrors one; plans: `[plan, joint]` factors on the lengths; spread: log-normal, of a length; direction: degrees.
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
    postures: tuple[Posture, ...]


def parse_body(fields: Mapping[str, Any], skeleton: Skeleton) -> Body:
    """The section `body` of a skeleton's file. Raises FormatError where bones are missing or names are unknown."""
    index = {name: k for k, name in enumerate(skeleton.keypoints)}
    twin = np.arange(len(index))
    for left, right in skeleton.symmetries:
        twin[right] = left
    parent, order = _tree(skeleton)
    bones = fields.get("bones") or {}
    rest, lacking = np.zeros((len(index), 3)), []
    for k in order[1:]:
        name = skeleton.keypoints[int(twin[k])]
        if name in bones:
            rest[k] = np.array(bones[name], dtype=np.float64) * ([1, -1, 1] if twin[k] != k else 1)
        else:
            lacking.append(name)
    strangers = sorted(set(bones) - set(index))
    if lacking or strangers:
        raise FormatError(
            f"skeleton {skeleton.name}: body: expected a bone to each joint, lacking {lacking or 'none'}, unknown {strangers or 'none'}"
        )
    plans = np.stack(
        [_factors(plan or {}, skeleton) for plan in (fields.get("plans") or {"only": {}}).values()]
    )
    always = _angles(fields.get("always") or {}, skeleton)
    postures = tuple(
        _posture(posture or {}, always, skeleton)
        for posture in (fields.get("postures") or {"only": {}}).values()
    )
    right = (twin != np.arange(len(index))).astype(np.float64)
    return Body(
        skeleton.keypoints,
        parent,
        order,
        rest,
        twin,
        right,
        plans,
        float(fields.get("spread", 0.1)),
        float(fields.get("direction", 0.0)),
        postures,
    )


def _tree(skeleton: Skeleton) -> tuple[Ints, Ints]:
    """Parent of each joint and an order in which parents come first. Raises FormatError where the edges are no tree over all joints."""
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
            f"skeleton {skeleton.name}: body: expected edges that are one tree over all joints, found {len(roots)} roots: {names}"
        )
    return parent, np.array(order)


def sideless(name: str) -> str:
    """`left_elbow` -> `elbow`."""
    return name.removeprefix("left_").removeprefix("right_")


def _factors(plan: Mapping[str, Any], skeleton: Skeleton) -> Floats:
    """`[joint]` factors of a body plan. Raises FormatError."""
    _check_names(plan, skeleton)
    return np.array(
        [float(plan.get(name, plan.get(sideless(name), 1.0))) for name in skeleton.keypoints]
    )


def _posture(fields: Mapping[str, Any], always: Angles, skeleton: Skeleton) -> Posture:
    least, most = fields.get("opposed") or (0.0, 0.0)
    return Posture(
        float(fields.get("weight", 1.0)),
        (float(least), float(most)),
        {**always, **_angles(fields.get("angles") or {}, skeleton)},
    )


def _angles(fields: Mapping[str, Any], skeleton: Skeleton) -> Angles:
    """Ranges and cycles of angles by bone and axis. Raises FormatError."""
    found = {}
    for key, numbers in fields.items():
        bone, _, axis = str(key).partition(".")
        if axis not in AXES or not isinstance(numbers, list) or len(numbers) not in (2, 3):
            raise FormatError(
                f"skeleton {skeleton.name}: body: {key}: expected bone.(roll|pitch|yaw): [least, most] or [middle, amplitude, phase]"
            )
        found[bone, axis] = tuple(float(number) for number in numbers)
    _check_names({bone: 0 for bone, _ in found}, skeleton)
    return found


def _check_names(names: Mapping[str, Any], skeleton: Skeleton) -> None:
    known = {_ROOT, *skeleton.keypoints, *map(sideless, skeleton.keypoints)}
    if strangers := sorted(set(names) - known):
        raise FormatError(
            f"skeleton {skeleton.name}: body: expected names of its joints, found {', '.join(strangers)}"
        )


def sample_bodies(rng: np.random.Generator, body: Body, count: int) -> Floats:
    """`[pose, joint, 3]` random bodies in random postures, +z up, +x forward, in the unit of the bones; the root is at the origin."""
    bones = sample_bones(rng, body, count)
    turn, facing = sample_turns(rng, body, count)
    return assemble(body, bones, turn, facing)


def sample_bones(rng: np.random.Generator, body: Body, count: int) -> Floats:
    """`[pose, joint, 3]` vectors from each joint's parent in the rest pose: a plan, with lengths and directions spread; both sides alike."""
    plan = body.plans[rng.integers(len(body.plans), size=count)]
    length = plan * np.exp(body.spread * rng.normal(size=plan.shape))
    bend = np.deg2rad(body.direction) * rng.normal(size=(*plan.shape, 3))
    rest = body.rest[body.twin] * length[:, body.twin, None]
    rest = np.einsum("pkij,pkj->pki", _matrix(bend[:, body.twin]), rest)
    middle = ~np.isin(
        np.arange(len(body.joints)),
        np.concatenate([np.flatnonzero(body.right), body.twin[body.right > 0]]),
    )
    rest[:, middle, 1] = body.rest[middle, 1]  # what has no twin stays in the plane of symmetry
    rest[:, body.right > 0, 1] *= -1
    return rest


def sample_turns(rng: np.random.Generator, body: Body, count: int) -> tuple[Floats, Floats]:
    """Angles `[pose, joint, 3]` (roll, pitch, yaw in radians, not yet mirrored) of each bone, and `[pose, 3]` of the whole body."""
    weight = np.array([posture.weight for posture in body.postures])
    which = rng.choice(len(weight), size=count, p=weight / weight.sum())
    turn, facing = np.zeros((count, len(body.joints), 3)), np.zeros((count, 3))
    for k, posture in enumerate(body.postures):
        mine = np.flatnonzero(which == k)
        stride = rng.uniform(0, 360, len(mine))
        after = rng.uniform(*posture.opposed, len(mine))
        vigour = rng.uniform(0.5, 1.15, len(mine))
        for (bone, axis), numbers in posture.angles.items():
            column = AXES.index(axis)
            if bone == _ROOT:
                facing[mine, column] = _draw(rng, numbers, stride, vigour)
            for joint in _named(body, bone):
                turn[mine, joint, column] = _draw(
                    rng, numbers, stride + after * body.right[joint], vigour
                )
    return np.deg2rad(turn), np.deg2rad(facing)


def _named(body: Body, bone: str) -> list[int]:
    """The joints that a name stands for: itself, or both sides."""
    return [k for k, name in enumerate(body.joints) if bone in (name, sideless(name))]


def _draw(
    rng: np.random.Generator, numbers: tuple[float, ...], stride: Floats, vigour: Floats
) -> Floats:
    """Degrees: within a range, the middle likelier; or at a place in the stride."""
    if len(numbers) == 2:
        return numbers[0] + (numbers[1] - numbers[0]) * rng.random((2, len(stride))).mean(0)
    middle, amplitude, phase = numbers
    jitter = _PHASE_JITTER_DEG * rng.normal(size=len(stride))
    return vigour * (
        middle + amplitude * np.cos(np.deg2rad(stride + phase + jitter))
    ) + 0.15 * amplitude * rng.normal(size=len(stride))


def assemble(body: Body, bones: Floats, turn: Floats, facing: Floats) -> Floats:
    """Forward kinematics: `[pose, joint, 3]` from bones `[pose, joint, 3]`, their angles, and those of the whole `[pose, 3]`."""
    mirror = np.where(body.right[:, None] > 0, [-1.0, 1.0, -1.0], 1.0)
    own = _matrix(turn * mirror)
    frame = np.empty_like(own)
    place = np.zeros_like(bones)
    root, *others = body.order.tolist()
    frame[:, root] = _matrix(facing) @ own[:, root]
    for k in others:
        above = int(body.parent[k])
        frame[:, k] = frame[:, above] @ own[:, k]
        place[:, k] = place[:, above] + np.einsum("pij,pj->pi", frame[:, k], bones[:, k])
    return place


def _matrix(angles: Floats) -> Floats:
    """`[..., 3, 3]` yaw about z after pitch about -y after roll about x, of `[..., 3]` angles (roll, pitch, yaw)."""
    (cr, cp, cy), (sr, sp, sy) = (
        np.moveaxis(np.cos(angles), -1, 0),
        np.moveaxis(np.sin(angles), -1, 0),
    )
    rows = [
        [cy * cp, -sy * cr - cy * sp * sr, sy * sr - cy * sp * cr],
        [sy * cp, cy * cr - sy * sp * sr, -cy * sr - sy * sp * cr],
        [sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)
