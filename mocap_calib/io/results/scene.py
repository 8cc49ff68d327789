"""Writing a synthetic recording with its truth, in the files that people have: COCO keypoints and calibration.toml.

- keypoints/<camera>.json: detections;
- intrinsics.toml: cameras, without where they stand;
- reference.toml: cameras, and where they stand (metres, +z up);
- truth.npz: `ids` (view, frame, instance) who each detection is, in file order, -1 = nobody; `poses3d` (frame,
  individual, joint, 3) metres; `joints` names;
- README.md: what it is and how it was made.
"""

import io
import json
from pathlib import Path
from typing import Protocol

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import folder
from mocap_calib.io.cameras.own import format_calibration_toml
from mocap_calib.io.keypoints.coco_writer import format_coco
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Keypoints2D


class SceneLike(Protocol):
    """What of a scene is written; `synthetic.Scene` is one (a layer above this one)."""

    @property
    def rig(self) -> CameraRig:
        """Cameras and where they stand."""

    @property
    def files(self) -> tuple[Keypoints2D, ...]:
        """`[view]` the detections."""

    @property
    def identity(self) -> Ints:
        """`[view, frame, instance]` who each detection is, -1 = nobody."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints of `poses`."""

    @property
    def poses(self) -> Floats:
        """`[frame, individual, joint, 3]` true bodies."""


def write_scene(path: Path, scene: SceneLike, command: str) -> None:
    """Writes a scene into the folder `path`, whole or not at all; `command` says how to make it again.

    Raises MismatchError where the folder holds keypoints of other cameras, which would join the recording.
    """
    strangers = sorted(
        {file.name for file in (path / "keypoints").glob("*")}
        - {f"{name}.json" for name in scene.rig.names}
    )
    if strangers:
        raise MismatchError(
            f"{path}: expected a new folder or one with the same cameras, found keypoints/{strangers[0]}: choose another or remove it"
        )
    with folder(path) as work:
        for name, content in scene_files(scene, command).items():
            file = work / name
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(content)


def scene_files(scene: SceneLike, command: str) -> dict[str, bytes]:
    """Relative path -> content."""
    texts = {f"keypoints/{file.camera}.json": format_coco(file) for file in scene.files}
    texts["intrinsics.toml"] = _intrinsics_toml(scene.rig.cameras)
    texts["reference.toml"] = format_calibration_toml(scene.rig, {"command": command})
    texts["README.md"] = (
        f"A synthetic recording of people: keypoints and cameras, and the truth: where cameras stand, who is who, 3D.\nMade by `{command}`.\n"
    )
    return {name: text.encode() for name, text in texts.items()} | {"truth.npz": _truth(scene)}


def _intrinsics_toml(cameras: tuple[Camera, ...]) -> str:
    """The keys of anipose without rotation and translation; Python's lists of floats are TOML's."""
    lines = []
    for k, camera in enumerate(cameras):
        lines += [f"[cam_{k}]", f"name = {json.dumps(camera.name)}", f"size = {list(camera.size)}"]
        lines += [
            f"matrix = {camera.matrix.tolist()}",
            f"distortions = {camera.distortion.tolist()}",
        ]
        lines += ["fisheye = true", ""] if camera.fisheye else [""]
    return "\n".join(lines)


def _truth(scene: SceneLike) -> bytes:
    """float32 keeps a micrometre of a room; the archive's dates are fixed by numpy, so the same scene gives the same bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ids=scene.identity.astype(np.int16),
        poses3d=scene.poses.astype(np.float32),
        joints=np.array(scene.joints),
    )
    return buffer.getvalue()
