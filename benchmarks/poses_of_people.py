"""Make the 3D poses that networks of people learn from, of motion capture in Acclaim's format.

    .venv/bin/python benchmarks/poses_of_people.py all_asfamc/subjects human_body29.npz

The CMU Graphics Lab Motion Capture Database gives such files away (mocap.cs.cmu.edu, "all
asf/amc"): a folder for each subject with a skeleton (`07/07.asf`) and motions (`07/07_01.amc`).
The use is free; it asks for its line of credit, which the model cards have.

Joints of the skeleton `people`: hips, knees, ankles, shoulders, elbows, wrists and toes are ends
of bones. Face, heels and small toes, which the bones lack, stand at usual places of an adult
beside the skull, the ankle and the ball of the foot, as large as the subject's legs.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import make_parser
from rich.progress import track

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.types import Floats

INCH = 0.0254  # metres; lengths are divided by the skeleton's `length`
EVERY = 12  # of 120 frames a second
LEG = 0.83  # metres, thigh and shank of the adult that the places below are of
HELD_OUT = 7  # every seventh subject tests, and the one after it validates
# joint: end of this bone; sides are l and r
ENDS = {
    **{"hip": "hipjoint", "knee": "femur", "ankle": "tibia", "big_toe": "toes"},
    **{"shoulder": "clavicle", "elbow": "humerus", "wrist": "radius", "hand": "hand"},
}
# joint: bone, at whose end it stands, and where beside it: metres to the left, up and forwards in
# the stance in which no joint is bent; to the other side on the right
BESIDE = {
    "eye": ("upperneck", (0.032, 0.07, 0.09)),
    "ear": ("upperneck", (0.075, 0.05, 0.01)),
    "heel": ("tibia", (0.0, -0.06, -0.05)),
    "small_toe": ("foot", (0.04, 0.0, 0.03)),
}
MIDDLE = {"nose": (0.0, 0.04, 0.11), "head_top": (0.0, 0.18, 0.0)}  # beside the end of upperneck


@dataclass(frozen=True)
class Bone:
    """A bone of a skeleton.

    offset: `[3]` from its begin to its end in metres, no joint bent. axes: `[3, 3]` of its turns.
    turns: the letters of the axes it turns about, the first first. parent: "" = the root.
    """

    offset: Floats
    axes: Floats
    turns: str
    parent: str


Bones = dict[str, Bone]  # parents before children; the root is "root"


def main() -> None:
    """Read every motion of every subject, and write one file."""
    parser = make_parser(__doc__)
    parser.add_argument("subjects", type=Path, help="folder with a folder for each subject")
    parser.add_argument("out", type=Path, help="the npz file")
    parser.add_argument("--every", type=int, default=EVERY, help=f"n-th frame (default: {EVERY})")
    options = parser.parse_args()
    try:
        made = collect(options.subjects, options.every)
    except FormatError as error:
        sys.exit(str(error))
    np.savez_compressed(options.out, **made)


def collect(folder: Path, every: int) -> dict[str, Any]:
    """Return the arrays of the file: poses `[S, 29, 3]`, joints, subject, sequence, split.

    Raises FormatError for a folder without motions, and for a file that is cut.
    """
    motions = sorted(folder.glob("*/*.amc"))
    if not motions:
        raise FormatError(folder, "motions such as 07/07_01.amc", "none", "check the folder")
    names = sorted({path.parent.name for path in motions})
    joints = load_skeleton("people").keypoints
    poses, subject, sequence = [], [], []
    for number, path in enumerate(track(motions, "motions")):
        lengths, bones = read_skeleton(path.parent / f"{path.parent.name}.asf")
        try:
            found = joints_of(bones, *place(bones, read_motion(path, every), lengths))
        except KeyError as error:
            raise FormatError(path, "a person's bones", f"no {error}", "leave it out") from None
        poses.append(np.stack([found[name] for name in joints], 1).astype(np.float16))
        subject += [names.index(path.parent.name)] * len(poses[-1])
        sequence += [number] * len(poses[-1])
    roles = ["test", "val", *["train"] * (HELD_OUT - 2)]
    split = np.array([roles[k % HELD_OUT] for k in subject])
    fields = {"subject": np.array(subject), "sequence": np.array(sequence), "split": split}
    return {"poses": np.concatenate(poses), "joints": np.array(joints), **fields}


# --- files


def read_skeleton(path: Path) -> tuple[float, Bones]:
    """Read an .asf file: metres of a length of 1, and its bones. Raises FormatError."""
    try:
        sections = _sections(path)
        unit = {line[0]: line[1] for line in sections["units"]}
        metres = INCH / float(unit["length"])
        bones = {"root": Bone(np.zeros(3), np.eye(3), "xyz", "")}
        described = _described(sections["bonedata"])
        for parent, *children in sections["hierarchy"]:
            _ = bones[parent]  # a parent comes first
            for name in children:
                bones[name] = _bone(described[name], parent, metres)
    except (OSError, KeyError, ValueError, IndexError) as error:
        raise FormatError(path, "an Acclaim skeleton", str(error), "copy it again") from None
    return metres, bones


def _sections(path: Path) -> dict[str, list[list[str]]]:
    """Return the words of the lines of each section `:name`."""
    sections: dict[str, list[list[str]]] = {}
    lines: list[list[str]] = []
    for line in path.read_text("latin-1").splitlines():
        words = line.split("#")[0].split()
        if words and words[0].startswith(":"):
            lines = sections.setdefault(words[0][1:], [])
        elif words and words[0] not in ("begin", "end"):
            lines.append(words)
    return sections


def _described(lines: list[list[str]]) -> dict[str, dict[str, list[str]]]:
    """Return the fields of each bone by its name; a bone begins with its `id`."""
    bones: list[dict[str, list[str]]] = []
    for key, *values in lines:
        if key == "id":
            bones.append({})
        bones[-1][key] = values
    return {bone["name"][0]: bone for bone in bones}


def _bone(fields: dict[str, list[str]], parent: str, metres: float) -> Bone:
    *angles, order = fields["axis"]
    turned = np.array(angles, dtype=float)[None]
    return Bone(
        offset=np.array(fields["direction"], dtype=float) * float(fields["length"][0]) * metres,
        axes=_turn(turned, order.lower())[0],
        turns="".join(name[1].lower() for name in fields.get("dof", ()) if name[0] == "r"),
        parent=parent,
    )


def read_motion(path: Path, every: int) -> dict[str, Floats]:
    """Read an .amc file: the numbers `[frame, value]` of each bone. Raises FormatError."""
    frames: list[dict[str, list[float]]] = []
    try:
        for line in path.read_text("latin-1").splitlines():
            words = line.split()
            if not words or words[0][0] in "#:":
                continue
            if len(words) == 1 and words[0].isdigit():
                frames.append({})
            else:
                frames[-1][words[0]] = [float(word) for word in words[1:]]
        return {name: np.array([f[name] for f in frames[::every]]) for name in frames[0]}
    except (OSError, KeyError, ValueError, IndexError) as error:
        raise FormatError(path, "an Acclaim motion", str(error), "copy it again") from None


# --- bodies


def _turn(degrees: Floats, order: str) -> Floats:
    """Return `[frame, 3, 3]` turns about fixed axes, the first of `order` first."""
    turn = np.broadcast_to(np.eye(3), (len(degrees), 3, 3))
    for angle, letter in zip(np.radians(degrees.T), order, strict=True):
        turn = matrix_from_vector(angle[:, None] * np.eye(3)["xyz".index(letter)]) @ turn
    return turn


def place(
    bones: Bones, motion: dict[str, Floats], metres: float
) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return the end `[frame, 3]` of each bone, and how it is turned `[frame, 3, 3]`; +y up.

    A bone that a motion does not name is not bent.
    """
    root = motion["root"]
    ends, turns = {"root": root[:, :3] * metres}, {"root": _turn(root[:, 3:], "xyz")}
    for name, bone in bones.items():
        if name == "root":
            continue
        angles = motion.get(name, np.zeros((len(root), len(bone.turns))))
        bent = bone.axes @ _turn(angles, bone.turns) @ bone.axes.T
        turns[name] = turns[bone.parent] @ bent
        ends[name] = ends[bone.parent] + turns[name] @ bone.offset
    return ends, turns


def joints_of(bones: Bones, ends: dict[str, Floats], turns: dict[str, Floats]) -> dict[str, Floats]:
    """Return the joints `[frame, 3]` of `people`: metres, +z up, the hips above x = y = 0.

    The floor, z = 0, is the lowest that a foot comes in the motion.
    """
    legs = [np.linalg.norm(bones[name].offset) for name in ("lfemur", "ltibia")]
    size = float(np.sum(legs)) / LEG
    joints = {
        name: ends["upperneck"] + size * turns["upperneck"] @ np.array(beside)
        for name, beside in MIDDLE.items()
    }
    for side, letter, sign in (("left", "l", 1.0), ("right", "r", -1.0)):
        joints |= {f"{side}_{name}": ends[letter + bone] for name, bone in ENDS.items()}
        for name, (bone, beside) in BESIDE.items():
            own = bone if bone == "upperneck" else letter + bone
            # the heel goes with the foot, which begins where the shank ends
            turn = turns[letter + "foot"] if name == "heel" else turns[own]
            joints[f"{side}_{name}"] = ends[own] + size * turn @ (beside * np.array([sign, 1, 1]))
    joints["mid_hip"] = (joints["left_hip"] + joints["right_hip"]) / 2
    joints["neck"] = ends["thorax"]
    joints["spine"] = (ends["lowerback"] + ends["upperback"]) / 2
    feet = [f"{side}_{name}" for side in ("left", "right") for name in ("heel", "big_toe")]
    floor = min(joints[name][:, 1].min() for name in feet)
    shift = joints["mid_hip"] * [1, 0, 1] + [0, floor, 0]
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +z up
    return {name: (place - shift) @ upright.T for name, place in joints.items()}


if __name__ == "__main__":
    main()
