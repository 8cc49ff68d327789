"""Make scenes of the paper's protocol.

Held-out people and animals placed at random in a room, seen by random cameras, 3 px noise.
"""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from mocap_calib.geometry.lens import pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.recording.joints import load_skeleton, match_names
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Ints, Sample, Skeleton

SIZE = (1920, 1080)
ROOM = 4.0  # metres, side of the square where subjects are
APART = 0.7  # metres between subjects
RADIUS = (4.5, 8.0)  # of the cameras from the middle
HEIGHT = (0.8, 2.4)  # metres: a person holds them, or a tripod
LEAST = 1.0  # metres between cameras
BODY = 0.55  # metres, RMS distance of a joint of an adult from the centroid
MIDDLE = 0.9  # metres above the floor, where the cameras look


@dataclass(frozen=True)
class Truth:
    """What the judge knows. ids: `[view, frame, instance]` who each detection is."""

    rig: CameraRig
    ids: Ints


@dataclass(frozen=True)
class Kind:
    """A set of 3D poses of the protocol.

    model: the shipped network; up: the axis that points up; keep: what was held out of training.
    """

    file: str
    model: str
    up: str
    keep: Literal["split", "last tenth", "last clip", "all"]


# what the network of a kind was trained on is left out: see the model cards
KINDS = {
    "people": Kind("human_body29.npz", "people", "+z", "split"),
    "dog": Kind("train_dog_mocap", "quadruped", "+y", "all"),
    "cheetah": Kind("train_cheetah_fte", "quadruped", "+z", "all"),
    "mouse": Kind("train_mouse22", "rodent", "+z", "last clip"),
    "rat": Kind("train_rat23", "rodent", "+z", "last tenth"),
    "hawk": Kind("train_hawk8", "bird", "+z", "last tenth"),
    "chickadee": Kind("train_chickadee", "bird", "+z", "all"),
}


@dataclass(frozen=True)
class Subjects:
    """Held-out poses `[pose, joint, 3]` of one kind by sequence `[pose]`, +z up.

    All kinds are as large as people, so that 3 px are as much to each.
    """

    skeleton: Skeleton
    joints: tuple[str, ...]
    poses: Floats
    sequence: Ints

    def draw(self, rng: np.random.Generator, count: int, frames: int) -> Floats:
        """Return `[frame, subject, joint, 3]` positions.

        Each subject is of one sequence, every frame another moment, place and heading.
        """
        out = np.zeros((frames, count, *self.poses.shape[1:]))
        for subject in range(count):
            sequence = rng.choice(np.unique(self.sequence))
            moments = rng.choice(np.flatnonzero(self.sequence == sequence), frames)
            angle = rng.uniform(0, 2 * np.pi, frames)
            turn = matrix_from_vector(angle[:, None] * np.array([0.0, 0.0, 1.0]))
            out[:, subject] = np.einsum("fij,fkj->fki", turn, self.poses[moments])
        for frame in out:
            frame[..., :2] += _places(rng, count)[:, None]
        return out


@cache
def load_subjects(folder: Path, kind: Kind) -> Subjects:
    """Return the subjects of a kind whose set of poses lies in a folder."""
    skeleton, path = load_skeleton(kind.model), folder / kind.file
    with np.load(path if path.is_file() else path / "poses3d.npz") as file:
        fields = dict(file)
    names = fields.get("joints")
    if names is None:
        names = json.loads((path / "joints.json").read_text())["names"]
    poses = fields["poses" if "poses" in fields else "poses3d"].astype(np.float64)
    sequence = fields["sequence" if "sequence" in fields else "clip"]
    keep = {
        "split": lambda: fields["split"] == "test",
        "last tenth": lambda: np.arange(len(poses)) * 10 // len(poses) == 9,
        "last clip": lambda: sequence == sequence.max(),
        "all": lambda: np.ones(len(poses), dtype=bool),
    }[kind.keep]()
    found = match_names(tuple(map(str, names)), skeleton)
    known = found >= 0
    whole = keep & np.isfinite(poses[:, known]).all((1, 2))
    joints = tuple(skeleton.keypoints[k] for k in found[known])
    return Subjects(skeleton, joints, _standing(poses[whole][:, known], kind), sequence[whole])


def _standing(poses: Floats, kind: Kind) -> Floats:
    """Turn poses upright; of animals also centred, on the floor, and as large as people."""
    if kind.model == "people":
        return poses
    column = "xyz".index(kind.up[1])
    poses = np.roll(poses, 2 - column, axis=-1)
    poses = poses - poses.mean(1, keepdims=True)
    poses *= BODY / np.median(np.sqrt((poses**2).sum(-1).mean(-1)))
    return poses + [0.0, 0.0, MIDDLE]


def _places(rng: np.random.Generator, count: int) -> Floats:
    """`[person, 2]` places in the room that are not within each other."""
    while True:
        places = rng.uniform(-ROOM / 2, ROOM / 2, (count, 2))
        gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 9 * np.eye(count)
        if gaps.min() > APART:
            return places


def random_rig(rng: np.random.Generator, views: int) -> CameraRig:
    """Cameras at the height of people, at azimuths anywhere, that look into the room."""
    while True:
        azimuth, out = rng.uniform(0, 2 * np.pi, views), rng.uniform(*RADIUS, views)
        centre = np.stack(
            [out * np.cos(azimuth), out * np.sin(azimuth), rng.uniform(*HEIGHT, views)], axis=-1
        )
        gaps = np.linalg.norm(centre[:, None] - centre[None], axis=-1) + 99 * np.eye(views)
        if gaps.min() > LEAST:
            break
    aim = np.array([0.0, 0.0, 0.9]) + rng.normal(0, 0.3, (views, 3))
    roll = matrix_from_vector(
        np.deg2rad(rng.normal(0, 3.0, views))[:, None] * np.array([0.0, 0.0, 1.0])
    )
    rotation = roll @ looking_along(aim - centre, np.array([0.0, 0.0, -1.0]))
    focal = rng.uniform(1000, 1400, views)
    middle = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
    cameras = [
        Camera(
            f"cam{v}",
            SIZE,
            np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]]),
            np.zeros(5),
            False,
        )
        for v, f in enumerate(focal)
    ]
    return CameraRig(tuple(cameras), rotation, -np.einsum("vij,vj->vi", rotation, centre), "m")


def scene(
    subjects: Subjects,
    rng: np.random.Generator,
    *,
    count: int,
    frames: int,
    views: int,
    noise_px: float,
) -> tuple[Sample, Truth]:
    """Return a recording of `count` subjects in their first `frames` moments, and its truth.

    Detections are in random order; those outside of the image are missing.
    """
    joints = subjects.joints
    bodies = subjects.draw(rng, count, frames)
    rig = random_rig(rng, views)
    positions = np.full((views, frames, count, len(joints), 2), np.nan)
    ids = np.zeros((views, frames, count), dtype=np.int64)
    for view in range(views):
        pixels, inside, order = shuffled_view(rng, rig, view, bodies, noise_px)
        inside &= inside.sum(-1, keepdims=True) >= 4
        positions[view] = np.where(inside[..., None], pixels, np.nan)
        ids[view] = np.where(inside.any(-1), order, -1)
    rays = np.stack(
        [
            rays_from_pixels(camera, seen)
            for camera, seen in zip(rig.cameras, positions, strict=True)
        ]
    )
    confidence = np.isfinite(positions[..., 0]).astype(np.float64)
    tracked = np.zeros(views, dtype=bool)
    vocabulary = np.array([subjects.skeleton.keypoints.index(name) for name in joints])
    sample = Sample(
        rig.cameras,
        joints,
        np.arange(frames),
        positions,
        confidence,
        tracked,
        vocabulary,
        rays,
        model=subjects.skeleton.name,
    )
    return sample, Truth(rig, ids)


def shuffled_view(
    rng: np.random.Generator, rig: CameraRig, view: int, bodies: Floats, noise_px: float
) -> tuple[Floats, Bools, Ints]:
    """Return what a camera sees of bodies `[frame, subject, joint, 3]`, in random order.

    Pixels `[frame, instance, joint, 2]` with noise, which of them are inside of the image, and the
    subject `[frame, instance]` that each is.
    """
    camera, (frames, count) = rig.cameras[view], bodies.shape[:2]
    order = rng.permuted(np.broadcast_to(np.arange(count), (frames, count)), axis=1)
    mixed = np.take_along_axis(bodies, order[..., None, None], axis=1)
    pixels = pixels_from_points(camera, mixed @ rig.rotation[view].T + rig.translation[view])
    pixels = pixels + rng.normal(0, noise_px, pixels.shape)
    return pixels, ((pixels >= 0) & (pixels < camera.size)).all(-1), order


def misplace(sample: Sample, share: float) -> Sample:
    """Return a recording in which a share of the points of the last view change places.

    A detector that takes one joint for another does so, and identities that are exchanged.
    """
    rng = np.random.default_rng(0)
    seen = np.argwhere(sample.seen[-1])
    moved = seen[np.sort(rng.permutation(len(seen))[: round(share * len(seen))])]
    places, others = tuple(moved.T), tuple(rng.permutation(moved).T)
    positions, rays = sample.positions.copy(), sample.rays.copy()
    positions[-1][places] = positions[-1][others]
    rays[-1][places] = rays[-1][others]
    return replace(sample, positions=positions, rays=rays)
