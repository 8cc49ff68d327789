"""Bodies made from a description alone, no data: random bones in random postures.

The description is the section `body` of a skeleton's file; mocap_calib/skeletons/quadruped.yaml
shows one. Each bone is named by the joint at its far end and has a vector from its parent in the
rest pose (x forward, y left, z up). Its angles turn it and all beyond: pitch raises the nose and
swings a hanging leg forward, yaw turns to the left, roll swings a hanging left leg outward. The
right side mirrors the left. A posture gives ranges of angles, and cycles of the stride, in which
the legs' phases and the spine go together.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.types import Floats, Ints, Skeleton

AXES = ("roll", "pitch", "yaw")
ROOT = "root"  # the name of the whole body among the bones

_PHASE_JITTER_DEG = 15.0  # of a joint within the stride

Angles = Mapping[tuple[str, str], tuple[float, ...]]
_AngleNumbers = Annotated[list[float], msgspec.Meta(min_length=2, max_length=3)]


# --- the section of a file


class _PostureFields(msgspec.Struct):
    weight: float = 1.0
    opposed: tuple[float, float] | None = None
    angles: dict[str, _AngleNumbers] | None = None


class _BodyFields(msgspec.Struct):
    bones: dict[str, tuple[float, float, float]] = {}
    plans: dict[str, dict[str, float] | None] = {}
    always: dict[str, _AngleNumbers] = {}
    spread: float = 0.1
    direction: float = 0.0
    postures: dict[str, _PostureFields | None] = {}


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


def parse_body(section: Mapping[str, Any], skeleton: Skeleton) -> BodyPlan:
    """Return the parsed section `body` of a skeleton's file.

    Raises FormatError where bones are missing, names are unknown, or values are no numbers.
    """
    given = {name: value for name, value in section.items() if value is not None}
    try:
        fields = msgspec.convert(given, _BodyFields, strict=False)
    except msgspec.ValidationError as error:
        raise _refuse(
            skeleton, "a section as docs/skeletons.md has it", error, "correct it"
        ) from None
    parent, order = _tree(skeleton)
    twin = np.arange(len(parent))
    for left, right in skeleton.symmetries:
        twin[right] = left
    always = _parse_angles(fields.always, skeleton)
    postures = fields.postures or {"only": None}
    return BodyPlan(
        joints=skeleton.keypoints,
        parent=parent,
        order=order,
        rest=_rest_pose(fields.bones, skeleton, order=order, twin=twin),
        twin=twin,
        right=(twin != np.arange(len(twin))).astype(np.float64),
        plans=np.stack(
            [
                _parse_factors(plan or {}, skeleton)
                for plan in (fields.plans or {"only": {}}).values()
            ]
        ),
        spread=fields.spread,
        direction=fields.direction,
        postures=tuple(
            PostureRange(
                name,
                each.weight,
                each.opposed or (0.0, 0.0),
                {**always, **_parse_angles(each.angles or {}, skeleton)},
            )
            for name, each in ((name, each or _PostureFields()) for name, each in postures.items())
        ),
    )


def _refuse(skeleton: Skeleton, expected: str, found: object, remedy: str) -> FormatError:
    """Return the refusal of the section `body` of a skeleton."""
    return FormatError(f"skeleton {skeleton.name}: body", expected, found, remedy)


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
        raise _refuse(
            skeleton,
            "edges that are one tree over all joints",
            f"{len(roots)} roots: {names}",
            "add or remove edges",
        )
    return parent, np.array(order)


def _rest_pose(
    bones: Mapping[str, tuple[float, float, float]], skeleton: Skeleton, *, order: Ints, twin: Ints
) -> Floats:
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
        found = f"none to {lacking or 'none'}, and unknown {unknown or 'none'}"
        raise _refuse(skeleton, "a bone to each joint", found, "add or rename bones")
    return rest


def _parse_factors(plan: Mapping[str, float], skeleton: Skeleton) -> Floats:
    """Return the factors `[joint]` on the lengths of a body plan. Raises FormatError."""
    _check_names(plan, skeleton)
    return np.array(
        [plan.get(name, plan.get(without_side(name), 1.0)) for name in skeleton.keypoints]
    )


def _parse_angles(fields: Mapping[str, list[float]], skeleton: Skeleton) -> Angles:
    """Return ranges and cycles of angles by bone and axis. Raises FormatError."""
    found = {}
    for key, numbers in fields.items():
        bone, _, axis = key.partition(".")
        if axis not in AXES:
            raise _refuse(skeleton, "angles bone.(roll|pitch|yaw)", key, "rename that angle")
        found[bone, axis] = tuple(numbers)
    _check_names([bone for bone, _ in found], skeleton)
    return found


def _check_names(names: Iterable[str], skeleton: Skeleton) -> None:
    """Raise FormatError where a name is of no joint of the skeleton."""
    known = {ROOT, *skeleton.keypoints, *map(without_side, skeleton.keypoints)}
    if unknown := sorted(set(names) - known):
        raise _refuse(skeleton, "names of its joints", ", ".join(unknown), "rename them")


# --- random bodies


def sample_bodies(rng: np.random.Generator, body: BodyPlan, count: int) -> Floats:
    """Return random bodies in random postures, `[pose, joint, 3]`.

    +z up, +x forward, in the unit of the bones; the root is at the origin.
    """
    bones = sample_bones(rng, body, count)
    turn, facing = sample_turns(rng, body, count)
    return assemble(body, bones, turn, facing)


def sample_bones(rng: np.random.Generator, body: BodyPlan, count: int) -> Floats:
    """Return vectors from each joint's parent in the rest pose, `[pose, joint, 3]`.

    A plan, with lengths and directions spread; both sides alike.
    """
    plan = body.plans[rng.integers(len(body.plans), size=count)]  # [pose, joint]
    length = plan * np.exp(body.spread * rng.normal(size=plan.shape))
    bend = np.deg2rad(body.direction) * rng.normal(size=(*plan.shape, 3))
    rest = body.rest[body.twin] * length[:, body.twin, None]
    rest = np.einsum("pkij,pkj->pki", _matrix_from_angles(bend[:, body.twin]), rest)
    right = np.flatnonzero(body.right)
    middle = np.setdiff1d(body.order, [*right, *body.twin[right]])
    rest[:, middle, 1] = body.rest[middle, 1]  # what has no twin stays in the plane of symmetry
    rest[:, right, 1] *= -1
    return rest


def sample_turns(rng: np.random.Generator, body: BodyPlan, count: int) -> tuple[Floats, Floats]:
    """Return the angles `[pose, joint, 3]` of each bone, and `[pose, 3]` of the whole body.

    Roll, pitch, yaw in radians; those of the bones are not yet mirrored.
    """
    weight = np.array([posture.weight for posture in body.postures])
    posture_of_pose = rng.choice(len(weight), size=count, p=weight / weight.sum())
    turn = np.zeros((count, len(body.joints), 3))
    facing = np.zeros((count, 3))
    for k, posture in enumerate(body.postures):
        poses = np.flatnonzero(posture_of_pose == k)
        stride = rng.uniform(0, 360, len(poses))
        opposed = rng.uniform(*posture.opposed, len(poses))
        vigour = rng.uniform(0.5, 1.15, len(poses))
        draw = partial(_draw_angles, rng, vigour)
        turn[poses], facing[poses] = posture_angles(body, posture, stride, opposed, draw)
    return np.deg2rad(turn), np.deg2rad(facing)


def posture_angles(
    body: BodyPlan,
    posture: PostureRange,
    stride: Floats,
    opposed: Floats | float,
    draw: Callable[[tuple[float, ...], Floats], Floats],
) -> tuple[Floats, Floats]:
    """Return the angles `[pose, joint, 3]` of bones and `[pose, 3]` of the body, in degrees.

    stride: `[pose]` degrees; opposed: `[pose]` degrees that the right side is ahead. draw: of the
    numbers of an angle and the stride `[pose]` of its side, the angles `[pose]`.
    """
    turn = np.zeros((len(stride), len(body.joints), 3))
    facing = np.zeros((len(stride), 3))
    for (bone, axis), numbers in posture.angles.items():
        column = AXES.index(axis)
        if bone == ROOT:
            facing[:, column] = draw(numbers, stride)
        for k, name in enumerate(body.joints):
            if bone in (name, without_side(name)):
                turn[:, k, column] = draw(numbers, stride + opposed * body.right[k])
    return turn, facing


def _draw_angles(
    rng: np.random.Generator, vigour: Floats, numbers: tuple[float, ...], stride: Floats
) -> Floats:
    """Return angles `[pose]` in degrees: within a range, or at a place in the stride.

    numbers: (least, most), of which the middle is likelier, or (middle, amplitude, phase); stride:
    `[pose]` degrees; vigour: `[pose]` how large the strides are.
    """
    if len(numbers) == 2:
        least, most = numbers
        share = rng.random((2, len(stride))).mean(0)
        return least + (most - least) * share
    middle, amplitude, phase = numbers
    jitter = _PHASE_JITTER_DEG * rng.normal(size=len(stride))
    angle = middle + amplitude * np.cos(np.deg2rad(stride + phase + jitter))
    return vigour * angle + 0.15 * amplitude * rng.normal(size=len(stride))


def assemble(body: BodyPlan, bones: Floats, turn: Floats, facing: Floats) -> Floats:
    """Return the joints `[pose, joint, 3]` by forward kinematics; the root is at the origin.

    bones: `[pose, joint, 3]`; turn: `[pose, joint, 3]` their angles; facing: `[pose, 3]` those of
    the whole body.
    """
    mirror = np.where(body.right[:, None] > 0, [-1.0, 1.0, -1.0], 1.0)
    turned = _matrix_from_angles(turn * mirror)
    axes = np.empty_like(turned)  # [pose, joint, 3, 3]
    place = np.zeros_like(bones)
    root, *others = body.order.tolist()
    axes[:, root] = _matrix_from_angles(facing) @ turned[:, root]
    for k in others:
        parent = int(body.parent[k])
        axes[:, k] = axes[:, parent] @ turned[:, k]
        bone = np.einsum("pij,pj->pi", axes[:, k], bones[:, k])
        place[:, k] = place[:, parent] + bone
    return place


def _matrix_from_angles(angles: Floats) -> Floats:
    """Return rotations `[..., 3, 3]`: yaw about z after pitch about -y after roll about x.

    angles: `[..., 3]` roll, pitch, yaw in radians.
    """
    cr, cp, cy = np.moveaxis(np.cos(angles), -1, 0)
    sr, sp, sy = np.moveaxis(np.sin(angles), -1, 0)
    rows = [
        [cy * cp, -sy * cr - cy * sp * sr, sy * sr - cy * sp * cr],
        [sy * cp, cy * cr - sy * sp * sr, -cy * sr - sy * sp * cr],
        [sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)
