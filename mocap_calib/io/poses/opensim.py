"""What OpenSim's models of Pose2Sim call the markers of people."""

from mocap_calib.io.poses.common import PoseFile
from mocap_calib.recording.joints import choose_skeleton, match_names

_PEOPLE = "people"
# joint of the skeleton `people`, without its side -> marker; a side becomes an L or an R before it
_MARKERS = {
    "nose": "Nose",
    "eye": "Eye",
    "ear": "Ear",
    "shoulder": "Shoulder",
    "elbow": "Elbow",
    "wrist": "Wrist",
    "hip": "Hip",
    "knee": "Knee",
    "ankle": "Ankle",
    "head_top": "Head",
    "neck": "Neck",
    "mid_hip": "Hip",
    "big_toe": "BigToe",
    "small_toe": "SmallToe",
    "heel": "Heel",
}


def marker_names(file: PoseFile) -> tuple[str, ...]:
    """Return the names `[keypoint]` of markers: left_hip -> LHip, mid_hip -> Hip.

    Those of the models in Pose2Sim's OpenSim_Setup (Halpe26, Body25, Coco17). Keypoints that they
    do not have, and those of animals, keep their names.
    """
    names = file.poses.keypoints
    skeleton = choose_skeleton(file.spelt)
    if skeleton.name != _PEOPLE:
        return names
    joints = match_names(file.spelt, skeleton)
    markers = tuple(
        _name_marker(skeleton.keypoints[joint], name) if joint >= 0 else name
        for name, joint in zip(names, joints, strict=True)
    )
    return markers if len(set(markers)) == len(names) else names


def _name_marker(joint: str, otherwise: str) -> str:
    """Return the marker of a joint, another name where it has none."""
    side, _, rest = joint.partition("_")
    if side in ("left", "right"):
        return f"{side[0].upper()}{_MARKERS[rest]}" if rest in _MARKERS else otherwise
    return _MARKERS.get(joint, otherwise)
