"""Compare a calibration from keypoints with one that was made with a board.

python against_a_board.py CAMERAS BOARD [DEGREES]

CAMERAS: what `mocap-calib run` wrote (out/cameras.yaml). BOARD: the calibration with the board, in
any camera format, with the same names of cameras. The exit status is 1 where a pair of cameras
differs by more than DEGREES (default 1).
"""

import sys

import numpy as np

import mocap_calib as mc


def main(cameras: str, board: str, limit: float = 1.0) -> int:
    """Print the angles between both, pair by pair; return the exit status."""
    rig, reference = mc.read_rig(cameras), mc.read_rig(board)
    common = [name for name in rig.names if name in reference]
    if len(common) < 2:
        sys.exit(f"expected two cameras of the same name or more, found {common}")
    evaluation = mc.evaluate(rig.select(common), reference.select(common))

    turned = np.degrees(evaluation.rotation_error)
    shifted = np.degrees(evaluation.translation_error)
    print("pair, rotation and direction of translation in degrees")
    for (a, b), turn, shift in zip(evaluation.pairs, turned, shifted, strict=True):
        mark = "  <--" if turn > limit else ""
        print(f"{a} - {b}: {turn:.2f} {shift:.2f}{mark}")
    print(f"median {np.median(turned):.2f}, largest {turned.max():.2f}")
    return int(turned.max() > limit)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:3], *map(float, sys.argv[3:])))
