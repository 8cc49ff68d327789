"""BVH of one individual: a hierarchy of joints and how they turn, for animation programs.

* The root stands at the hips. A joint with several bones does not turn itself: each of its bones
  hangs on a joint of its own in the same place, called `neck_to_left_shoulder`. What stands in the
  file is thus exact but for the bones, which have one length each: their mean.
* A point says nothing of the twist of its bone. Each bone takes the smallest turn that brings it
  from its direction in the rest pose, in the frame of the bone before it, to where it points. The
  root takes the turn of the whole body: the best one between the rest pose and a frame. The rest
  pose is the mean of the body over all frames, upright, facing along z, left along x.
* y is up. Channels are Zrotation Xrotation Yrotation in degrees: R = Rz Rx Ry.
* Frames have no gaps, and nothing is missing: what was not seen stays as it was. Lengths have no
  unit: they are those of the poses.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import mean_of_known, nearest_rotation
from mocap_calib.io.format import Format, Loss
from mocap_calib.io.poses import (
    INDIVIDUALS,
    QUALITY,
    UNIT,
    PoseFile,
    fill_gaps,
    known_edges,
    need_keypoints,
    need_rate,
    turn_between,
)
from mocap_calib.kinematics import bone_lengths
from mocap_calib.recording.joints import choose_skeleton, match_names
from mocap_calib.types import Bools, Floats, Ints

_TURN = "CHANNELS 3 Zrotation Xrotation Yrotation"
_MOVE = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
_HIPS = "hips"  # between left and right, where no keypoint is there
_ROOTS = ("mid_hip", "croup", "spine_back", "tail_base", "back")  # of the shipped skeletons
_ROUNDS = 10  # of rest pose and turns of the body in turn: further ones change nothing
_LEAST_SPREAD = 0.02  # of a joint in the body, in sizes of the body: none counts beyond that
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class _Tree:
    """A tree of joints, parents first; the first is the root.

    names: `[joint]`. parents: `[joint]` indices, -1 of the root. keypoints: `[joint]` the keypoints
        (indices) of which it is the middle: one, or two of the root.
    left_right: pairs of joints (indices).
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    keypoints: tuple[tuple[int, ...], ...]
    left_right: tuple[tuple[int, int], ...]

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Pairs (parent, joint) of all joints but the root."""
        return tuple((parent, k) for k, parent in enumerate(self.parents) if parent >= 0)

    def children(self, joint: int) -> tuple[int, ...]:
        """Return the joints (indices) that hang on one."""
        return tuple(k for k, parent in enumerate(self.parents) if parent == joint)


@dataclass(frozen=True, eq=False)
class _Motion:
    """How the joints of a tree move.

    offsets: `[joint, 3]` from the parent, in the rest pose. root: `[frame, 3]` place of the root.
    turns: `[joint, frame, 3, 3]` of the bone that ends at a joint, against the bone before it; of
        the root: of the body against the rest pose.
    """

    offsets: Floats
    root: Floats
    turns: Floats


def write(file: PoseFile, title: str) -> bytes:
    """Write one individual. Raises MismatchError where no skeleton joins its keypoints."""
    rate = need_rate(file, "bvh")
    need_keypoints(file, r"\S+", "text without spaces", "bvh")
    tree = _make_tree(file)
    frames, positions = fill_gaps(file.poses, "bvh")
    points = np.stack([positions[:, 0, list(own)].mean(1) for own in tree.keypoints], axis=1)
    motion = _find_motion(tree, points)
    described = list(_describe_joint(tree, motion, 0, depth=0))
    angles = [_angles(turns, len(frames)) for _, turns in described if turns is not None]
    table = np.concatenate([motion.root, *angles], axis=1) + 0.0
    lines = ["HIERARCHY", *(line for line, _ in described)]
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {1 / rate!r}"]
    lines += [" ".join([f"{value:.6g}" for value in row]) for row in table.tolist()]
    return ("\n".join(lines) + "\n").encode()


Lines = Iterator[tuple[str, Floats | None]]  # and the turns `[frame, 3, 3]` of a line of channels


def _describe_joint(tree: _Tree, motion: _Motion, joint: int, *, depth: int) -> Lines:
    """Yield the lines of a joint and all below it."""
    children = tree.children(joint)
    alone = joint != 0 and len(children) == 1
    turns = motion.turns[children[0] if alone else 0] if alone or not joint else np.eye(3)[None]
    kind, channels = ("JOINT", _TURN) if joint else ("ROOT", _MOVE)
    yield from _open(depth, f"{kind} {tree.names[joint]}", motion.offsets[joint])
    yield f"{_indent(depth + 1)}{channels}", turns
    for child in children:
        if alone:
            yield from _describe_joint(tree, motion, child, depth=depth + 1)
            continue
        bone = f"JOINT {tree.names[joint]}_to_{tree.names[child]}"
        yield from _open(depth + 1, bone, np.zeros(3))
        yield f"{_indent(depth + 2)}{_TURN}", motion.turns[child]
        yield from _describe_joint(tree, motion, child, depth=depth + 2)
        yield f"{_indent(depth + 1)}}}", None
    if not children:
        yield from _open(depth + 1, "End Site", np.zeros(3))
        yield f"{_indent(depth + 1)}}}", None
    yield f"{_indent(depth)}}}", None


def _open(depth: int, title: str, offset: Floats) -> Lines:
    """Yield the first lines of a joint."""
    x, y, z = (offset + 0.0).tolist()
    for line in (title, "{", f"  OFFSET {x:.6g} {y:.6g} {z:.6g}"):
        yield _indent(depth) + line, None


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


# --- the tree and its motion


def _make_tree(file: PoseFile) -> _Tree:
    """Return the tree of the keypoints that bones join, from the hips on.

    Raises MismatchError where no bone is known.
    """
    names = file.poses.keypoints
    edges = known_edges(file)
    if not edges:
        found = f"{', '.join(names[:4])}, ..."
        remedy = "write another format, or rename them (docs/skeletons.md)"
        raise MismatchError("bvh", "keypoints that a skeleton joins", found, remedy)
    skeleton = choose_skeleton(names)
    joints = match_names(names, skeleton)
    known = {skeleton.keypoints[joint]: k for k, joint in enumerate(joints) if joint >= 0}
    root = next((known[name] for name in _ROOTS if name in known), edges[0][0])
    hips = (known.get("left_hip", -1), known.get("right_hip", -1))
    between = -1 not in hips and not any(name in known for name in _ROOTS[:2])
    if between:
        root = len(names)
        edges = (*((a, b) for a, b in edges if {a, b} != set(hips)), *((root, hip) for hip in hips))
    above = _hang(root, edges)
    place = {keypoint: k for k, keypoint in enumerate(above)}
    pairs = [[known.get(skeleton.keypoints[k], -1) for k in pair] for pair in skeleton.symmetries]
    return _Tree(
        names=tuple(_HIPS if k == len(names) else names[k] for k in above),
        parents=tuple(place.get(parent, -1) for parent in above.values()),
        keypoints=tuple(hips if k == len(names) else (k,) for k in above),
        left_right=tuple((place[a], place[b]) for a, b in pairs if a in place and b in place),
    )


def _hang(root: int, edges: tuple[tuple[int, int], ...]) -> Mapping[int, int]:
    """Return what each node that edges lead to hangs on, the nearest to the root first."""
    above = {root: -1}
    waiting = [root]
    for node in waiting:
        for a, b in edges:
            for here, other in ((a, b), (b, a)):
                if here == node and other not in above:
                    above[other] = node
                    waiting.append(other)
    return above


def _find_motion(tree: _Tree, points: Floats) -> _Motion:
    """Return the motion of joints `[frame, joint, 3]`, y up, NaN = missing.

    A bone of which an end is missing keeps the turn that it had last, that of the rest pose before
    it was seen at all; the root keeps its place and its turn, and has the first ones before.
    """
    own = points - points[:, :1]
    rest, body = _fit_rest_pose(own)
    rest, body = _stand_upright(tree, rest, body)
    mean = bone_lengths(points[:, None], tree.edges)[0][0]
    offsets = np.zeros((len(tree.names), 3))
    turns = np.empty((len(tree.names), len(points), 3, 3))
    turns[0] = body
    frames = {0: body}  # global turns of the bones that end at a joint
    for (parent, k), length in zip(tree.edges, mean, strict=True):
        offsets[k] = _offset(rest[k] - rest[parent], length)
        seen = points[:, k] - points[:, parent]
        inside = np.einsum("fji,fj->fi", frames[parent], seen)
        there: Bools = np.asarray(np.isfinite(inside).all(-1))
        turn = turn_between(offsets[k], np.where(there[:, None], inside, offsets[k]))
        turns[k] = _hold(turn, there)
        frames[k] = frames[parent] @ turns[k]
    known: Bools = np.asarray(np.isfinite(points[:, 0]).all(-1))
    root = np.where(known[:, None], points[:, 0], 0.0)
    return _Motion(offsets, root[_last_known(known, first=True)], turns)


def _offset(direction: Floats, length: float) -> Floats:
    """Return a bone `[3]` of the rest pose; upwards where its direction is not known."""
    size = np.linalg.norm(direction)
    along = direction / size if size > 0 else _UP
    return np.nan_to_num(length) * along


def _fit_rest_pose(own: Floats) -> tuple[Floats, Floats]:
    """Return the mean `[joint, 3]` of the body in its own axes, and its turns `[frame, 3, 3]`.

    Generalised Procrustes (Gower 1975) about the root, each joint weighted by how still it is in
    the body, so that the trunk counts and swinging limbs count little.

    own: `[frame, joint, 3]` from the root, NaN = missing.
    """
    there: Bools = np.asarray(np.isfinite(own).all(-1))
    filled = np.where(there[..., None], own, 0.0)
    usable = there.sum(1) > 2  # the root, and two more
    body = np.tile(np.eye(3), (len(own), 1, 1))
    rest = np.nan_to_num(own[there.sum(1).argmax()])
    weight = there[there.sum(1).argmax()].astype(np.float64)
    for _ in range(_ROUNDS):
        products = np.einsum("fj,fja,jb->fab", there * weight, filled, rest)
        body = _hold(nearest_rotation(products), usable, first=True)
        turned = np.einsum("fba,fjb->fja", body, own)
        turned = np.where(usable[:, None, None], turned, np.nan)
        mean = mean_of_known(turned, 0)
        spread = mean_of_known(((turned - mean) ** 2).sum(-1), 0)
        size = np.nanmean((mean**2).sum(-1)) if np.isfinite(mean).any() else 1.0
        rest = np.nan_to_num(mean)
        weight = np.nan_to_num(1 / (spread + max(_LEAST_SPREAD**2 * size, 1e-300)))
    return rest, body


def _stand_upright(tree: _Tree, rest: Floats, body: Floats) -> tuple[Floats, Floats]:
    """Return the rest pose with its mean up along y and its left along x, and the turns to it."""
    up = np.einsum("fba,b->a", body, _UP)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-9 else _UP
    sides = np.array([rest[a] - rest[b] for a, b in tree.left_right]).reshape(-1, 3).sum(0)
    across = sides - (sides @ up) * up
    if np.linalg.norm(across) <= 1e-9 * np.abs(rest).max(initial=0) or not np.abs(rest).any():
        across = turn_between(_UP, up)[:, 0]
    x = across / np.linalg.norm(across)
    axes = np.stack([x, up, np.cross(x, up)])
    return rest @ axes.T, body @ axes.T


def _last_known(known: Bools, *, first: bool) -> Ints:
    """Return the index `[frame]` of the last frame that is known, up to each.

    Before any is known: the first that is, or with `first` unset -1. 0 where none is.
    """
    index = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    return np.where(index < 0, int(known.argmax()), index) if first else index


def _hold(turns: Floats, known: Bools, *, first: bool = False) -> Floats:
    """Return rotations `[frame, 3, 3]`, the last known one where one is not known.

    Before any is known: the first known one, or with `first` unset none.
    """
    index = _last_known(known, first=first)
    return np.where((index < 0)[:, None, None], np.eye(3), turns[index])


def _has_loose_keypoints(file: PoseFile) -> bool:
    """Return whether a keypoint is joined to no other."""
    joined = {k for own in _make_tree(file).keypoints for k in own}
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
