"""Bodies made from a description alone, no data: random bones in random postures.

The description is the section `body` of a skeleton's file (`body_plan.py`).
"""

import numpy as np

from mocap_calib.synthetic.body_plan import AXES, ROOT, BodyPlan, PostureRange, without_side
from mocap_calib.types import Bools, Floats, Ints

_PHASE_JITTER_DEG = 15.0  # of a joint within the stride


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
    middle = _without_twin(body)
    rest[:, middle, 1] = body.rest[middle, 1]  # what has no twin stays in the plane of symmetry
    rest[:, body.right > 0, 1] *= -1
    return rest


def _without_twin(body: BodyPlan) -> Bools:
    """Return which joints `[joint]` are not one of a pair."""
    right = np.flatnonzero(body.right)
    left = body.twin[body.right > 0]
    return ~np.isin(np.arange(len(body.joints)), np.concatenate([right, left]))


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
        _sample_posture(rng, body, posture, poses, turn=turn, facing=facing)
    return np.deg2rad(turn), np.deg2rad(facing)


def _sample_posture(
    rng: np.random.Generator,
    body: BodyPlan,
    posture: PostureRange,
    poses: Ints,
    *,
    turn: Floats,
    facing: Floats,
) -> None:
    """Fill in the angles, in degrees, of the poses (indices) that hold a posture.

    turn: `[pose, joint, 3]` and facing: `[pose, 3]`, of all poses.
    """
    stride = rng.uniform(0, 360, len(poses))
    opposed = rng.uniform(*posture.opposed, len(poses))
    vigour = rng.uniform(0.5, 1.15, len(poses))
    for (bone, axis), numbers in posture.angles.items():
        column = AXES.index(axis)
        if bone == ROOT:
            facing[poses, column] = _draw_angles(rng, numbers, stride, vigour)
        for joint in joints_named(body, bone):
            own_stride = stride + opposed * body.right[joint]
            turn[poses, joint, column] = _draw_angles(rng, numbers, own_stride, vigour)


def joints_named(body: BodyPlan, bone: str) -> list[int]:
    """Return the joints that a name stands for: itself, or both sides."""
    return [k for k, name in enumerate(body.joints) if bone in (name, without_side(name))]


def _draw_angles(
    rng: np.random.Generator, numbers: tuple[float, ...], stride: Floats, vigour: Floats
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
