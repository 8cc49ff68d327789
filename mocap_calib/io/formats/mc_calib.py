"""MC-Calib's calibrated_cameras_data.yml: cameras camera_0, camera_1, ..., as OpenCV writes YAML.

`camera_pose_matrix` is the transform from the camera to the reference camera of its group;
`distortion_type` 1 is a fisheye. Lengths are those that the user gave of the boards.
"""

from functools import partial

import numpy as np

from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras, entries, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format

_FISHEYE = 1
_KEYS = ("camera_matrix", "distortion_vector", "camera_pose_matrix")


def read(document: Document) -> CameraFile:
    """Read the cameras of one group. Raises FormatError."""
    tree = document.mapping("nb_camera")
    cameras = {name: fields for name, fields in tree.items() if str(name).startswith("camera_")}
    raws, groups = [], set()
    for name, fields in entries(cameras, document.source, *_KEYS):
        where = f"{document.source}: camera {name}"
        pose = numbers(fields["camera_pose_matrix"], "a 4 x 4 camera_pose_matrix", where, 16)
        turned, centre = np.split(pose.reshape(4, 4)[:3], [3], axis=1)
        groups.add(str(fields.get("camera_group", 0)))
        raws.append(
            RawCamera(
                name=name,
                size=[fields.get("img_width"), fields.get("img_height")],
                matrix=fields["camera_matrix"],
                distortion=fields["distortion_vector"],
                fisheye=fields.get("distortion_type") == _FISHEYE,
                rotation=turned.T,
                centre=centre,
            )
        )
    if len(groups) > 1:
        found, remedy = f"{len(groups)} groups", "keep the cameras of one group in the file"
        raise document.refuse("cameras of one group, in one world", found, remedy)
    return collect_cameras(raws, document.source)


FORMAT = Format(
    name="mc-calib",
    title="MC-Calib calibrated_cameras_data.yml",
    sniff=partial(Document.has_line, pattern=r"^nb_camera\s*:"),
    read=read,
    passed_over=("nb_camera",),
)
