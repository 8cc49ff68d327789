"""A Python script that builds the poses in Blender: `blender_scene.py` with its data inside.

Lengths are metres where they are known. z is up where the poses say what is up, as Blender has it.
Blender's cameras are the pinhole parts of ours; its images begin at the corner of a pixel.
"""

import base64
import json
import re
import zlib
from importlib import resources
from typing import Any

import numpy as np

from mocap_calib.io.format import Format
from mocap_calib.io.poses import (
    LENSES,
    QUALITY,
    PoseFile,
    convert_unit,
    known_edges,
)
from mocap_calib.io.units import ARBITRARY
from mocap_calib.kinematics import bone_lengths
from mocap_calib.types import Floats, PosedCamera

_SHARE = 0.004  # radius of a point, in sizes of the scene
_BONE_SHARE = 0.12  # at most, in lengths of a usual bone
_DIGITS = 5  # after the size of the scene: a hundred-thousandth of it
_REACH = (0.02, 0.98)  # quantiles of the points, which single wild ones do not reach
_LINE = 96  # letters
_PLACE = re.compile(r'^SCENE = "".*$', re.MULTILINE)


def write(file: PoseFile, title: str) -> bytes:
    """Write the script. What it shows is not what was measured: it has no errors of points."""
    if file.poses.unit != ARBITRARY:
        file = convert_unit(file, "m", "blender")
    said = json.dumps(describe_scene(file, title), allow_nan=False, separators=(",", ":"))
    packed = base64.b64encode(zlib.compress(said.encode(), 9)).decode()
    lines = [packed[k : k + _LINE] for k in range(0, len(packed), _LINE)]
    data = "SCENE = (\n" + "".join(f'    "{line}"\n' for line in lines) + ")"
    script = resources.files("mocap_calib.io.formats") / "blender_scene.py"
    text = _PLACE.sub(lambda _: data, script.read_text("utf-8"), count=1)
    return text.encode()


def describe_scene(file: PoseFile, title: str = "") -> dict[str, Any]:
    """Return what the script builds, as JSON has it."""
    poses = file.poses
    edges = known_edges(file)
    lengths = bone_lengths(poses.positions, edges)[0]
    size = _scene_size(file)
    usual = float(np.median(lengths[lengths > 0])) if (lengths > 0).any() else size
    digits = _DIGITS - int(np.floor(np.log10(size)))
    return {
        "title": title or "poses",
        "fps": file.rate if np.isfinite(file.rate) else None,
        "frames": poses.frames.tolist() or [0],
        "keypoints": list(poses.keypoints),
        "edges": [list(edge) for edge in edges],
        "size": size,
        "radius": min(_SHARE * size, _BONE_SHARE * usual),
        "bodies": [
            {
                "name": name,
                "tracks": _list_tracks(poses.positions[:, k], digits),
                "lengths": np.where(lengths[k] > 0, lengths[k], usual).tolist(),
            }
            for k, name in enumerate(file.individuals)
        ],
        "cameras": [] if file.rig is None else [_describe_camera(each) for each in file.rig],
        "floor": _find_floor(file),
    }


def _scene_size(file: PoseFile) -> float:
    """Return about how far bodies and cameras reach, 1 where nothing does."""
    points = file.poses.positions.reshape(-1, 3)
    if file.rig is not None:
        points = np.concatenate([points, file.rig.centres])
    points = points[np.isfinite(points).all(-1)]
    if not len(points):
        return 1.0
    least, most = np.quantile(points, _REACH, axis=0)
    return float(np.linalg.norm(most - least)) or 1.0


def _list_tracks(positions: Floats, digits: int) -> list[list[list[float] | None]]:
    """Return the places `[keypoint][frame]` of positions `[frame, keypoint, 3]`, None = missing."""
    there: list[list[bool]] = np.asarray(np.isfinite(positions).all(-1)).T.tolist()
    places = (np.round(positions, digits) + 0.0).swapaxes(0, 1).tolist()
    return [
        [place if known else None for place, known in zip(track, own, strict=True)]
        for track, own in zip(places, there, strict=True)
    ]


def _describe_camera(camera: PosedCamera) -> dict[str, Any]:
    """Return a camera in Blender's terms: it looks along -z, y is up in its image.

    `lens` is the focal length and `shift` that of the principal point, in widths of the image. The
    shape of pixels stands for focal lengths that differ.
    """
    (fx, _, cx), (_, fy, cy) = camera.matrix[:2].tolist()
    width, height = camera.size if all(camera.size) else (round(2 * cx + 1), round(2 * cy + 1))
    aspect = fx / fy  # how high a pixel is, in its widths
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation.T * [1.0, -1.0, -1.0]
    matrix[:3, 3] = camera.centre
    return {
        "name": camera.name,
        "width": width,
        "height": height,
        "aspect_x": max(1.0, 1 / aspect),  # Blender takes none below 1
        "aspect_y": max(1.0, aspect),
        "lens": fx / width,
        "shift": [-((cx + 0.5) / width - 0.5), (cy + 0.5 - height / 2) * aspect / width],
        "matrix": matrix.tolist(),
    }


def _find_floor(file: PoseFile) -> list[float] | None:
    """Return the point of the floor below the bodies, z up; None where the floor is not known."""
    world = file.poses.world
    if not (np.isfinite(world.floor).all() and np.isfinite(world.up).all()):
        return None
    points = file.poses.positions.reshape(-1, 3)
    points = points[np.isfinite(points).all(-1)]
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    return [*(middle[:2] + 0.0).tolist(), float(world.floor[2]) + 0.0]


POSES = Format(
    name="blender",
    title="Python script for Blender",
    write=write,
    endings=(".py",),
    result="poses.blend.py",
    rig=True,
    up="z",
    loses=(LENSES, *QUALITY),
)
