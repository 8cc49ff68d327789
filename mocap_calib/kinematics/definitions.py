"""What is measured of a kind of body: the section `kinematics` of its skeleton's file.

Joints stand there without their sides. A list in place of a joint is a choice: the first that the
recording has counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mocap_calib.recording.joints import edges_of_keypoints, load_section, match_names
from mocap_calib.types import Skeleton

_SIDES = ("left_", "right_")


@dataclass(frozen=True)
class Definitions:
    """What can be measured of a recording; numbers are indices of its keypoints.

    edges: pairs that a bone joins.
    angles: name -> (end, vertex, end).
    trunk: keypoints that move as the body does.
    legs: chains of keypoints from the hip down.
    feet: name -> keypoints of which one touches the floor where the foot does.
    """

    edges: tuple[tuple[int, int], ...]
    angles: Mapping[str, tuple[int, int, int]]
    trunk: tuple[int, ...]
    legs: tuple[tuple[int, ...], ...]
    feet: Mapping[str, tuple[int, ...]]


def define(
    keypoints: Sequence[str], skeleton: Skeleton, aliases: Mapping[str, str] | None = None
) -> Definitions:
    """Return what can be measured of these keypoints by the section of a shipped skeleton.

    aliases: a user's names, own name -> joint.
    """
    section = load_section(skeleton.name, "kinematics")
    names = tuple((aliases or {}).get(name, name) for name in keypoints)
    vocabulary = match_names(names, skeleton)
    known = {skeleton.keypoints[joint]: k for k, joint in enumerate(vocabulary) if joint >= 0}
    trunk = (found for name in section.get("trunk", ()) for found in _both(name, known).values())
    return Definitions(
        edges=edges_of_keypoints(skeleton, vocabulary),
        angles=_define_angles(section.get("angles", {}), known),
        trunk=tuple(dict.fromkeys(trunk)),
        legs=tuple(_chains(section.get("leg", ()), known).values()),
        feet=_define_feet(section.get("feet", {}), known),
    )


def _define_angles(
    angles: Mapping[str, Any], known: Mapping[str, int]
) -> dict[str, tuple[int, int, int]]:
    """Return the angles of which the recording has all three joints."""
    found = {}
    for name, joints in angles.items():
        for side, (a, vertex, b) in _chains(joints, known).items():
            found[f"{side}{name}"] = (a, vertex, b)
    return found


def _define_feet(feet: Mapping[str, Any], known: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Return the feet; of several groups of joints the first of which the recording has any."""
    found = {}
    for name, groups in feet.items():
        for side in _SIDES:
            spelt = [[f"{side}{joint}" for joint in group] for group in groups]
            own = [[known[joint] for joint in group if joint in known] for group in spelt]
            if any(own):
                found[f"{side}{name}"] = tuple(next(group for group in own if group))
    return found


def _chains(joints: Sequence[Any], known: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Return the keypoints of a chain of joints, by side; "" = a chain in the body's middle."""
    sided = {side: [_find(joint, side, known) for joint in joints] for side in _SIDES}
    middle = [_find(joint, "", known) for joint in joints]
    if joints and -1 not in middle:
        return {"": tuple(middle)}
    return {side: tuple(own) for side, own in sided.items() if own and -1 not in own}


def _find(joint: Any, side: str, known: Mapping[str, int]) -> int:
    """Return the keypoint of a joint of a side, or of the middle; -1 where there is none."""
    for name in joint if isinstance(joint, list) else [joint]:
        for spelt in (f"{side}{name}", name):
            if spelt in known:
                return known[spelt]
    return -1


def _both(joint: str, known: Mapping[str, int]) -> dict[str, int]:
    """Return the keypoints of a joint: left and right, or the one in the middle."""
    return {side: known[side + joint] for side in ("", *_SIDES) if side + joint in known}
