"""Triangulate only: the cameras have not moved since they were calibrated.

python known_rig.py CAMERAS KEYPOINTS OUT

CAMERAS: a calibration with extrinsics, in any format (out/cameras.yaml, calibration.toml, ...).
Writes OUT/poses.npz, and OUT/poses.nc for movement.
"""

import sys
from pathlib import Path

import numpy as np

import mocap_calib as mc


def main(cameras: str, keypoints: str, out: Path) -> None:
    """Check that the rig still holds, find identities, triangulate, and write."""
    rig = mc.read_rig(cameras)
    session = mc.read_recording(keypoints, cameras=rig)
    rig = rig.select(session.names)  # the cameras that have keypoints, in their order

    check = mc.verify(session, rig)
    print(f"Verification: {check.verdict}")
    if not check.passes:
        print("calibrate again, or take check.rig:", *check.reasons, sep="\n  ")

    matches = mc.match(session, rig)
    poses = mc.triangulate(session, rig, matches)
    found = np.isfinite(poses.positions).all(-1).mean()
    print(f"{poses}: {100 * found:.0f} % of the points, {np.nanmedian(poses.error):.1f} px")

    out.mkdir(parents=True, exist_ok=True)
    mc.write(poses, out / "poses.nc", format="movement-3d")
    np.savez(out / "poses.npz", positions=poses.positions, keypoints=poses.keypoints)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
