"""Smooth tracks with aniposelib; called by smoothing.py in an environment of its own.

    python smoothing_peers.py tracks.npz result.npz

tracks.npz: pixels `[individual, view, frame, keypoint, 2]` (NaN = missing), scores `[individual,
view, frame, keypoint]`, edges `[edge, 2]`, fisheye, and the cameras as in adjustment_peers.py.
result.npz: positions `[individual, frame, keypoint, 3]`, NaN outside the frames in which an
individual was seen, and the seconds of the processor.
"""

import sys
import time

import numpy as np
from aniposelib.cameras import Camera, CameraGroup, FisheyeCamera


def cameras(tracks):
    """Return the cameras; `triangulate_optim` is a method of theirs."""
    rows = zip(
        *(tracks[name] for name in ("matrix", "size", "rotation", "translation")), strict=True
    )
    kind, terms = (FisheyeCamera, 4) if tracks["fisheye"] else (Camera, 5)
    return CameraGroup(
        [
            kind(matrix, tracks["distortion"][k][:terms], tuple(size), turn, shift, name=str(k))
            for k, (matrix, size, turn, shift) in enumerate(rows)
        ]
    )


def smooth(group, pixels, scores, edges):
    """Return the points `[frame, keypoint, 3]` of one individual; its bones are constraints."""
    seen = np.flatnonzero((np.isfinite(pixels[..., 0]).sum(0) >= 2).any(1))
    found = np.full((*pixels.shape[1:3], 3), np.nan)
    if len(seen) < 3:
        return found
    span = slice(seen[0], seen[-1] + 1)
    found[span] = group.triangulate_optim(
        pixels[:, span], constraints=edges, scores=scores[:, span]
    )
    return found


def main():
    """Read the tracks, smooth them, write the result."""
    with np.load(sys.argv[1]) as file:
        tracks = dict(file)
    group, edges = cameras(tracks), tracks["edges"].tolist()
    pairs = list(zip(tracks["pixels"], tracks["scores"], strict=True))
    few = slice(30)
    # what it compiles on first use is not counted
    smooth(group, pairs[0][0][:, few], pairs[0][1][:, few], edges)
    start = time.process_time()
    found = [smooth(group, pixels, scores, edges) for pixels, scores in pairs]
    np.savez(sys.argv[2], positions=np.stack(found), processor=time.process_time() - start)


if __name__ == "__main__":
    main()
