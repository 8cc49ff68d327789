"""Write a synthetic recording with its truth, in the files that people have.

- keypoints/CAMERA.json: detections, in COCO's format;
- intrinsics.toml: cameras, without where they stand;
- reference.toml: cameras, and where they stand (metres, +z up), in anipose's format;
- truth.npz: `ids` (view, frame, instance) who each detection is, in file order, -1 = nobody;
  `poses3d` (frame, individual, joint, 3) metres, NaN for joints that an individual does not have;
  `joints` names; `kinds` (individual) people, quadruped, rodent or bird;
- README.md: what it is, how it was made, and commands to run.
"""

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mocap_calib.errors import MismatchError, count
from mocap_calib.io.atomic import write_files
from mocap_calib.io.formats.anipose import format_calibration_toml, format_intrinsics_toml
from mocap_calib.io.formats.coco import format_coco
from mocap_calib.recording.names import compose_name
from mocap_calib.synthetic.scene import Scene

_COMMANDS = """\
In this folder:

    mocap-calib inspect keypoints/ --cameras intrinsics.toml
    mocap-calib run keypoints/ --cameras intrinsics.toml -o out
    mocap-calib evaluate out/cameras.yaml --reference reference.toml
"""


def write_scene(path: Path, scene: Scene, command: str) -> None:
    """Write a scene into the folder `path`, whole or not at all.

    command: says how to make it again.

    Raises MismatchError where the folder holds keypoints of other cameras, which would join the
    recording.
    """
    own = {f"{name}.json" for name in scene.rig.names}
    strangers = {compose_name(file.name) for file in (path / "keypoints").glob("*")} - own
    if strangers:
        raise MismatchError(
            path,
            "a new folder or one with the same cameras",
            f"keypoints/{min(strangers)}",
            "choose another or remove that file",
        )
    write_files(path, scene_files(scene, command))


def check_own_files(path: Path, files: Mapping[str, bytes]) -> None:
    """Raise MismatchError where a file in the folder `path` is another than the one of its name."""
    for name, content in files.items():
        if (path / name).exists() and (path / name).read_bytes() != content:
            raise MismatchError(
                path / name,
                "a new folder, or one with the same example",
                "another file of that name",
                "choose another folder",
            )


def scene_files(scene: Scene, command: str) -> dict[str, bytes]:
    """Return the files of a scene: relative path -> content."""
    texts = {f"keypoints/{file.camera}.json": format_coco(file) for file in scene.files}
    texts["intrinsics.toml"] = format_intrinsics_toml(scene.rig.cameras)
    texts["reference.toml"] = format_calibration_toml(scene.rig, {"command": command})
    texts["README.md"] = (
        f"A synthetic recording of {describe_kinds(scene.kinds)}: keypoints and cameras, and the "
        f"truth: camera poses, identities, 3D poses.\nMade by `{command}`.\n\n{_COMMANDS}"
    )
    files = {name: text.encode() for name, text in texts.items()}
    return files | {"truth.npz": _pack_truth(scene)}


def describe_kinds(kinds: Sequence[str]) -> str:
    """Return who is in a scene: `3 people, 1 quadruped`. kinds: of each individual."""
    plurals = {"people": ("person", "people")}
    return ", ".join(
        count(number, *plurals.get(kind, (kind,))) for kind, number in Counter(kinds).items()
    )


def _pack_truth(scene: Scene) -> bytes:
    """Return the truth as an npz archive; float32 keeps a micrometre of a room.

    numpy fixes the archive's dates, so that the same scene gives the same bytes.
    """
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ids=scene.identity.astype(np.int16),
        poses3d=scene.poses.astype(np.float32),
        joints=np.array(scene.joints),
        kinds=np.array(scene.kinds),
    )
    return buffer.getvalue()
