"""filled_in.tsv: the keypoints that were completed, a row a point, beside files of any format.

Keypoint formats have no place for such a mark. Columns, with tabs between: the camera's name, the
frame number, the instance (order in the file), the keypoint. Readers of keypoints pass it over.
"""

import csv
import io
from collections.abc import Sequence

import numpy as np

from mocap_calib.types import Bools, Keypoints2D

FILLED_TABLE = "filled_in.tsv"


def format_filled_table(views: Sequence[Keypoints2D], filled: Bools) -> bytes:
    """Return the table.

    filled: `[view, frame, instance, keypoint]` the points that were completed.
    """
    text = io.StringIO()
    table = csv.writer(text, delimiter="\t", lineterminator="\n")
    table.writerow(["camera", "frame", "instance", "keypoint"])
    for view, points in zip(views, filled, strict=True):
        for frame, instance, keypoint in np.argwhere(points):
            number, name = view.frames[frame], view.keypoints[keypoint]
            table.writerow([view.camera, number, instance, name])
    return text.getvalue().encode()
