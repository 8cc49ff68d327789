"""Make problems of the paper's protocol from real recordings: two views, one frame each."""

from itertools import combinations
from pathlib import Path

import numpy as np

from mocap_calib.io.camera_files import read_cameras, read_rig
from mocap_calib.io.keypoints import read_keypoints
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.types import CameraRig, Ints, Recording

from .methods import Problem
from .scenes import Truth

# whose detections they are: the shipped network that lifts them
RECORDINGS = {
    "shelf": "people",
    "h36m_S5_multi3": "people",
    "mvor_openpose": "people",
    "acinoset_lily_run": "quadruped",
    "sleap_anipose_mouse": "rodent",
}
LEAST_JOINTS = 4  # seen, of a detection that counts


def real_pairs(
    folder: Path, skeleton: str, count: int, *, seed: int
) -> tuple[list[Problem], list[Truth]]:
    """Return pairs of views and frames in which at least two known bodies are in both views.

    One body where no frame has more. folder: a recording with reference and truth, as
    benchmarks/README.md says.
    """
    recording = make_recording(
        read_keypoints([folder / "keypoints"]),
        read_cameras(folder / "intrinsics.toml"),
        load_skeleton(skeleton),
        {},
    )
    rig = read_rig(folder / "reference.toml")
    order = [rig.names.index(name) for name in recording.names]
    with np.load(folder / "truth.npz") as truth:
        ids = _known_ids(recording, truth["ids"][order])
    choices = _choices(ids)
    rng = np.random.default_rng(seed)
    problems, truths = [], []
    for k in rng.permutation(len(choices))[:count]:
        a, b, frame = choices[k]
        chosen = recording.select(frames=np.array([frame]), views=np.array([a, b]))
        sample = take_sample(chosen, slice(None))
        views = [order[a], order[b]]
        reference = CameraRig(sample.cameras, rig.rotation[views], rig.translation[views], rig.unit)
        problems.append(Problem(sample, 0, 1))
        truths.append(Truth(reference, ids[[a, b], frame : frame + 1]))
    return problems, truths


def _known_ids(recording: Recording, ids: Ints) -> Ints:
    """Return `[view, frame, instance]` identities in the recording's frames, -1 = nobody knows.

    ids: the same by the number of the frame.
    """
    known = np.full(recording.positions.shape[:3], -1)
    there = recording.frames < ids.shape[1]
    width = min(ids.shape[2], known.shape[2])
    known[:, there, :width] = ids[:, recording.frames[there], :width]
    known[recording.seen.sum(-1) < LEAST_JOINTS] = -1
    return known


def _choices(ids: Ints) -> list[tuple[int, int, int]]:
    """Return the pairs of views, and indices of frames, that share enough known bodies."""
    choices = []
    for a, b in combinations(range(len(ids)), 2):
        same = (ids[a][:, :, None] == ids[b][:, None]) & (ids[a][:, :, None] >= 0)
        shared = same.any(-1).sum(-1)
        enough = shared >= min(2, shared.max(initial=1))
        choices += [(a, b, int(frame)) for frame in np.flatnonzero(enough)]
    return choices
