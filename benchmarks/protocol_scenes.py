"""Scenes of the paper's protocol: held-out people placed at random in a room, seen by random cameras, 3 px noise."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_calib.geometry.projection import pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.skeleton import match_names
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Sample, Skeleton

SIZE = (1920, 1080)
ROOM = 4.0  # metres, side of the square where people are
APART = 0.7  # metres between people
RADIUS = (4.5, 8.0)  # of the cameras from the middle
HEIGHT = (0.8, 2.4)  # metres: a person holds them, or a tripod
LEAST = 1.0  # metres between cameras


@dataclass(frozen=True)
class Truth:
    """What the judge knows. ids: `[view, frame, instance]` who each detection is."""

    rig: CameraRig
    ids: Ints


class People:
    """Held-out poses by sequence, +z up, in metres."""

    def __init__(self, path: Path, skeleton: Skeleton, split: str = "test") -> None:
        with np.load(path) as file:
            names = tuple(str(name) for name in file["joints"])
            keep = file["split"] == split
            poses, self.sequence = file["poses"][keep].astype(np.float64), file["sequence"][keep]
        found = match_names(names, skeleton)
        self.poses = poses[:, [int(np.flatnonzero(found == k)[0]) for k in range(len(skeleton.keypoints))]]
        self.skeleton = skeleton

    def draw(self, rng: np.random.Generator, count: int, frames: int) -> Floats:
        """`[frame, person, joint, 3]`: each person is of one sequence, every frame another moment, place and heading."""
        out = np.zeros((frames, count, *self.poses.shape[1:]))
        for person in range(count):
            sequence = rng.choice(np.unique(self.sequence))
            moments = rng.choice(np.flatnonzero(self.sequence == sequence), frames)
            angle = rng.uniform(0, 2 * np.pi, frames)
            turn = matrix_from_vector(angle[:, None] * np.array([0.0, 0.0, 1.0]))
            out[:, person] = np.einsum("fij,fkj->fki", turn, self.poses[moments])
        for frame in out:
            frame[..., :2] += _places(rng, count)[:, None]
        return out


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
        centre = np.stack([out * np.cos(azimuth), out * np.sin(azimuth), rng.uniform(*HEIGHT, views)], axis=-1)
        gaps = np.linalg.norm(centre[:, None] - centre[None], axis=-1) + 99 * np.eye(views)
        if gaps.min() > LEAST:
            break
    aim = np.array([0.0, 0.0, 0.9]) + rng.normal(0, 0.3, (views, 3))
    roll = matrix_from_vector(np.deg2rad(rng.normal(0, 3.0, views))[:, None] * np.array([0.0, 0.0, 1.0]))
    rotation = roll @ looking_along(aim - centre, np.array([0.0, 0.0, -1.0]))
    focal = rng.uniform(1000, 1400, views)
    middle = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
    cameras = [Camera(f"cam{v}", SIZE, np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]]), np.zeros(5), False) for v, f in enumerate(focal)]
    return CameraRig(tuple(cameras), rotation, -np.einsum("vij,vj->vi", rotation, centre), "m")


def scene(people: People, rng: np.random.Generator, *, count: int, frames: int, views: int, noise_px: float, joints: tuple[str, ...]) -> tuple[Sample, Truth]:
    """A recording of `count` people in their first `frames` moments, detections in random order, and its truth.

    joints: those that the detector gives; detections outside of the image are missing.
    """
    bodies = people.draw(rng, count, frames)
    rig = random_rig(rng, views)
    columns = np.array([people.skeleton.keypoints.index(name) for name in joints])
    positions = np.full((views, frames, count, len(columns), 2), np.nan)
    ids = np.zeros((views, frames, count), dtype=np.int64)
    for view, camera in enumerate(rig.cameras):
        order = rng.permuted(np.broadcast_to(np.arange(count), (frames, count)), axis=1)
        mixed = np.take_along_axis(bodies[:, :, columns], order[..., None, None], axis=1)
        pixels = pixels_from_points(camera, mixed @ rig.rotation[view].T + rig.translation[view])
        pixels += rng.normal(0, noise_px, pixels.shape)
        inside = ((pixels >= 0) & (pixels < SIZE)).all(-1)
        inside &= inside.sum(-1, keepdims=True) >= 4
        positions[view] = np.where(inside[..., None], pixels, np.nan)
        ids[view] = np.where(inside.any(-1), order, -1)
    rays = np.stack([rays_from_pixels(camera, seen) for camera, seen in zip(rig.cameras, positions, strict=True)])
    confidence = np.isfinite(positions[..., 0]).astype(np.float64)
    tracked = np.zeros(views, dtype=bool)
    return Sample(rig.cameras, joints, np.arange(frames), positions, confidence, tracked, columns, rays), Truth(rig, ids)
