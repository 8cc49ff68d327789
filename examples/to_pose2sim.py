"""Keypoints in, the calibration of Pose2Sim and the TRC files of OpenSim out.

python to_pose2sim.py KEYPOINTS INTRINSICS FPS METRES OUT

METRES: the distance of the first two cameras, by tape; a calibration alone knows no length.
"""

import sys
from pathlib import Path

import numpy as np

import mocap_calib as mc


def main(keypoints: str, intrinsics: str, fps: float, metres: float, out: Path) -> None:
    """Calibrate, set the scale, and write."""
    result = mc.calibrate(mc.read_recording(keypoints, intrinsics))
    group = result.groups[0]
    print(f"the rig is {group.verdict}", *group.reasons, sep="\n  ")
    if group.verdict == "not determined":
        sys.exit("do not measure with it")

    first, second = group.rig.centres[:2]
    factor = metres / np.linalg.norm(second - first)
    rig, poses = group.rig.scale(factor, "m"), group.poses.scale(factor, "m")

    mc.write(rig, out / "calibration" / "Calib.toml", format="pose2sim")
    lost = mc.write(poses, out / "pose-3d" / "poses.trc", fps=fps)
    print("not held by TRC:", *lost, sep="\n  ")


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    keypoints, intrinsics, fps, metres, out = sys.argv[1:]
    main(keypoints, intrinsics, float(fps), float(metres), Path(out))
