"""multical's calibration.json: cameras, and the poses of some of them.

A pose is called by its camera, or `A_to_B`: the transform of world points from camera B, which is
the reference, to camera A. Sizes are (width, height); lengths are those of the boards.
"""

from functools import partial
from typing import Any

import numpy as np

from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras, entries, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.types import Floats

_RELATIVE = "_to_"
_AMBIGUOUS = 4  # coefficients: k1 k2 p1 p2, or those of its fisheye


def read(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping("cameras")
    poses = dict(entries(data.get("camera_poses") or {}, document.source, "R", "T"))
    raws, notes = [], []
    for name, fields in entries(data["cameras"], document.source, "K", "dist"):
        if numbers(fields["dist"], "distortions", document.source).size == _AMBIGUOUS:
            notes.append(f"camera {name} is read as a pinhole; multical's fisheye has 4 terms, too")
        pose = _pose(name, poses, document.source)
        raws.append(
            RawCamera(
                name=name,
                size=fields.get("image_size"),
                matrix=fields["K"],
                distortion=fields["dist"],
                rotation=None if pose is None else pose[:3, :3],
                translation=None if pose is None else pose[:3, 3],
            )
        )
    return collect_cameras(raws, document.source, notes=notes)


def _pose(
    name: str, poses: dict[str, dict[str, Any]], source: str, steps: int = 0
) -> Floats | None:
    """Return the `[4, 4]` transform of a camera from the world, None where the file has none."""
    relative = (key for key in poses if key.startswith(name + _RELATIVE))
    key = name if name in poses else next(relative, None)
    if key is None or steps > len(poses):
        return None
    where, pose = f"{source}: pose {key}", np.eye(4)
    pose[:3, :3] = numbers(poses[key]["R"], "a rotation R", where, 9).reshape(3, 3)
    pose[:3, 3] = numbers(poses[key]["T"], "a translation T", where, 3).ravel()
    if key == name:
        return pose
    reference = _pose(key.removeprefix(name + _RELATIVE), poses, source, steps + 1)
    return None if reference is None else pose @ reference


FORMAT = Format(
    name="multical",
    title="multical calibration.json",
    sniff=partial(Document.has, syntax="json", keys=["cameras", "camera_poses"]),
    read=read,
)
