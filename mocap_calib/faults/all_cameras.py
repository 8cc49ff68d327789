"""Hypotheses about the input of all cameras at once, of which no leave-one-out rig knows.

What all cameras show in the mirror makes a rig in the mirror, without any error. But joints have
names, and no body bends its knees backwards: the lifting network predicts from each view which
joints are nearer, and in the mirror they are the farther ones (`Uncertainty.mirrored`).
"""

import numpy as np

from mocap_calib.faults.compare import Alternative
from mocap_calib.faults.hypotheses import describe
from mocap_calib.kinematics import define
from mocap_calib.recording.corrections import Flipped
from mocap_calib.recording.joints import SHIPPED, load_skeleton
from mocap_calib.results import Fault, GroupResult
from mocap_calib.types import Recording
from mocap_calib.verdict.checks import report_frames


def find_upward_axes(group: GroupResult) -> list[Alternative]:
    """Return that y may go up in the images of all cameras: bodies stand on their heads in all.

    Where cameras do, bodies are in the mirror once their y axes are reversed.
    """
    recording = group.recording
    if not _all_upside_down(recording.select(frames=report_frames(recording))):
        return []
    nats = max(0.0, group.uncertainty.mirrored)
    mends = map(Flipped, group.rig.names)
    faults = tuple(
        Fault(mend.camera, mend.word, describe(mend), {"nats": nats}, mend) for mend in mends
    )
    return [Alternative(faults, nats)]


def _all_upside_down(recording: Recording) -> bool:
    """Return whether legs go up from the hip in the images of each camera, mostly."""
    if recording.model not in SHIPPED:
        return False
    legs = define(recording.keypoints, load_skeleton(recording.model)).legs
    if not legs:
        return False
    height = recording.positions[..., 1]
    along = np.array([height[..., chain[-1]] - height[..., chain[0]] for chain in legs])
    upwards, downwards = ((side * along > 0).sum((0, 2, 3)) for side in (-1, 1))
    return bool((upwards > downwards).all())
