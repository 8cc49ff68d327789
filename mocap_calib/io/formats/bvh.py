"""BVH of one individual: a hierarchy of joints and how they turn, for animation programs.

* The root stands at the hips; `io.formats.bvh_motion` says how joints turn.
* A joint with several bones does not turn itself: each of its bones hangs on a joint of its own in
  the same place, called `neck_to_left_shoulder`. What stands in the file is thus exact but for the
  bones, which have one length each: their mean.
* y is up. Channels are Zrotation Xrotation Yrotation in degrees: R = Rz Rx Ry.
* Frames have no gaps, and nothing is missing: what was not seen stays as it was. Lengths have no
  unit: they are those of the poses.
"""

import numpy as np

from mocap_calib.io.format import Format, Loss
from mocap_calib.io.formats.bvh_motion import Motion, Tree, find_motion, make_tree, place_joints
from mocap_calib.io.poses import (
    INDIVIDUALS,
    QUALITY,
    UNIT,
    PoseFile,
    fill_gaps,
    need_keypoints,
    need_rate,
)
from mocap_calib.types import Floats

_TURN = "CHANNELS 3 Zrotation Xrotation Yrotation"
_MOVE = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def write(file: PoseFile, title: str) -> bytes:
    """Write one individual. Raises MismatchError where no skeleton joins its keypoints."""
    rate = need_rate(file, "bvh")
    need_keypoints(file, r"\S+", "text without spaces", "bvh")
    tree = make_tree(file)
    frames, positions = fill_gaps(file.poses, "bvh")
    motion = find_motion(tree, place_joints(tree, positions[:, 0]))
    lines: list[str] = ["HIERARCHY"]
    columns: list[Floats] = []
    _describe_joint(tree, motion, 0, depth=0, lines=lines, columns=columns)
    table = np.concatenate([motion.root, *columns], axis=1) + 0.0
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {1 / rate!r}"]
    lines += [" ".join([f"{value:.6g}" for value in row]) for row in table.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _describe_joint(
    tree: Tree, motion: Motion, joint: int, *, depth: int, lines: list[str], columns: list[Floats]
) -> None:
    """Add the lines of a joint and all below it, and the angles `[frame, 3]` of their channels."""
    children = tree.children(joint)
    alone = joint != 0 and len(children) == 1
    if joint == 0:
        turn = motion.turns[0]
    else:
        turn = motion.turns[children[0]] if alone else np.eye(3)[None]
    lines += _open(depth, "JOINT" if joint else "ROOT", tree.names[joint], motion.offsets[joint])
    lines.append(f"{_indent(depth + 1)}{_TURN if joint else _MOVE}")
    columns.append(_angles(turn, len(motion.root)))
    for child in children:
        if alone:
            _describe_joint(tree, motion, child, depth=depth + 1, lines=lines, columns=columns)
            continue
        name = f"{tree.names[joint]}_to_{tree.names[child]}"
        lines += _open(depth + 1, "JOINT", name, np.zeros(3))
        lines.append(f"{_indent(depth + 2)}{_TURN}")
        columns.append(_angles(motion.turns[child], len(motion.root)))
        _describe_joint(tree, motion, child, depth=depth + 2, lines=lines, columns=columns)
        lines.append(f"{_indent(depth + 1)}}}")
    if not children:
        lines += [*_open(depth + 1, "End", "Site", np.zeros(3)), f"{_indent(depth + 1)}}}"]
    lines.append(f"{_indent(depth)}}}")


def _open(depth: int, kind: str, name: str, offset: Floats) -> list[str]:
    """Return the first lines of a joint."""
    x, y, z = (offset + 0.0).tolist()
    start = _indent(depth)
    return [f"{start}{kind} {name}", f"{start}{{", f"{start}  OFFSET {x:.6g} {y:.6g} {z:.6g}"]


def _indent(depth: int) -> str:
    return "  " * depth


def _angles(turns: Floats, frames: int) -> Floats:
    """Return `[frame, 3]` degrees about z, x and y of rotations `[frame, 3, 3]`, Rz Rx Ry.

    Without jumps of a turn from frame to frame.
    """
    sine = np.clip(turns[:, 2, 1], -1, 1)
    level = np.abs(sine) < 1 - 1e-12  # else z and y turn about the same axis: z takes it all
    z = np.where(
        level,
        np.arctan2(-turns[:, 0, 1], turns[:, 1, 1]),
        np.arctan2(turns[:, 1, 0], turns[:, 0, 0]),
    )
    y = np.where(level, np.arctan2(-turns[:, 2, 0], turns[:, 2, 2]), 0.0)
    angles = np.unwrap(np.stack([z, np.arcsin(sine), y], axis=-1), axis=0)
    return np.broadcast_to(np.degrees(angles), (frames, 3))


def _has_loose_keypoints(file: PoseFile) -> bool:
    """Return whether a keypoint is joined to no other."""
    joined = {k for own in make_tree(file).keypoints for k in own}
    return len(joined) < len(file.poses.keypoints)


JOINTS = Loss("keypoints that no bone joins", _has_loose_keypoints)
POSES = Format(
    name="bvh",
    title="BVH of animation programs",
    write=write,
    endings=(".bvh",),
    single=True,
    timed=True,
    up="y",
    loses=(JOINTS, UNIT, *QUALITY, INDIVIDUALS),
)
