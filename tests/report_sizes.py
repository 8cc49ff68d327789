"""Recordings far larger than those that tests calibrate, of noise, which no packing makes small."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import as_strided

from mocap_calib.html_report.source import ReportSource, Seen
from mocap_calib.results import Matches, Poses3D
from mocap_calib.types import CameraRig, Recording


def large_source(
    small: ReportSource, *, cameras: int, people: int, frames: int, seed: int = 0
) -> ReportSource:
    """Return the source of a report of a recording of any size, in little memory.

    small: that of a recording that was calibrated, of which all else is taken.
    A frame of an array begins a number after the one before: each is of other noise.
    """
    rng = np.random.default_rng(seed)
    recording = small.seen.recording
    joints = len(recording.keypoints)
    rig = _spread_rig(small.rig, cameras)
    places = rng.normal(scale=0.01, size=frames + people * joints * 3)
    positions = _slide(places + 0.3, (frames, people, joints, 3))
    pixels = _slide(
        rng.uniform(0, 1000, size=frames + cameras * people * joints * 2).astype(np.float32),
        (frames, cameras, people, joints, 2),
    )
    labels = np.where(rng.random((cameras, frames, people)) < 0.9, np.arange(people), -1)
    shape = (frames, people, joints)
    full = np.broadcast_to(1.0, shape)
    numbers = np.arange(frames)
    poses = Poses3D(
        keypoints=recording.keypoints,
        frames=numbers,
        positions=positions,
        error=full,
        views=np.broadcast_to(2, shape),
        confidence=full,
        unit="m",
        raw=positions,
        source=np.broadcast_to(np.int8(1), shape),
        world=small.poses.world,
    )
    seen = Recording(
        cameras=rig.cameras,
        keypoints=recording.keypoints,
        frames=numbers,
        positions=np.moveaxis(pixels, 1, 0),
        confidence=np.broadcast_to(np.float32(1), (cameras, *shape)),
        tracked=np.ones(cameras, dtype=bool),
        vocabulary=recording.vocabulary,
    )
    return replace(
        small,
        run=_spread_run(small.run, rig.names, people, rng),
        rig=rig,
        covariance=np.tile(np.eye(3) * 1e-4, (cameras, 1, 1)),
        poses=poses,
        seen=Seen(seen, Matches(labels)),
    )


def _slide(noise, shape):
    """Return an array of noise whose first axis goes on by one number."""
    each = noise.itemsize
    strides = [each * int(np.prod(shape[k + 1 :])) for k in range(1, len(shape))]
    return as_strided(noise, shape, (each, *strides), writeable=False)


def _spread_rig(rig: CameraRig, count: int) -> CameraRig:
    """Return a rig of the cameras again and again, under names of their own."""
    which = np.arange(count) % len(rig)
    cameras = [replace(rig.cameras[k], name=f"camera {n}") for n, k in enumerate(which)]
    shift = 0.1 * np.arange(count)[:, None]
    return replace(
        rig,
        cameras=tuple(cameras),
        rotation=rig.rotation[which],
        translation=rig.translation[which] + shift,
    )


def _spread_run(run, names, people, rng):
    """Return run.json as that of a rig of these cameras, with numbers of noise."""

    def noisy(value):
        if isinstance(value, dict):
            return {key: noisy(each) for key, each in value.items()}
        return float(rng.random()) if isinstance(value, float) else value

    camera, pair = run["cameras"][0], run["pairs"][0]
    other = {"score": 0.1, "turned_deg": 90.0}
    return {
        **run,
        "cameras": [{**noisy(camera), "name": name} for name in names],
        "pairs": [
            {**noisy(pair), "a": a, "b": b, "alternatives": [noisy(other) for _ in range(4)]}
            for a, b in combinations(names, 2)
        ],
        "individuals": [
            {"individual": k, "frames": 1000, "cameras": dict.fromkeys(names, 1000)}
            for k in range(people)
        ],
    }
